//! What a case has at hand while it runs, and what runs it.

use super::case::{Case, Finding};
use super::verdict::Verdict;
use rayon::ThreadPool;
use scenesplat_scene::formats::npy_writer::write_npy;
use std::any::Any;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Why a case did not pass. Any error becomes one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure(pub String);

impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        let mut text = error.to_string();
        let mut source = error.source();
        while let Some(inner) = source {
            text = format!("{text}: {inner}");
            source = inner.source();
        }
        Self(text)
    }
}

/// Fails the case with a text unless the condition holds.
macro_rules! ensure {
    ($ok:expr, $($text:tt)+) => {
        match $ok {
            true => {}
            false => return Err($crate::doctor::Failure(format!($($text)+))),
        }
    };
}
pub(super) use ensure;

/// Runs cases.
pub struct Doctor {
    folder: PathBuf,
    keep: bool,
    one: ThreadPool,
    many: ThreadPool,
}

impl Doctor {
    /// With a folder in which cases write their files; it is made if need be. The files of a case
    /// are removed when it is done.
    ///
    /// # Errors
    /// If the folder or threads cannot be made.
    pub fn new(folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let pool = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(io::Error::other)
        };
        // Two on a single core too: what depends on the number shows there as well.
        let many = rayon::current_num_threads().max(2);
        Ok(Self { folder: folder.to_owned(), keep: false, one: pool(1)?, many: pool(many)? })
    }

    /// Leaves what the cases made in the folder, also the numbers that went into operators.
    #[must_use]
    pub fn keeping(self) -> Self {
        Self { keep: true, ..self }
    }

    /// Threads of the larger of the two pools.
    pub fn threads(&self) -> usize {
        self.many.current_num_threads()
    }

    /// Runs a case; what it panics with counts as its failure.
    pub fn run(&self, case: &Case) -> Verdict {
        let folder = self.folder.join(&case.name);
        let began = Instant::now();
        let trial = Trial { folder: &folder, doctor: self };
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

/// What a panic said.
pub(super) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a word")
}

/// A case that runs.
pub struct Trial<'a> {
    folder: &'a Path,
    doctor: &'a Doctor,
}

impl Trial<'_> {
    /// Where the case's files are.
    pub fn folder(&self) -> &Path {
        self.folder
    }

    /// Writes a file that the case reads again; it is kept if the user asked for that.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn file(&self, name: &str, bytes: &[u8]) -> Result<PathBuf, Failure> {
        let path = self.folder.join(name);
        std::fs::write(&path, bytes)?;
        Ok(path)
    }

    /// Notes numbers that go into an operator, as a `.npy` file, if the user asked for that.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn keep(&self, name: &str, values: &[f32]) -> Result<(), Failure> {
        if self.doctor.keep {
            write_npy(&self.folder.join(format!("{name}.npy")), &[values.len()], values)?;
        }
        Ok(())
    }

    /// What `compute` gives on one thread, if it gives the same bits on several.
    ///
    /// # Errors
    /// If it fails, or the two differ.
    pub fn one_and_many<C>(&self, compute: C) -> Result<Vec<f32>, Failure>
    where
        C: Fn() -> Result<Vec<f32>, Failure> + Sync,
    {
        let one = self.doctor.one.install(&compute)?;
        let many = self.doctor.many.install(&compute)?;
        ensure!(
            one.len() == many.len(),
            "{} values on one thread, {} on {}",
            one.len(),
            many.len(),
            self.doctor.threads()
        );
        let apart = one.iter().zip(&many).position(|(a, b)| a.to_bits() != b.to_bits());
        if let Some(at) = apart {
            let (a, b, threads) = (one[at], many[at], self.doctor.threads());
            return Err(Failure(format!(
                "value {at}: {a:e} on one thread, {b:e} on {threads}: results depend on threads"
            )));
        }
        Ok(one)
    }

    /// As [`one_and_many`](Self::one_and_many), for what is no list of numbers.
    ///
    /// # Errors
    /// If it fails, or the two differ.
    pub fn same_on_threads<T, C>(&self, compute: C) -> Result<T, Failure>
    where
        T: PartialEq + Send,
        C: Fn() -> Result<T, Failure> + Sync,
    {
        let one = self.doctor.one.install(&compute)?;
        let many = self.doctor.many.install(&compute)?;
        ensure!(one == many, "one thread and {} give different results", self.doctor.threads());
        Ok(one)
    }
}

/// Compares what a case measured with what it allows.
pub(super) fn passes(case: &Case, finding: &Finding) -> bool {
    // A NaN is at most nothing.
    finding.error <= case.tolerance && case.bounds().broken(&finding.measures).is_none()
}
