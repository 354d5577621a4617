//! Pictures that appear while a run goes on.

use anyhow::Result;
use scenesplat::scene::AtomicFile;
use scenesplat::scene::picture::RgbPicture;
use std::path::{Path, PathBuf};

/// The previews of a run. Of a run that fails, as on a full disk, none stay.
pub(super) struct Previews {
    folder: PathBuf,
    written: Vec<PathBuf>,
}

impl Previews {
    /// None yet; they go into `previews/` of the output folder.
    pub(super) fn of(out: &Path) -> Self {
        Self { folder: out.join("previews"), written: Vec::new() }
    }

    /// Writes one, which appears whole.
    pub(super) fn write(&mut self, step: u64, picture: &RgbPicture) -> Result<()> {
        std::fs::create_dir_all(&self.folder)?;
        let path = self.folder.join(format!("step-{step:09}.png"));
        // One of another run is not taken away.
        if !path.exists() {
            self.written.push(path.clone());
        }
        Ok(AtomicFile::write(&path, &picture.encode_png()?)?)
    }

    /// All stay.
    pub(super) fn keep(mut self) {
        self.written.clear();
    }
}

impl Drop for Previews {
    fn drop(&mut self) {
        if self.written.is_empty() {
            return;
        }
        for path in &self.written {
            // What cannot be taken away stays; the run has failed already.
            let _ = std::fs::remove_file(path);
        }
        let _ = std::fs::remove_dir(&self.folder);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn those_of_a_run_that_fails_are_taken_away() {
        let out = tempfile::tempdir().unwrap();
        let picture = RgbPicture::filled(2, 2, [7; 3]);
        let file = |step: u64| out.path().join(format!("previews/step-{step:09}.png"));
        let mut kept = Previews::of(out.path());
        kept.write(1, &picture).unwrap();
        kept.keep();
        assert!(file(1).is_file());
        let mut failed = Previews::of(out.path());
        failed.write(1, &picture).unwrap();
        failed.write(2, &picture).unwrap();
        drop(failed);
        assert!(file(1).is_file() && !file(2).exists(), "only its own");
        std::fs::remove_file(file(1)).unwrap();
        let mut failed = Previews::of(out.path());
        failed.write(3, &picture).unwrap();
        drop(failed);
        assert!(!out.path().join("previews").exists());
    }
}
