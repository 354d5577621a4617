//! The one table that all detectors read: patches of neighbors around a fixed choice of Gaussians.
//!
//! At most [`MOST_ROWS`] Gaussians of a scene are looked at, evenly chosen, so that a large scene costs no more
//! than a small one and its patches are no smaller than a hand.

use super::isolation::{NEIGHBOUR, reach};
use crate::from_points::symmetric_eigen;
use scenesplat_kernels::neighbors::{KdTree, Neighbor};
use scenesplat_scene::bounds::{Bounds, robust_bounds};
use scenesplat_scene::{GaussianScene, vector};

/// Gaussians that are looked at.
pub(super) const MOST_ROWS: usize = 65_536;
/// Those among them around which is looked.
const MOST_PATCHES: usize = 8192;
/// Neighbors of each, itself not counted.
pub(super) const NEAR: usize = 16;
/// The spread across a patch is at most this share of that along it, or it is no piece of a surface.
const FLAT: f64 = 0.35;
/// Share of the patches that is flat where there are surfaces: 0.24 to 0.56 in clean rooms, 0.01 to 0.06 in
/// captures of fur, strings and haze.
const LEAST_FLAT: f64 = 0.15;

/// A Gaussian and those around it.
#[derive(Debug, Clone, Default)]
pub(super) struct Patch {
    /// Its row.
    pub(super) row: u32,
    /// Rows of the patch, the Gaussian itself among them, the nearest first.
    pub(super) near: Vec<u32>,
    /// Distance to the fourth neighbor.
    pub(super) fourth: f32,
    /// Standard deviation of the centers across the plane of least squares, in units of the scene; NaN where
    /// the patch has no plane: too few of them, or all on a line.
    pub(super) rough: f64,
    /// The plane through the patch; `None` where the patch is no piece of a surface.
    pub(super) plane: Option<Plane>,
}

/// The plane through a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Two directions in it, then the normal; each of length 1.
    pub(super) axes: [[f64; 3]; 3],
}

/// What detectors look at.
pub(super) struct Table<'a> {
    pub(super) scene: &'a GaussianScene,
    /// Rows that are looked at, ascending: of those whose numbers can be used.
    pub(super) rows: Vec<u32>,
    /// The box without what is stray.
    pub(super) bounds: Bounds,
    pub(super) patches: Vec<Patch>,
    /// Median distance to the fourth neighbor among them, in units of the scene.
    pub(super) spacing: f64,
}

impl<'a> Table<'a> {
    /// Of the usable rows; `None` below `fewest`, or where all are in one place.
    pub(super) fn of(scene: &'a GaussianScene, fewest: usize) -> Option<Self> {
        let usable: Vec<u32> =
            (0..scene.len()).filter(|&row| is_usable(scene, row)).map(|row| row as u32).collect();
        if usable.len() < fewest {
            return None;
        }
        let rows: Vec<u32> =
            choice(usable.len(), MOST_ROWS).into_iter().map(|i| usable[i]).collect();
        let coord: Vec<[f32; 3]> = rows.iter().map(|&row| scene.coord[row as usize]).collect();
        let bounds = robust_bounds(&coord);
        // Cannot fail for finite coordinates; without a tree nothing is said.
        let tree = KdTree::new(&coord).ok().filter(|_| bounds.diagonal() > 0.0)?;
        let chosen = choice(rows.len(), MOST_PATCHES);
        let queries: Vec<[f32; 3]> = chosen.iter().map(|&i| coord[i]).collect();
        let patches = tree.map_nearest(
            &queries,
            NEAR + 1,
            || (),
            |(), i, near| patch(&coord, &rows, chosen[i], near),
        );
        let spacing = quantile_of(patches.iter().map(|p| f64::from(p.fourth)), 0.5)?;
        Some(Self { scene, rows, bounds, patches, spacing })
    }

    /// Patches that are pieces of surfaces, with their planes.
    pub(super) fn flat(&self) -> impl Iterator<Item = (&Patch, Plane)> {
        self.patches.iter().filter_map(|patch| patch.plane.map(|plane| (patch, plane)))
    }

    /// Whether surfaces are what there is, at this sampling.
    pub(super) fn has_surfaces(&self) -> Result<(), &'static str> {
        let enough = self.flat().count() as f64 >= LEAST_FLAT * self.patches.len() as f64;
        if enough {
            Ok(())
        } else {
            Err("too little of the scene is flat at the size of its patches")
        }
    }

    /// Where a patch is, in units of the scene.
    pub(super) fn place(&self, patch: &Patch) -> [f64; 3] {
        self.scene.coord[patch.row as usize].map(f64::from)
    }

    /// The median largest standard deviation of the Gaussians, in units of the scene.
    pub(super) fn size(&self) -> f64 {
        let sizes = self.patches.iter().map(|p| reach(self.scene, p.row as usize) / 3.0);
        quantile_of(sizes, 0.5).unwrap_or(0.0)
    }
}

/// Whether nothing in a row is NaN, and where it is and how large is finite.
fn is_usable(scene: &GaussianScene, row: usize) -> bool {
    let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    finite(&scene.coord[row])
        && finite(&scene.quat[row])
        && scene.log_scale[row].iter().all(|s| !s.is_nan() && *s < 80.0)
        && !scene.opacity_logit[row].is_nan()
        && finite(&scene.sh_dc[row])
}

/// One of each `rows / most` in turn, which one by the number of the stretch; all if there are few.
pub(super) fn choice(rows: usize, most: usize) -> Vec<usize> {
    if rows <= most {
        return (0..rows).collect();
    }
    // Numbers of rows times numbers of rows need 64 bits.
    let start = |i: usize| (i as u64 * rows as u64 / most as u64) as usize;
    (0..most)
        .map(|i| {
            let (first, last) = (start(i), start(i + 1));
            first + (scramble(i as u64) % (last - first) as u64) as usize
        })
        .collect()
}

/// A fixed number for each number: the finisher of splitmix64.
pub(super) fn scramble(i: u64) -> u64 {
    let mut x = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

fn patch(coord: &[[f32; 3]], rows: &[u32], of: usize, near: &[Neighbor]) -> Patch {
    let (rough, plane) = plane(coord, of, near);
    Patch {
        row: rows[of],
        near: near.iter().map(|n| rows[n.row as usize]).collect(),
        fourth: near.get(NEIGHBOUR).map_or(0.0, |n| n.distance_squared.sqrt() as f32),
        rough,
        plane,
    }
}

/// The deviation from the plane of least squares through a patch, and that plane if the patch is flat.
fn plane(coord: &[[f32; 3]], of: usize, near: &[Neighbor]) -> (f64, Option<Plane>) {
    let n = near.len() as f64;
    if near.len() < NEAR / 2 {
        return (f64::NAN, None);
    }
    // Relative to one point, so that coordinates far from the origin keep their digits.
    let from = |row: u32| -> [f64; 3] {
        std::array::from_fn(|a| f64::from(coord[row as usize][a]) - f64::from(coord[of][a]))
    };
    let mut mean = [0.0; 3];
    for near in near {
        let p = from(near.row);
        (0..3).for_each(|a| mean[a] += p[a] / n);
    }
    let mut matrix = [[0.0; 3]; 3];
    for near in near {
        let p = from(near.row);
        for a in 0..3 {
            for b in 0..3 {
                // A plane takes three of the degrees of freedom.
                matrix[a][b] += (p[a] - mean[a]) * (p[b] - mean[b]) / (n - 3.0);
            }
        }
    }
    let (values, vectors) = symmetric_eigen(matrix);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    let [_, middle, least] = order.map(|i| values[i].max(0.0));
    if !(middle > 0.0 && middle.is_finite()) {
        return (f64::NAN, None);
    }
    let axes: [[f64; 3]; 3] = order.map(|i| std::array::from_fn(|a| vectors[a][i]));
    (least.sqrt(), (least <= FLAT * FLAT * middle).then_some(Plane { axes }))
}

/// The covariance of a Gaussian in the plane of a patch: along the first axis, between, along the second.
pub(super) fn in_plane(scene: &GaussianScene, row: usize, plane: &Plane) -> [f64; 3] {
    let turn =
        vector::rotation(crate::transforms::quaternion::unit(scene.quat[row].map(f64::from)));
    let mut sum = [0.0; 3];
    for axis in 0..3 {
        let square = (2.0 * f64::from(scene.log_scale[row][axis])).exp();
        let along = [turn[0][axis], turn[1][axis], turn[2][axis]];
        let [u, v] = [0, 1].map(|i| vector::dot(along, plane.axes[i]));
        sum[0] += square * u * u;
        sum[1] += square * u * v;
        sum[2] += square * v * v;
    }
    sum
}

/// Quantile by nearest rank; `None` without values.
pub(super) fn quantile_of(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return None;
    }
    let at = scenesplat_scene::quantile::rank(values.len(), share);
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}
