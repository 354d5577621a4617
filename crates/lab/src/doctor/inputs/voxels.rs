//! Shapes of scenes that break grids, trees and networks.

use super::files::{refused, scene};
use crate::doctor::case::Case;
use crate::doctor::noise::points;
use crate::doctor::scenes::{encode, finite_unit_rows, small_room};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::GaussianScene;

/// Positions of scenes that the network has to take, so that every Gaussian gets a finite row of unit length: name,
/// positions.
const SHAPES: [(&str, fn() -> Vec<[f32; 3]>); 10] = [
    ("one-gaussian", || vec![[1.0, 2.0, 3.0]]),
    ("two-gaussians", || vec![[0.0; 3], [0.5, 0.0, 0.0]]),
    ("all-in-one-voxel", || points(300, 1, 0.004)),
    ("duplicates", || points(40, 2, 0.5).repeat(50)),
    ("coplanar", || points(600, 3, 1.0).into_iter().map(|p| [p[0], p[1], 0.0]).collect()),
    ("colinear", || (0..500).map(|i| [i as f32 * 0.01, 0.0, 0.0]).collect()),
    ("outliers-at-1-km", || {
        let far = (0..5).map(|i| [1000.0, 200.0 * i as f32, -700.0]);
        points(500, 4, 1.0).into_iter().chain(far).collect()
    }),
    ("offset-1e6", || points(500, 5, 8.0).into_iter().map(|p| p.map(|v| v + 1e6)).collect()),
    ("beyond-16-bits", || points(300, 6, 1.0).into_iter().chain([[4000.0, 0.0, 0.0]]).collect()),
    ("fewer-than-a-patch", || points(37, 7, 0.4)),
];

pub(super) fn cases() -> Vec<Case> {
    let shape = |(name, coord): (&str, fn() -> Vec<[f32; 3]>)| {
        case(format!("scene-{name}"), move |_| {
            let scene = at(coord());
            finite_unit_rows(&encode(&scene)?, scene.len())
        })
    };
    let others = [
        case("scene-beyond-21-bits", |_| {
            let coord: Vec<_> = points(60, 8, 1.0).into_iter().chain([[1e6, 0.0, 0.0]]).collect();
            refused(voxel_groups(&coord, 0.02, KeyOrder::Morton), &["60", "1000000"])
        }),
        case("scene-nan-in-memory", nan_in_memory),
        case("scene-100000-duplicates", many_duplicates),
        case("scene-in-millimetres", millimetres),
    ];
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

/// The same room in millimeters is read as a scaled copy: what the network sees is the same room.
fn millimetres(_: &Trial<'_>) -> Result<(), Failure> {
    let room = small_room()?;
    let mut large = room.clone();
    large.coord.iter_mut().flatten().for_each(|v| *v *= 1000.0);
    large.log_scale.iter_mut().flatten().for_each(|v| *v += 1000f32.ln());
    let (metres, millimetres) = (encode(&room)?, encode(&large)?);
    let alignment = millimetres.alignment.as_ref();
    ensure!(alignment.is_some_and(|a| !a.is_identity()), "taken as meters");
    let (rows, width) = (room.len(), metres.width());
    let (a, b) = (metres.gaussian_rows(0..rows)?, millimetres.gaussian_rows(0..rows)?);
    ensure!(b.iter().all(|v| v.is_finite()), "not finite");
    let cosine = |row: usize| {
        let at = row * width..(row + 1) * width;
        a[at.clone()].iter().zip(&b[at]).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
    };
    let alike = (0..rows).filter(|&row| cosine(row) > 0.99).count();
    // Gaussians on the border of two voxels may change sides with the last bit of a product.
    ensure!(alike * 100 >= rows * 95, "{alike} of {rows} features are those of the room in meters");
    Ok(())
}
