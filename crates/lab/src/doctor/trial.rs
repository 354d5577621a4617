//! What a case has at hand while it runs.

use rayon::ThreadPool;
use scenesplat_scene::formats::npy_writer::write_npy;
use std::any::Any;
use std::io;
use std::path::{Path, PathBuf};

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

/// What a panic said.
pub(super) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("without a word")
}

/// Pools of one thread and of several.
pub(super) struct Pools {
    one: ThreadPool,
    many: ThreadPool,
}

impl Pools {
    pub(super) fn new() -> io::Result<Self> {
        let pool = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(io::Error::other)
        };
        // Two on a single core too: what depends on the number shows there as well.
        let many = rayon::current_num_threads().max(2);
        Ok(Self { one: pool(1)?, many: pool(many)? })
    }

    /// Threads of the larger one.
    pub(super) fn threads(&self) -> usize {
        self.many.current_num_threads()
    }
}

/// A case that runs.
pub struct Trial<'a> {
    pub(super) folder: &'a Path,
    pub(super) keep: bool,
    pub(super) pools: &'a Pools,
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
        if self.keep {
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
        let one = self.pools.one.install(&compute)?;
        let many = self.pools.many.install(&compute)?;
        ensure!(
            one.len() == many.len(),
            "{} values on one thread, {} on {}",
            one.len(),
            many.len(),
            self.pools.threads()
        );
        let apart = one.iter().zip(&many).position(|(a, b)| a.to_bits() != b.to_bits());
        if let Some(at) = apart {
            let (a, b, threads) = (one[at], many[at], self.pools.threads());
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
        let one = self.pools.one.install(&compute)?;
        let many = self.pools.many.install(&compute)?;
        ensure!(one == many, "one thread and {} give different results", self.pools.threads());
        Ok(one)
    }
}
