//! What one task of the thread pool works on.

use super::Heads;
use crate::gemm::SharedMut;
use crate::patches::Patches;
use std::ops::Range;

/// One patch, one head.
#[derive(Clone, Copy)]
pub(super) struct Task<'a> {
    pub qkv: &'a [f32],
    pub heads: Heads,
    pub head: usize,
    /// Rows of the patch's slots.
    pub rows: &'a [u32],
    /// Leading slots whose outputs count.
    pub own: usize,
    /// Rows and head of the task that this thread will likely do next.
    next: (&'a [u32], usize),
}

impl<'a> Task<'a> {
    /// Task `t` of `patches · heads`: patches in order, the heads of a patch after each other.
    pub fn new(
        qkv: &'a [f32],
        heads: Heads,
        patches: &'a Patches,
        rows: &'a [u32],
        t: usize,
    ) -> Self {
        let place = |t: usize| {
            let patch = patches.patches().get(t / heads.count);
            (patch.map_or(&[][..], |p| &rows[p.start..p.start + p.len]), t % heads.count)
        };
        let (rows, head) = place(t);
        let own = patches.patches()[t / heads.count].own;
        Self { qkv, heads, head, rows, own, next: place(t + 1) }
    }

    /// One part (0 q, 1 k, 2 v) of a row's head.
    pub fn part(&self, row: u32, part: usize) -> &'a [f32] {
        self.part_of(row, part, self.head)
    }

    fn part_of(&self, row: u32, part: usize, head: usize) -> &'a [f32] {
        let c = self.heads.channels();
        let at = row as usize * 3 * c + part * c + head * self.heads.dim;
        &self.qkv[at..at + self.heads.dim]
    }

    /// The row's channels of the head in a result, `[N, C]`.
    ///
    /// # Safety
    /// The row must be inside the result.
    pub unsafe fn result(&self, row: u32, out: SharedMut) -> *mut f32 {
        let at = row as usize * self.heads.channels() + self.head * self.heads.dim;
        // SAFETY: the caller's promise.
        unsafe { out.at(at) }
    }

    /// Asks for the memory that these slots of a block of queries will need: results, and the
    /// queries of the next block of as many lanes. Rows lie anywhere; without this and the next
    /// function a tenth of the time of narrow heads more is waiting for them.
    ///
    /// # Safety
    /// The slots' rows must be inside `out`, `[N, C]`.
    #[inline(always)]
    pub unsafe fn prefetch_queries(&self, slots: Range<usize>, lanes: usize, out: SharedMut) {
        for slot in slots {
            if slot < self.own {
                // SAFETY: the caller's promise.
                prefetch(unsafe { self.result(self.rows[slot], out) }, self.heads.dim);
            }
            if slot + lanes < self.own {
                prefetch(self.part(self.rows[slot + lanes], 0).as_ptr(), self.heads.dim);
            }
        }
    }

    /// Asks for keys and values of the next task, and for its first queries.
    #[inline(always)]
    pub fn prefetch_next(&self, slots: Range<usize>, lanes: usize) {
        let (rows, head) = self.next;
        for slot in slots {
            if let Some(&row) = rows.get(slot) {
                for part in if slot < lanes { 0..3 } else { 1..3 } {
                    prefetch(self.part_of(row, part, head).as_ptr(), self.heads.dim);
                }
            }
        }
    }
}

/// Asks for `len` values to be brought to the second-level cache.
#[inline(always)]
fn prefetch(from: *const f32, len: usize) {
    #[cfg(target_arch = "x86_64")]
    // A row that does not start where a line starts has one line more.
    for value in (0..len + 15).step_by(16) {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        let at = from.wrapping_add(value.min(len.saturating_sub(1)));
        // SAFETY: a hint; it may name any address.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(at.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (from, len);
}
