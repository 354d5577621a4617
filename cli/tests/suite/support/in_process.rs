//! Runs the program in this process, and notices what panics there.

use super::{SMALL_PICTURE, WITH_PICTURE};
use std::ffi::OsString;
#[cfg(unix)]
use std::os::unix::process::ExitStatusExt;
#[cfg(windows)]
use std::os::windows::process::ExitStatusExt;
use std::path::Path;
use std::process::{ExitStatus, Output};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, Once, PoisonError};

/// Runs the program in this process, on as many threads as it is told to take. Pictures are small unless it says a
/// size, and what is done is printed step by step unless it says `--quiet` or, a word of these tests, `--brief`. A panic fails the test, also where the program makes an error of it.
#[track_caller]
pub fn scenesplat(args: &[&str]) -> Output {
    with_defaults(args, None)
}

/// As [`scenesplat`], with this file of defaults.
#[track_caller]
pub fn with_defaults(args: &[&str], file: Option<&Path>) -> Output {
    let given = args.iter().position(|arg| *arg == "--threads").and_then(|at| args.get(at + 1));
    let threads = given.and_then(|n| n.parse().ok()).filter(|n| (1..=8).contains(n)).unwrap_or(0);
    let draws = args.first().is_some_and(|command| WITH_PICTURE.contains(command));
    let small = draws && !args.iter().any(|arg| arg.starts_with("--preview-size"));
    // What a command does step by step is what many tests are about; its first screen has tests of its own.
    let is_plain = args.is_empty() || args[0].starts_with('-');
    let brief = ["--quiet", "--brief", "-v"].iter().any(|flag| args.contains(flag));
    let verbose = (!is_plain && !brief).then_some(&"--verbose");
    let (command, rest) = args.split_at(usize::from(!args.is_empty()));
    let rest = rest.iter().filter(|arg| **arg != "--brief");
    let words = ["scenesplat"].iter().chain(command).chain(verbose).chain(rest);
    let words = words.chain(small.then_some(&SMALL_PICTURE));
    let words = words.map(OsString::from);
    let (code, said) = without_panic(threads, || scenesplat_cli::run_captured(words, file));
    let status = i32::from(code);
    #[cfg(unix)]
    let status = ExitStatus::from_raw(status << 8);
    #[cfg(windows)]
    let status = ExitStatus::from_raw(status as u32);
    Output { status, stdout: said.stdout, stderr: said.stderr }
}

/// Panics by the name of their thread.
static PANICS: Mutex<Vec<(String, String)>> = Mutex::new(Vec::new());

fn panics() -> MutexGuard<'static, Vec<(String, String)>> {
    PANICS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Notes every panic from now on.
fn note_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let tell = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            let thread = std::thread::current().name().unwrap_or_default().to_owned();
            panics().push((thread, panic.to_string()));
            tell(panic);
        }));
    });
}

/// Gives what `work` gives on a pool of its own: waiting for a part of its work, a command must not begin another
/// command. Fails if anything panics on the pool, or on a thread that somebody started meanwhile.
#[track_caller]
fn without_panic<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    static COMMANDS: AtomicUsize = AtomicUsize::new(0);
    note_panics();
    let before = panics().len();
    let name = format!("command {}", COMMANDS.fetch_add(1, Ordering::Relaxed));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).stack_size(8 << 20);
    let named = name.clone();
    let pool = pool.thread_name(move |_| named.clone()).build().unwrap();
    let done = pool.install(work);
    // Tests run on threads of their names, `module::test`, or on the main one.
    let is_other =
        |of: &str| of.starts_with("command ") && of != name || of.contains("::") || of == "main";
    let found: Vec<String> = panics()[before..]
        .iter()
        .filter(|(thread, _)| !is_other(thread))
        .map(|(_, said)| said.clone())
        .collect();
    assert!(found.is_empty(), "a command panicked: {}", found.join("; "));
    done
}

#[test]
fn a_panic_that_became_an_error_is_noticed() {
    let hides = || std::panic::catch_unwind(|| panic!("made on purpose")).is_err();
    let noticed = std::panic::catch_unwind(|| without_panic(1, hides)).unwrap_err();
    let said = noticed.downcast_ref::<String>().unwrap();
    assert!(said.contains("made on purpose"), "{said}");
    assert_eq!(without_panic(1, || 7), 7);
}
