//! What a game or a simulation collides with: a hull of cubes for each object, the floor and the walls among them.

use crate::error::{Result, check_rows, check_setting};
use crate::{Catalogue, Object, ObjectInput};
use rayon::prelude::*;
use scenesplat_scene::GaussianScene;
use std::collections::{BTreeMap, BTreeSet, HashMap};

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

/// The hull of an object: the surface of the cubes that its Gaussians touch, as closed as they are.
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

/// The widest that a Gaussian reaches from its middle, in cubes; what is wider is haze or a mistake, and would fill memory.
const REACH: f64 = 40.0;

type Cell = [i64; 3];

/// The hull of each object that has a Gaussian opaque enough, in the order of the catalogue.
///
/// Cubes lie in the upright frame, so that floors and walls along the axes are flat. A Gaussian touches the cubes that its disc
/// of one standard deviation meets. Faces of neighbors that lie in one plane are joined to rectangles. The same for any number of
/// threads.
///
/// # Errors
/// If a setting is out of range, or the catalogue is of another scene.
pub fn colliders(
    input: &ObjectInput<'_>,
    found: &Catalogue,
    settings: &ColliderSettings,
) -> Result<Vec<Collider>> {
    input.check()?;
    let ColliderSettings { cell, min_opacity } = *settings;
    check_setting((0.005..=2.0).contains(&cell), "cell", cell, "an edge of 0.005 to 2 meters")?;
    let is_share = (0.0..=1.0).contains(&min_opacity);
    check_setting(is_share, "min_opacity", min_opacity, "an opacity of 0 to 1")?;
    check_rows("the catalogue's Gaussians", input.scene.len(), found.gaussians)?;
    let hull = |object: &Object| hull(input, object, settings);
    Ok(found.objects.par_iter().filter_map(hull).collect())
}

fn hull(input: &ObjectInput<'_>, object: &Object, settings: &ColliderSettings) -> Option<Collider> {
    let scene = input.scene;
    let least = (settings.min_opacity / (1.0 - settings.min_opacity)).ln();
    let mut cells = BTreeSet::new();
    for &row in &object.rows {
        let row = row as usize;
        let opacity = scene.opacity_logit.get(row).map_or(f64::INFINITY, |&l| f64::from(l));
        if opacity >= least {
            touched(input, scene, row, settings.cell, &mut cells);
        }
    }
    if cells.is_empty() {
        return None;
    }
    let (corners, triangles) = surface(&cells);
    let place = |corner: &Cell| {
        let upright = corner.map(|k| k as f64 * settings.cell);
        input.to_scene(upright).map(|v| v as f32)
    };
    let positions = corners.iter().map(place).collect();
    Some(Collider { id: object.id, class: object.class.clone(), positions, triangles })
}

/// Adds the cubes that the disc of a Gaussian meets: points of it, half a cube apart.
fn touched(
    input: &ObjectInput<'_>,
    scene: &GaussianScene,
    row: usize,
    cell: f64,
    cells: &mut BTreeSet<Cell>,
) {
    let middle = input.to_upright(scene.coord[row]);
    let (axes, sizes) = input.upright_axes(row);
    let thin = (0..3).fold(0, |s, a| if sizes[a] < sizes[s] { a } else { s });
    let [u, v] = [(thin + 1) % 3, (thin + 2) % 3];
    let steps = |axis: usize| (2.0 * (sizes[axis] / cell).min(REACH)).round() as i32;
    let (across, along) = (steps(u), steps(v));
    for i in -across..=across {
        for j in -along..=along {
            let [a, b] =
                [(i, across), (j, along)].map(|(k, of)| f64::from(k) / f64::from(of.max(1)));
            if a * a + b * b > 1.0 {
                continue;
            }
            let reach = [(a, u), (b, v)].map(|(share, axis)| {
                let size = sizes[axis].min(REACH * cell);
                axes[axis].map(|part| share * size * part)
            });
            cells.insert(std::array::from_fn(|k| {
                ((middle[k] + reach[0][k] + reach[1][k]) / cell).floor() as i64
            }));
        }
    }
}

/// The faces between cells and what is none, joined to rectangles: corners in whole cells, triangles.
fn surface(cells: &BTreeSet<Cell>) -> (Vec<Cell>, Vec<[u32; 3]>) {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for outward in [-1, 1] {
            let mut faces: Vec<[i64; 3]> = (cells.iter())
                .filter(|cell| {
                    let mut beside = **cell;
                    beside[axis] += outward;
                    !cells.contains(&beside)
                })
                .map(|cell| [cell[axis], cell[v], cell[u]])
                .collect();
            faces.sort_unstable();
            for [slice, [u0, u1], [v0, v1]] in rectangles(&faces) {
                let plane = slice[0] + i64::from(outward > 0);
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
fn rectangles(faces: &[[i64; 3]]) -> Vec<[[i64; 2]; 3]> {
    let mut runs: Vec<[i64; 4]> = Vec::new();
    for &[slice, v, u] in faces {
        match runs.last_mut() {
            Some(run) if run[0] == slice && run[1] == v && run[3] == u => run[3] = u + 1,
            _ => runs.push([slice, v, u, u + 1]),
        }
    }
    let (mut out, mut open) = (Vec::new(), BTreeMap::<[i64; 3], [i64; 2]>::new());
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
