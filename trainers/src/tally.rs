//! How much of the data there was to learn from.

use serde::{Deserialize, Serialize};

/// Rows and batches of a step or an epoch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tally {
    /// Batches.
    pub batches: u64,
    /// Batches that were passed over because they hold nothing.
    pub empty_batches: u64,
    /// Rows of all batches.
    pub rows: u64,
    /// Rows that the loss looks at: those with a label or a target.
    pub counted_rows: u64,
}

impl Tally {
    /// Adds another one.
    pub fn add(&mut self, other: Self) {
        self.batches += other.batches;
        self.empty_batches += other.empty_batches;
        self.rows += other.rows;
        self.counted_rows += other.counted_rows;
    }
}
