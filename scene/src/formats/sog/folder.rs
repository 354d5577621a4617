//! Replacing the files of a scene in a folder, all of them or none.

use super::META_NAME;
use super::meta::{MAX_META_BYTES, SogMeta};
use super::streamed::part_names;
use crate::SceneError;
use crate::atomic_file::make_beside;
use crate::input_file::read_file;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Files that appear in a folder when they are complete.
///
/// They are written to a folder in it, with a name that begins with a dot, and moved by
/// [`commit`](Self::commit). Dropped without that, everything is as it was.
pub(super) struct FolderWriter {
    meta: PathBuf,
    folder: PathBuf,
    /// Whether the folder itself is new.
    is_new: bool,
    part: PathBuf,
    written: Vec<String>,
}

impl FolderWriter {
    /// Starts writing the scene with that `meta.json`. Its folder is made if only it is missing.
    pub(super) fn create(meta: &Path) -> Result<Self, SceneError> {
        let Some(name) = meta.file_name() else {
            return Err(SceneError::format(meta, "is not a file name", ""));
        };
        let folder = match meta.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
            _ => PathBuf::from("."),
        };
        let is_new = !folder.exists();
        if is_new {
            fs::create_dir(&folder).map_err(SceneError::io(&folder, "cannot make the folder"))?;
        }
        let action = "cannot make a folder in this folder";
        let place = folder.join(name);
        let ((), part) = make_beside(&place, action, |path| fs::create_dir(path))?;
        let this = Self { meta: meta.to_owned(), folder, is_new, part, written: Vec::new() };
        fs::create_dir(this.old()).map_err(SceneError::io(&this.folder, action))?;
        Ok(this)
    }

    /// Where files that are replaced wait.
    fn old(&self) -> PathBuf {
        self.part.join("old")
    }

    /// Writes one of the files.
    pub(super) fn write(&mut self, name: &str, bytes: &[u8]) -> Result<(), SceneError> {
        let target = self.folder.join(name);
        let part = self.part.join(name);
        // Parts of streamed scenes have folders of their own.
        part.parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| File::create_new(part))
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .map_err(SceneError::io(&target, "cannot write the file"))?;
        self.written.push(name.to_owned());
        Ok(())
    }

    /// Puts the files in place, in the order they were written, and removes those of the scene that
    /// was there before. Gives their paths.
    ///
    /// Fails, with everything as it was, if a file is there already and `overwrite` is not set.
    pub(super) fn commit(mut self, overwrite: bool) -> Result<Vec<PathBuf>, SceneError> {
        let written = std::mem::take(&mut self.written);
        // What is moved is in the folder itself: files, and folders of parts as a whole.
        let mut entries: Vec<String> = Vec::new();
        for name in &written {
            let entry = top(name);
            if !entries.iter().any(|known| known == entry) {
                entries.push(entry.to_owned());
            }
        }
        let mut leaving = self.files_of_old_scene();
        leaving.extend(entries.iter().cloned());
        leaving.sort_unstable();
        leaving.dedup();
        leaving.retain(|name| self.folder.join(name).exists());
        if let Some(name) = leaving.first().filter(|_| !overwrite) {
            let path = self.folder.join(name);
            let help = "overwrite it or choose another folder";
            return Err(SceneError::format(&path, "is there already", help));
        }
        let mut moves: Vec<(PathBuf, PathBuf)> = Vec::new();
        for name in &leaving {
            moves.push((self.folder.join(name), self.old().join(name)));
        }
        for name in &entries {
            moves.push((self.part.join(name), self.folder.join(name)));
        }
        for (i, (from, to)) in moves.iter().enumerate() {
            if let Err(source) = fs::rename(from, to) {
                for (from, to) in moves[..i].iter().rev() {
                    // The first error is the one to report; what can be moved back, is.
                    let _ = fs::rename(to, from);
                }
                return Err(SceneError::io(to, "cannot put the finished file in place")(source));
            }
        }
        self.is_new = false;
        Ok(written.iter().map(|name| self.folder.join(name)).collect())
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
            folders.retain(|name| self.folder.join(name).join(META_NAME).is_file());
            return folders;
        }
        let Ok(meta) = SogMeta::parse(&text, &self.meta) else { return Vec::new() };
        let is_ours = |name: &&str| name.ends_with(".webp") || name.ends_with(".safetensors");
        let plain = meta.files().into_iter().filter(|name| !name.contains('/') && is_ours(name));
        plain.filter(|name| self.folder.join(name).is_file()).map(str::to_owned).collect()
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

impl Drop for FolderWriter {
    fn drop(&mut self) {
        // Nothing better can be done here: an error is already on its way, or all is in place.
        let _ = fs::remove_dir_all(&self.part);
        if self.is_new {
            let _ = fs::remove_dir(&self.folder);
        }
    }
}
