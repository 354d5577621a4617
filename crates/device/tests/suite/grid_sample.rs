use crate::{Buffer, Grid, GridError};
use crate::{ROWS, in_any_order, random};
use scenesplat_device::Launcher;
use scenesplat_device::ops::grid_sample::{GridSampleError, KeyOrder, VoxelGroups, voxel_groups};
use scenesplat_kernels::grid_sample as cpu;

crate::support::on_grid! {
    voxels_are_those_of_the_cpu
    all_in_one_voxel_borders_of_cells_and_the_largest_extent
    what_the_cpu_refuses_is_refused
}

const ORDERS: [(KeyOrder, cpu::KeyOrder); 3] = [
    (KeyOrder::Morton, cpu::KeyOrder::Morton),
    (KeyOrder::Ravel, cpu::KeyOrder::Ravel),
    (KeyOrder::Fnv, cpu::KeyOrder::Fnv),
];

fn coordinates(n: usize, size: f32, seed: u64) -> Vec<[f32; 3]> {
    random(3 * n, seed).as_chunks::<3>().0.iter().map(|c| c.map(|v| v * size)).collect()
}

type Found = Result<VoxelGroups<Buffer>, GridSampleError<GridError>>;

fn run(l: &Grid, coord: &[[f32; 3]], grid_size: f64, order: KeyOrder) -> Found {
    let coord_on_device = l.upload_values(coord)?;
    voxel_groups(l, &coord_on_device, coord.len() as u32, grid_size, order)
}

fn check(coord: &[[f32; 3]], grid_size: f64) {
    let n = coord.len();
    for (order, cpu_order) in ORDERS {
        let want = cpu::voxel_groups(coord, grid_size, cpu_order).unwrap();
        let got = in_any_order(|l| {
            let got = run(l, coord, grid_size, order).map_err(|e| match e {
                GridSampleError::Launch(e) => e,
                other => panic!("{other}"),
            })?;
            let voxels = got.num_voxels as usize;
            Ok((
                l.download_values::<u32>(&got.order, n)?,
                l.download_values::<u32>(&got.offsets, voxels + 1)?,
                l.download_values::<u32>(&got.inverse, n)?,
                l.download_values::<[i32; 3]>(&got.grid_coord, voxels)?,
                got.min_cell,
            ))
        });
        let what = format!("{order:?}, {n} rows");
        assert_eq!(got.3, want.grid_coord, "{what}");
        assert_eq!(got.1, want.offsets, "{what}");
        assert_eq!(got.0, want.order, "{what}");
        assert_eq!(got.2, want.inverse, "{what}");
        assert_eq!(got.4, want.min_cell, "{what}");
    }
}

fn voxels_are_those_of_the_cpu() {
    for n in ROWS {
        check(&coordinates(n, 1.0, 1), 0.2);
        check(&coordinates(n, 40.0, 2), 0.02);
    }
}

fn all_in_one_voxel_borders_of_cells_and_the_largest_extent() {
    check(&vec![[0.3, -0.2, 5.0]; 1500], 0.05);
    // Multiples of the voxel size, both sides of zero.
    let on_borders: Vec<[f32; 3]> = (0..1000)
        .map(|i| [(i % 10) as f32 * 0.1 - 0.5, (i / 10 % 10) as f32 * 0.1, (i / 100) as f32 * -0.1])
        .collect();
    check(&on_borders, 0.1);
    check(&[[0.0; 3], [2_097_151.5, 2_097_151.5, 2_097_151.5], [5.0, 2_000_000.0, 3.0]], 1.0);
}

fn what_the_cpu_refuses_is_refused() {
    let l = crate::grid(0);
    let error =
        |coord: &[[f32; 3]], size: f64| run(l, coord, size, KeyOrder::Morton).err().unwrap();
    let mut coord = coordinates(5000, 1.0, 3);
    assert!(matches!(error(&coord, 0.0), GridSampleError::GridSize(_)));
    assert!(matches!(error(&coord, f64::NAN), GridSampleError::GridSize(_)));
    coord[4999][1] = f32::NAN;
    assert!(matches!(error(&coord, 0.1), GridSampleError::NotFinite));
    coord[4999][1] = f32::NEG_INFINITY;
    assert!(matches!(error(&coord, 0.1), GridSampleError::NotFinite));
    coord[4999][1] = 1e6;
    assert!(matches!(error(&coord, 0.1), GridSampleError::TooWide { axis: 'y', .. }));
}
