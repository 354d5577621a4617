//! Scales of scenes.

use crate::clouds::{cells, clouds};
use crate::support::gpu;
use scenesplat_gpu::Commands;
use scenesplat_gpu::ops::cloud::DeviceCloud;
use scenesplat_gpu::ops::pool::DeviceGroups;
use scenesplat_gpu::ops::product::NONE;
use scenesplat_kernels::segment::Groups;
use scenesplat_kernels::serialization::{self, Curve};
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};

const RULES: [CurveDepth; 3] =
    [CurveDepth::PerScene, CurveDepth::PerSceneExtent, CurveDepth::WholeBatch];

/// Checks everything of a cloud against the CPU's.
fn same(commands: &mut Commands, got: &DeviceCloud, want: &SerializedCloud) {
    assert_eq!((got.len(), got.is_empty()), (want.len(), want.is_empty()));
    assert_eq!(commands.read(got.cells()).unwrap(), want.grid_coord());
    assert_eq!(got.offsets(), want.offsets());
    assert_eq!(got.depth(), want.depth());
    assert_eq!(got.num_orders(), want.num_orders());
    for i in 0..want.num_orders() {
        assert_eq!(got.codes(i).read(commands).unwrap(), want.codes(i), "codes {i}");
        let (order, inverse) = (&got.order(i).order, &got.order(i).inverse);
        assert_eq!(commands.read(order).unwrap(), *want.order(i).order, "order {i}");
        assert_eq!(commands.read(inverse).unwrap(), *want.order(i).inverse, "inverse {i}");
    }
}

fn same_groups(commands: &mut Commands, got: &DeviceGroups, want: &Groups) {
    assert_eq!(commands.read(&got.rows).unwrap(), want.rows());
    assert_eq!(commands.read(&got.starts).unwrap(), want.offsets());
    assert_eq!(commands.read(&got.inverse).unwrap(), want.inverse());
}

#[test]
fn codes_and_orders_are_those_of_the_cpu_by_every_rule() {
    let Some(gpu) = gpu() else { return };
    for (grid, offsets) in clouds() {
        for rule in RULES {
            let want =
                SerializedCloud::new(grid.clone(), offsets.clone(), &Curve::ALL, rule).unwrap();
            let mut commands = gpu.commands();
            let device = gpu.upload("cells", &grid).unwrap();
            let got = DeviceCloud::new(&mut commands, &device, offsets.clone(), &Curve::ALL, rule);
            same(&mut commands, &got.unwrap(), &want);
            let got = DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &[], rule);
            assert_eq!(got.unwrap().depth(), want.depth(), "{rule:?}");
        }
    }
}

#[test]
pub fn pooled_scales_are_those_of_the_cpu_down_to_one_voxel() {
    let Some(gpu) = gpu() else { return };
    for (grid, offsets) in clouds() {
        for rule in RULES {
            let mut commands = gpu.commands();
            let curves = [Curve::HilbertTrans, Curve::Z];
            let mut got =
                DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &curves, rule).unwrap();
            let mut want =
                SerializedCloud::new(grid.clone(), offsets.clone(), &curves, rule).unwrap();
            for shift in [1, 2, 3, 11, 9] {
                let before = commands.reads();
                let (coarse, groups) = got.pool(&mut commands, shift).unwrap();
                assert_eq!(commands.reads(), before + 1, "one result is read");
                let (want_coarse, want_groups) = want.pool(shift);
                same(&mut commands, &coarse, &want_coarse);
                same_groups(&mut commands, &groups, &want_groups);
                (got, want) = (coarse, want_coarse);
            }
        }
    }
}

#[test]
fn scenes_of_few_bits_are_left_as_they_are() {
    let Some(gpu) = gpu() else { return };
    // 1, 0, 6 and 11 bits, with 4 cut off.
    let mut grid = cells(50, 2, 1);
    grid.extend([[0; 3]; 3]);
    grid.extend(cells(500, 64, 2));
    grid.extend(cells(500, 2048, 3));
    let offsets = vec![0, 50, 53, 553, 1053];
    let rule = CurveDepth::PerScene;
    let mut commands = gpu.commands();
    let got = DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &Curve::ALL, rule);
    let (coarse, groups) = got.unwrap().pool(&mut commands, 4).unwrap();
    let (want, want_groups) =
        SerializedCloud::new(grid, offsets, &Curve::ALL, rule).unwrap().pool(4);
    assert_eq!(want.depth(), [1, 0, 2, 7]);
    same(&mut commands, &coarse, &want);
    same_groups(&mut commands, &groups, &want_groups);
}

/// LitePT's rule, row by row (`models/src/litept/scale.rs`).
fn coarser(
    grid: &[[i32; 3]],
    offsets: &[usize],
    shift: u32,
) -> (Vec<[i32; 3]>, Vec<usize>, Groups) {
    let (mut starts, mut coarse, mut ends) = (vec![], vec![], vec![0]);
    for scene in offsets.windows(2) {
        let mut last = None;
        for row in scene[0]..scene[1] {
            let cell = grid[row].map(|v| v >> shift);
            if last != Some(cell) {
                last = Some(cell);
                starts.push(row as u32);
                coarse.push(cell);
            }
        }
        ends.push(coarse.len());
    }
    starts.push(grid.len() as u32);
    (coarse, ends, Groups::new((0..grid.len() as u32).collect(), starts).unwrap())
}

#[test]
pub fn coarser_scales_follow_the_rule_of_litept() {
    let Some(gpu) = gpu() else { return };
    for (mut grid, offsets) in clouds() {
        for scene in offsets.windows(2) {
            grid[scene[0]..scene[1]].sort_by_key(|cell| Curve::Z.code(cell.map(|v| v as u32), 21));
        }
        let rule = CurveDepth::PerSceneExtent;
        let mut commands = gpu.commands();
        let mut got =
            DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &[], rule).unwrap();
        let (mut cells, mut ends) = (grid, offsets);
        for (shift, curves) in [(1, &Curve::ALL[..]), (2, &[]), (0, &[Curve::Hilbert]), (17, &[])] {
            let (coarse, groups) = got.coarser(&mut commands, shift, curves).unwrap();
            let (want_cells, want_ends, want_groups) = coarser(&cells, &ends, shift);
            let want =
                SerializedCloud::new(want_cells.clone(), want_ends.clone(), curves, rule).unwrap();
            same(&mut commands, &coarse, &want);
            same_groups(&mut commands, &groups, &want_groups);
            (got, cells, ends) = (coarse, want_cells, want_ends);
        }
    }
}

#[test]
pub fn slots_show_rows_of_the_order() {
    let Some(gpu) = gpu() else { return };
    for (grid, offsets) in clouds() {
        let rule = CurveDepth::PerScene;
        let curves = [Curve::Z, Curve::Hilbert];
        let mut commands = gpu.commands();
        let got =
            DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &curves, rule).unwrap();
        let want = SerializedCloud::new(grid, offsets, &curves, rule).unwrap();
        for size in [1, 48, 256, 1024] {
            let patches = got.patches(&commands, size).unwrap();
            let cut = want.patches(size);
            assert_eq!(*patches.patches(), *cut);
            for i in 0..2 {
                let order = want.order(i);
                let rows = patches.rows_of_slots(&mut commands, got.order(i)).unwrap();
                let of_slots: Vec<u32> =
                    cut.pad().iter().map(|position| order.order[*position as usize]).collect();
                assert_eq!(commands.read(&rows).unwrap(), of_slots);
                let slots = patches.slots_of_rows(&mut commands, got.order(i)).unwrap();
                let of_rows: Vec<u32> =
                    order.inverse.iter().map(|at| cut.unpad()[*at as usize]).collect();
                assert_eq!(commands.read(&slots).unwrap(), of_rows);
            }
        }
    }
}

#[test]
fn kernel_maps_belong_to_their_scale_and_orders_change_places() {
    let Some(gpu) = gpu() else { return };
    let (grid, offsets) = (cells(3000, 16, 5), vec![0, 1000, 3000]);
    let rule = CurveDepth::PerScene;
    let mut commands = gpu.commands();
    let fine = DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &Curve::ALL, rule);
    let (mut coarse, _) = fine.unwrap().pool(&mut commands, 1).unwrap();
    let mut want = SerializedCloud::new(grid, offsets, &Curve::ALL, rule).unwrap().pool(1).0;
    let map = want.kernel_map(3).unwrap();
    let (first, len) = (100, want.len() - 300);
    for _ in 0..2 {
        let got = coarse.table(&mut commands, 3, first..first + len).unwrap();
        let got = commands.read(&got).unwrap();
        let mut pairs = 0;
        for tap in 0..27 {
            let (from, to) = map.tap_pairs(tap);
            for (from, to) in from.into_iter().zip(to) {
                if (first..first + len).contains(&(to as usize)) {
                    assert_eq!(got[tap * len + to as usize - first], from);
                    pairs += 1;
                }
            }
        }
        assert_eq!(got.iter().filter(|row| **row != NONE).count(), pairs);
    }
    want.permute_orders(&[2, 0, 3, 1]);
    coarse.permute_orders(&[2, 0, 3, 1]).unwrap();
    same(&mut commands, &coarse, &want);
    assert!(coarse.permute_orders(&[0, 1, 2, 2]).is_err());
    // The first order is another one now; rows of the next scale follow it.
    let (next, groups) = coarse.pool(&mut commands, 1).unwrap();
    let (want, want_groups) = want.pool(1);
    same(&mut commands, &next, &want);
    same_groups(&mut commands, &groups, &want_groups);
}

#[test]
fn a_large_cloud_is_the_same_twice() {
    let Some(gpu) = gpu() else { return };
    let grid = cells(65_537, 60, 9);
    let rule = CurveDepth::PerSceneExtent;
    let (offsets, curves) = (vec![0, 30_000, 65_537], [Curve::Hilbert]);
    let want = SerializedCloud::new(grid.clone(), offsets.clone(), &curves, rule).unwrap();
    let (want_coarse, want_groups) = want.pool(1);
    for _ in 0..2 {
        let mut commands = gpu.commands();
        let got =
            DeviceCloud::upload(&mut commands, &grid, offsets.clone(), &curves, rule).unwrap();
        same(&mut commands, &got, &want);
        let (coarse, groups) = got.pool(&mut commands, 1).unwrap();
        same(&mut commands, &coarse, &want_coarse);
        same_groups(&mut commands, &groups, &want_groups);
    }
}

#[test]
fn what_the_cpu_refuses_is_refused_with_its_words() {
    let Some(gpu) = gpu() else { return };
    let rule = CurveDepth::PerScene;
    let mut commands = gpu.commands();
    for (row, axis, value) in [(0, 0, -1), (699, 2, 1 << 21), (300, 1, i32::MIN), (5, 1, i32::MAX)]
    {
        let mut grid = vec![[7; 3]; 700];
        grid[row][axis] = value;
        let offsets = vec![0, 200, 200, 700];
        let want = SerializedCloud::new(grid.clone(), offsets.clone(), &[], rule).unwrap_err();
        let device = gpu.upload("cells", &grid).unwrap();
        let errors = [
            DeviceCloud::new(&mut commands, &device, offsets.clone(), &[], rule).unwrap_err(),
            DeviceCloud::upload(&mut commands, &grid, offsets, &[], rule).unwrap_err(),
        ];
        for error in errors {
            assert_eq!(error.to_string(), want.to_string());
        }
    }
    let bad = DeviceCloud::upload(&mut commands, &[[0; 3]], vec![0, 2], &[], rule);
    assert!(bad.unwrap_err().to_string().contains("offsets"));
    let plain = DeviceCloud::upload(&mut commands, &[[0; 3]], vec![0, 1], &[], rule).unwrap();
    assert!(plain.pool(&mut commands, 1).is_err(), "no order to follow");
    assert!(plain.coarser(&mut commands, 22, &[]).is_err());
    assert!(plain.patches(&commands, 0).is_err());
    let patches = plain.patches(&commands, 4).unwrap();
    let two = serialization::invert(&[1, 0]);
    let order = scenesplat_gpu::ops::curves::DeviceOrder {
        order: gpu.upload("an order", &two).unwrap(),
        inverse: gpu.upload("an order", &two).unwrap(),
    };
    assert!(patches.rows_of_slots(&mut commands, &order).is_err());
}
