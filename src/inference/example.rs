//! A small part of a scene that stands for the whole, for networks that calibrate on one first.

use scenesplat_datasets::{NetworkInput, Tile};
use std::collections::BTreeMap;

/// Voxels of an example at least, where there are as many: several times the width of any layer, and
/// a few percent of a room.
const LEAST: usize = 4096;
/// Edge of the cubes that it is made of, voxels at least: wide enough that most voxels have all their
/// neighbors.
const EDGE: u32 = 32;

/// Whole cubes of the voxels of an input, spread over it, until there are enough. `align`: edge of
/// the network's coarsest cells.
///
/// Depends on nothing but the voxels: a scene that goes through tiles has the same example as one
/// that does not.
pub(super) fn example(input: &NetworkInput, align: u32) -> NetworkInput {
    let align = align.max(1);
    let edge = EDGE.div_ceil(align).saturating_mul(align).min(1 << 21) as i32;
    let mut cubes: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
    for (voxel, cell) in input.grid_coord.iter().enumerate() {
        cubes.entry(cell.map(|v| v / edge)).or_default().push(voxel as u32);
    }
    let cubes: Vec<Vec<u32>> = cubes.into_values().collect();
    // Steps of the golden ratio come near to every place soon.
    let mut order: Vec<usize> = (0..cubes.len()).collect();
    let place = |i: usize| (i as f64 * 0.618_033_988_749_894_9).fract();
    order.sort_by(|&a, &b| place(a).total_cmp(&place(b)));
    let mut voxels = Vec::new();
    for cube in order {
        voxels.extend_from_slice(&cubes[cube]);
        if voxels.len() >= LEAST {
            break;
        }
    }
    voxels.sort_unstable();
    let is_core = vec![true; voxels.len()];
    Tile { voxels, is_core, origin: [0; 3], halo: 0 }.input(input)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(cells: Vec<[i32; 3]>) -> NetworkInput {
        let count = cells.len();
        NetworkInput {
            rows: (0..count as u32).collect(),
            slots: (0..count as u32).collect(),
            feat: (0..count).map(|i| i as f32).collect(),
            grid_coord: cells,
            channels: 1,
        }
    }

    #[test]
    fn small_scenes_are_their_own_example() {
        let whole = input((0..500).map(|i| [i % 50, i / 50, 3]).collect());
        assert_eq!(example(&whole, 8), whole);
        assert_eq!(example(&input(vec![]), 8).len(), 0);
    }

    #[test]
    fn large_scenes_give_whole_cubes_from_all_over() {
        let side = 300;
        let whole = input((0..side * side).map(|i| [i % side, i / side, 0]).collect());
        for align in [1, 8, 24] {
            let some = example(&whole, align);
            some.check().unwrap();
            assert!((LEAST..LEAST + 96 * 96).contains(&some.len()), "{}", some.len());
            let edge = EDGE.div_ceil(align) * align;
            let cube = |c: &[i32; 3]| c.map(|v| v / edge as i32);
            let mut cubes: Vec<[i32; 3]> = some.grid_coord.iter().map(cube).collect();
            cubes.sort_unstable();
            cubes.dedup();
            let whole_cubes = whole.grid_coord.iter().filter(|c| cubes.contains(&cube(c))).count();
            assert_eq!(whole_cubes, some.len(), "whole cubes");
            let far = |axis: usize| {
                let places = || cubes.iter().map(|c| c[axis]);
                places().max().unwrap() - places().min().unwrap()
            };
            assert!(far(0) >= 2 && far(1) >= 2, "{cubes:?}");
            assert!(some.rows.is_sorted());
        }
    }
}
