//! Defines a hard case.

use super::measures::{Bounds, Measures};
use super::trial::{Failure, Trial};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What a case is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Files and scenes that come in.
    Inputs,
    /// Single operators, losses and metrics.
    Operators,
    /// Steps of training.
    Training,
    /// Whole scenes through the network.
    Scenes,
}

impl Level {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Inputs, Self::Operators, Self::Training, Self::Scenes];

    /// 1 to 4.
    pub fn number(self) -> usize {
        self as usize + 1
    }

    /// Its word in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Inputs => "inputs",
            Self::Operators => "operators",
            Self::Training => "training",
            Self::Scenes => "scenes",
        }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What has to become of the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// It is legal: it is kept, and the result is right within the tolerance.
    Exact,
    /// It is repaired or left out, and a report names it.
    Repaired,
    /// It is refused with an error that says what and where.
    Refused,
}

impl Policy {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Exact, Self::Repaired, Self::Refused];

    /// Its word in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Repaired => "repaired",
            Self::Refused => "refused",
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a case found: how far the result is from the right one, and where it is farthest.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Finding {
    /// Largest error, in the unit of the case's tolerance; 0 where right and wrong is all there is.
    pub error: f64,
    /// The input with that error; empty where there is none to name.
    pub worst: String,
    /// What else was measured of an operator.
    pub measures: Measures,
}

impl Finding {
    /// Right, with nothing to measure.
    pub fn right() -> Self {
        Self::default()
    }

    /// One error, and where it is.
    pub fn of(error: f64, worst: impl Into<String>) -> Self {
        Self { error, worst: worst.into(), ..Self::default() }
    }

    /// Takes an error in if it is the largest so far; a NaN is larger than anything.
    pub fn add(&mut self, error: f64, worst: impl FnOnce() -> String) {
        if error > self.error || error.is_nan() && !self.error.is_nan() {
            (self.error, self.worst) = (error, worst());
        }
    }

    /// Takes the findings of a part in.
    pub fn join(&mut self, part: Self) {
        self.measures.join(part.measures);
        self.add(part.error, || part.worst);
    }
}

/// Right, with nothing to measure.
impl From<()> for Finding {
    fn from((): ()) -> Self {
        Self::default()
    }
}

/// Makes the input and judges what becomes of it.
pub(super) type Check = Box<dyn Fn(&Trial<'_>) -> Result<Finding, Failure> + Send + Sync>;

/// One hard case.
pub struct Case {
    /// Unique; lower case with hyphens.
    pub name: String,
    /// What it is about.
    pub level: Level,
    /// What it is about within the level, one word or two.
    pub area: String,
    /// Where it comes from: a thread, a line of a paper, a bug, a line of a specification.
    pub origin: String,
    /// What is expected.
    pub policy: Policy,
    /// The largest error that passes.
    pub tolerance: f64,
    /// Why it is that.
    pub reason: String,
    /// Whether it belongs to the subset that is run by default.
    pub quick: bool,
    pub(super) check: Check,
}

impl Case {
    /// A case of your own: the library's are in [`catalogue`](super::catalogue).
    ///
    /// It belongs to the quick subset and has a tolerance of 0; change the fields. A check without anything to
    /// measure returns `Ok(())`.
    pub fn new<T: Into<Finding>>(
        name: impl Into<String>,
        level: Level,
        check: impl Fn(&Trial<'_>) -> Result<T, Failure> + Send + Sync + 'static,
    ) -> Self {
        Self {
            name: name.into(),
            level,
            area: String::new(),
            origin: String::new(),
            policy: Policy::Exact,
            tolerance: 0.0,
            reason: String::new(),
            quick: true,
            check: Box::new(move |trial| check(trial).map(Into::into)),
        }
    }

    /// What the measures beside the error may come to.
    pub fn bounds(&self) -> Bounds {
        Bounds::of(self.tolerance)
    }

    /// Runs the check alone: a panic is not caught, and the error is not compared.
    ///
    /// # Errors
    /// If what became of the input is not what should.
    pub fn check(&self, trial: &Trial<'_>) -> Result<Finding, Failure> {
        (self.check)(trial)
    }
}

impl fmt::Debug for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Case").field("name", &self.name).finish_non_exhaustive()
    }
}
