//! What a long command shows: a bar on a terminal, plain lines elsewhere; and stopping on Ctrl-C or SIGTERM.

use crate::caller::caller;
use crate::flags::Running;
use crate::log::{self, Level, Stage};
use crate::terminal::{is_terminal, note_warning, say, tell};
use crate::threads::set_threads;
use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use scenesplat::scene::printable;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

/// Whether somebody asked to stop.
static STOP: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// Makes Ctrl-C and SIGTERM (of schedulers and containers) ask the work to stop; a second one ends
/// the program at once. SIGHUP is left as it is: `nohup` works.
///
/// # Errors
/// If the system does not allow it.
pub fn listen_for_interrupt() -> std::io::Result<()> {
    static LISTENING: AtomicBool = AtomicBool::new(false);
    if LISTENING.swap(true, Ordering::SeqCst) {
        return Ok(());
    }
    for signal in [SIGINT, SIGTERM] {
        // In this order: the first signal finds the flag unset, and sets it.
        flag::register_conditional_shutdown(signal, 1, Arc::clone(&STOP))?;
        flag::register(signal, Arc::clone(&STOP))?;
    }
    Ok(())
}

/// Whether the user or the system asked to stop, or the program that called.
pub fn interrupted() -> bool {
    STOP.load(Ordering::SeqCst) || caller().is_some_and(|caller| caller.stops())
}

/// Asks the work to stop, as Ctrl-C does.
#[cfg(feature = "mcp")]
pub fn stop() {
    STOP.store(true, Ordering::SeqCst);
}

/// Shows the steps of a command on standard error.
#[derive(Debug)]
pub struct Progress {
    quiet: bool,
    terminal: bool,
    bar: RefCell<Option<ProgressBar>>,
    last_line: RefCell<(Instant, String)>,
    /// Whether each step has a line when it begins, not only when it takes long.
    each_step: bool,
}

/// Time between two plain lines of the same step.
const LINE_EVERY: Duration = Duration::from_secs(10);

impl Progress {
    /// Begins a command: takes its threads, and listens for Ctrl-C unless a caller does.
    ///
    /// # Errors
    /// If there cannot be that many threads.
    pub fn start(running: &Running) -> Result<Self> {
        set_threads(running.threads)?;
        if caller().is_none() {
            // A handler is there already when several commands run in one process.
            let _ = listen_for_interrupt();
        }
        Ok(Self::new(running.quiet))
    }

    /// Shows nothing if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self {
            quiet,
            terminal: is_terminal() && !log::is_json(),
            bar: RefCell::default(),
            last_line: RefCell::new((Instant::now(), String::new())),
            each_step: log::is_verbose() || log::is_json(),
        }
    }

    /// Says one line.
    pub fn say(&self, text: impl AsRef<str>) {
        if let Some(caller) = caller() {
            return caller.say(text.as_ref());
        }
        if self.quiet {
            return;
        }
        self.put(Level::Info, text.as_ref());
    }

    /// Says one line of what is done step by step, if that was asked for.
    pub fn detail(&self, text: impl AsRef<str>) {
        if self.each_step || caller().is_some() {
            self.say(text);
        }
    }

    /// Writes a message above the bar, if there is one.
    fn put(&self, level: Level, text: &str) {
        match self.bar.borrow().as_ref() {
            Some(bar) => bar.println(log::line_of(level, text)),
            None => say(level, text),
        }
    }

    /// Says a warning on standard error, whether quiet or not, each once. Whether it is new.
    pub fn warn(&self, text: &str) -> bool {
        let is_new = note_warning(text);
        if let Some(caller) = caller().filter(|_| is_new) {
            caller.warn(text);
        } else if is_new {
            self.put(Level::Warning, text);
        }
        is_new
    }

    /// Shows how far a step is, `done` in 0..=1.
    pub fn advance(&self, step: &str, done: f64) {
        if let Some(caller) = caller() {
            return caller.advance(step, done);
        }
        if self.quiet {
            return;
        }
        if self.terminal {
            let mut bar = self.bar.borrow_mut();
            let bar = bar.get_or_insert_with(|| {
                let style = ProgressStyle::with_template(
                    "{msg} [{bar:32}] {percent}% {elapsed} ({eta} left)",
                );
                ProgressBar::new(1000).with_style(
                    style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "),
                )
            });
            bar.set_message(printable(step).into_owned());
            bar.set_position((done * 1000.0) as u64);
            return;
        }
        let mut last = self.last_line.borrow_mut();
        if self.each_step && last.1 != step || last.0.elapsed() >= LINE_EVERY {
            *last = (Instant::now(), step.to_owned());
            let text = format!("{step}: {:.0} %", done * 100.0);
            let stage = Stage { name: step, done, total: 1.0 };
            tell(format!("{}\n", log::line_of_stage(stage, &text, Default::default())).as_bytes());
        }
    }

    /// Ends the bar of a step.
    pub fn finish(&self) {
        if let Some(bar) = self.bar.borrow_mut().take() {
            bar.finish_and_clear();
        }
        if self.each_step {
            self.last_line.borrow_mut().1.clear();
        }
    }
}
