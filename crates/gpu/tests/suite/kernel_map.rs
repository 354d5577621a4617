//! Which voxel feeds which.

use crate::clouds::{MOST, cells, clouds, scenes};
use crate::support::gpu;
use scenesplat_gpu::ops::kernel_map::CellTable;
use scenesplat_gpu::ops::product::NONE;
use scenesplat_gpu::ops::scenes::Scenes;
use scenesplat_kernels::kernel_map::KernelMap;
use std::ops::Range;

/// The CPU's map as a table. `[taps, range]`
fn table(map: &KernelMap, range: &Range<usize>) -> Vec<u32> {
    let mut all = vec![NONE; map.taps() * range.len()];
    for tap in 0..map.taps() {
        let (from, to) = map.tap_pairs(tap);
        for (from, to) in from.into_iter().zip(to) {
            if range.contains(&(to as usize)) {
                all[tap * range.len() + to as usize - range.start] = from;
            }
        }
    }
    all
}

#[test]
pub fn tables_are_those_of_the_cpu_for_every_kernel_size() {
    let Some(gpu) = gpu() else { return };
    for (grid, offsets) in clouds() {
        let mut commands = gpu.commands();
        let device = gpu.upload("cells", &grid).unwrap();
        let cells = CellTable::new(&mut commands, &device, &scenes(&gpu, &offsets)).unwrap();
        for size in [1, 3, 5, 7] {
            let map = KernelMap::build(&grid, &offsets, size).unwrap();
            let got = cells.sources(&mut commands, size, 0..grid.len()).unwrap();
            let want = table(&map, &(0..grid.len()));
            assert!(commands.read(&got).unwrap() == want, "{size} {offsets:?}");
        }
    }
}

#[test]
fn parts_of_a_table_are_the_rows_asked_for() {
    let Some(gpu) = gpu() else { return };
    let (grid, offsets) = (cells(2000, 14, 7), [0, 900, 900, 2000]);
    let map = KernelMap::build(&grid, &offsets, 3).unwrap();
    assert!(map.has_duplicates());
    let mut commands = gpu.commands();
    let device = gpu.upload("cells", &grid).unwrap();
    let found = CellTable::new(&mut commands, &device, &scenes(&gpu, &offsets)).unwrap();
    for range in [0..0, 0..1, 5..5, 255..511, 800..1000, 1999..2000, 2000..2000] {
        let got = found.sources(&mut commands, 3, range.clone()).unwrap();
        assert_eq!(commands.read(&got).unwrap(), table(&map, &range), "{range:?}");
    }
}

#[test]
fn the_first_row_stands_for_a_voxel_whichever_invocation_comes_first() {
    let Some(gpu) = gpu() else { return };
    // 20 000 rows of 27 voxels: all invocations want the same slots.
    let (grid, offsets) = (cells(20_000, 3, 8), [0, 12_000, 20_000]);
    let map = KernelMap::build(&grid, &offsets, 3).unwrap();
    let want = table(&map, &(0..grid.len()));
    let device = gpu.upload("cells", &grid).unwrap();
    for _ in 0..3 {
        let mut commands = gpu.commands();
        let found = CellTable::new(&mut commands, &device, &scenes(&gpu, &offsets)).unwrap();
        let got = found.sources(&mut commands, 3, 0..grid.len()).unwrap();
        assert!(commands.read(&got).unwrap() == want);
    }
}

#[test]
fn cells_at_the_ends_of_the_axes_have_no_neighbors_beyond() {
    let Some(gpu) = gpu() else { return };
    let mut grid = Vec::new();
    for end in [0, MOST - 1] {
        grid.extend((0..8).map(|i| [end + (i & 1), end + (i >> 1 & 1), end + (i >> 2)]));
    }
    let map = KernelMap::build(&grid, &[0, 16], 3).unwrap();
    let mut commands = gpu.commands();
    let device = gpu.upload("cells", &grid).unwrap();
    let found = CellTable::new(&mut commands, &device, &scenes(&gpu, &[0, 16])).unwrap();
    let got = found.sources(&mut commands, 3, 0..16).unwrap();
    let got = commands.read(&got).unwrap();
    assert_eq!(got, table(&map, &(0..16)));
    assert_eq!(got.iter().filter(|row| **row != NONE).count(), 2 * 64);
}

#[test]
fn wrong_sizes_and_ranges_are_errors() {
    let Some(gpu) = gpu() else { return };
    let mut commands = gpu.commands();
    let device = gpu.upload("cells", &cells(9, 5, 1)).unwrap();
    assert!(CellTable::new(&mut commands, &device, &scenes(&gpu, &[0, 8])).is_err());
    assert!(Scenes::upload(&gpu, vec![0, 8], 9).is_err());
    assert!(Scenes::upload(&gpu, vec![0, 8, 7, 9], 9).is_err());
    let found = CellTable::new(&mut commands, &device, &scenes(&gpu, &[0, 9])).unwrap();
    for size in [0, 2, 4, 9] {
        let error = found.sources(&mut commands, size, 0..9).unwrap_err();
        assert!(error.to_string().contains("1, 3, 5 or 7"), "{error}");
    }
    assert!(found.sources(&mut commands, 3, 4..10).is_err());
}
