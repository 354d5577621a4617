//! Shapes of scenes that break grids, trees and networks.

use super::files::{refused, scene};
use super::input;
use crate::doctor::case::Case;
use crate::doctor::noise::points;
use crate::doctor::scenes::{encode, finite_unit_rows, small_room};
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::GaussianScene;

/// Positions of scenes that the network has to take, so that every Gaussian gets a finite row of unit length: name,
/// origin, positions.
const SHAPES: [(&str, &str, fn() -> Vec<[f32; 3]>); 10] = [
    (
        "one-gaussian",
        "demands 2a, level 1: 1 Gaussian; open_questions B 31: depth-0 Hilbert curve crashes",
        || vec![[1.0, 2.0, 3.0]],
    ),
    ("two-gaussians", "demands 2a, level 1: 2 Gaussians", || vec![[0.0; 3], [0.5, 0.0, 0.0]]),
    (
        "all-in-one-voxel",
        "open_questions B 31: all points in voxel 0 crash the Hilbert curve",
        || points(300, 1, 0.004),
    ),
    (
        "duplicates",
        "demands 2a, level 1: exact duplicates; Mix3D copies rows (open_questions B 29)",
        || points(40, 2, 0.5).repeat(50),
    ),
    ("coplanar", "demands 2a, level 1: coplanar", || {
        points(600, 3, 1.0).into_iter().map(|p| [p[0], p[1], 0.0]).collect()
    }),
    ("colinear", "demands 2a, level 1: colinear", || {
        (0..500).map(|i| [i as f32 * 0.01, 0.0, 0.0]).collect()
    }),
    ("outliers-at-1-km", "supersplat #116: 1 % outliers at 1 km", || {
        let far = (0..5).map(|i| [1000.0, 200.0 * i as f32, -700.0]);
        points(500, 4, 1.0).into_iter().chain(far).collect()
    }),
    ("offset-1e6", "demands 2a, level 1: coordinates at a 10⁶ m offset", || {
        points(500, 5, 8.0).into_iter().map(|p| p.map(|v| v + 1e6)).collect()
    }),
    (
        "beyond-16-bits",
        "demands 2a, level 1: grid index of 2^16 and more; 65 535 voxels are 1.3 km (open_questions E)",
        || points(300, 6, 1.0).into_iter().chain([[4000.0, 0.0, 0.0]]).collect(),
    ),
    ("fewer-than-a-patch", "demands 2a, level 1: N < patch", || points(37, 7, 0.4)),
];

pub(super) fn cases() -> Vec<Case> {
    let shape = |(name, origin, coord): (&str, _, fn() -> Vec<[f32; 3]>)| {
        input(format!("scene-{name}"), origin, move |_| {
            let scene = at(coord());
            finite_unit_rows(&encode(&scene)?, scene.len())
        })
        .within(1e-5, "a row of unit length in f32, within the rounding of its norm")
    };
    let others = [
        input(
            "scene-beyond-21-bits",
            "demands 2a, level 1: grid index of 2^21 and more: Morton and Hilbert codes have no bits left",
            |_| {
                let coord: Vec<_> = points(60, 8, 1.0).into_iter().chain([[1e6, 0.0, 0.0]]).collect();
                refused(voxel_groups(&coord, 0.02, KeyOrder::Morton), &["60", "1000000"])
            },
        )
        .refused(),
        input(
            "scene-nan-in-memory",
            "demands 2a, level 1: NaN coordinates that come in otherwise than from a file",
            nan_in_memory,
        )
        .refused(),
        input(
            "scene-100000-duplicates",
            "demands 2a, level 1: 10^5 exact duplicates; a tree that splits by value never ends",
            many_duplicates,
        ),
        input(
            "scene-in-millimetres",
            "PTv3 #31: scenes in millimetres or in a unit cube",
            millimetres,
        ),
    ];
    let others = others.map(|case| case.because("a count or an error; nothing is measured"));
    SHAPES.map(shape).into_iter().chain(others).collect()
}

/// A scene with these positions.
fn at(coord: Vec<[f32; 3]>) -> GaussianScene {
    let mut scene = scene(coord.len(), 0, 11);
    scene.coord = coord;
    scene
}

fn nan_in_memory(_: &Trial<'_>) -> Result<(), Failure> {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut coord = points(60, 9, 1.0);
        coord[41][1] = bad;
        refused(voxel_groups(&coord, 0.02, KeyOrder::Morton), &["41", "y"])?;
        refused(KdTree::new(&coord), &["41"])?;
    }
    Ok(())
}

fn many_duplicates(trial: &Trial<'_>) -> Result<(), Failure> {
    let coord = vec![[0.3, -0.2, 0.1]; 100_000];
    let groups = trial.same_on_threads(|| {
        let groups = voxel_groups(&coord, 0.02, KeyOrder::Morton)?;
        Ok((groups.num_voxels(), groups.largest_count()))
    })?;
    ensure!(groups == (1, 100_000), "(voxels, most Gaussians of one) = {groups:?}");
    let tree = KdTree::new(&coord)?;
    let rows: Vec<u32> = tree.nearest(coord[0], 5).iter().map(|n| n.row).collect();
    ensure!(rows == [0, 1, 2, 3, 4], "nearest of equal points: {rows:?}, smaller rows come first");
    Ok(())
}

/// The same room in millimetres is read as a scaled copy: what the network sees is the same room.
fn millimetres(_: &Trial<'_>) -> Result<(), Failure> {
    let room = small_room()?;
    let mut large = room.clone();
    large.coord.iter_mut().flatten().for_each(|v| *v *= 1000.0);
    large.log_scale.iter_mut().flatten().for_each(|v| *v += 1000f32.ln());
    let (metres, millimetres) = (encode(&room)?, encode(&large)?);
    let alignment = millimetres.alignment.as_ref();
    ensure!(alignment.is_some_and(|a| !a.is_identity()), "taken as metres");
    let (rows, width) = (room.len(), metres.width());
    let (a, b) = (metres.gaussian_rows(0..rows)?, millimetres.gaussian_rows(0..rows)?);
    ensure!(b.iter().all(|v| v.is_finite()), "not finite");
    let cosine = |row: usize| {
        let at = row * width..(row + 1) * width;
        a[at.clone()].iter().zip(&b[at]).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
    };
    let alike = (0..rows).filter(|&row| cosine(row) > 0.99).count();
    // Gaussians on the border of two voxels may change sides with the last bit of a product.
    ensure!(alike * 100 >= rows * 95, "{alike} of {rows} features are those of the room in metres");
    Ok(())
}
