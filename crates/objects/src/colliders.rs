//! What a game or a simulation collides with: a hull of cubes for each object, the floor and the walls among them.

use crate::error::{ObjectError, Result, check_rows, check_setting};
use crate::{Catalogue, Object, ObjectInput};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

mod file;

pub use file::colliders_glb;

/// How hulls are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColliderSettings {
    /// Edge of the cubes, meters, 0.005..=2.
    pub cell: f64,
    /// Gaussians that are less opaque are left out, 0..=1: haze is nothing to walk into.
    pub min_opacity: f64,
}

impl Default for ColliderSettings {
    fn default() -> Self {
        Self { cell: 0.05, min_opacity: 0.3 }
    }
}

/// The hull of an object: the surface of the cubes that its Gaussians touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Collider {
    /// Number of the object.
    pub id: usize,
    /// Its class.
    pub class: String,
    /// Corners, in the frame and unit of the scene, relative to its origin. `[V, 3]`
    pub positions: Vec<[f32; 3]>,
    /// Triangles, counterclockwise from outside. `[T, 3]`
    pub triangles: Vec<[u32; 3]>,
}

/// The hulls of a scene, and what they leave out.
#[derive(Debug, Clone, PartialEq)]
pub struct Colliders {
    /// One for each object with a Gaussian that counts, in the order of the catalogue.
    pub hulls: Vec<Collider>,
    /// Gaussians of objects that are less opaque than asked.
    pub faint: usize,
    /// Gaussians that are too far away for cubes of this size to be told apart in 32 bits.
    pub far: usize,
    /// Gaussians whose standard deviation is above [`REACH`], which count as if it was that.
    pub cut: usize,
}

/// The widest standard deviation, meters: what is wider is haze or a mistake.
pub const REACH: f64 = 2.0;
/// Places that are looked at in a scene: some seconds, and at most 4 GB of cubes.
const MOST_PLACES: u64 = 300_000_000;
/// The number of the farthest cube.
const FARTHEST: f64 = (1u32 << 22) as f64;
/// Cubes of an object that are gathered before those that are there twice are dropped.
const GATHERED: usize = 1 << 20;

type Cell = [i32; 3];

/// The hull of each object that has a Gaussian opaque enough.
///
/// Cubes lie along the axes of the upright frame, and floors in the middle of a layer, so that what is flat stays so. A Gaussian
/// touches the cubes that it meets within one standard deviation. Faces that lie in one plane are joined to rectangles, which
/// need not share corners with others. The same for any number of threads.
///
/// # Errors
/// If a setting is out of range, the catalogue is of another scene, or the cubes are too small for the scene.
pub fn colliders(
    input: &ObjectInput<'_>,
    found: &Catalogue,
    settings: &ColliderSettings,
) -> Result<Colliders> {
    input.check()?;
    let ColliderSettings { cell, min_opacity } = *settings;
    check_setting((0.005..=2.0).contains(&cell), "cell", cell, "an edge of 0.005 to 2 meters")?;
    let is_share = (0.0..=1.0).contains(&min_opacity);
    check_setting(is_share, "min_opacity", min_opacity, "an opacity of 0 to 1")?;
    check_rows("the catalogue's Gaussians", input.scene.len(), found.gaussians)?;
    let grid = Grid { input, cell, floor: found.floor.height - 0.5 * cell };
    let least = (min_opacity / (1.0 - min_opacity)).ln();
    let is_opaque = |row: &u32| {
        let logit = input.scene.opacity_logit.get(*row as usize);
        logit.is_none_or(|&logit| f64::from(logit) >= least)
    };
    let rows: Vec<Vec<u32>> = (found.objects.par_iter())
        .map(|object| object.rows.iter().copied().filter(is_opaque).collect())
        .collect();
    let (mut places, mut far, mut cut) = (0u64, 0, 0);
    for &row in rows.iter().flatten() {
        let blob = grid.blob(row as usize);
        places = places.saturating_add(blob.places());
        far += usize::from(blob.is_far);
        cut += usize::from(blob.is_cut);
    }
    if places > MOST_PLACES {
        return Err(ObjectError::SmallCubes { cell, places, most: MOST_PLACES });
    }
    let objects = found.objects.iter().map(|object| object.rows.len()).sum::<usize>();
    let hulls =
        found.objects.par_iter().zip(&rows).filter_map(|(object, rows)| grid.hull(object, rows));
    Ok(Colliders {
        hulls: hulls.collect(),
        faint: objects - rows.iter().map(Vec::len).sum::<usize>(),
        far,
        cut,
    })
}

/// Where the cubes lie.
struct Grid<'a> {
    input: &'a ObjectInput<'a>,
    cell: f64,
    /// The lower end of the layer that holds the floor, meters.
    floor: f64,
}

/// A Gaussian in cubes.
struct Blob {
    middle: [f64; 3],
    axes: [[f64; 3]; 3],
    /// Standard deviations.
    sizes: [f64; 3],
    /// Places on each side of the middle along each axis, at most half a cube apart.
    steps: [i32; 3],
    is_far: bool,
    is_cut: bool,
}

impl Blob {
    fn places(&self) -> u64 {
        self.steps.iter().map(|&n| 2 * n as u64 + 1).product()
    }
}

impl Grid<'_> {
    fn blob(&self, row: usize) -> Blob {
        let mut middle = self.input.to_upright(self.input.scene.coord[row]);
        middle[2] -= self.floor;
        let middle = middle.map(|v| v / self.cell);
        let (axes, sizes) = self.input.upright_axes(row);
        let is_far = middle.iter().any(|v| v.abs() > FARTHEST);
        let is_cut = sizes.iter().any(|&size| size > REACH);
        let sizes = sizes.map(|size| size.min(REACH) / self.cell);
        // What is thinner than a cube is flat.
        let steps = sizes.map(|size| if size < 0.5 { 0 } else { (2.0 * size).ceil() as i32 });
        Blob { middle, axes, sizes, steps, is_far, is_cut }
    }

    fn hull(&self, object: &Object, rows: &[u32]) -> Option<Collider> {
        let mut cells = Vec::new();
        let mut limit = GATHERED;
        for &row in rows {
            let blob = self.blob(row as usize);
            if !blob.is_far {
                touched(&blob, &mut cells);
            }
            if cells.len() > limit {
                cells.sort_unstable();
                cells.dedup();
                limit = 2 * cells.len().max(GATHERED / 2);
            }
        }
        cells.sort_unstable();
        cells.dedup();
        if cells.is_empty() {
            return None;
        }
        let (corners, triangles) = surface(&cells);
        let place = |corner: &Cell| {
            let [x, y, z] = corner.map(|k| f64::from(k) * self.cell);
            self.input.to_scene([x, y, z + self.floor]).map(|v| v as f32)
        };
        let positions = corners.iter().map(place).collect();
        Some(Collider { id: object.id, class: object.class.clone(), positions, triangles })
    }
}

/// Adds the cubes that a Gaussian meets.
fn touched(blob: &Blob, cells: &mut Vec<Cell>) {
    let shares = |axis: usize| {
        let steps = blob.steps[axis];
        (-steps..=steps).map(move |k| f64::from(k) / f64::from(steps.max(1)))
    };
    for a in shares(0) {
        for b in shares(1) {
            for c in shares(2) {
                if a * a + b * b + c * c > 1.0 {
                    continue;
                }
                let along = [a * blob.sizes[0], b * blob.sizes[1], c * blob.sizes[2]];
                cells.push(std::array::from_fn(|k| {
                    let reach: f64 = (0..3).map(|axis| along[axis] * blob.axes[axis][k]).sum();
                    (blob.middle[k] + reach).floor() as i32
                }));
            }
        }
    }
}

/// The faces between cells and what is none, joined to rectangles: corners in whole cells, triangles.
///
/// `cells`: sorted, each once.
fn surface(cells: &[Cell]) -> (Vec<Cell>, Vec<[u32; 3]>) {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for outward in [-1, 1] {
            let mut faces: Vec<[i32; 3]> = (cells.iter())
                .filter(|cell| {
                    let mut beside = **cell;
                    beside[axis] += outward;
                    cells.binary_search(&beside).is_err()
                })
                .map(|cell| [cell[axis], cell[v], cell[u]])
                .collect();
            faces.sort_unstable();
            for [slice, [u0, u1], [v0, v1]] in rectangles(&faces) {
                let plane = slice[0] + i32::from(outward > 0);
                let corner = |at_u, at_v| {
                    let mut corner = [plane; 3];
                    (corner[u], corner[v]) = (at_u, at_v);
                    corner
                };
                let mut around = [corner(u0, v0), corner(u1, v0), corner(u1, v1), corner(u0, v1)];
                if outward < 0 {
                    around.reverse();
                }
                mesh.add(around);
            }
        }
    }
    (mesh.corners, mesh.triangles)
}

/// Rectangles that cover faces `[slice, v, u]`, sorted: first runs along u, then equal runs of neighboring v. Each as
/// `[[slice, _], [u0, u1], [v0, v1]]`, ends excluded.
fn rectangles(faces: &[[i32; 3]]) -> Vec<[[i32; 2]; 3]> {
    let mut runs: Vec<[i32; 4]> = Vec::new();
    for &[slice, v, u] in faces {
        match runs.last_mut() {
            Some(run) if run[0] == slice && run[1] == v && run[3] == u => run[3] = u + 1,
            _ => runs.push([slice, v, u, u + 1]),
        }
    }
    let (mut out, mut open) = (Vec::new(), BTreeMap::<[i32; 3], [i32; 2]>::new());
    for [slice, v, u0, u1] in runs {
        let rows = open.entry([slice, u0, u1]).or_insert([v, v]);
        if rows[1] != v {
            out.push([[slice, 0], [u0, u1], *rows]);
            *rows = [v, v];
        }
        rows[1] = v + 1;
    }
    out.extend(open.into_iter().map(|([slice, u0, u1], rows)| [[slice, 0], [u0, u1], rows]));
    out
}

#[derive(Default)]
struct Mesh {
    corners: Vec<Cell>,
    numbers: HashMap<Cell, u32>,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Two triangles between four corners in their order.
    fn add(&mut self, around: [Cell; 4]) {
        let [a, b, c, d] = around.map(|corner| {
            *self.numbers.entry(corner).or_insert_with(|| {
                self.corners.push(corner);
                self.corners.len() as u32 - 1
            })
        });
        self.triangles.extend([[a, b, c], [a, c, d]]);
    }
}

#[cfg(test)]
mod tests;
