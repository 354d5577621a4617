//! Who called, where a command runs as a function of another program: it shows the progress and decides when to stop.

use std::cell::RefCell;
use std::sync::Arc;

/// A program that runs a command as a function, see [`called`](crate::called).
pub trait Caller: Send + Sync {
    /// A line about what is done.
    fn say(&self, text: &str);
    /// Something that the user should know; each once.
    fn warn(&self, text: &str);
    /// How far a step is, `done` in 0..=1.
    fn advance(&self, step: &str, done: f64);
    /// Whether the work is to stop.
    fn stops(&self) -> bool;
}

thread_local! {
    static CALLER: RefCell<Option<Arc<dyn Caller>>> = const { RefCell::new(None) };
}

/// Puts the caller from before back, also where the work panics.
struct Before(Option<Arc<dyn Caller>>);

impl Drop for Before {
    fn drop(&mut self) {
        CALLER.replace(self.0.take());
    }
}

/// Does some work for a caller, on this thread.
pub fn called_by<T>(caller: Arc<dyn Caller>, work: impl FnOnce() -> T) -> T {
    let _before = Before(CALLER.replace(Some(caller)));
    work()
}

/// Who called the command of this thread; `None` where it is a program's own.
pub fn caller() -> Option<Arc<dyn Caller>> {
    CALLER.with_borrow(Clone::clone)
}
