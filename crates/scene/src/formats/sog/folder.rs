//! Replacing the files of a scene in a folder, all of them or none.

use super::META_NAME;
use super::meta::{MAX_META_BYTES, SogMeta};
use super::streamed::part_names;
use crate::formats::WriteReport;
use crate::input_file::read_file;
use crate::{SceneError, StagedFolder, WriteError};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// The files of a scene: they appear in a [`StagedFolder`], the description last, and those of the
/// scene that was there before go.
pub(super) struct FolderWriter {
    meta: PathBuf,
    staged: StagedFolder,
    written: Vec<String>,
}

impl FolderWriter {
    /// Starts writing the scene with that `meta.json`. Its folder is made if only it is missing.
    pub(super) fn create(meta: &Path) -> Result<Self, SceneError> {
        let Some(name) = meta.file_name().and_then(OsStr::to_str) else {
            return Err(SceneError::format(meta, "is not a file name in UTF-8", ""));
        };
        let folder = match meta.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        // A path with a slip in it does not make a tree of folders.
        if let Some(around) = folder.parent().filter(|p| !p.as_os_str().is_empty() && !p.exists()) {
            let missing = std::io::ErrorKind::NotFound.into();
            return Err(WriteError::io(around, "is no folder to make one in")(missing).into());
        }
        let mut staged = StagedFolder::create(&folder)?;
        // Named first, so put in place last: readers tell by it that there is a scene.
        staged.add(name);
        Ok(Self { meta: meta.to_owned(), staged, written: Vec::new() })
    }

    /// Writes one of the files.
    pub(super) fn write(&mut self, name: &str, bytes: &[u8]) -> Result<(), SceneError> {
        match name.split_once('/') {
            None => self.staged.write(name, bytes)?,
            Some((folder, name)) => self.staged.write_in(folder, name, bytes)?,
        }
        self.written.push(name.to_owned());
        Ok(())
    }

    /// Puts the files in place, the description last, and removes those of the scene that was there
    /// before. The description comes last in the folder, so that it never names what is not there
    /// yet, and first in the report.
    ///
    /// Fails, with everything as it was, if a file is there already and `overwrite` is not set.
    pub(super) fn commit(
        mut self,
        overwrite: bool,
        report: &mut WriteReport,
    ) -> Result<(), SceneError> {
        let old = self.files_of_old_scene();
        let folder = self.staged.folder().to_owned();
        let is_there = |name: &&OsStr| folder.join(name).symlink_metadata().is_ok();
        let mut leaving: Vec<&OsStr> = old.iter().map(OsStr::new).collect();
        leaving.extend(self.staged.names());
        leaving.sort_unstable();
        if let Some(name) = leaving.into_iter().find(is_there).filter(|_| !overwrite) {
            let help = "overwrite it or choose another folder";
            return Err(SceneError::format(&folder.join(name), "is there already", help));
        }
        for name in old.iter().filter(|name| is_part_folder(name)) {
            self.staged.replace_folder(name);
        }
        self.staged.commit(&old)?;
        self.written.rotate_right(1);
        self.written.iter().try_for_each(|name| report.wrote(&folder.join(name)))
    }

    /// The files that the present `meta.json` names, if it is one; none in other folders, and none
    /// but textures and labels, whatever it names.
    fn files_of_old_scene(&self) -> Vec<String> {
        let Ok(text) = read_file(&self.meta, MAX_META_BYTES as u64) else { return Vec::new() };
        if let Some(parts) = part_names(&text) {
            // A folder of a part has textures and a description, and nothing of anybody else.
            let folders = parts.iter().map(|name| top(name)).filter(|name| is_part_folder(name));
            let mut folders: Vec<String> = folders.map(str::to_owned).collect();
            folders.sort_unstable();
            folders.dedup();
            folders.retain(|name| self.staged.folder().join(name).join(META_NAME).is_file());
            return folders;
        }
        let Ok(meta) = SogMeta::parse(&text, &self.meta) else { return Vec::new() };
        let is_ours = |name: &&str| name.ends_with(".webp") || name.ends_with(".safetensors");
        let plain = meta.files().into_iter().filter(|name| !name.contains('/') && is_ours(name));
        plain.filter(|name| self.staged.folder().join(name).is_file()).map(str::to_owned).collect()
    }
}

/// The first part of a path.
fn top(name: &str) -> &str {
    name.split('/').next().unwrap_or(name)
}

/// Whether a folder is called as those of parts are: `<level>_<number>`.
fn is_part_folder(name: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    name.split_once('_').is_some_and(|(level, number)| is_number(level) && is_number(number))
}
