//! Several files of one folder that appear together.

use crate::atomic_file::{WriteError, check_replaceable, make_beside, write_new};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

/// Files that appear in a folder when all of them are complete, or not at all.
///
/// They wait in a folder inside it, under a name that begins with a dot and cannot be foreseen, and
/// are moved by [`commit`](Self::commit); should a move fail, those before it are taken back.
/// Dropped without `commit`, everything is as it was. A link of such a name in the folder becomes a
/// file, and what it led to is kept.
#[derive(Debug)]
pub struct StagedFolder {
    folder: PathBuf,
    /// Folders made for it, the innermost first.
    new_folders: Vec<PathBuf>,
    /// Where the files wait; `None` if it must not be deleted.
    part: Option<PathBuf>,
    names: Vec<OsString>,
    /// Names under which a folder may go, with what is in it.
    folders: Vec<OsString>,
}

impl StagedFolder {
    /// Starts; `folder`, and those around it, are made if they are missing.
    ///
    /// # Errors
    /// If the folder cannot be made, or takes no new files.
    pub fn create(folder: &Path) -> Result<Self, WriteError> {
        let missing = folder.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists());
        let mut this = Self {
            folder: folder.to_owned(),
            new_folders: missing.map(Path::to_owned).collect(),
            part: None,
            names: Vec::new(),
            folders: Vec::new(),
        };
        fs::create_dir_all(folder).map_err(WriteError::io(folder, "cannot make the folder"))?;
        // A new one each time: what another run left in its own must not come into this one.
        let ((), part) =
            make_beside(&folder.join("new"), CANNOT_STAGE, |path| fs::create_dir(path))?;
        this.part = Some(part);
        Ok(this)
    }

    /// Removes what runs that were killed have left: other folders in which files waited. For who holds a
    /// [`FolderLock`](crate::FolderLock), under which no other run has files waiting here. What cannot be removed stays.
    pub fn remove_left_over(&self) {
        let waits = |name: &OsStr| {
            let digits = name.to_str()?.strip_prefix(".new.")?.strip_suffix(".part")?;
            (digits.len() == 16 && digits.bytes().all(|b| b.is_ascii_hexdigit())).then_some(())
        };
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            // A link of such a name is somebody else's.
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            let other = self.part.as_deref() != Some(&entry.path());
            if is_folder && other && waits(&entry.file_name()).is_some() {
                drop(fs::remove_dir_all(entry.path()));
            }
        }
    }

    /// Where to write the file of that name, which has no folders in it.
    ///
    /// The first file that is added is the last to be put in place: the one by which readers tell
    /// that there is something.
    pub fn add(&mut self, name: impl Into<OsString>) -> PathBuf {
        let name = name.into();
        let path = self.waiting().join(&name);
        if !self.names.contains(&name) {
            self.names.push(name);
        }
        path
    }

    /// Adds every file that waits and was not added by its name, in the order of names.
    ///
    /// # Errors
    /// If the files cannot be listed.
    pub fn add_waiting(&mut self) -> Result<(), WriteError> {
        let failed = || WriteError::io(&self.folder, "cannot list the files that wait");
        let mut found = Vec::new();
        for entry in fs::read_dir(self.waiting()).map_err(failed())? {
            found.push(entry.map_err(failed())?.file_name());
        }
        found.sort();
        found.retain(|name| !self.names.contains(name));
        self.names.extend(found);
        Ok(())
    }

    /// Writes a file of these bytes.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        write_new(&self.add(name), bytes)
            .map_err(WriteError::io(&self.folder.join(name), "cannot write the file"))
    }

    /// Writes a file of these bytes in a folder of the folder, which appears as a whole: one that is
    /// there is replaced with all that is in it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write_in(&mut self, folder: &str, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        let path = self.add(folder);
        self.replace_folder(folder);
        fs::create_dir_all(&path)
            .and_then(|()| write_new(&path.join(name), bytes))
            .map_err(WriteError::io(&self.folder.join(folder).join(name), "cannot write the file"))
    }

    /// Lets a folder of that name, which would be refused, go as files go: with all that is in it.
    pub fn replace_folder(&mut self, name: impl Into<OsString>) {
        self.folders.push(name.into());
    }

    /// What was added, in that order.
    pub fn names(&self) -> impl Iterator<Item = &OsStr> {
        self.names.iter().map(OsString::as_os_str)
    }

    /// The folder in which the files will be.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder in which the files wait.
    pub fn waiting(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.folder)
    }

    /// Moves the files in place, the first one last, and removes those called `old`. Gives the paths
    /// in the order they were added.
    ///
    /// # Errors
    /// If something cannot be moved, or a place is taken by what is no regular file; then everything
    /// is as it was.
    pub fn commit<N: AsRef<OsStr>>(mut self, old: &[N]) -> Result<Vec<PathBuf>, WriteError> {
        let Some(part) = self.part.clone() else { return Ok(Vec::new()) };
        let aside = part.join(".old");
        fs::create_dir(&aside).map_err(WriteError::io(&self.folder, CANNOT_STAGE))?;
        let mut leaving: Vec<&OsStr> = old.iter().map(AsRef::as_ref).collect();
        leaving.extend(self.names.iter().map(OsString::as_os_str));
        leaving.sort_unstable();
        leaving.dedup();
        leaving.retain(|name| self.folder.join(name).symlink_metadata().is_ok());
        for name in &leaving {
            let place = self.folder.join(name);
            let may_go = self.folders.iter().any(|folder| folder == name);
            if !(may_go && place.symlink_metadata().is_ok_and(|about| about.is_dir())) {
                check_replaceable(&place)?;
            }
        }
        let mut moves: Vec<(PathBuf, PathBuf)> = Vec::new();
        // What tells readers that there is something goes first and comes last.
        leaving.sort_by_key(|name| self.names.first().is_none_or(|first| first != name));
        for name in leaving {
            moves.push((self.folder.join(name), aside.join(name)));
        }
        for name in self.names.iter().rev() {
            moves.push((part.join(name), self.folder.join(name)));
        }
        for (i, (from, to)) in moves.iter().enumerate() {
            let Err(source) = fs::rename(from, to) else { continue };
            for (from, to) in moves[..i].iter().rev() {
                if fs::rename(to, from).is_err() {
                    // What cannot be put back must not be deleted.
                    self.part = None;
                    let problem = format!("cannot be moved to {}: {source}", to.display());
                    return Err(WriteError::Stranded { path: from.clone(), problem, aside });
                }
            }
            return Err(WriteError::io(to, "cannot put the finished file in place")(source));
        }
        self.new_folders.clear();
        Ok(self.names.iter().map(|name| self.folder.join(name)).collect())
    }
}

const CANNOT_STAGE: &str = "cannot make a folder in this folder";

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atomic_file::tests::names;

    #[test]
    fn files_appear_together_and_old_ones_go() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a", "gone", "kept"] {
            fs::write(dir.path().join(name), "old").unwrap();
        }
        let mut staged = StagedFolder::create(dir.path()).unwrap();
        staged.write("a", b"new").unwrap();
        fs::write(staged.waiting().join("b"), "new").unwrap();
        staged.add_waiting().unwrap();
        assert_eq!(fs::read(dir.path().join("a")).unwrap(), b"old");
        let paths = staged.commit(&["gone"]).unwrap();
        assert_eq!(paths, [dir.path().join("a"), dir.path().join("b")]);
        assert_eq!(names(dir.path()), ["a", "b", "kept"]);
        assert_eq!(fs::read(dir.path().join("a")).unwrap(), b"new");
    }

    #[test]
    fn what_a_killed_run_left_can_go_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let mut killed = StagedFolder::create(dir.path()).unwrap();
        killed.write("half", b"written").unwrap();
        std::mem::forget(killed);
        let theirs = [".new.0123.part", ".new.0123456789abcdef", ".old.0123456789abcdef.part"];
        for name in theirs {
            fs::create_dir(dir.path().join(name)).unwrap();
        }
        let file = ".new.0123456789abcdef.part";
        fs::write(dir.path().join(file), "a file").unwrap();
        assert_eq!(names(dir.path()).len(), 5);
        let mut staged = StagedFolder::create(dir.path()).unwrap();
        staged.write("a", b"new").unwrap();
        staged.remove_left_over();
        staged.commit::<&str>(&[]).unwrap();
        let mut expected = vec![file, "a"];
        expected.extend(theirs);
        expected.sort_unstable();
        assert_eq!(names(dir.path()), expected);
    }

    #[test]
    fn abandoned_it_leaves_nothing_and_no_folder() {
        let dir = tempfile::tempdir().unwrap();
        let mut staged = StagedFolder::create(&dir.path().join("x/y")).unwrap();
        staged.write("a", b"new").unwrap();
        drop(staged);
        assert!(names(dir.path()).is_empty());
    }

    #[test]
    fn a_move_that_fails_takes_the_others_back() {
        let dir = tempfile::tempdir().unwrap();
        let contents = |name: &str| fs::read_to_string(dir.path().join(name)).unwrap();
        for name in ["a", "b", "c"] {
            fs::write(dir.path().join(name), format!("old {name}")).unwrap();
        }
        let mut staged = StagedFolder::create(dir.path()).unwrap();
        for name in ["a", "b", "c"] {
            staged.write(name, b"new").unwrap();
        }
        // It is moved when "c" has been and "a" has not.
        fs::remove_file(staged.waiting().join("b")).unwrap();
        let error = staged.commit::<&str>(&[]).unwrap_err().to_string();
        assert!(error.contains("cannot put the finished file in place"), "{error}");
        assert_eq!(names(dir.path()), ["a", "b", "c"]);
        assert_eq!([contents("a"), contents("b"), contents("c")], ["old a", "old b", "old c"]);
    }

    #[test]
    fn a_folder_in_the_way_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("b")).unwrap();
        fs::write(dir.path().join("a"), "old").unwrap();
        let mut staged = StagedFolder::create(dir.path()).unwrap();
        staged.write("a", b"new").unwrap();
        staged.write("b", b"new").unwrap();
        let error = staged.commit::<&str>(&[]).unwrap_err().to_string();
        assert!(error.contains("is a folder"), "{error}");
        assert_eq!(names(dir.path()), ["a", "b"]);
        assert_eq!(fs::read(dir.path().join("a")).unwrap(), b"old");
    }

    #[test]
    fn folders_are_replaced_only_where_that_was_said() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["0_0", "0_1", "0_2"] {
            fs::create_dir(dir.path().join(name)).unwrap();
            fs::write(dir.path().join(name).join("old"), "old").unwrap();
        }
        let mut staged = StagedFolder::create(dir.path()).unwrap();
        staged.write_in("0_0", "new", b"new").unwrap();
        staged.replace_folder("0_1");
        staged.commit(&["0_1"]).unwrap();
        assert_eq!(names(dir.path()), ["0_0", "0_2"]);
        assert_eq!(names(&dir.path().join("0_0")), ["new"]);

        let staged = StagedFolder::create(dir.path()).unwrap();
        let error = staged.commit(&["0_2"]).unwrap_err().to_string();
        assert!(error.contains("is a folder"), "{error}");
        assert_eq!(names(&dir.path().join("0_2")), ["old"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_become_files_and_what_they_led_to_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let victim = dir.path().join("victim");
        fs::write(&victim, "precious").unwrap();
        let folder = dir.path().join("out");
        fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(&victim, folder.join("a")).unwrap();
        std::os::unix::fs::symlink("nowhere", folder.join("b")).unwrap();
        let mut staged = StagedFolder::create(&folder).unwrap();
        staged.write("a", b"new").unwrap();
        staged.write("b", b"new").unwrap();
        staged.commit::<&str>(&[]).unwrap();
        assert_eq!(fs::read(&victim).unwrap(), b"precious");
        for name in ["a", "b"] {
            assert!(folder.join(name).symlink_metadata().unwrap().is_file());
        }
    }
}
