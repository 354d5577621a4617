//! How a serialized scene is cut into attention patches.
//!
//! A scene of `n ≤ K` points is one patch of `n`. A longer one has `⌈n/K⌉` patches of exactly K:
//! the last patch is filled up with the same slots of the patch before it, so that as a set it is
//! the last K points of the sequence. Borrowed points are seen as keys; their outputs are dropped.
//! Every scene is cut for itself: a small batch mate never shrinks another scene's patches.

use crate::error::check_offsets;

/// One patch: a stretch of slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patch {
    /// First slot.
    pub start: usize,
    /// Number of slots, at most K.
    pub len: usize,
    /// Leading slots whose outputs count; the others are borrowed.
    pub own: usize,
}

/// The patches of a batch.
///
/// Made by [`cut`] alone: the attention sizes its buffers by them and finds rows through them without
/// asking again, so what they say of each other must be true.
///
/// ```compile_fail,E0451
/// use scenesplat_kernels::patches::{Patches, cut};
/// let lie = Patches { longest: 1, ..cut(&[0, 4096], 4096) };
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Patches {
    pad: Vec<u32>,
    unpad: Vec<u32>,
    patches: Vec<Patch>,
    longest: usize,
}

/// Cuts scenes (rows `offsets[i]..offsets[i + 1]` of the sequence) into patches of `patch_size`.
///
/// # Panics
/// If `patch_size` is 0 (configurations are checked before), if the offsets do not start at 0 or fall
/// (a bug of the caller), or if padding needs more than 2³² slots.
pub fn cut(offsets: &[usize], patch_size: usize) -> Patches {
    assert!(patch_size > 0, "patch size 0");
    let rows = offsets.last().copied().unwrap_or(0);
    let checked = check_offsets(offsets, rows);
    assert!(checked.is_ok(), "patches: {}", checked.err().map_or(String::new(), |e| e.to_string()));
    // No patch is longer than the sequence; sums with a larger size would wrap around.
    let patch_size = patch_size.min(rows.max(1));
    let mut out = Patches {
        pad: Vec::with_capacity(rows + rows / 64),
        unpad: Vec::with_capacity(rows),
        patches: Vec::new(),
        longest: 0,
    };
    for scene in offsets.windows(2) {
        let (first, n) = (scene[0], scene[1] - scene[0]);
        if n == 0 {
            continue;
        }
        let slot = out.pad.len();
        assert!(u32::try_from(slot + n + patch_size).is_ok(), "more than 2³² attention slots");
        let count = n.div_ceil(patch_size);
        let rest = n % patch_size;
        out.unpad.extend((slot..slot + n).map(|s| s as u32));
        out.pad.extend((first..first + n).map(|p| p as u32));
        if n > patch_size && rest != 0 {
            let borrowed = first + (count - 2) * patch_size;
            out.pad.extend((rest..patch_size).map(|s| (borrowed + s) as u32));
        }
        for i in 0..count {
            let own = patch_size.min(n - i * patch_size);
            let len = if n > patch_size { patch_size } else { n };
            out.patches.push(Patch { start: slot + i * patch_size, len, own });
            out.longest = out.longest.max(len);
        }
    }
    out
}

impl Patches {
    /// Position in the serialized sequence that each slot shows. `[slots]`
    pub fn pad(&self) -> &[u32] {
        &self.pad
    }

    /// Slot of each position. `[N]`
    pub fn unpad(&self) -> &[u32] {
        &self.unpad
    }

    /// Positions of the sequence, N.
    pub fn num_positions(&self) -> usize {
        self.unpad.len()
    }

    /// The patches, scene after scene.
    pub fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// Largest number of slots of a patch.
    pub fn longest(&self) -> usize {
        self.longest
    }

    /// First slot of each patch, closed by the number of slots. `[patches + 1]`
    pub fn boundaries(&self) -> Vec<usize> {
        self.patches.iter().map(|p| p.start).chain([self.pad.len()]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(counts: &[usize], k: usize) -> Patches {
        let mut offsets = vec![0];
        for c in counts {
            offsets.push(offsets[offsets.len() - 1] + c);
        }
        cut(&offsets, k)
    }

    #[test]
    fn examples_by_hand() {
        let p = run(&[5], 4);
        assert_eq!(p.pad, [0, 1, 2, 3, 4, 1, 2, 3]);
        assert_eq!(p.boundaries(), [0, 4, 8]);
        let p = run(&[4, 9, 1], 4);
        assert_eq!(p.pad, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 9, 10, 11, 13]);
        assert_eq!(p.boundaries(), [0, 4, 8, 12, 16, 17]);
        assert_eq!(p.unpad[13], 16);
    }

    #[test]
    fn every_position_is_owned_once() {
        for n in [0, 1, 2, 63, 64, 65, 127, 128, 129, 500] {
            let p = run(&[n, 3, n], 64);
            let mut owned = vec![0; 2 * n + 3];
            for patch in &p.patches {
                assert!(patch.own <= patch.len && patch.len <= 64);
                for slot in patch.start..patch.start + patch.own {
                    owned[p.pad[slot] as usize] += 1;
                    assert_eq!(p.unpad[p.pad[slot] as usize] as usize, slot);
                }
            }
            assert!(owned.iter().all(|&c| c == 1));
        }
    }
}
