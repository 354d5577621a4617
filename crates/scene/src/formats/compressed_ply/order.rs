//! The order of rows in a compressed PLY file: neighbors share a chunk.

use super::CHUNK_ROWS;
use crate::SceneError;
use crate::bounds::{EMPTY_BOX, bounding_box, joined_box};
use rayon::prelude::*;

/// How much larger chunks may be in the scene's own order than in Morton order for it to be kept.
///
/// Loose enough that a file which is in Morton order stays so after its positions were rounded.
const KEEP_UP_TO: f64 = 1.25;

/// Bits of a Morton code for each axis.
const BITS: u32 = 21;

/// Top bits of a code by which rows are put into buckets before they are sorted.
const BUCKET_BITS: u32 = 12;

/// Rows that are worked on between two calls of `tick`: some ms of work.
const ROWS_PER_TICK: usize = 1 << 18;

/// Called now and then; its error ends the work.
pub(super) type Tick<'a> = &'a mut dyn FnMut() -> Result<(), SceneError>;

/// Row of the scene for each row of the file; `None` where the scene's order will do.
///
/// `rounded` gives the positions, in the order of the file, as they will be read from it. What is
/// read must find its own order good enough, else a file would change when it is written again, so
/// the decision is made on those positions too.
pub(super) fn chunk_order(
    coord: &[[f32; 3]],
    rounded: impl Fn(Option<&[u32]>, Tick<'_>) -> Result<Vec<[f32; 3]>, SceneError>,
    tick: Tick<'_>,
) -> Result<Option<Vec<u32>>, SceneError> {
    // Each round sorts what the file would hold; one is the rule, and a limit the safeguard.
    const ROUNDS: usize = 8;
    if coord.len() <= CHUNK_ROWS {
        return Ok(None);
    }
    let mut order = better_order(coord, tick)?;
    for _ in 0..ROUNDS {
        let Some(next) = better_order(&rounded(order.as_deref(), tick)?, tick)? else { break };
        order = Some(match order {
            None => next,
            Some(order) => next.into_iter().map(|row| order[row as usize]).collect(),
        });
    }
    Ok(order)
}

/// Morton order, where it makes chunks smaller by enough.
fn better_order(coord: &[[f32; 3]], tick: Tick<'_>) -> Result<Option<Vec<u32>>, SceneError> {
    let order = morton_order(coord, tick)?;
    let kept = total_extent(coord.len(), |row| coord[row]);
    tick()?;
    let sorted = total_extent(coord.len(), |row| coord[order[row] as usize]);
    tick()?;
    Ok((kept > KEEP_UP_TO * sorted).then_some(order))
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

/// Rows along a Morton curve through the box around all of them; equals in their old order.
fn morton_order(coord: &[[f32; 3]], tick: Tick<'_>) -> Result<Vec<u32>, SceneError> {
    let parts = coord.par_chunks(CHUNK_ROWS).map(|part| bounding_box(part.iter().copied()));
    let (min, max) = parts.reduce(|| EMPTY_BOX, joined_box);
    tick()?;
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
    let mut codes = vec![0u64; coord.len()];
    for (codes, coord) in codes.chunks_mut(ROWS_PER_TICK).zip(coord.chunks(ROWS_PER_TICK)) {
        codes.par_iter_mut().zip(coord).for_each(|(to, coord)| *to = code(coord));
        tick()?;
    }
    sort_rows(&codes, tick)
}

/// Rows in ascending order of their codes; equals in ascending order of rows.
///
/// Buckets of the top bits first, so that there is a pause now and then in which to stop.
fn sort_rows(codes: &[u64], tick: Tick<'_>) -> Result<Vec<u32>, SceneError> {
    let bucket = |code: u64| (code >> (3 * BITS - BUCKET_BITS)) as usize;
    let mut starts = vec![0usize; 1 << BUCKET_BITS];
    codes.iter().for_each(|&code| starts[bucket(code)] += 1);
    let mut total = 0;
    for start in &mut starts {
        total += std::mem::replace(start, total);
    }
    let mut ends = starts;
    let mut keyed = vec![(0u64, 0u32); codes.len()];
    for (first, codes) in (0..).step_by(ROWS_PER_TICK).zip(codes.chunks(ROWS_PER_TICK)) {
        for (i, &code) in codes.iter().enumerate() {
            let to = &mut ends[bucket(code)];
            // The caller of this module has made sure that rows fit.
            keyed[*to] = (code, (first + i) as u32);
            *to += 1;
        }
        tick()?;
    }
    let (mut left, mut at) = (keyed.as_mut_slice(), 0);
    let mut ends = ends.into_iter().peekable();
    while !left.is_empty() {
        let (mut buckets, mut taken) = (Vec::new(), 0);
        while let Some(end) = ends.next_if(|_| taken < ROWS_PER_TICK) {
            let (rows, rest) = std::mem::take(&mut left).split_at_mut(end - at);
            taken += rows.len();
            buckets.push(rows);
            (left, at) = (rest, end);
        }
        // A bucket may hold nearly everything, where a few rows are far away: split within, too.
        buckets.into_par_iter().for_each(|rows| rows.par_sort_unstable());
        tick()?;
    }
    Ok(keyed.into_par_iter().map(|(_, row)| row).collect())
}

/// Puts two zero bits after each of the lowest 21 bits.
pub(in crate::formats) fn spread(mut bits: u64) -> u64 {
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
        let tick: Tick<'_> = &mut || Ok(());
        let coord: Vec<[f32; 3]> = (0..2000u32)
            .map(|i| [0, 7, 19].map(|shift| (i.wrapping_mul(2_654_435_761) >> shift & 1023) as f32))
            .collect();
        let order = better_order(&coord, tick).unwrap().unwrap();
        let mut all: Vec<u32> = order.clone();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..2000));
        let sorted: Vec<_> = order.iter().map(|&row| coord[row as usize]).collect();
        assert_eq!(better_order(&sorted, tick).unwrap(), None);
        assert_eq!(better_order(&[[1.0; 3]; 600], tick).unwrap(), None);
        let huge = [[f32::MAX; 3], [f32::MIN; 3]].repeat(400);
        assert!(better_order(&huge, tick).unwrap().is_some_and(|order| order[0] == 1));
    }

    #[test]
    fn rows_are_sorted_by_code_then_row() {
        for rows in [1usize, 5000, ROWS_PER_TICK + 3, 2 * ROWS_PER_TICK] {
            for bits in [63, 30, 4, 0] {
                let code = |row: usize| {
                    (row as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 1 & ((1 << bits) - 1)
                };
                let codes: Vec<u64> = (0..rows).map(code).collect();
                let mut due: Vec<u32> = (0..rows as u32).collect();
                due.sort_by_key(|&row| codes[row as usize]);
                let mut ticks = 0;
                let mut tick = || {
                    ticks += 1;
                    Ok(())
                };
                assert!(sort_rows(&codes, &mut tick).unwrap() == due, "{rows} rows, {bits} bits");
                assert!(ticks >= 2);
            }
        }
        let stop: Tick<'_> = &mut || Err(SceneError::Stopped);
        assert!(sort_rows(&[3, 1, 2], stop).is_err());
    }
}
