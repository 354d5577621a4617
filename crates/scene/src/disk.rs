//! Where files are written: on the disk, or in a browser in memory, from where they are taken.

#[cfg(target_family = "wasm")]
pub(crate) use place::take;
pub(crate) use place::{File, create_new, length, remove, rename, write_all_at};

#[cfg(not(target_family = "wasm"))]
mod place {
    pub(crate) use std::fs::{File, remove_file as remove, rename};
    use std::io::Result;
    use std::path::Path;

    /// A file that is not there yet, to write and to read.
    pub(crate) fn create_new(path: &Path) -> Result<File> {
        std::fs::OpenOptions::new().read(true).write(true).create_new(true).open(path)
    }

    /// Bytes of a file.
    pub(crate) fn length(path: &Path) -> Result<u64> {
        std::fs::metadata(path).map(|about| about.len())
    }

    /// Writes `bytes` at `offset` without moving a cursor, so threads may share the file.
    pub(crate) fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> Result<()> {
        #[cfg(unix)]
        {
            std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
        }
        #[cfg(windows)]
        {
            let (mut bytes, mut offset) = (bytes, offset);
            while !bytes.is_empty() {
                let written = std::os::windows::fs::FileExt::seek_write(file, bytes, offset)?;
                if written == 0 {
                    return Err(std::io::ErrorKind::WriteZero.into());
                }
                bytes = &bytes[written..];
                offset += written as u64;
            }
            Ok(())
        }
    }
}

#[cfg(target_family = "wasm")]
mod place {
    use std::collections::BTreeMap;
    use std::io::{Cursor, Error, ErrorKind, Result, Seek, SeekFrom, Write};
    use std::path::{Path, PathBuf};
    use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

    /// Bytes with a cursor.
    #[derive(Debug, Clone)]
    pub struct File(Arc<Mutex<Cursor<Vec<u8>>>>);

    static FILES: Mutex<BTreeMap<PathBuf, File>> = Mutex::new(BTreeMap::new());

    fn files() -> MutexGuard<'static, BTreeMap<PathBuf, File>> {
        FILES.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn create_new(path: &Path) -> Result<File> {
        let file = File(Arc::default());
        match files().insert(path.to_owned(), file.clone()) {
            None => Ok(file),
            Some(_) => Err(ErrorKind::AlreadyExists.into()),
        }
    }

    pub(crate) fn length(path: &Path) -> Result<u64> {
        let about = files().get(path).map(File::metadata);
        about.unwrap_or_else(|| Err(ErrorKind::NotFound.into())).map(|about| about.len())
    }

    pub(crate) fn rename(from: &Path, to: &Path) -> Result<()> {
        let mut files = files();
        let file = files.remove(from).ok_or(ErrorKind::NotFound)?;
        files.insert(to.to_owned(), file);
        Ok(())
    }

    pub(crate) fn remove(path: &Path) -> Result<()> {
        files().remove(path).map(drop).ok_or(ErrorKind::NotFound.into())
    }

    /// Takes a file away.
    pub(crate) fn take(path: &Path) -> Option<Vec<u8>> {
        let file = files().remove(path)?;
        Some(std::mem::take(&mut *file.lock()).into_inner())
    }

    pub(crate) fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> Result<()> {
        let start = usize::try_from(offset).map_err(Error::other)?;
        let mut cursor = file.lock();
        let content = cursor.get_mut();
        let end = start + bytes.len();
        if content.len() < end {
            content.try_reserve(end - content.len())?;
            content.resize(end, 0);
        }
        content[start..end].copy_from_slice(bytes);
        Ok(())
    }

    /// What is known of a file.
    pub struct About(u64);

    impl About {
        /// Its bytes.
        pub fn len(&self) -> u64 {
            self.0
        }

        /// Whether there are none.
        pub fn is_empty(&self) -> bool {
            self.0 == 0
        }
    }

    impl File {
        fn lock(&self) -> MutexGuard<'_, Cursor<Vec<u8>>> {
            self.0.lock().unwrap_or_else(PoisonError::into_inner)
        }

        /// As of a file on disk.
        ///
        /// # Errors
        /// None.
        pub fn metadata(&self) -> Result<About> {
            Ok(About(self.lock().get_ref().len() as u64))
        }

        /// As of a file on disk.
        ///
        /// # Errors
        /// None.
        pub fn try_clone(&self) -> Result<Self> {
            Ok(self.clone())
        }

        /// As of a file on disk; there is nothing to do.
        ///
        /// # Errors
        /// None.
        pub fn sync_all(&self) -> Result<()> {
            Ok(())
        }

        /// As of a file on disk.
        ///
        /// # Errors
        /// If the memory is not to be had.
        pub fn set_len(&self, length: u64) -> Result<()> {
            let length = usize::try_from(length).map_err(Error::other)?;
            let mut cursor = self.lock();
            let content = cursor.get_mut();
            content.try_reserve(length.saturating_sub(content.len()))?;
            content.resize(length, 0);
            Ok(())
        }

        /// The bytes.
        pub(crate) fn bytes(&self) -> Vec<u8> {
            self.lock().get_ref().clone()
        }
    }

    impl Write for &File {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            let mut cursor = self.lock();
            cursor.get_mut().try_reserve(bytes.len())?;
            cursor.write(bytes)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    impl Write for File {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            (&*self).write(bytes)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    impl Seek for &File {
        fn seek(&mut self, to: SeekFrom) -> Result<u64> {
            self.lock().seek(to)
        }
    }

    impl Seek for File {
        fn seek(&mut self, to: SeekFrom) -> Result<u64> {
            (&*self).seek(to)
        }
    }
}
