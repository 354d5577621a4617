//! Runs cases.

use super::case::Case;
use super::trial::{Failure, Pools, Trial, panic_text};
use super::verdict::Verdict;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Runs cases.
pub struct Doctor {
    folder: PathBuf,
    keep: bool,
    pools: Pools,
}

impl Doctor {
    /// With a folder in which cases write their files; it is made if need be. The files of a case
    /// are removed when it is done.
    ///
    /// # Errors
    /// If the folder or threads cannot be made.
    pub fn new(folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        Ok(Self { folder: folder.to_owned(), keep: false, pools: Pools::new()? })
    }

    /// Leaves what the cases made in the folder, also the numbers that went into operators.
    #[must_use]
    pub fn keeping(self) -> Self {
        Self { keep: true, ..self }
    }

    /// Threads of the larger of the two pools.
    pub fn threads(&self) -> usize {
        self.pools.threads()
    }

    /// Runs a case; what it panics with counts as its failure.
    pub fn run(&self, case: &Case) -> Verdict {
        let folder = self.folder.join(&case.name);
        let began = Instant::now();
        let trial = Trial { folder: &folder, keep: self.keep, pools: &self.pools };
        let made = std::fs::create_dir_all(&folder);
        let checked = made.map_err(Failure::from).and_then(|()| {
            catch_unwind(AssertUnwindSafe(|| case.check(&trial)))
                .unwrap_or_else(|panic| Err(Failure(format!("panicked: {}", panic_text(&*panic)))))
        });
        let empty = std::fs::read_dir(&folder).is_ok_and(|mut files| files.next().is_none());
        if !self.keep || empty {
            // A rest in a folder for such does no harm.
            let _ = std::fs::remove_dir_all(&folder);
        }
        let seconds = began.elapsed().as_secs_f64();
        let (finding, failure) = match checked {
            Ok(finding) => (Some(finding), None),
            Err(Failure(text)) => (None, Some(text)),
        };
        Verdict::new(case, finding, failure, seconds)
    }
}
