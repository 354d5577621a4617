//! Which voxel feeds which in a submanifold convolution.
//!
//! Built once per scale and shared by every convolution there. Voxels are looked up in blocks of
//! 4×4×4 cells.
//!
//! Two rows may share a voxel of one scene (mixed scenes in training). The original leaves the
//! outcome to chance; here the first such row stands for the voxel, and every row keeps itself as
//! its own center.

use crate::error::{KernelError, check_offsets};
use blocks::Blocks;

mod blocks;
mod window;

/// Output rows of one chunk of pairs.
pub(crate) const CHUNK: usize = 1024;

/// The input–output pairs of a convolution, grouped by chunk of output rows and by tap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KernelMap {
    kernel_size: usize,
    rows: usize,
    duplicates: bool,
    /// Pairs of chunk `c`, tap `t`: `starts[c·taps + t]..starts[c·taps + t + 1]`.
    starts: Vec<usize>,
    input: Vec<u32>,
    output: Vec<u32>,
}

impl KernelMap {
    /// Finds all pairs.
    ///
    /// Tap `(kx·k + ky)·k + kz` of output voxel p is input voxel `p + (kx, ky, kz) − k/2` of the
    /// same scene; there is no pair where that voxel is empty.
    ///
    /// # Shapes
    /// `grid_coord`: `[N, 3]`, 0..2²¹ · `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If offsets or coordinates are out of range, or the kernel size is not 1, 3, 5 or 7.
    pub fn build(
        grid_coord: &[[i32; 3]],
        offsets: &[usize],
        kernel_size: usize,
    ) -> Result<Self, KernelError> {
        if !matches!(kernel_size, 1 | 3 | 5 | 7) {
            return Err(KernelError::KernelSize(kernel_size));
        }
        check_offsets(offsets, grid_coord.len())?;
        crate::serialization::depth_of(grid_coord)?;
        let blocks = Blocks::new(grid_coord, offsets);
        let (starts, input, output) = blocks.pairs(grid_coord, kernel_size);
        let duplicates = blocks.has_duplicates();
        Ok(Self { kernel_size, rows: grid_coord.len(), duplicates, starts, input, output })
    }

    /// Taps along one axis.
    pub fn kernel_size(&self) -> usize {
        self.kernel_size
    }

    /// Number of taps, `k³`.
    pub fn taps(&self) -> usize {
        self.kernel_size.pow(3)
    }

    /// Number of voxels.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of pairs over all taps.
    pub fn num_pairs(&self) -> usize {
        self.input.len()
    }

    /// Whether two rows share a voxel.
    pub fn has_duplicates(&self) -> bool {
        self.duplicates
    }

    pub(crate) fn num_chunks(&self) -> usize {
        self.rows.div_ceil(CHUNK)
    }

    /// Input and output rows of one chunk and tap; output rows ascend.
    pub(crate) fn pairs(&self, chunk: usize, tap: usize) -> (&[u32], &[u32]) {
        let at = chunk * self.taps() + tap;
        let range = self.starts[at]..self.starts[at + 1];
        (&self.input[range.clone()], &self.output[range])
    }

    /// Input and output rows of one tap over all chunks.
    pub fn tap_pairs(&self, tap: usize) -> (Vec<u32>, Vec<u32>) {
        let mut all = (Vec::new(), Vec::new());
        for chunk in 0..self.num_chunks() {
            let (input, output) = self.pairs(chunk, tap);
            all.0.extend_from_slice(input);
            all.1.extend_from_slice(output);
        }
        all
    }

    /// The map with input and output exchanged, taps unchanged.
    pub(crate) fn transposed(&self) -> Self {
        let taps = self.taps();
        let mut counts = vec![0usize; self.num_chunks() * taps + 1];
        let slot = |tap: usize, row: u32| row as usize / CHUNK * taps + tap;
        for chunk in 0..self.num_chunks() {
            for tap in 0..taps {
                for &row in self.pairs(chunk, tap).0 {
                    counts[slot(tap, row) + 1] += 1;
                }
            }
        }
        for i in 1..counts.len() {
            counts[i] += counts[i - 1];
        }
        let starts = counts.clone();
        let mut input = vec![0; self.input.len()];
        let mut output = vec![0; self.input.len()];
        for chunk in 0..self.num_chunks() {
            for tap in 0..taps {
                let (from, to) = self.pairs(chunk, tap);
                for (&from, &to) in from.iter().zip(to) {
                    let at = &mut counts[slot(tap, from)];
                    input[*at] = to;
                    output[*at] = from;
                    *at += 1;
                }
            }
        }
        Self { starts, input, output, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use std::collections::HashMap;

    /// The same map by a table of cells: the first row stands for its voxel, each row is its own center.
    fn slow(grid: &[[i32; 3]], offsets: &[usize], kernel_size: usize) -> KernelMap {
        let (rows, k) = (grid.len(), kernel_size as i32);
        let scene_of = |row: usize| offsets.partition_point(|&o| o <= row);
        let mut first = HashMap::new();
        for (row, &cell) in grid.iter().enumerate() {
            first.entry((scene_of(row), cell)).or_insert(row as u32);
        }
        let (duplicates, starts) = (first.len() < rows, vec![0]);
        let (input, output) = (Vec::new(), Vec::new());
        let mut map = KernelMap { kernel_size, rows, duplicates, starts, input, output };
        for chunk in (0..rows).step_by(CHUNK) {
            for tap in 0..k.pow(3) {
                let d = [tap / (k * k), tap / k % k, tap % k].map(|v| v - k / 2);
                for row in chunk..(chunk + CHUNK).min(rows) {
                    let to = [0, 1, 2].map(|a| grid[row][a] + d[a]);
                    let found = match d {
                        [0, 0, 0] => Some(row as u32),
                        _ => first.get(&(scene_of(row), to)).copied(),
                    };
                    map.input.extend(found);
                    map.output.extend(found.map(|_| row as u32));
                }
                map.starts.push(map.input.len());
            }
        }
        map
    }

    fn all(map: &KernelMap) -> Vec<(usize, u32, u32)> {
        let mut out: Vec<_> = (0..map.taps())
            .flat_map(|t| {
                let (i, o) = map.tap_pairs(t);
                i.into_iter().zip(o).map(move |(i, o)| (t, i, o)).collect::<Vec<_>>()
            })
            .collect();
        out.sort_unstable();
        out
    }

    #[test]
    fn finds_the_same_pairs_in_the_same_order() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut cells = std::collections::BTreeSet::new();
        while cells.len() < 1300 {
            cells.insert(std::array::from_fn::<i32, 3, _>(|_| rng.random_range(0..14)));
        }
        let top = (1 << 21) - 1;
        let mut grid: Vec<[i32; 3]> = cells.into_iter().collect();
        grid.extend([[top; 3], [top, top - 1, top], [0, 0, top], [0, 1, 0], [top - 2, top, top]]);
        // Unsorted rows and two scenes that overlap in space.
        for i in (1..grid.len()).rev() {
            grid.swap(i, rng.random_range(0..=i));
        }
        let offsets = [0, 500, 500, grid.len()];
        for k in [1, 3, 5, 7] {
            let map = KernelMap::build(&grid, &offsets, k).unwrap();
            assert!(!map.has_duplicates());
            // With the order of the pairs, on which the sums of the convolution depend.
            assert_eq!(map, slow(&grid, &offsets, k));
            let back = map.transposed().transposed();
            assert_eq!(all(&back), all(&map));
        }
    }

    #[test]
    fn no_voxel_one_voxel_and_duplicates() {
        let empty = KernelMap::build(&[], &[0], 3).unwrap();
        assert_eq!(empty.num_pairs(), 0);
        let one = KernelMap::build(&[[5, 5, 5]], &[0, 1], 5).unwrap();
        assert_eq!(all(&one), [(62, 0, 0)]);
        let twice = KernelMap::build(&[[1, 1, 1], [1, 1, 1], [1, 1, 2]], &[0, 3], 3).unwrap();
        assert!(twice.has_duplicates());
        assert_eq!(
            all(&twice),
            [(12, 0, 2), (13, 0, 0), (13, 1, 1), (13, 2, 2), (14, 2, 0), (14, 2, 1)],
            "the first row stands for the voxel, each row is its own center"
        );
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let crowded: Vec<[i32; 3]> =
            (0..3000).map(|_| std::array::from_fn(|_| rng.random_range(0..12))).collect();
        for k in [1, 3, 5, 7] {
            let offsets = [0, 1100, crowded.len()];
            let map = KernelMap::build(&crowded, &offsets, k).unwrap();
            assert!(map.has_duplicates());
            assert_eq!(map, slow(&crowded, &offsets, k));
        }
    }

    #[test]
    fn refuses_bad_input() {
        let grid = [[0, 0, 0]];
        assert_eq!(KernelMap::build(&grid, &[0, 1], 4), Err(KernelError::KernelSize(4)));
        assert!(KernelMap::build(&grid, &[0, 2], 3).is_err());
        assert!(KernelMap::build(&grid, &[], 3).is_err());
        assert!(KernelMap::build(&[[-1, 0, 0]], &[0, 1], 3).is_err());
    }
}
