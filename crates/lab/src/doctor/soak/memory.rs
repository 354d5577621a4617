//! Whether resident memory stays flat.

use scenesplat::machine::resident_memory_bytes;
use serde::{Deserialize, Serialize};
use std::fmt;

/// What memory may grow by between the middle and the end, bytes. Before the middle it says little: allocators keep
/// what they may need again, and the largest of the random inputs come when they come. A leak grows as fast in the
/// second half as in the first; one of a kilobyte a round is above this after 35,000 rounds of it.
const MAY_GROW: u64 = 32 << 20;
/// Rounds of each kind before the start counts, or what allocators keep would count as growth ...
const WARM_ROUNDS: u64 = 50;
/// ... and the share of the time.
const WARM_SHARE: f64 = 0.05;

/// Resident memory during a soak, bytes; `None` if the system does not report it.
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
    /// What the end may be above the middle.
    pub may_grow: u64,
    /// Whether it is not; `None` if the soak was too short to be warm, or the system does not tell.
    pub flat: Option<bool>,
}

#[derive(Default)]
pub(super) struct Watch {
    memory: SoakMemory,
    past_half: bool,
}

impl Watch {
    /// Looks, after so much of the time and so many rounds of each kind.
    pub(super) fn look(&mut self, share: f64, rounds: u64) {
        let now = resident_memory_bytes();
        let memory = &mut self.memory;
        memory.peak = memory.peak.max(now);
        if memory.start.is_none() && share >= WARM_SHARE && rounds >= WARM_ROUNDS {
            memory.start = now;
        }
        if share >= 0.5 && !self.past_half {
            self.past_half = true;
            // What was not warm by then is not judged.
            memory.middle = memory.start.and(now);
        }
    }

    pub(super) fn end(mut self) -> SoakMemory {
        let memory = &mut self.memory;
        memory.end = resident_memory_bytes();
        memory.peak = memory.peak.max(memory.end);
        memory.may_grow = MAY_GROW;
        memory.flat = memory.middle.zip(memory.end).map(|(middle, end)| end <= middle + MAY_GROW);
        self.memory
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
