//! Which Gaussians share a voxel: floors, borders and orders.

use crate::doctor::case::Case;
use crate::doctor::noise::{Noise, points};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::grid_sample::{KeyOrder, VoxelGroups, voxel_groups};
use std::collections::BTreeMap;

/// Points to put into voxels: name, points, size of a voxel.
type Points = (&'static str, fn() -> Vec<[f32; 3]>, f64);

const POINTS: [Points; 5] = [
    ("of-noise", || points(4000, 1, 3.0), 0.04),
    ("below-zero", || points(3000, 2, 0.05), 0.02),
    (
        "on-their-borders",
        || {
            // Multiples of the voxel size, and their neighbors among the f32.
            let around = |x: f32| [x, x.next_up(), x.next_down()].map(|x| [x, -x, 0.5 * x]);
            (-60..60).flat_map(|i| around(i as f32 * 0.02)).collect()
        },
        0.02,
    ),
    ("at-1e6", || points(2000, 3, 30.0).into_iter().map(|p| p.map(|v| v + 1e6)).collect(), 0.5),
    (
        "beyond-2-to-16",
        || {
            let far = points(500, 5, 1.0).into_iter().map(|p| p.map(|v| v + 20_000.0));
            points(500, 4, 1.0).into_iter().chain(far).collect()
        },
        0.02,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = POINTS
        .iter()
        .map(|&(name, make, size)| case(format!("voxels-{name}"), move |t| band(t, &make(), size)))
        .collect();
    cases.extend([
        case("voxels-of-no-row", |_| {
            let groups = voxel_groups(&[], 0.02, KeyOrder::Morton)?;
            ensure!(groups.num_voxels() == 0 && groups.largest_count() == 0, "{groups:?}");
            Ok(())
        }),
        case("voxel-sizes-that-are-none", |_| {
            for size in [0.0, -0.02, f64::NAN, f64::INFINITY] {
                let groups = voxel_groups(&[[0.0; 3]], size, KeyOrder::Morton);
                ensure!(groups.is_err(), "{size} is taken for a voxel size");
            }
            Ok(())
        }),
        case("voxel-orders-hold-the-same", orders),
        case("fragments-hold-every-row", fragments),
        case("nearest-to-the-centre-with-ties", nearest_with_ties),
        case("grid-rows-shuffled", shuffled),
    ]);
    cases
}

fn fragments(_: &Trial<'_>) -> Result<(), Failure> {
    let groups = voxel_groups(&points(900, 6, 0.1), 0.05, KeyOrder::Fnv)?;
    let mut seen = vec![false; 900];
    for fragment in 0..groups.largest_count() {
        let rows = groups.fragment_rows(fragment);
        ensure!(rows.len() == groups.num_voxels(), "a fragment has one row a voxel");
        rows.iter().for_each(|row| seen[*row as usize] = true);
    }
    ensure!(seen.iter().all(|seen| *seen), "a row is in no fragment");
    Ok(())
}

fn nearest_with_ties(trial: &Trial<'_>) -> Result<(), Failure> {
    let mut coord = vec![[0.004, 0.01, 0.01], [0.016, 0.01, 0.01]];
    coord.extend(vec![[0.012, 0.01, 0.01]; 5]);
    coord.push([0.03, 0.0, 0.0]);
    let rows = trial.same_on_threads(|| {
        Ok(voxel_groups(&coord, 0.02, KeyOrder::Morton)?.nearest_to_centre(&coord)?)
    })?;
    ensure!(rows == [2, 7], "rows {rows:?}, 2 and 7 are right");
    Ok(())
}

/// Rows whose coordinate is farther than this from every border, in voxels, have one right cell; an
/// f32 divided in f64 is off by less.
const BAND: f64 = 1e-9;

/// The band test: cells are exact inside; at a border one cell to either side is as good.
fn band(trial: &Trial<'_>, coord: &[[f32; 3]], size: f64) -> Result<(), Failure> {
    trial.keep("coord", coord.as_flattened())?;
    let groups: VoxelGroups =
        trial.same_on_threads(|| Ok(voxel_groups(coord, size, KeyOrder::Morton)?))?;
    check_lists(&groups, coord.len())?;
    for (row, p) in coord.iter().enumerate() {
        let cell = groups.grid_coord[groups.inverse[row] as usize];
        for axis in 0..3 {
            let exact = f64::from(p[axis]) / size;
            let got = f64::from(cell[axis]) + groups.min_cell[axis];
            let inside = exact - exact.floor();
            let near_border = !(BAND..=1.0 - BAND).contains(&inside);
            let apart = (got - exact.floor()).abs();
            ensure!(
                apart == 0.0 || near_border && apart == 1.0,
                "row {row}, axis {axis}: {} is in cell {got}, f64 says {exact}",
                p[axis]
            );
        }
    }
    // Rows with the same coordinates are always together.
    let mut cells = BTreeMap::new();
    for (row, p) in coord.iter().enumerate() {
        let voxel = groups.inverse[row];
        let first = *cells.entry(p.map(f32::to_bits)).or_insert(voxel);
        ensure!(first == voxel, "row {row} is apart from a row at the same place");
    }
    Ok(())
}

/// That the lists are what they say.
fn check_lists(groups: &VoxelGroups, rows: usize) -> Result<(), Failure> {
    ensure!(groups.order.len() == rows && groups.inverse.len() == rows, "lists of other lengths");
    let mut seen = vec![false; rows];
    for voxel in 0..groups.num_voxels() {
        let members = groups.rows_of(voxel);
        ensure!(!members.is_empty(), "voxel {voxel} has no row");
        ensure!(members.is_sorted(), "rows of voxel {voxel} do not rise");
        for &row in members {
            ensure!(groups.inverse[row as usize] as usize == voxel, "row {row} is in two voxels");
            seen[row as usize] = true;
        }
    }
    ensure!(seen.iter().all(|seen| *seen), "a row is in no voxel");
    let distinct: BTreeMap<[i32; 3], ()> = groups.grid_coord.iter().map(|c| (*c, ())).collect();
    ensure!(distinct.len() == groups.num_voxels(), "two voxels have the same cell");
    Ok(())
}

fn orders(_: &Trial<'_>) -> Result<(), Failure> {
    let coord = points(3000, 7, 0.6);
    let sets = [KeyOrder::Fnv, KeyOrder::Ravel, KeyOrder::Morton]
        .map(|order| voxel_groups(&coord, 0.05, order));
    let mut all = Vec::new();
    for groups in sets {
        let groups = groups?;
        check_lists(&groups, coord.len())?;
        let mut voxels: Vec<([i32; 3], Vec<u32>)> = (0..groups.num_voxels())
            .map(|v| (groups.grid_coord[v], groups.rows_of(v).to_vec()))
            .collect();
        voxels.sort();
        all.push(voxels);
    }
    ensure!(all[0] == all[1] && all[1] == all[2], "orders hold different voxels");
    Ok(())
}

fn shuffled(_: &Trial<'_>) -> Result<(), Failure> {
    let coord = points(2000, 8, 0.5);
    let mut rng = Noise::new(9);
    let mut order: Vec<usize> = (0..coord.len()).collect();
    rng.shuffle(&mut order);
    let other: Vec<[f32; 3]> = order.iter().map(|&row| coord[row]).collect();
    let a = voxel_groups(&coord, 0.03, KeyOrder::Morton)?;
    let b = voxel_groups(&other, 0.03, KeyOrder::Morton)?;
    ensure!(a.grid_coord == b.grid_coord, "other voxels");
    for (new, &old) in order.iter().enumerate() {
        ensure!(b.inverse[new] == a.inverse[old], "row {old} is in another voxel");
    }
    Ok(())
}
