//! Points into voxels.

use crate::clouds::LENGTHS;
use crate::support::gpu;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_gpu::Gpu;
use scenesplat_gpu::ops::cloud::DeviceCloud;
use scenesplat_gpu::ops::grid_sample::voxel_groups;
use scenesplat_kernels::grid_sample::{self as host, KeyOrder};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};

const ORDERS: [KeyOrder; 3] = [KeyOrder::Morton, KeyOrder::Ravel, KeyOrder::Fnv];

/// Points between two corners.
fn points(len: usize, low: [f32; 3], high: [f32; 3], seed: u64) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut axis =
        |a: usize| if low[a] < high[a] { rng.random_range(low[a]..high[a]) } else { low[a] };
    (0..len).map(|_| [axis(0), axis(1), axis(2)]).collect()
}

fn same(gpu: &Gpu, coord: &[[f32; 3]], grid_size: f64, key_order: KeyOrder) {
    let want = host::voxel_groups(coord, grid_size, key_order).unwrap();
    let mut commands = gpu.commands();
    let device = gpu.upload("points", coord).unwrap();
    let got = voxel_groups(&mut commands, &device, grid_size, key_order).unwrap();
    assert_eq!(got.num_voxels(), want.num_voxels());
    assert!(got.read(&mut commands).unwrap() == want, "{key_order:?} {grid_size} {}", coord.len());
    assert_eq!(commands.read(&got.first_rows).unwrap(), want.first_rows());
    for axis in 0..3 {
        let most = want.grid_coord.iter().map(|cell| cell[axis] as u32).max();
        assert_eq!(got.max_cell[axis], most.unwrap_or(0));
    }
}

#[test]
pub fn groups_are_those_of_the_cpu_at_every_length_in_every_order() {
    let Some(gpu) = gpu() else { return };
    for len in LENGTHS {
        let coord = points(len, [-3.0, 1.5, -0.7], [4.0, 9.0, 2.2], len as u64);
        for key_order in ORDERS {
            same(&gpu, &coord, 0.2, key_order);
        }
    }
}

#[test]
fn cells_are_those_of_a_division_in_f64() {
    let Some(gpu) = gpu() else { return };
    // Points on the bounds of cells and beside them, where single precision goes wrong.
    for size in [0.02, 0.1, 1.0 / 3.0, 1e-3, 0.7] {
        let mut coord = Vec::new();
        for cell in -700..700 {
            let bound = (f64::from(cell) * size) as f32;
            for v in [bound, bound.next_up(), bound.next_down(), bound.next_down().next_down()] {
                coord.push([v, v + 100.0, -v]);
            }
        }
        for key_order in ORDERS {
            same(&gpu, &coord, size, key_order);
        }
    }
}

#[test]
fn zeros_tiny_and_large_numbers_and_one_voxel_of_all() {
    let Some(gpu) = gpu() else { return };
    let tiny = f32::MIN_POSITIVE / 8.0;
    let zeros: Vec<[f32; 3]> =
        [0.0, -0.0, tiny, -tiny, 1e-45, -1e-45, 0.5, -0.5].map(|v| [v, -v, 0.0]).to_vec();
    let large = points(900, [1e6; 3], [1e6 + 30.0, 1e6 + 20.0, 1e6 + 4.0], 1);
    let flat = points(400, [2.0, -5.0, 3.0], [2.0, 5.0, 3.0], 2);
    for key_order in ORDERS {
        same(&gpu, &zeros, 0.3, key_order);
        same(&gpu, &zeros[..6], f64::from(tiny) / 7.0, key_order);
        same(&gpu, &large, 0.05, key_order);
        same(&gpu, &flat, 0.02, key_order);
        same(&gpu, &flat, 1e6, key_order);
        same(&gpu, &[[-7.0, 8.0, 9.0]; 300], 0.1, key_order);
    }
}

#[test]
fn the_widest_scene_fills_63_bits() {
    let Some(gpu) = gpu() else { return };
    // 2²¹ cells of an axis, the fewest that fill all bits of the two others.
    let most = ((1 << 21) - 1) as f32;
    let mut coord = points(5000, [0.0; 3], [most, most, most], 3);
    coord.extend([[0.0; 3], [most; 3], [most, 0.0, 0.0], [0.0, most, 0.5], [0.0, 0.0, most]]);
    for key_order in ORDERS {
        same(&gpu, &coord, 1.0, key_order);
    }
}

#[test]
fn what_the_cpu_refuses_is_refused_with_its_words() {
    let Some(gpu) = gpu() else { return };
    let plain = points(3000, [0.0; 3], [5.0; 3], 4);
    let with = |row: usize, axis: usize, value: f32| {
        let mut coord = plain.clone();
        coord[row][axis] = value;
        coord
    };
    for (coord, size) in [
        (with(2999, 1, f32::NAN), 0.1),
        (with(0, 2, f32::INFINITY), 0.1),
        (with(2500, 0, f32::NEG_INFINITY), 0.1),
        (with(77, 2, 3e5), 0.1),
        (with(77, 0, -3e38), 1e-300),
        (plain.clone(), 0.0),
        (plain.clone(), -1.0),
        (plain.clone(), f64::NAN),
        (plain.clone(), 2e6),
    ] {
        let want = host::voxel_groups(&coord, size, KeyOrder::Morton).unwrap_err();
        let device = gpu.upload("points", &coord).unwrap();
        let error = voxel_groups(&mut gpu.commands(), &device, size, KeyOrder::Morton).unwrap_err();
        assert_eq!(error.to_string(), want.to_string());
    }
}

#[test]
fn points_become_scales_without_leaving_the_device() {
    let Some(gpu) = gpu() else { return };
    let coord = points(9000, [-2.0; 3], [2.0, 1.0, 0.5], 6);
    let rule = CurveDepth::PerScene;
    let want = host::voxel_groups(&coord, 0.1, KeyOrder::Morton).unwrap();
    let n = want.num_voxels();
    let want = SerializedCloud::new(want.grid_coord, vec![0, n], &Curve::ALL, rule).unwrap();
    let (want, _) = want.pool(2);
    for _ in 0..2 {
        let mut commands = gpu.commands();
        let device = gpu.upload("points", &coord).unwrap();
        let found = voxel_groups(&mut commands, &device, 0.1, KeyOrder::Morton).unwrap();
        assert_eq!(commands.reads(), 2, "bounds, and the number of voxels");
        let cloud =
            DeviceCloud::new(&mut commands, &found.cells, vec![0, n], &Curve::ALL, rule).unwrap();
        let (coarse, _) = cloud.pool(&mut commands, 2).unwrap();
        assert_eq!(commands.read(coarse.cells()).unwrap(), want.grid_coord());
        assert_eq!(coarse.codes(3).read(&mut commands).unwrap(), want.codes(3));
    }
}
