//! How Gaussians come and go while they are optimised.

mod doubling;
mod mcmc;

pub use doubling::{DefaultSettings, DoublingState};
pub use mcmc::McmcSettings;

use crate::{Adam, Model};

/// What a strategy did at a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Refined {
    /// Moved to others.
    pub relocated: usize,
    /// New ones.
    pub added: usize,
    /// Taken out.
    pub removed: usize,
    /// Of those moved or taken out, how many held a value that was not finite.
    pub not_finite: usize,
    /// Whether the opacities were set back.
    pub reset: bool,
}

impl Refined {
    /// Whether rows changed.
    pub fn is_any(&self) -> bool {
        self.relocated + self.added + self.removed > 0
    }
}

/// Splits rows that were drawn, in ascending order, once for each time they were: gives each with its
/// new copies' number.
fn runs(drawn: &[u32]) -> impl Iterator<Item = (usize, usize)> + '_ {
    drawn.chunk_by(|a, b| a == b).map(|run| (run[0] as usize, run.len()))
}

/// Rows with a value that is not finite.
fn not_finite(model: &Model) -> Vec<bool> {
    (0..model.len()).map(|i| !model.is_finite(i)).collect()
}

/// Takes rows out of the model and the optimizer.
fn remove(model: &mut Model, adam: &mut Adam, keep: &[bool]) {
    model.retain(keep);
    adam.retain(keep);
}
