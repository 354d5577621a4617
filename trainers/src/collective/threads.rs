//! Ranks that are threads of one process: for tests, and for machines without a message passing system.

use super::{Collective, CollectiveError};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A rank that is a thread; the others find that it is gone when it is dropped.
#[derive(Debug)]
pub struct ThreadRank {
    rank: usize,
    group: Arc<Group>,
}

#[derive(Debug)]
struct Group {
    size: usize,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// What each rank has brought to the exchange under way.
    brought: Vec<Option<Vec<Vec<u8>>>>,
    /// How many have taken theirs.
    taken: usize,
    /// Ranks that are dropped.
    gone: Vec<usize>,
}

impl ThreadRank {
    /// As many ranks, in their order.
    pub fn group(size: usize) -> Vec<Self> {
        let size = size.max(1);
        let state = State { brought: vec![None; size], ..State::default() };
        let group = Arc::new(Group { size, state: Mutex::new(state), changed: Condvar::new() });
        (0..size).map(|rank| Self { rank, group: Arc::clone(&group) }).collect()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.group.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `ready`.
    fn wait<'a>(
        &'a self,
        mut state: MutexGuard<'a, State>,
        ready: impl Fn(&State) -> bool,
    ) -> Result<MutexGuard<'a, State>, CollectiveError> {
        while !ready(&state) {
            if let Some(&rank) = state.gone.first() {
                return Err(CollectiveError::Gone { rank });
            }
            state = self.group.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(state)
    }

    /// Brings a part for each rank, and takes those that are for this one.
    fn exchange(&self, parts: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, CollectiveError> {
        // The exchange before this one has to be over.
        let mut state = self.wait(self.lock(), |state| state.brought[self.rank].is_none())?;
        state.brought[self.rank] = Some(parts);
        self.group.changed.notify_all();
        let mut state = self.wait(state, |state| state.brought.iter().all(Option::is_some))?;
        let of = |parts: &mut Option<Vec<Vec<u8>>>| match parts {
            Some(parts) => std::mem::take(&mut parts[self.rank]),
            None => Vec::new(),
        };
        let mine = state.brought.iter_mut().map(of).collect();
        state.taken += 1;
        if state.taken == self.group.size {
            state.taken = 0;
            state.brought.fill(None);
            self.group.changed.notify_all();
        }
        Ok(mine)
    }
}

impl Drop for ThreadRank {
    fn drop(&mut self) {
        let rank = self.rank;
        self.lock().gone.push(rank);
        self.group.changed.notify_all();
    }
}

impl Collective for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.group.size
    }

    fn all_gather(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError> {
        self.exchange(vec![mine.to_vec(); self.group.size])
    }

    fn all_to_all(&self, parts: &[&[f32]]) -> Result<Vec<Vec<f32>>, CollectiveError> {
        let bytes = |part: &&[f32]| part.iter().flat_map(|v| v.to_le_bytes()).collect();
        let got = self.exchange(parts.iter().map(bytes).collect())?;
        let values = |bytes: Vec<u8>| {
            let (values, _) = bytes.as_chunks::<4>();
            values.iter().map(|v| f32::from_le_bytes(*v)).collect()
        };
        Ok(got.into_iter().map(values).collect())
    }
}
