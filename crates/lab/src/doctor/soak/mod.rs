//! Hours of random inputs: nothing panics, nothing that is not finite comes out, memory stays flat.
//!
//! Round `n` of seed `s` is the same on every machine: it depends on the two numbers alone, so what
//! went wrong can be run again by [`soak_round`].

mod memory;
mod report;
mod rounds;

pub use memory::SoakMemory;
pub use report::{SoakKind, SoakProblem, SoakReport};

use super::noise::Noise;
use super::trial::{Failure, panic_text};
use memory::Watch;
use rounds::Bath;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// Problems that a report tells of; more are counted.
const TOLD: usize = 20;

/// How long, and which inputs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoakSettings {
    /// Rounds begin until then; each kind has one at least.
    pub duration: Duration,
    /// Other inputs.
    pub seed: u64,
}

/// What became of a random input.
enum Outcome {
    /// A result that is as it has to be.
    Sound,
    /// An error instead of a result.
    Refused,
}

/// What is done with random inputs.
struct Kind {
    name: &'static str,
    run: fn(&mut Bath, &mut Noise) -> Result<Outcome, Failure>,
}

/// Runs rounds until the time is over. `go_on` gets the share of the time that has passed, and the rounds and problems
/// so far; returning false cancels.
///
/// `folder`: where rounds write their files; nothing is left there. A panic is a problem of its round;
/// its text reaches the panic hook all the same.
///
/// # Errors
/// If the folder cannot be used, or the network inside the program cannot be loaded.
pub fn soak(
    settings: SoakSettings,
    folder: &Path,
    go_on: &mut dyn FnMut(f64, u64, usize) -> bool,
) -> io::Result<SoakReport> {
    run(rounds::KINDS, settings, folder, go_on)
}

/// Runs one round of a seed again and gives its kind; its files stay in the folder.
///
/// # Errors
/// What went wrong.
pub fn soak_round(seed: u64, round: u64, folder: &Path) -> Result<&'static str, Failure> {
    let mut bath = Bath::new(folder)?;
    let kind = &rounds::KINDS[(round % rounds::KINDS.len() as u64) as usize];
    once(kind, &mut bath, seed, round).map_err(|Failure(text)| {
        Failure(format!("round {round} of seed {seed} ({}): {text}", kind.name))
    })?;
    Ok(kind.name)
}

fn once(kind: &Kind, bath: &mut Bath, seed: u64, round: u64) -> Result<Outcome, Failure> {
    let mut rng = Noise::new(Noise::new(seed).next().wrapping_add(round));
    catch_unwind(AssertUnwindSafe(|| (kind.run)(bath, &mut rng)))
        .unwrap_or_else(|panic| Err(Failure(format!("panicked: {}", panic_text(&*panic)))))
}

fn run(
    kinds: &[Kind],
    settings: SoakSettings,
    folder: &Path,
    go_on: &mut dyn FnMut(f64, u64, usize) -> bool,
) -> io::Result<SoakReport> {
    let mut bath = Bath::new(folder).map_err(|Failure(text)| io::Error::other(text))?;
    let began = Instant::now();
    let of_name = |kind: &Kind| SoakKind { name: kind.name.to_owned(), ..SoakKind::default() };
    let mut found: Vec<SoakKind> = kinds.iter().map(of_name).collect();
    let (mut problems, mut round, mut stopped) = (Vec::new(), 0u64, false);
    let mut watch = Watch::default();
    loop {
        let share = began.elapsed().as_secs_f64() / settings.duration.as_secs_f64().max(1e-9);
        if share >= 1.0 && round >= kinds.len() as u64 {
            break;
        }
        watch.look(share, round / kinds.len() as u64);
        if !go_on(share.min(1.0), round, problems.len()) {
            stopped = true;
            break;
        }
        let at = (round % kinds.len() as u64) as usize;
        let start = Instant::now();
        let outcome = once(&kinds[at], &mut bath, settings.seed, round);
        found[at].rounds += 1;
        found[at].seconds += start.elapsed().as_secs_f64();
        match outcome {
            Ok(Outcome::Sound) => {}
            Ok(Outcome::Refused) => found[at].refused += 1,
            Err(Failure(text)) => {
                found[at].problems += 1;
                if problems.len() < TOLD {
                    problems.push(SoakProblem { round, kind: kinds[at].name.to_owned(), text });
                }
            }
        }
        bath.clear()?;
        round += 1;
    }
    let memory = watch.end();
    let passed = found.iter().all(|kind| kind.problems == 0) && memory.flat != Some(false);
    Ok(SoakReport {
        seed: settings.seed,
        asked_seconds: settings.duration.as_secs_f64(),
        seconds: began.elapsed().as_secs_f64(),
        rounds: round,
        kinds: found,
        problems,
        memory,
        stopped,
        passed,
    })
}

#[cfg(test)]
mod tests;
