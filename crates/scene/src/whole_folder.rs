//! A folder that appears with everything that is in it.

use crate::atomic_file::{WriteError, make_beside, write_new};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// A folder that appears under its name only when it is complete, such as a checkpoint.
///
/// It is filled beside its place, under a name that begins with a dot, cannot be foreseen and did not
/// exist, and renamed by [`commit`](Self::commit); dropped without that, it is deleted. A folder that
/// is there goes only then, and comes back if the rename fails. What is in it is durable before it
/// has its name.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let root = tempfile::tempdir()?;
/// # let place = root.path().join("step-1");
/// let folder = scenesplat_scene::WholeFolder::create(&place)?;
/// folder.write("state.json", b"{}")?;
/// assert!(!place.exists());
/// folder.commit()?;
/// assert_eq!(std::fs::read(place.join("state.json"))?, b"{}");
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct WholeFolder {
    place: PathBuf,
    /// Where it is filled; `None` if there is nothing to delete.
    part: Option<PathBuf>,
}

impl WholeFolder {
    /// Starts; the folders around `place` are made if they are missing.
    ///
    /// # Errors
    /// If `place` is there and no folder, or the folder around it takes no new one.
    pub fn create(place: &Path) -> Result<Self, WriteError> {
        check_folder(place)?;
        if let Some(around) = place.parent().filter(|p| !p.as_os_str().is_empty()) {
            fs::create_dir_all(around).map_err(WriteError::io(around, "cannot make the folder"))?;
        }
        let action = "cannot make a folder beside it";
        let ((), part) = make_beside(place, action, |path| fs::create_dir(path))?;
        Ok(Self { place: place.to_owned(), part: Some(part) })
    }

    /// Where it is being filled.
    pub fn waiting(&self) -> &Path {
        self.part.as_deref().unwrap_or(&self.place)
    }

    /// Writes a file of these bytes, which must not be there yet.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), WriteError> {
        write_new(&self.waiting().join(name), bytes)
            .map_err(WriteError::io(&self.place.join(name), "cannot write the file"))
    }

    /// Makes the files durable and gives the folder its name.
    ///
    /// # Errors
    /// If the disk fails, or the place has been taken by something that is no folder; then everything is
    /// as it was.
    pub fn commit(mut self) -> Result<(), WriteError> {
        let Some(part) = self.part.clone() else { return Ok(()) };
        let failed = |action| WriteError::io(&self.place, action);
        sync(&part).map_err(failed("cannot write to the disk"))?;
        check_folder(&self.place)?;
        swap(&part, &self.place)?;
        self.part = None;
        if let Some(around) = self.place.parent() {
            // The names are durable too, where the system knows such a thing.
            let _ = sync(around);
        }
        Ok(())
    }
}

/// Gives a folder the name `place`; the one that has it goes, or stays if that fails.
fn swap(new: &Path, place: &Path) -> Result<(), WriteError> {
    if place.symlink_metadata().is_err() {
        return fs::rename(new, place).map_err(WriteError::io(place, CANNOT_PLACE));
    }
    let (aside, old) = set_aside(place)?;
    match fs::rename(new, place) {
        Ok(()) => {
            // The new one is there; what is left of the old one harms nobody.
            let _ = fs::remove_dir_all(aside);
            Ok(())
        }
        Err(source) => {
            if let Err(why) = fs::rename(&old, place) {
                let problem = format!("cannot be put in place: {source}; nor the old one: {why}");
                return Err(WriteError::Stranded { path: place.to_owned(), problem, aside });
            }
            let _ = fs::remove_dir(aside);
            Err(WriteError::io(place, CANNOT_PLACE)(source))
        }
    }
}

const CANNOT_PLACE: &str = "cannot put the folder in place";

/// Moves a folder into a new one beside it. Gives the new one, and the old one's path in it.
fn set_aside(place: &Path) -> Result<(PathBuf, PathBuf), WriteError> {
    let action = "cannot move the old folder away";
    let ((), folder) = make_beside(place, action, |path| fs::create_dir(path))?;
    let old = folder.join("old");
    match fs::rename(place, &old) {
        Ok(()) => Ok((folder, old)),
        Err(source) => {
            let _ = fs::remove_dir(&folder);
            Err(WriteError::io(place, action)(source))
        }
    }
}

/// Refuses a place that is there and no folder itself: a link would lead elsewhere.
fn check_folder(place: &Path) -> Result<(), WriteError> {
    match place.symlink_metadata() {
        Ok(about) if !about.is_dir() => Err(WriteError::NoPlace {
            path: place.to_owned(),
            problem: "is there and no folder (move it away)",
        }),
        _ => Ok(()),
    }
}

/// Has the system write the entries of a folder to the disk.
fn sync(folder: &Path) -> std::io::Result<()> {
    if !cfg!(unix) || folder.as_os_str().is_empty() {
        return Ok(());
    }
    match File::open(folder)?.sync_all() {
        // Some file systems keep no promise about folders, and say so.
        Err(error) if error.kind() == std::io::ErrorKind::InvalidInput => Ok(()),
        done => done,
    }
}

impl Drop for WholeFolder {
    fn drop(&mut self) {
        if let Some(part) = &self.part {
            // Nothing better can be done here: an error is already on its way.
            let _ = fs::remove_dir_all(part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atomic_file::tests::names;

    #[test]
    fn it_replaces_a_folder_as_a_whole() {
        let root = tempfile::tempdir().unwrap();
        let place = root.path().join("a/step");
        for round in ["first", "second"] {
            let folder = WholeFolder::create(&place).unwrap();
            folder.write(round, b"new").unwrap();
            assert!(folder.write(round, b"again").is_err(), "not over a file");
            assert_eq!(place.exists(), round == "second");
            folder.commit().unwrap();
            assert_eq!(names(&place), [round]);
            assert_eq!(names(&root.path().join("a")), ["step"]);
        }
    }

    #[test]
    fn abandoned_it_leaves_what_was_there() {
        let root = tempfile::tempdir().unwrap();
        let place = root.path().join("step");
        fs::create_dir(&place).unwrap();
        fs::write(place.join("old"), "old").unwrap();
        let folder = WholeFolder::create(&place).unwrap();
        folder.write("new", b"new").unwrap();
        drop(folder);
        assert_eq!((names(root.path()), names(&place)), (vec!["step".into()], vec!["old".into()]));
    }

    #[test]
    fn the_old_one_comes_back_if_the_new_one_cannot_come() {
        let root = tempfile::tempdir().unwrap();
        let place = root.path().join("step");
        fs::create_dir(&place).unwrap();
        fs::write(place.join("old"), "old").unwrap();
        let error = swap(&root.path().join("none"), &place).unwrap_err().to_string();
        assert!(error.contains("cannot put the folder in place"), "{error}");
        assert_eq!((names(root.path()), names(&place)), (vec!["step".into()], vec!["old".into()]));
    }

    #[cfg(unix)]
    #[test]
    fn links_and_files_in_the_way_are_refused_and_kept() {
        let root = tempfile::tempdir().unwrap();
        let elsewhere = root.path().join("elsewhere");
        fs::create_dir(&elsewhere).unwrap();
        fs::write(elsewhere.join("precious"), "precious").unwrap();
        std::os::unix::fs::symlink("elsewhere", root.path().join("link")).unwrap();
        fs::write(root.path().join("file"), "file").unwrap();
        for name in ["link", "file"] {
            let error = WholeFolder::create(&root.path().join(name)).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("no folder"), "{error}");
        }
        let folder = WholeFolder::create(&root.path().join("late")).unwrap();
        std::os::unix::fs::symlink("elsewhere", root.path().join("late")).unwrap();
        assert!(folder.commit().is_err());
        assert_eq!(names(root.path()), ["elsewhere", "file", "late", "link"]);
        assert_eq!(names(&elsewhere), ["precious"]);
    }
}
