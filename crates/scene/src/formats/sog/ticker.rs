//! How far writing is, and whether to go on.

use crate::SceneError;
use crate::formats::WriteProgress;

/// Tells the caller how far the work is, and hears whether to go on.
pub(super) struct Ticker<'a> {
    progress: WriteProgress<'a>,
    from: f64,
    to: f64,
}

impl<'a> Ticker<'a> {
    /// For the whole work.
    pub(super) fn new(progress: WriteProgress<'a>) -> Self {
        Self { progress, from: 0.0, to: 1.0 }
    }

    /// At that fraction of this part of the work.
    pub(super) fn tick(&mut self, fraction: f64) -> Result<(), SceneError> {
        let at = self.from + (self.to - self.from) * fraction;
        if (self.progress)(at) { Ok(()) } else { Err(SceneError::Stopped) }
    }

    /// A part of the work, by fractions of this one.
    pub(super) fn part(&mut self, from: f64, to: f64) -> Ticker<'_> {
        let range = self.to - self.from;
        let (from, to) = (self.from + range * from, self.from + range * to);
        Ticker { progress: &mut *self.progress, from, to }
    }
}
