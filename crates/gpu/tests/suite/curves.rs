//! Codes of curves, and orders.

use crate::clouds::{MOST, cells, clouds, offsets, scenes};
use crate::support::gpu;
use scenesplat_gpu::ops::curves::{codes, order};
use scenesplat_kernels::serialization::{self, Curve, MAX_DEPTH, depth_of};

#[test]
pub fn codes_are_those_of_the_cpu_at_every_depth() {
    let Some(gpu) = gpu() else { return };
    for depth in 0..=MAX_DEPTH {
        // Also cells with more bits than that, which are cut off.
        let mut grid = cells(300, 1 << depth, depth.into());
        grid.extend([[0; 3], [MOST; 3], [MOST, 0, 0], [0, MOST, 0], [0, 0, MOST]]);
        grid.extend(cells(100, MOST, 99));
        let mut commands = gpu.commands();
        let device = gpu.upload("cells", &grid).unwrap();
        let one = scenes(&gpu, &[0, grid.len()]);
        for curve in Curve::ALL {
            let got = codes(&mut commands, curve, &device, &one, &[depth]).unwrap();
            let want = serialization::codes(curve, &grid, depth);
            assert_eq!(got.read(&mut commands).unwrap(), want, "{curve:?} {depth}");
        }
    }
}

#[test]
fn each_scene_has_its_depth() {
    let Some(gpu) = gpu() else { return };
    for (grid, offsets) in clouds() {
        let depths: Vec<u32> =
            offsets.windows(2).map(|s| depth_of(&grid[s[0]..s[1]]).unwrap()).collect();
        let mut commands = gpu.commands();
        let device = gpu.upload("cells", &grid).unwrap();
        let all = scenes(&gpu, &offsets);
        for curve in Curve::ALL {
            let got = codes(&mut commands, curve, &device, &all, &depths).unwrap();
            let want: Vec<u64> = offsets
                .windows(2)
                .zip(&depths)
                .flat_map(|(s, depth)| serialization::codes(curve, &grid[s[0]..s[1]], *depth))
                .collect();
            assert_eq!(got.read(&mut commands).unwrap(), want, "{curve:?} {offsets:?}");
        }
    }
}

#[test]
fn orders_keep_scenes_together() {
    let Some(gpu) = gpu() else { return };
    // More scenes than a digit of the sort has values; some of them empty.
    let counts: Vec<usize> = (0..700).map(|i| i % 5).collect();
    let (offsets, n) = (offsets(&counts), counts.iter().sum());
    let grid = cells(n, 4, 1);
    let mut commands = gpu.commands();
    let device = gpu.upload("cells", &grid).unwrap();
    let all = scenes(&gpu, &offsets);
    let keys = codes(&mut commands, Curve::Hilbert, &device, &all, &vec![2; 700]).unwrap();
    let got = order(&mut commands, &keys, &all, 6).unwrap();
    let codes = serialization::codes(Curve::Hilbert, &grid, 2);
    let mut want: Vec<u32> = Vec::new();
    for s in offsets.windows(2) {
        let rows = serialization::argsort(&codes[s[0]..s[1]]);
        want.extend(rows.iter().map(|row| row + s[0] as u32));
    }
    assert_eq!(commands.read(&got.order).unwrap(), want);
    assert_eq!(commands.read(&got.inverse).unwrap(), serialization::invert(&want));
}

#[test]
fn sizes_that_do_not_fit_and_too_many_bits_are_errors() {
    let Some(gpu) = gpu() else { return };
    let mut commands = gpu.commands();
    let device = gpu.upload("cells", &cells(5, 9, 1)).unwrap();
    let one = scenes(&gpu, &[0, 5]);
    assert!(codes(&mut commands, Curve::Z, &device, &one, &[22]).is_err());
    assert!(codes(&mut commands, Curve::Z, &device, &one, &[4, 4]).is_err());
    let four = scenes(&gpu, &[0, 4]);
    assert!(codes(&mut commands, Curve::Z, &device, &four, &[4]).is_err());
    let keys = codes(&mut commands, Curve::Z, &device, &one, &[4]).unwrap();
    assert!(order(&mut commands, &keys, &four, 12).is_err());
}
