//! The files that a new scene in a folder replaces.

use super::meta::SogMeta;
use crate::SceneError;
use std::fs;
use std::path::Path;

/// The files that the present `meta.json` names and that are there, if it is one; none in other
/// folders, and none but textures and labels, whatever it names.
pub(super) fn files_of_old_scene(meta: &Path) -> Vec<String> {
    let Ok(text) = fs::read(meta) else { return Vec::new() };
    let Ok(old) = SogMeta::parse(&text, meta) else { return Vec::new() };
    let is_ours = |name: &&str| name.ends_with(".webp") || name.ends_with(".safetensors");
    let plain = old.files().into_iter().filter(|name| !name.contains('/') && is_ours(name));
    plain.filter(|name| meta.with_file_name(name).is_file()).map(str::to_owned).collect()
}

/// Refuses to replace what is there.
pub(super) fn check_free<'a>(
    meta: &Path,
    names: impl IntoIterator<Item = &'a str>,
) -> Result<(), SceneError> {
    let mut there: Vec<&str> = names.into_iter().collect();
    there.retain(|name| meta.with_file_name(name).exists());
    match there.iter().min() {
        Some(name) => {
            let path = meta.with_file_name(name);
            Err(SceneError::format(
                &path,
                "is there already",
                "overwrite it or choose another folder",
            ))
        }
        None => Ok(()),
    }
}
