//! Smooth surfaces of one color, each of which is part of one thing: what labels can agree on.
//!
//! A graph of cells, joined from the most alike neighbors on for as long as a join is no worse than what the two
//! parts have inside (Felzenszwalb & Huttenlocher, *Efficient Graph-Based Image Segmentation*, IJCV 2004). Cells
//! differ by the angle of their surfaces and by color; nothing is read of labels or features.

mod agree;
mod small;

pub use agree::{AgreeSettings, Agreed, ClassShares, agree};

use crate::cells::Joined;
use crate::error::{Result, check_rows, check_setting};
use crate::input::upright;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::frame::Matrix3;
use serde::Serialize;

/// The surface of Gaussians without a place: none.
pub const NO_SURFACE: u32 = u32::MAX;

/// What is taken for one surface; lengths in meters.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceSettings {
    /// Size of the cells whose means are compared, 0.001 to 10.
    pub cell: f64,
    /// How much a difference in color counts (of the means, all channels from 0 to 1) beside 1 − |cos| of the
    /// angle between the surfaces, from 0.
    pub color: f64,
    /// How large surfaces become: a part of n cells may join another over a difference of this ÷ n more than it has
    /// inside. Above 0; one set of surfaces for each.
    pub scales: Vec<f64>,
    /// Parts of fewer cells join what they touch, the most alike first.
    pub min_cells: usize,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self { cell: 0.05, color: 1.5, scales: vec![1.0, 3.0, 6.0, 10.0, 20.0], min_cells: 5 }
    }
}

impl SurfaceSettings {
    fn check(&self) -> Result<()> {
        let (cell, color) = (self.cell, self.color);
        check_setting((1e-3..=10.0).contains(&cell), "cell", cell, "0.001 to 10 meters")?;
        let fits = color >= 0.0 && color.is_finite();
        check_setting(fits, "color", color, "a finite number from 0")?;
        check_setting(!self.scales.is_empty(), "scales", 0, "one at least")?;
        for &scale in &self.scales {
            let fits = scale > 0.0 && scale.is_finite();
            check_setting(fits, "scales", scale, "finite numbers above 0")?;
        }
        Ok(())
    }
}

/// Which surface each Gaussian is part of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Surfaces {
    /// Number of its surface, or [`NO_SURFACE`]. `[N]`
    pub of: Vec<u32>,
    /// How many there are, numbered in the order of their first Gaussian.
    pub count: usize,
}

/// The smooth surfaces of a scene, and the cells that they are made of.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSurfaces {
    /// For each of the scales, from small to large as the settings have them.
    pub scales: Vec<Surfaces>,
    /// Cell of each Gaussian, or [`NO_SURFACE`]. `[N]`
    cell_of: Vec<u32>,
    /// How much surface each cell stands for, square meters.
    area: Vec<f32>,
    /// Cells that touch, each pair once.
    touching: Vec<[u32; 2]>,
}

impl SceneSurfaces {
    /// Those of the largest scale.
    pub fn largest(&self) -> &Surfaces {
        // Settings have a scale at least.
        &self.scales[self.scales.len() - 1]
    }

    /// How much surface there is of each thing, square meters: that of its cells, of which each thing in one has
    /// its part by Gaussians. `thing`: of each Gaussian, which below `count`, or −1. About the same for sparse and
    /// dense scenes: a cell stands for what is between it and its neighbors, up to 12.5 cm away for cells of 5 cm.
    ///
    /// # Errors
    /// If things and Gaussians differ in number.
    pub fn areas(&self, thing: &[i32], count: usize) -> Result<Vec<f64>> {
        check_rows("things", self.cell_of.len(), thing.len())?;
        let mut held = vec![0_u32; self.area.len()];
        let in_cell = self.cell_of.iter().filter(|cell| **cell != NO_SURFACE);
        in_cell.for_each(|&cell| held[cell as usize] += 1);
        let mut out = vec![0.0; count];
        for (&cell, &thing) in self.cell_of.iter().zip(thing) {
            let Some(sum) = usize::try_from(thing).ok().and_then(|thing| out.get_mut(thing)) else {
                continue;
            };
            if cell != NO_SURFACE {
                *sum += f64::from(self.area[cell as usize]) / f64::from(held[cell as usize]);
            }
        }
        Ok(out)
    }
}

/// Neighbors that cells are joined with, and that their angle is from.
const EDGES: usize = 8;
const PLANE: usize = 12;

/// Cells farther apart than so many sizes do not touch, or are no part of a plane.
const TOUCH: f64 = 2.5;
const NEAR: f64 = 2.6;

/// The smooth surfaces of a scene, for each of the scales.
///
/// Gaussians whose place or color is not finite have none. The same for any number of threads.
///
/// # Shapes
/// `coord`: `[N, 3]` meters · `color`: `[N, 3]`, 0 to 1
///
/// # Errors
/// If `coord` and `color` differ in number, or a setting is out of range.
pub fn surfaces(
    coord: &[[f32; 3]],
    color: &[[f32; 3]],
    settings: &SurfaceSettings,
) -> Result<SceneSurfaces> {
    settings.check()?;
    check_rows("color", coord.len(), color.len())?;
    let cells = Cells::new(coord, color, settings.cell);
    let (edges, area) = cells.edges(settings)?;
    let count = cells.color.len();
    let of_scale = |&scale: &f64| {
        let part_of_cell = join(count, &edges, scale, settings.min_cells);
        let (mut number, mut count) = (vec![NO_SURFACE; count], 0);
        let of = (cells.of.iter())
            .map(|&cell| {
                let Some(&part) = part_of_cell.get(cell as usize) else { return NO_SURFACE };
                let own = &mut number[part as usize];
                if *own == NO_SURFACE {
                    *own = count;
                    count += 1;
                }
                *own
            })
            .collect();
        Surfaces { of, count: count as usize }
    };
    let scales = settings.scales.par_iter().map(of_scale).collect();
    let mut touching: Vec<[u32; 2]> = edges.iter().map(|&(_, a, b)| [a, b]).collect();
    touching.par_sort_unstable();
    Ok(SceneSurfaces { scales, touching, area, cell_of: cells.of })
}

/// The smooth surfaces of a scene, by places and colors; opacities do not matter. `turn` brings +z up, as its
/// network reads it: cells lie along the axes, so a scene on its side has other surfaces if it is not turned.
///
/// # Errors
/// As [`surfaces`].
pub fn scene_surfaces(
    scene: &GaussianScene,
    turn: &Matrix3,
    metres_per_unit: f64,
    settings: &SurfaceSettings,
) -> Result<SceneSurfaces> {
    let color = |row| scene.color_u8(row).map(|c| f32::from(c) / 255.0);
    let color: Vec<[f32; 3]> = (0..scene.len()).map(color).collect();
    surfaces(&upright(&scene.coord, turn, metres_per_unit), &color, settings)
}

/// How much two cells differ, and which they are.
type Edge = (f32, u32, u32);

/// Means of what lies in each cell.
struct Cells {
    /// Cell of each Gaussian, or [`NO_SURFACE`]. `[N]`
    of: Vec<u32>,
    center: Vec<[f32; 3]>,
    color: Vec<DVec3>,
    size: f64,
}

impl Cells {
    fn new(coord: &[[f32; 3]], color: &[[f32; 3]], size: f64) -> Self {
        let is_finite = |p: &[f32; 3], c: &[f32; 3]| p.iter().chain(c).all(|v| v.is_finite());
        let mut least = [f32::INFINITY; 3];
        for (p, _) in coord.iter().zip(color).filter(|(p, c)| is_finite(p, c)) {
            least = std::array::from_fn(|i| least[i].min(p[i]));
        }
        // Counted from a corner, so that a shifted scene has the same cells. Far strays would leave the range of
        // i32; they only meet others as far out.
        let place = |p: &[f32; 3]| -> [i32; 3] {
            std::array::from_fn(|i| {
                ((f64::from(p[i]) - f64::from(least[i])) / size).floor().min(2e9) as i32
            })
        };
        let mut sorted: Vec<([i32; 3], u32)> = (coord.iter().zip(color).enumerate())
            .filter(|(_, (p, c))| is_finite(p, c))
            .map(|(row, (p, _))| (place(p), row as u32))
            .collect();
        sorted.par_sort_unstable();
        let mut cells =
            Self { of: vec![NO_SURFACE; coord.len()], center: Vec::new(), color: Vec::new(), size };
        for together in sorted.chunk_by(|a, b| a.0 == b.0) {
            let (mut center, mut mean) = (DVec3::ZERO, DVec3::ZERO);
            for &(_, row) in together {
                cells.of[row as usize] = cells.center.len() as u32;
                center += Vec3::from(coord[row as usize]).as_dvec3();
                mean += Vec3::from(color[row as usize]).as_dvec3();
            }
            let count = together.len() as f64;
            cells.center.push((center / count).as_vec3().to_array());
            cells.color.push(mean / count);
        }
        cells
    }

    /// Neighboring cells and how much they differ, the most alike first; and how much surface each cell stands for.
    fn edges(&self, settings: &SurfaceSettings) -> Result<(Vec<Edge>, Vec<f32>)> {
        let tree = KdTree::new(&self.center)?;
        let within = |near: f64| (near * self.size) * (near * self.size);
        let (touch, near) = (within(TOUCH), within(NEAR));
        let about = tree.map_nearest(
            &self.center,
            PLANE + 1,
            || (),
            |(), _, found| {
                let close = found.iter().filter(|n| n.distance_squared < near);
                let normal = normal(close.map(|n| self.center[n.row as usize]));
                let beside = found.iter().take(EDGES + 1);
                let beside = beside.filter(|n| n.distance_squared < touch).map(|n| n.row);
                // Of a plane with so many cells a square meter the k-th nearest is as far as a circle for k of them.
                let last = found[..found.len().min(EDGES + 1)].last();
                let reach = last.map_or(touch, |n| n.distance_squared.min(touch));
                let area = (std::f64::consts::PI * reach / EDGES as f64) as f32;
                (normal, beside.collect::<Vec<u32>>(), area)
            },
        );
        let difference = |a: usize, b: usize| {
            let cos = about[a].0.dot(about[b].0);
            let color = (self.color[a] - self.color[b]).abs().element_sum();
            (1.0 - cos.abs().min(1.0) + settings.color * color) as f32
        };
        let mut edges: Vec<Edge> = (about.par_iter().enumerate())
            .flat_map_iter(|(a, (_, beside, _))| {
                let further = beside.iter().filter(move |&&b| b as usize != a);
                further.map(move |&b| {
                    let (low, high) = (b.min(a as u32), b.max(a as u32));
                    (difference(low as usize, high as usize), low, high)
                })
            })
            .collect();
        edges.par_sort_unstable_by(|a, b| {
            a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2))
        });
        // Most see each other.
        edges.dedup();
        let area = about.into_iter().map(|(_, _, area)| area).collect();
        Ok((edges, area))
    }
}

/// The direction in which points spread least; no direction of fewer than three.
fn normal(points: impl Iterator<Item = [f32; 3]> + Clone) -> DVec3 {
    let points = points.map(|p| Vec3::from(p).as_dvec3());
    let (count, sum) = points.clone().fold((0.0, DVec3::ZERO), |(n, sum), p| (n + 1.0, sum + p));
    if count < 3.0 {
        return DVec3::ZERO;
    }
    let mut spread = [0.0; 9];
    for d in points.map(|p| p - sum / count) {
        (0..9).for_each(|k| spread[k] += d[k / 3] * d[k % 3]);
    }
    DVec3::from_slice(&symmetric_eigen(&spread, 3, 3).vectors[6..])
}

/// The part of each cell, named by one of its cells. `edges`: the most alike first.
fn join(count: usize, edges: &[Edge], scale: f64, min_cells: usize) -> Vec<u32> {
    let mut parts = Joined::new(count);
    let mut size = vec![1_u32; count];
    let mut bound = vec![scale; count];
    let merge = |parts: &mut Joined, size: &mut [u32], a: u32, b: u32| {
        parts.join(a, b);
        size[a.min(b) as usize] += size[a.max(b) as usize];
        a.min(b) as usize
    };
    for &(difference, a, b) in edges {
        let (a, b) = (parts.root(a), parts.root(b));
        let difference = f64::from(difference);
        if a != b && difference <= bound[a as usize].min(bound[b as usize]) {
            let one = merge(&mut parts, &mut size, a, b);
            bound[one] = difference + scale / f64::from(size[one]);
        }
    }
    for &(_, a, b) in edges {
        let (a, b) = (parts.root(a), parts.root(b));
        let least = size[a as usize].min(size[b as usize]) as usize;
        if a != b && least < min_cells {
            merge(&mut parts, &mut size, a, b);
        }
    }
    (0..count as u32).map(|cell| parts.root(cell)).collect()
}

#[cfg(test)]
mod tests;
