//! Long work: on threads of its own, without the lock of the interpreter, and stopped by Ctrl-C.

use crate::errors::{Error, error, panicked};
use pyo3::exceptions::{PyKeyboardInterrupt, PyUserWarning};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scenesplat_cli::called::Caller;
use std::ffi::CString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// How often signals are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// The threads; made when they are first needed.
static POOL: Mutex<Option<Arc<ThreadPool>>> = Mutex::new(None);

/// The threads that work.
pub fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    match &*pool {
        Some(pool) => Ok(Arc::clone(pool)),
        None => {
            let made = Arc::new(build(0)?);
            *pool = Some(Arc::clone(&made));
            Ok(made)
        }
    }
}

/// 0: as many as RAYON_NUM_THREADS says, or as there are cores.
fn build(threads: usize) -> PyResult<ThreadPool> {
    let name = |i| format!("scenesplat-{i}");
    ThreadPoolBuilder::new().num_threads(threads).thread_name(name).build().map_err(error)
}

/// Takes so many threads from now on.
#[pyfunction]
pub fn set_num_threads(threads: usize) -> PyResult<()> {
    let most = 4 * std::thread::available_parallelism().map_or(16, usize::from).max(16);
    if !(1..=most).contains(&threads) {
        return Err(crate::errors::argument("threads", format!("{threads} is not in 1 to {most}")));
    }
    let made = Arc::new(build(threads)?);
    *POOL.lock().unwrap_or_else(PoisonError::into_inner) = Some(made);
    Ok(())
}

/// Number of threads.
#[pyfunction]
pub fn num_threads() -> PyResult<usize> {
    Ok(pool()?.current_num_threads())
}

/// Of a process that was forked: the threads of its parent are not there, and nothing may wait for them.
#[pyfunction]
pub fn forget_threads() {
    // A lock that another thread of the parent held would never be free again; then there is no pool to forget.
    if let Ok(mut pool) = POOL.try_lock() {
        std::mem::forget(pool.take());
    }
}

/// What happens in the work.
enum Event<T> {
    Said(String),
    Warned(String),
    Advanced(String, f64),
    Done(std::thread::Result<T>),
}

/// What a running command tells the thread that waits for it.
struct Line<T> {
    events: Sender<Event<T>>,
    stop: Arc<AtomicBool>,
    shows: bool,
}

impl<T: Send> Caller for Line<T> {
    fn say(&self, text: &str) {
        if self.shows {
            let _ = self.events.send(Event::Said(text.to_owned()));
        }
    }

    fn warn(&self, text: &str) {
        let _ = self.events.send(Event::Warned(text.to_owned()));
    }

    fn advance(&self, step: &str, done: f64) {
        if self.shows {
            let _ = self.events.send(Event::Advanced(step.to_owned(), done));
        }
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// Does work that can be stopped, and waits for it. `progress` is called with a step's name and the share that is done.
/// Warnings become Python's. Ctrl-C, an exception of `progress` and warnings that are errors end the work.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Arc<dyn Caller>) -> T + Send + 'static,
) -> PyResult<T> {
    run_with_stop(py, progress, |caller, _| work(caller))
}

/// As [`run`], for work that looks at a flag to know whether it is to stop.
pub fn run_with_stop<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(Arc<dyn Caller>, Arc<AtomicBool>) -> T + Send + 'static,
) -> PyResult<T> {
    let (events, mut happened) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    let shows = progress.is_some();
    let line = Arc::new(Line { events: events.clone(), stop: Arc::clone(&stop), shows });
    pool()?.spawn(move || {
        let done = catch_unwind(AssertUnwindSafe(|| work(line, stopping)));
        let _ = events.send(Event::Done(done));
    });
    let mut raised: Option<PyErr> = None;
    let done = loop {
        let (receiver, event) = py.detach(move || next(happened));
        happened = receiver;
        let happening = match event {
            Ok(Event::Done(done)) => break done,
            Ok(_) if raised.is_some() => Ok(()),
            Ok(Event::Said(text)) => show(progress, &text, None),
            Ok(Event::Advanced(step, share)) => show(progress, &step, Some(share)),
            Ok(Event::Warned(text)) => warn(py, &text),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::new_err("a fault of scenesplat, please report it: no result"));
            }
        };
        if raised.is_none()
            && let Err(error) = happening.and_then(|()| py.check_signals())
        {
            stop.store(true, Ordering::SeqCst);
            raised = Some(error);
        }
    };
    match (raised, done) {
        (Some(error), _) => Err(error),
        (None, Ok(value)) => Ok(value),
        (None, Err(payload)) => Err(panicked(&*payload)),
    }
}

type Next<T> = (Receiver<Event<T>>, Result<Event<T>, RecvTimeoutError>);

fn next<T>(happened: Receiver<Event<T>>) -> Next<T> {
    let event = happened.recv_timeout(LOOK_EVERY);
    (happened, event)
}

fn show(progress: Option<&Bound<'_, PyAny>>, step: &str, share: Option<f64>) -> PyResult<()> {
    progress.map_or(Ok(()), |progress| progress.call1((step, share)).map(drop))
}

/// Warns as Python does.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    // A text from a file may hold what no C text can.
    let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)
}

/// Does short work that borrows arrays, on our threads and without the interpreter's lock; Ctrl-C waits for its end.
pub fn compute<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let pool = pool()?;
    let done = py.detach(|| pool.install(|| catch_unwind(AssertUnwindSafe(work))));
    py.check_signals()?;
    done.map_err(|payload| panicked(&*payload))
}

/// That the caller stopped the work.
pub fn stopped() -> PyErr {
    PyKeyboardInterrupt::new_err(())
}
