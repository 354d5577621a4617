//! What a soak found.

use super::SoakMemory;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A kind of round, and how it went.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SoakKind {
    /// Its name.
    pub name: String,
    /// How often it ran.
    pub rounds: u64,
    /// Inputs that were refused with an error, as they may be.
    pub refused: u64,
    /// Rounds that went wrong.
    pub problems: u64,
    /// How long it took in all.
    pub seconds: f64,
}

/// A round that went wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SoakProblem {
    /// Number of the round; with the seed it can be run again.
    pub round: u64,
    /// Kind of the round.
    pub kind: String,
    /// What happened.
    pub text: String,
}

/// What a soak found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SoakReport {
    /// Seed of all rounds.
    pub seed: u64,
    /// How long it was to last, seconds.
    pub asked_seconds: f64,
    /// How long it lasted.
    pub seconds: f64,
    /// Rounds of all kinds.
    pub rounds: u64,
    /// The kinds.
    pub kinds: Vec<SoakKind>,
    /// The first problems.
    pub problems: Vec<SoakProblem>,
    /// Resident memory.
    pub memory: SoakMemory,
    /// Whether somebody ended it before its time.
    pub stopped: bool,
    /// No problem, and memory was flat.
    pub passed: bool,
}

impl fmt::Display for SoakReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "seed {}, {} rounds in {:.1} s", self.seed, self.rounds, self.seconds)?;
        for SoakKind { name, rounds, refused, problems, seconds } in &self.kinds {
            writeln!(
                f,
                "  {name:<12} {rounds:>8} rounds, {refused:>7} refused, {problems:>3} wrong, \
                 {seconds:>8.1} s"
            )?;
        }
        for SoakProblem { round, kind, text } in &self.problems {
            writeln!(f, "WRONG round {round} ({kind}): {text}")?;
        }
        writeln!(f, "{}", self.memory)?;
        let end = if self.stopped { ", stopped before its time" } else { "" };
        write!(f, "{}{end}", if self.passed { "passed" } else { "FAILED" })
    }
}
