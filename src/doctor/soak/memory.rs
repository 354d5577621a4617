//! Whether resident memory stays flat.

use crate::machine::resident_memory_bytes;
use serde::{Deserialize, Serialize};
use std::fmt;

/// What memory may grow by between the start and the end, bytes: allocators keep what they may need
/// again. A leak of a kilobyte a round is above it after 100,000 rounds.
const MAY_GROW: u64 = 64 << 20;
/// Rounds of each kind before the start counts, or what allocators keep would count as growth ...
const WARM_ROUNDS: u64 = 50;
/// ... and the share of the time.
const WARM_SHARE: f64 = 0.05;

/// Resident memory in the course of a soak, bytes; `None` where the system does not tell.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SoakMemory {
    /// After the first rounds of each kind, when everything that is kept has been loaded.
    pub start: Option<u64>,
    /// After half of the time.
    pub middle: Option<u64>,
    /// At the end.
    pub end: Option<u64>,
    /// Largest at any look.
    pub peak: Option<u64>,
    /// What the end may be above the start.
    pub may_grow: u64,
    /// Whether it is not; `None` if the soak was too short to be warm, or the system does not tell.
    pub flat: Option<bool>,
}

#[derive(Default)]
pub(super) struct Watch(SoakMemory);

impl Watch {
    /// Looks, after so much of the time and so many rounds of each kind.
    pub(super) fn look(&mut self, share: f64, rounds: u64) {
        let now = resident_memory_bytes();
        self.0.peak = self.0.peak.max(now);
        if self.0.start.is_none() && share >= WARM_SHARE && rounds >= WARM_ROUNDS {
            self.0.start = now;
        }
        if self.0.middle.is_none() && self.0.start.is_some() && share >= 0.5 {
            self.0.middle = now;
        }
    }

    pub(super) fn end(mut self) -> SoakMemory {
        self.0.end = resident_memory_bytes();
        self.0.peak = self.0.peak.max(self.0.end);
        self.0.may_grow = MAY_GROW;
        self.0.flat = self.0.start.zip(self.0.end).map(|(start, end)| end <= start + MAY_GROW);
        self.0
    }
}

impl fmt::Display for SoakMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = |bytes: Option<u64>| {
            let mib = bytes.map(|bytes| bytes as f64 / f64::from(1 << 20));
            mib.map_or("unknown".to_owned(), |mib| format!("{mib:.1} MiB"))
        };
        write!(
            f,
            "memory: {} at the start, {} in the middle, {} at the end, {} at most: {}",
            text(self.start),
            text(self.middle),
            text(self.end),
            text(self.peak),
            match self.flat {
                Some(true) => "flat",
                Some(false) => "it GROWS",
                None => "too short to tell",
            }
        )
    }
}
