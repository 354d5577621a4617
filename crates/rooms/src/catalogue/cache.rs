//! Decoded models: each is decoded once, and those drawn last are kept within a bound.

use super::piece::Piece;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Bytes of decoded models that are kept.
const LIMIT: usize = 512 << 20;

type Cell = Arc<OnceLock<Result<Arc<Piece>, String>>>;

#[derive(Debug, Default)]
struct State {
    cells: BTreeMap<usize, (Cell, u64)>,
    clock: u64,
}

/// Models by their index.
#[derive(Debug, Default)]
pub(super) struct Cache(Mutex<State>);

impl Cache {
    /// The model of an index; `read` is called if it is not there. Others wait for a model that is being
    /// decoded, not for other models.
    pub(super) fn get(
        &self,
        index: usize,
        read: impl FnOnce() -> Result<Piece, String>,
    ) -> Result<Arc<Piece>, String> {
        let cell = {
            let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            state.clock += 1;
            let now = state.clock;
            let (cell, used) = state.cells.entry(index).or_default();
            *used = now;
            Arc::clone(cell)
        };
        let is_new = cell.get().is_none();
        let piece = cell.get_or_init(|| read().map(Arc::new)).clone();
        if is_new {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).forget(LIMIT);
        }
        piece
    }
}

impl State {
    /// Drops those that were not asked for the longest until the rest is within the limit. Rooms that
    /// hold them keep them.
    fn forget(&mut self, limit: usize) {
        let bytes = |cell: &Cell| match cell.get() {
            Some(Ok(piece)) => piece.bytes(),
            _ => 0,
        };
        let mut total: usize = self.cells.values().map(|(cell, _)| bytes(cell)).sum();
        while total > limit {
            let old = self.cells.iter().filter(|(_, (cell, _))| bytes(cell) > 0);
            let Some(index) = old.min_by_key(|(_, (_, used))| *used).map(|(&index, _)| index)
            else {
                break;
            };
            if let Some((cell, _)) = self.cells.remove(&index) {
                total -= bytes(&cell);
            }
        }
    }
}
