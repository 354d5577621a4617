//! One row a setting: what it is changed to, on which base, and what must come out otherwise.

mod data;
mod evaluation;
mod experiment;
mod losses;
mod network;
mod self_supervised;
mod trainer;

/// What a changed setting must change.
#[derive(Debug, Clone, Copy)]
pub enum Effect {
    /// The parameters at the end.
    Weights,
    /// Evaluations, with the same parameters.
    Measured,
    /// Other lines of the log, with the same parameters.
    Logged,
    /// Which checkpoints are there.
    Files,
    /// What is recorded of data, alarms and the teacher.
    Recorded,
    /// There is no such run: it is refused, and the error says this.
    Refused(&'static str),
    /// No number at all, for this reason.
    #[expect(dead_code, reason = "read by people")]
    Nothing(&'static str),
}

/// One setting.
pub struct Case {
    /// Its name; kinds of tables in brackets.
    pub setting: &'static str,
    /// Which experiment.
    pub base: &'static str,
    /// What else is set, before and after.
    pub with: &'static [(&'static str, &'static str)],
    /// Where it is.
    pub pointer: &'static str,
    /// JSON, or plain words.
    pub value: &'static str,
    /// What follows.
    pub effect: Effect,
}

const fn row(
    setting: &'static str,
    base: &'static str,
    pointer: &'static str,
    value: &'static str,
    effect: Effect,
) -> Case {
    Case { setting, base, with: &[], pointer, value, effect }
}

impl Case {
    const fn with(self, with: &'static [(&'static str, &'static str)]) -> Self {
        Self { with, ..self }
    }
}

/// All settings, in the order of an experiment's file.
pub fn all() -> impl Iterator<Item = &'static Case> {
    [
        experiment::CASES,
        network::CASES,
        data::CASES,
        losses::CASES,
        self_supervised::CASES,
        trainer::CASES,
        evaluation::CASES,
    ]
    .into_iter()
    .flatten()
}
