//! One run at a time in a folder.

use crate::atomic_file::WriteError;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// Keeps other runs out of a folder while it lives.
///
/// The system's lock on the folder itself (on Unix; elsewhere on a file `.lock` in it): it leaves
/// no trace, and a process that is killed holds it no longer. It binds only those who ask for it. A
/// file system without locks locks nothing.
#[derive(Debug)]
pub struct FolderLock {
    folder: PathBuf,
    _file: File,
}

impl FolderLock {
    /// Locks a folder that exists.
    ///
    /// # Errors
    /// [`WriteError::Busy`] if another process, or another part of this one, holds the lock.
    pub fn acquire(folder: &Path) -> Result<Self, WriteError> {
        let file = Self::open(folder)
            .map_err(WriteError::io(folder, "cannot open the folder to lock it"))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(WriteError::Busy { path: folder.to_owned() }),
            // Some network file systems know no locks, or none on folders.
            Ok(()) | Err(TryLockError::Error(_)) => {
                Ok(Self { folder: folder.to_owned(), _file: file })
            }
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    #[cfg(unix)]
    fn open(folder: &Path) -> std::io::Result<File> {
        File::open(folder)
    }

    #[cfg(not(unix))]
    fn open(folder: &Path) -> std::io::Result<File> {
        File::options().create(true).write(true).truncate(false).open(folder.join(".lock"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_locked_once_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let first = FolderLock::acquire(dir.path()).unwrap();
        let error = FolderLock::acquire(dir.path()).unwrap_err();
        assert!(matches!(error, WriteError::Busy { .. }));
        assert!(error.to_string().contains("another run is writing"));
        drop(first);
        FolderLock::acquire(dir.path()).unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
