//! The surface of a scene as up is judged by: pieces with a place, a normal and an area.

use crate::frame::{Matrix3, apply};
use crate::quantile::quantile;
use crate::quaternion::axes_by_size;
use crate::singular_values::singular_values;
use crate::vector::rotation;
use crate::{GaussianScene, Similarity, gaussian_scene::sigmoid};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Rows that are looked at.
const SAMPLE: usize = 200_000;

/// A Gaussian is flat when its shortest axis is so much shorter than the middle one, in ln.
const FLAT: f32 = 1.0;

/// With a smaller share of flat Gaussians, normals come from planes through neighbors.
const FEWEST_FLAT: f64 = 0.2;

/// Rows farther from the middle than so many times the median distance are stray.
const REACH: f64 = 3.0;

/// Side of the cells in which planes are fitted, in units of the scene's size; a plane sees the cell and
/// its 26 neighbors.
const CELL: f64 = 1.0 / 64.0;

/// Fewest rows of a plane, and how much thinner than wide they must lie.
const FEWEST_ON_PLANE: f64 = 8.0;
const THIN: f64 = 0.3;

/// Where fewer rows than these are in a cell, in the mean of those that hold any, cells are taken larger, up to this
/// side.
const FEWEST_IN_CELL: f64 = 2.0;
const COARSEST: f64 = 1.0 / 16.0;

/// A piece of surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// Place about the middle of the scene.
    pub(super) place: DVec3,
    /// Unit normal, of either sign; zero for what is round.
    pub(super) normal: DVec3,
    /// Visible area, squared units of the scene; 0 for what is round.
    pub(super) area: f64,
}

/// The surface of a scene.
#[derive(Debug)]
pub(super) struct Surface {
    /// Its pieces, in the order of the rows.
    pub(super) pieces: Vec<Piece>,
    /// The middle of the scene.
    pub(super) middle: DVec3,
    /// Twice the distance from the middle within which nearly all rows lie.
    pub(super) size: f64,
}

impl Surface {
    /// Looks at a scene; without any finite row there are no pieces. Normals are those of flat Gaussians, or, where
    /// few are flat, of planes through neighbors.
    pub(super) fn of(scene: &GaussianScene) -> Self {
        let mut surface = Self::of_places(scene, &Similarity::IDENTITY.rotation, piece);
        let flat = surface.flat().count() as f64;
        if flat < FEWEST_FLAT * surface.pieces.len() as f64 {
            fit_planes(&mut surface.pieces, CELL * surface.size);
        }
        cap(&mut surface.pieces);
        surface
    }

    /// As [`of`](Self::of) of a turned scene, with the normals of planes through neighbors, however Gaussians lie.
    pub(super) fn of_planes(scene: &GaussianScene, turn: &Matrix3) -> Self {
        let round = |_: &GaussianScene, _, place| Piece { place, normal: DVec3::ZERO, area: 0.0 };
        let mut surface = Self::of_places(scene, turn, round);
        let mut side = CELL * surface.size;
        // Sparse scenes have no plane in small cells.
        while side < COARSEST * surface.size
            && rows_of_a_cell(&surface.pieces, side) < FEWEST_IN_CELL
        {
            side *= 2.0;
        }
        fit_planes(&mut surface.pieces, side);
        cap(&mut surface.pieces);
        surface
    }

    fn of_places(
        scene: &GaussianScene,
        turn: &Matrix3,
        piece: impl Fn(&GaussianScene, usize, DVec3) -> Piece,
    ) -> Self {
        let step = scene.len().div_ceil(SAMPLE).max(1);
        let there: Vec<(usize, DVec3)> = (0..scene.len())
            .step_by(step)
            .map(|row| (row, DVec3::from(apply(turn, scene.coord[row].map(f64::from)))))
            .filter(|(_, place)| place.is_finite())
            .collect();
        let Some((middle, reach)) = middle(&there) else {
            return Self { pieces: Vec::new(), middle: DVec3::ZERO, size: 0.0 };
        };
        let pieces: Vec<Piece> = there
            .into_iter()
            .map(|(row, place)| (row, place - middle))
            .filter(|(_, place)| place.length() <= reach)
            .map(|(row, place)| piece(scene, row, place))
            .collect();
        let size = size(&pieces);
        Self { pieces, middle, size }
    }

    /// Pieces that have a normal.
    pub(super) fn flat(&self) -> impl Iterator<Item = &Piece> + Clone {
        self.pieces.iter().filter(|p| p.area > 0.0)
    }
}

/// The middle of a scene, and how far from it a row may be.
fn middle(there: &[(usize, DVec3)]) -> Option<(DVec3, f64)> {
    let mut median = [0.0; 3];
    for (axis, value) in median.iter_mut().enumerate() {
        let mut values: Vec<f32> = there.iter().map(|(_, p)| p[axis] as f32).collect();
        *value = f64::from(quantile(&mut values, 0.5)?);
    }
    let middle = DVec3::from(median);
    let mut away: Vec<f32> = there.iter().map(|(_, p)| (*p - middle).length() as f32).collect();
    let usual = quantile(&mut away, 0.5)?;
    // Where half of the rows are one point, the others are the scene.
    let usual = if usual > 0.0 { usual } else { quantile(&mut away, 0.99)? };
    Some((middle, REACH * f64::from(usual)))
}

fn size(pieces: &[Piece]) -> f64 {
    let mut away: Vec<f32> = pieces.iter().map(|p| p.place.length() as f32).collect();
    2.0 * quantile(&mut away, 0.98).map_or(0.0, f64::from)
}

/// A row; flat Gaussians have a normal and an area.
fn piece(scene: &GaussianScene, row: usize, place: DVec3) -> Piece {
    let round = Piece { place, normal: DVec3::ZERO, area: 0.0 };
    let sizes = scene.log_scale[row];
    let [short, middle, long] = axes_by_size(sizes);
    if sizes[middle] - sizes[short] < FLAT || sizes[middle] == f32::NEG_INFINITY {
        return round;
    }
    let normal = rotation(scene.quat[row].map(f64::from)).map(|r| r[short]);
    let Some(normal) = DVec3::from(normal).try_normalize() else { return round };
    let opacity = f64::from(sigmoid(scene.opacity_logit[row]));
    let area = f64::from(sizes[middle] + sizes[long]).exp() * opacity;
    if area.is_finite() { Piece { normal, area, ..round } } else { round }
}

/// A few huge discs, a backdrop say, must not outweigh the scene.
fn cap(pieces: &mut [Piece]) {
    let mut areas: Vec<f32> =
        pieces.iter().filter(|p| p.area > 0.0).map(|p| p.area as f32).collect();
    let most = quantile(&mut areas, 0.99).map_or(0.0, f64::from);
    pieces.iter_mut().for_each(|p| p.area = p.area.min(most));
}

/// Sums over the rows of a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: f64,
    place: DVec3,
    /// xx, yy, zz
    squares: DVec3,
    /// yz, zx, xy
    products: DVec3,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.place += other.place;
        self.squares += other.squares;
        self.products += other.products;
    }

    /// The normal of the plane through the rows, if they lie on one.
    fn normal(&self) -> Option<DVec3> {
        if self.count < FEWEST_ON_PLANE {
            return None;
        }
        let mean = self.place / self.count;
        let [xx, yy, zz] = (self.squares / self.count - mean * mean).to_array();
        let turned = DVec3::new(mean.y * mean.z, mean.z * mean.x, mean.x * mean.y);
        let [yz, zx, xy] = (self.products / self.count - turned).to_array();
        let (axes, spread, _) = singular_values(&[[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]);
        // Variances, so the square of how thin it is; what lies on a line has no plane.
        let is_plane = spread[2] <= THIN * THIN * spread[1] && spread[1] >= 0.04 * spread[0];
        let normal = DVec3::from(axes.map(|row| row[2]));
        (is_plane && normal.is_finite()).then_some(normal)
    }
}

type Cell = [i32; 3];

fn cell(place: DVec3, side: f64) -> Cell {
    (place / side).floor().to_array().map(|v| v as i32)
}

/// Rows in a cell, in the mean of the cells that hold any.
fn rows_of_a_cell(pieces: &[Piece], side: f64) -> f64 {
    let cells: BTreeSet<Cell> = pieces.iter().map(|p| cell(p.place, side)).collect();
    pieces.len() as f64 / cells.len().max(1) as f64
}

/// Gives pieces the normals of planes through their neighbors. A cell counts once, however many rows
/// it has: each gets its share of the cell's face.
fn fit_planes(pieces: &mut [Piece], side: f64) {
    if side <= 0.0 {
        return;
    }
    let mut cells: BTreeMap<Cell, Sums> = BTreeMap::new();
    for piece in &*pieces {
        let p = piece.place / side;
        cells.entry(cell(piece.place, side)).or_default().add(&Sums {
            count: 1.0,
            place: p,
            squares: p * p,
            products: DVec3::new(p.y * p.z, p.z * p.x, p.x * p.y),
        });
    }
    let normals: BTreeMap<Cell, (DVec3, f64)> = cells
        .iter()
        .filter_map(|(at, own)| {
            let mut around = Sums::default();
            for step in 0..27 {
                let offset = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1];
                let near: Cell = std::array::from_fn(|a| at[a] + offset[a]);
                cells.get(&near).into_iter().for_each(|sums| around.add(sums));
            }
            Some((*at, (around.normal()?, side * side / own.count)))
        })
        .collect();
    for piece in pieces {
        let found = normals.get(&cell(piece.place, side));
        (piece.normal, piece.area) = found.copied().unwrap_or((DVec3::ZERO, 0.0));
    }
}
