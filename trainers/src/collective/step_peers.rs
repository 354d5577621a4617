//! The ranks of a step as peers of its batch norms.

use super::{Collective, CollectiveError};
use scenesplat_models::peers::Peers;
use std::cell::Cell;
use std::rc::Rc;
use std::time::Instant;

/// What a rank says when it has nothing more to say in a step.
const DONE: u8 = 0;
const NUMBERS: u8 = 1;

/// The ranks while each works at its batch of a step. A rank without a batch has nothing to say and still has to
/// [`finish`](Self::finish).
#[derive(Debug)]
pub(crate) struct StepPeers {
    collective: Rc<dyn Collective>,
    bytes: Cell<u64>,
    seconds: Cell<f64>,
}

impl StepPeers {
    pub(crate) fn new(collective: Rc<dyn Collective>) -> Self {
        Self { collective, bytes: Cell::new(0), seconds: Cell::new(0.0) }
    }

    /// Waits until all ranks are through with their batch. Gives the bytes that this rank sent to each other one, and
    /// the seconds that sending and waiting took.
    pub(crate) fn finish(&self) -> Result<(u64, f64), CollectiveError> {
        while !self.exchange(&[DONE])?.iter().all(|said| said == &[DONE]) {}
        Ok((self.bytes.get(), self.seconds.get()))
    }

    fn exchange(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError> {
        let began = Instant::now();
        let all = self.collective.all_gather(mine)?;
        self.bytes.set(self.bytes.get() + mine.len() as u64);
        self.seconds.set(self.seconds.get() + began.elapsed().as_secs_f64());
        Ok(all)
    }
}

impl Peers for StepPeers {
    fn gather(&self, mine: &[f64]) -> candle_core::Result<Vec<Option<Vec<f64>>>> {
        let mut bytes = vec![NUMBERS];
        bytes.extend(mine.iter().flat_map(|v| v.to_le_bytes()));
        let numbers = |said: Vec<u8>| {
            let (numbers, _) = said.strip_prefix(&[NUMBERS])?.as_chunks::<8>();
            Some(numbers.iter().map(|v| f64::from_le_bytes(*v)).collect())
        };
        let all = self.exchange(&bytes).map_err(candle_core::Error::wrap)?;
        Ok(all.into_iter().map(numbers).collect())
    }
}
