//! Voxels in the order of their hash, without sorting by 64 bits.
//!
//! The hash ends with an exclusive or of `z`. So the cells of a column (equal `x`, `y`) share all
//! bits above those of `z`: columns are sorted by these, a few times fewer than voxels, and within a
//! column the handful of low bits is left.

use super::CHUNK;
use super::keys::fnv_key;
use super::parts::{pieces, running_sum};
use crate::serialization::Sorted;
use rayon::prelude::*;

/// Voxels by ascending [`fnv_key`]; those of one key stay as they are.
///
/// `cells` ascend by `x, y, z`; all `z` are below `2^z_bits`.
pub(super) fn voxels_by_hash(cells: &[[i32; 3]], z_bits: u32) -> Vec<u32> {
    let key = |voxel: u32| fnv_key(cells[voxel as usize].map(|c| c as u32));
    let mut starts: Vec<u32> = (0..cells.len() as u32)
        .into_par_iter()
        .with_min_len(CHUNK)
        .filter(|&v| v == 0 || cells[v as usize - 1][..2] != cells[v as usize][..2])
        .collect();
    let high: Vec<u64> =
        starts.par_iter().with_min_len(CHUNK).map(|&start| key(start) >> z_bits).collect();
    starts.push(cells.len() as u32);

    let sorted = Sorted::of(&high);
    let column = |entry: &u64| {
        let column = (entry & sorted.row_mask) as usize;
        starts[column]..starts[column + 1]
    };
    let counts: Vec<usize> = sorted
        .entries
        .par_chunks(CHUNK)
        .map(|entries| entries.iter().map(|e| column(e).len()).sum())
        .collect();
    let mut voxels = vec![0; cells.len()];
    pieces(&mut voxels, &running_sum(&counts))
        .into_par_iter()
        .zip(sorted.entries.par_chunks(CHUNK))
        .for_each(|(mut rest, entries)| {
            // Low bits of the key above the voxel.
            let mut packed = Vec::new();
            for entry in entries {
                let column = column(entry);
                let base = key(column.start) ^ cells[column.start as usize][2] as u64;
                let (listed, after) = std::mem::take(&mut rest).split_at_mut(column.len());
                rest = after;
                packed.clear();
                packed.extend(column.map(|voxel| {
                    let low = (base ^ cells[voxel as usize][2] as u64) & ((1 << z_bits) - 1);
                    low << 32 | u64::from(voxel)
                }));
                packed.sort_unstable();
                listed.iter_mut().zip(&packed).for_each(|(to, &p)| *to = p as u32);
            }
        });
    put_shared_columns_in_order(&mut voxels, &sorted, &high, |e| column(e).len(), key);
    voxels
}

/// Sorts the voxels of columns that agree in the high bits: far apart cells of one hash, or nearly.
fn put_shared_columns_in_order(
    voxels: &mut [u32],
    sorted: &Sorted,
    high: &[u64],
    len: impl Fn(&u64) -> usize,
    key: impl Fn(u32) -> u64,
) {
    let alike = |a: u64, b: u64| !sorted.differ(high, a, b);
    if !sorted.entries.par_windows(2).with_min_len(CHUNK).any(|w| alike(w[0], w[1])) {
        return;
    }
    let mut rest = voxels;
    for columns in sorted.entries.chunk_by(|&a, &b| alike(a, b)) {
        let (listed, after) =
            std::mem::take(&mut rest).split_at_mut(columns.iter().map(&len).sum());
        rest = after;
        if columns.len() > 1 {
            // Of equal keys the smaller voxel first: they ascend by `x, y, z`.
            listed.sort_unstable_by_key(|&voxel| (key(voxel), voxel));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid_sample::MAX_CELL;
    use rand::{Rng, SeedableRng};

    #[test]
    fn equals_sorting_by_key() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        for (n, width, bits) in [(0, 4, 3), (1, 4, 3), (5000, 40, 5), (40_000, MAX_CELL, 21)] {
            let mut cells: Vec<[i32; 3]> = (0..n)
                .map(|_| {
                    let z = rng.random_range(0..1i32 << bits);
                    [rng.random_range(0..width as i32), rng.random_range(0..width as i32), z]
                })
                .collect();
            cells.sort_unstable();
            cells.dedup();
            let mut want: Vec<u32> = (0..cells.len() as u32).collect();
            want.sort_by_key(|&v| fnv_key(cells[v as usize].map(|c| c as u32)));
            assert_eq!(voxels_by_hash(&cells, bits), want);
        }
    }
}
