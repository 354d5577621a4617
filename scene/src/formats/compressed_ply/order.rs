//! The order of rows in a compressed PLY file: neighbours share a chunk.

use super::CHUNK_ROWS;
use crate::SceneError;
use rayon::prelude::*;

/// How much larger chunks may be in the scene's own order than in Morton order for it to be kept.
///
/// Loose enough that a file which is in Morton order stays so after its positions were rounded.
const KEEP_UP_TO: f64 = 1.25;

/// Bits of a Morton code for each axis.
const BITS: u32 = 21;

/// Row of the scene for each row of the file; `None` where the scene's order will do.
///
/// `rounded` gives the positions, in the order of the file, as they will be read from it. What is
/// read must find its own order good enough, else a file would change when it is written again, so
/// the decision is made on those positions too. What it fails with is passed on.
pub(super) fn chunk_order(
    coord: &[[f32; 3]],
    mut rounded: impl FnMut(Option<&[u32]>) -> Result<Vec<[f32; 3]>, SceneError>,
) -> Result<Option<Vec<u32>>, SceneError> {
    // Each round sorts what the file would hold; one is the rule, and a limit the safeguard.
    const ROUNDS: usize = 8;
    if coord.len() <= CHUNK_ROWS {
        return Ok(None);
    }
    let mut order = better_order(coord);
    for _ in 0..ROUNDS {
        let Some(next) = better_order(&rounded(order.as_deref())?) else { break };
        order = Some(match order {
            None => next,
            Some(order) => next.into_iter().map(|row| order[row as usize]).collect(),
        });
    }
    Ok(order)
}

/// Morton order, where it makes chunks smaller by enough.
fn better_order(coord: &[[f32; 3]]) -> Option<Vec<u32>> {
    let order = morton_order(coord);
    let kept = total_extent(coord.len(), |row| coord[row]);
    let sorted = total_extent(coord.len(), |row| coord[order[row] as usize]);
    // Written so that sums that overflow keep the order.
    (kept > KEEP_UP_TO * sorted).then_some(order)
}

/// Sum over the chunks of the lengths of their boxes along the three axes.
fn total_extent(rows: usize, coord: impl Fn(usize) -> [f32; 3] + Sync) -> f64 {
    let extents: Vec<f64> = (0..rows.div_ceil(CHUNK_ROWS))
        .into_par_iter()
        .map(|chunk| {
            let rows = chunk * CHUNK_ROWS..rows.min((chunk + 1) * CHUNK_ROWS);
            let (min, max) = bounding_box(rows.map(&coord));
            (0..3).map(|i| f64::from(max[i]) - f64::from(min[i])).sum::<f64>()
        })
        .collect();
    // Added one after the other: a parallel sum would depend on the number of threads.
    extents.iter().sum()
}

fn bounding_box(coord: impl Iterator<Item = [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    let empty = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    coord.fold(empty, |(min, max), coord| {
        (
            std::array::from_fn(|i| min[i].min(coord[i])),
            std::array::from_fn(|i| max[i].max(coord[i])),
        )
    })
}

/// Rows along a Morton curve through the box around all of them; equals in their old order.
fn morton_order(coord: &[[f32; 3]]) -> Vec<u32> {
    let (min, max) = bounding_box(coord.iter().copied());
    let cells = f64::from(1u32 << BITS);
    let scale: [f64; 3] = std::array::from_fn(|i| {
        let extent = f64::from(max[i]) - f64::from(min[i]);
        if extent > 0.0 { cells / extent } else { 0.0 }
    });
    let code = |coord: &[f32; 3]| {
        (0..3).fold(0u64, |code, i| {
            let cell = (f64::from(coord[i]) - f64::from(min[i])) * scale[i];
            // The cast cuts off; the upper end belongs to the last cell.
            code | spread((cell as u64).min((1 << BITS) - 1)) << i
        })
    };
    // The caller has made sure that rows fit.
    let mut keyed: Vec<(u64, u32)> =
        coord.par_iter().enumerate().map(|(row, c)| (code(c), row as u32)).collect();
    keyed.par_sort_unstable();
    keyed.into_iter().map(|(_, row)| row).collect()
}

/// Puts two zero bits after each of the lowest 21 bits.
fn spread(mut bits: u64) -> u64 {
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        bits = (bits | bits << shift) & mask;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for i in 0..BITS {
            assert_eq!(spread(1 << i), 1 << (3 * i));
        }
        assert_eq!(spread((1 << BITS) - 1), 0x1249_2492_4924_9249);
    }

    #[test]
    fn scattered_rows_are_sorted_and_sorted_ones_kept() {
        let coord: Vec<[f32; 3]> = (0..2000u32)
            .map(|i| [0, 7, 19].map(|shift| (i.wrapping_mul(2_654_435_761) >> shift & 1023) as f32))
            .collect();
        let order = better_order(&coord).unwrap();
        let mut all: Vec<u32> = order.clone();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..2000));
        let sorted: Vec<_> = order.iter().map(|&row| coord[row as usize]).collect();
        assert_eq!(better_order(&sorted), None);
        assert_eq!(better_order(&[[1.0; 3]; 600]), None);
        let huge = [[f32::MAX; 3], [f32::MIN; 3]].repeat(400);
        assert!(better_order(&huge).is_some_and(|order| order[0] == 1));
    }
}
