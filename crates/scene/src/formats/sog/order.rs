//! The order of Gaussians in the textures: neighbors in space should be neighbors in a texture.

use crate::formats::compressed_ply::order::spread;
use rayon::prelude::*;

/// Below this, order cannot matter.
const MIN_ROWS: usize = 1024;
/// How much longer the way from row to row may be than in sorted order to be kept, as a fraction.
const KEPT_UP_TO: (u64, u64) = (5, 4);

/// The row to write at each place; `None` to keep the order.
///
/// Decided by the codes of the positions alone, in whole numbers: a scene that was read from a file
/// has the same codes, so its order is kept. Other programs sort their own way; their order stays
/// too if its way from row to row is at most 1.25 times that along the curve used here.
pub(super) fn spatial_order(codes: &[[u16; 3]]) -> Option<Vec<u32>> {
    if codes.len() < MIN_ROWS {
        return None;
    }
    let mut keyed: Vec<(u64, u32)> =
        codes.par_iter().enumerate().map(|(row, code)| (morton(*code), row as u32)).collect();
    if keyed.is_sorted() {
        return None;
    }
    // Unique keys, as rows differ: the result does not depend on how the sort works.
    keyed.par_sort_unstable();
    let order: Vec<u32> = keyed.into_iter().map(|(_, row)| row).collect();
    let as_it_is: u64 = codes.par_windows(2).map(|pair| step(pair[0], pair[1])).sum();
    let sorted: u64 = order
        .par_windows(2)
        .map(|pair| step(codes[pair[0] as usize], codes[pair[1] as usize]))
        .sum();
    (as_it_is * KEPT_UP_TO.1 > sorted * KEPT_UP_TO.0).then_some(order)
}

fn step(a: [u16; 3], b: [u16; 3]) -> u64 {
    (0..3).map(|i| u64::from(a[i].abs_diff(b[i]))).sum()
}

/// The place along a Z-shaped curve through the cube of codes.
fn morton(code: [u16; 3]) -> u64 {
    let [x, y, z] = code.map(|v| spread(v.into()));
    x | y << 1 | z << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread_by_three() {
        for value in [0, 1, 2, 0x8000, 0xffff, 0x1234] {
            let slow = (0..16).map(|b| (value >> b & 1) << (3 * b)).sum::<u64>();
            assert_eq!(spread(value), slow, "{value:#x}");
        }
        assert_eq!(morton([1, 2, 4]), 1 | 1 << 4 | 1 << 8);
    }

    #[test]
    fn a_sorted_scene_keeps_its_order_and_a_shuffled_one_does_not() {
        let codes: Vec<[u16; 3]> = (0..4096u32)
            .map(|i| [(i * 7919 % 4096) as u16, (i * 104_729 % 4099) as u16, (i % 3) as u16])
            .collect();
        let order = spatial_order(&codes).unwrap();
        let mut seen = order.clone();
        seen.sort_unstable();
        assert!(seen.iter().enumerate().all(|(i, &row)| i == row as usize), "a permutation");
        let sorted: Vec<[u16; 3]> = order.iter().map(|&row| codes[row as usize]).collect();
        assert_eq!(spatial_order(&sorted), None);
        // Along a line from end to end: not Morton order, but as short.
        let line: Vec<[u16; 3]> =
            (0..4096).map(|i| [i as u16 * 16, 5, 65_535 - i as u16]).collect();
        assert_eq!(spatial_order(&line), None);
        assert_eq!(spatial_order(&codes[..1023]), None);
    }
}
