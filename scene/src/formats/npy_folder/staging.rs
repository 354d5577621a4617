//! Replacing the files of a scene in a folder, all of them or none.

use crate::SceneError;
use crate::formats::files::make_beside;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// Files that appear in a folder when all of them are complete.
///
/// They wait in a folder in it, of a name that begins with a dot, and are moved by
/// [`commit`](Self::commit). Dropped without that, everything is as it was.
pub(super) struct StagedFolder {
    folder: PathBuf,
    /// Folders made for it, the innermost first.
    new_folders: Vec<PathBuf>,
    part: Option<PathBuf>,
    written: Vec<String>,
}

impl StagedFolder {
    /// Starts; `folder` is made if it is missing.
    pub(super) fn create(folder: &Path) -> Result<Self, SceneError> {
        let missing = folder.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists());
        let mut this = Self {
            folder: folder.to_owned(),
            new_folders: missing.map(Path::to_owned).collect(),
            part: None,
            written: Vec::new(),
        };
        fs::create_dir_all(folder).map_err(SceneError::io(folder, "cannot make the folder"))?;
        // A new one each time: what another run left in its own must not come into the scene.
        let failed = "cannot make a folder in this folder";
        let ((), part) = make_beside(&folder.join("npy"), failed, |path| fs::create_dir(path))?;
        this.part = Some(part);
        Ok(this)
    }

    /// Where to write the file of that name.
    pub(super) fn add(&mut self, name: String) -> PathBuf {
        let path = self.part.as_deref().unwrap_or(&self.folder).join(&name);
        self.written.push(name);
        path
    }

    /// Moves the files in place, the first one last, and removes the files called `old`. Gives the
    /// paths in the order they were added.
    pub(super) fn commit(mut self, old: &[OsString]) -> Result<Vec<PathBuf>, SceneError> {
        let Some(part) = self.part.clone() else { return Ok(Vec::new()) };
        let aside = part.join("old");
        fs::create_dir(&aside)
            .map_err(SceneError::io(&self.folder, "cannot make a folder in this folder"))?;
        let old = old.iter().map(|name| (self.folder.join(name), aside.join(name)));
        let new = self.written.iter().rev();
        let new = new.map(|name| (part.join(name), self.folder.join(name)));
        let moves: Vec<(PathBuf, PathBuf)> = old.chain(new).collect();
        for (i, (from, to)) in moves.iter().enumerate() {
            let Err(source) = fs::rename(from, to) else { continue };
            for (from, to) in moves[..i].iter().rev() {
                if fs::rename(to, from).is_err() {
                    // What cannot be put back must not be deleted.
                    self.part = None;
                    let problem = format!("cannot be moved to {}: {source}", to.display());
                    let help = format!("files of the old scene are in {}", aside.display());
                    return Err(SceneError::format(from, problem, help));
                }
            }
            return Err(SceneError::io(to, "cannot put the finished file in place")(source));
        }
        self.new_folders.clear();
        Ok(self.written.iter().map(|name| self.folder.join(name)).collect())
    }
}

impl Drop for StagedFolder {
    fn drop(&mut self) {
        // Nothing better can be done here: an error is already on its way, or all is in place.
        if let Some(part) = &self.part {
            let _ = fs::remove_dir_all(part);
        }
        for folder in &self.new_folders {
            let _ = fs::remove_dir(folder);
        }
    }
}
