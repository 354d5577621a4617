//! A model as rooms need it: points of its surface, where it is solid, where things stand on it.

use super::Entry;
use super::mesh;
use super::package::Package;
use super::points::{self, Point, mean_color, spread};
use crate::classes::ClassId;
use crate::model::Support;
use crate::shape::{Block, SurfacePoint};
use crate::vector::{V3, Z, unit_or};
use scenesplat_kernels::random::{SampleRng, below, unit};
use std::collections::BTreeMap;

/// A decoded model, in its own frame: x to the right, +y to the front, z up from its underside, meters.
#[derive(Debug)]
pub(crate) struct Piece {
    points: Vec<Point>,
    num_seen: usize,
    /// Of all points, and of those that are seen, square meters.
    areas: [f64; 2],
    pub(crate) bounds: Block,
    pub(crate) solids: Vec<Block>,
    pub(crate) support: Option<Support>,
    /// The mean of what is seen, 0..=255.
    pub(crate) mean_color: V3,
}

/// Cells of the ground plan in which it is looked where a model is solid, meters.
const CELL: f64 = 0.15;

/// Gaps between the points of a column that nothing fits into, meters.
const GAP: f64 = 0.15;

/// Cells of the level place where things stand, meters.
const SHELF_CELL: f64 = 0.04;

/// What stands there ends below this height, meters.
const CLEARANCE: f64 = 0.6;

impl Piece {
    pub(super) fn read(entry: &Entry, package: &Package) -> Result<Self, String> {
        let mesh = mesh::read(entry, package)?;
        let points = points::sample(&mesh, super::split::hash(&entry.id));
        if points.num_seen == 0 {
            return Err("has no surface that is seen from outside".to_owned());
        }
        let corners = mesh.triangles.iter().flat_map(|t| t.corners).map(Block::at);
        let bounds = corners.reduce(Block::join).unwrap_or(Block::at([0.0; 3]));
        let share = points.num_seen as f64 / points.all.len() as f64;
        use ClassId::{Chair, CoffeeTable, Desk, Stool, Table};
        let is_open =
            matches!(entry.meaning.class(), Some(Table | Desk | CoffeeTable | Chair | Stool));
        Ok(Self {
            solids: if is_open { columns(&points.all, &bounds) } else { vec![bounds] },
            support: entry.top.and_then(|top| shelf(&points.all[..points.num_seen], top)),
            mean_color: mean_color(&points.all[..points.num_seen]),
            areas: [points.area, points.area * share],
            num_seen: points.num_seen,
            points: points.all,
            bounds,
        })
    }

    /// Area with everything inside, or of what is seen from outside, square meters.
    pub(crate) fn area(&self, with_hidden: bool) -> f64 {
        self.areas[usize::from(!with_hidden)]
    }

    /// As [`area`](Self::area), where surfaces grow by a factor that depends on their unit normal.
    pub(crate) fn area_by(&self, with_hidden: bool, growth: impl Fn(V3) -> f64) -> f64 {
        let count = if with_hidden { self.points.len() } else { self.num_seen };
        let of_point = |point: &Point| growth(unit_or(points::long(point.normal), Z));
        let mean = self.points[..count].iter().map(of_point).sum::<f64>() / count as f64;
        self.area(with_hidden) * mean
    }

    /// A random point of the surface, and its color.
    pub(crate) fn sample(&self, with_hidden: bool, rng: &mut SampleRng) -> (SurfacePoint, V3) {
        let count = if with_hidden { self.points.len() } else { self.num_seen };
        let point = &self.points[below(rng, count as u32) as usize];
        // Each stands for a square of this side.
        let side = (self.area(with_hidden) / count as f64).sqrt();
        let by = [unit(rng), unit(rng)].map(|u| (u - 0.5) * side);
        let (coord, normal, tangent) = spread(point, by);
        let edge = f64::from(point.edge);
        let point_of_surface = SurfacePoint { coord, normal, tangent, st: [0.0; 2], edge };
        (point_of_surface, point.color.map(f64::from))
    }

    /// Bytes that it takes.
    pub(super) fn bytes(&self) -> usize {
        self.points.capacity() * size_of::<Point>() + self.solids.capacity() * size_of::<Block>()
    }
}

/// Upright boxes around the points of each cell of the ground plan, one for each run of points.
fn columns(points: &[Point], bounds: &Block) -> Vec<Block> {
    let mut cells: BTreeMap<[i32; 2], Vec<[f64; 3]>> = BTreeMap::new();
    for point in points {
        let p = point.coord.map(f64::from);
        let cell = |i: usize| ((p[i] - bounds.low[i]) / CELL) as i32;
        cells.entry([cell(0), cell(1)]).or_default().push(p);
    }
    let mut blocks: Vec<Block> = Vec::new();
    for mut column in cells.into_values() {
        column.sort_by(|a, b| a[2].total_cmp(&b[2]));
        let mut block = Block::at(column[0]);
        for p in column {
            if p[2] > block.high[2] + GAP {
                blocks.push(block);
                block = Block::at(p);
            }
            block = block.join(Block::at(p));
        }
        blocks.push(block);
    }
    // A box without extent overlaps nothing.
    for block in &mut blocks {
        for i in 0..3 {
            block.high[i] = block.high[i].max(block.low[i] + 0.005);
        }
    }
    blocks
}

/// The largest rectangle at a height that is covered all over by what looks up there.
fn shelf(points: &[Point], height: f64) -> Option<Support> {
    let mut cells: BTreeMap<[i32; 2], ()> = BTreeMap::new();
    let (mut least, mut most) = ([i32::MAX; 2], [i32::MIN; 2]);
    for point in points {
        let [x, y, z] = point.coord.map(f64::from);
        if (z - height).abs() < 0.02 && f64::from(point.normal[2]) > 0.8 * 32767.0 {
            let cell = [x, y].map(|v| (v / SHELF_CELL).floor() as i32);
            cells.insert(cell, ());
            least = [0, 1].map(|i| least[i].min(cell[i]));
            most = [0, 1].map(|i| most[i].max(cell[i]));
        }
    }
    if cells.is_empty() {
        return None;
    }
    let width = usize::try_from(most[0] - least[0] + 1).ok().filter(|&w| w <= 2000)?;
    // Largest rectangle under the histogram of how far each cell's column is covered.
    let mut heights = vec![0_usize; width];
    let (mut best, mut found) = (0, None);
    for row in least[1]..=most[1] {
        for (column, height) in heights.iter_mut().enumerate() {
            let is_covered = cells.contains_key(&[least[0] + column as i32, row]);
            *height = if is_covered { *height + 1 } else { 0 };
        }
        for first in 0..width {
            let mut lowest = usize::MAX;
            for last in first..width {
                lowest = lowest.min(heights[last]);
                if lowest == 0 {
                    break;
                }
                let area = lowest * (last - first + 1);
                if area > best {
                    best = area;
                    found = Some((first as i32, last as i32, row - lowest as i32 + 1, row));
                }
            }
        }
    }
    let (first, last, front, back) = found?;
    let low = [f64::from(least[0] + first), f64::from(front)].map(|v| v * SHELF_CELL);
    let high = [f64::from(least[0] + last + 1), f64::from(back + 1)].map(|v| v * SHELF_CELL);
    Some(Support { low, high, z: height, clearance: CLEARANCE })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(x: [f64; 2], y: [f64; 2], z: f64) -> Vec<Point> {
        let mut points = Vec::new();
        let mut at = x[0] + 0.005;
        while at < x[1] {
            let mut to = y[0] + 0.005;
            while to < y[1] {
                points.push(Point {
                    coord: [at, to, z].map(|v| v as f32),
                    normal: [0, 0, 32767],
                    tangent: [32767, 0, 0],
                    edge: 1.0,
                    color: [0; 3],
                });
                to += 0.01;
            }
            at += 0.01;
        }
        points
    }

    #[test]
    fn things_stand_on_the_largest_covered_rectangle() {
        // An L: 1.2 × 0.4 and, at its end, 0.4 × 0.8 more.
        let mut points = plane([0.0, 1.2], [0.0, 0.4], 0.75);
        points.extend(plane([0.0, 0.4], [0.4, 1.2], 0.75));
        points.extend(plane([-1.0, 2.0], [-1.0, 2.0], 0.1));
        let found = shelf(&points, 0.75).unwrap();
        assert!((found.z - 0.75).abs() < 1e-9);
        let [w, d] = [0, 1].map(|i| found.high[i] - found.low[i]);
        assert!((w - 1.2).abs() < 0.05 && (d - 0.4).abs() < 0.05, "{found:?}");
        assert!(shelf(&points, 0.4).is_none());
    }

    #[test]
    fn a_table_is_solid_where_it_is() {
        let mut points = plane([-0.6, 0.6], [-0.4, 0.4], 0.75);
        for z in 0..75 {
            points.extend(plane([-0.6, -0.55], [-0.4, -0.35], f64::from(z) / 100.0));
        }
        let bounds = Block { low: [-0.6, -0.4, 0.0], high: [0.6, 0.4, 0.75] };
        let blocks = columns(&points, &bounds);
        let is_solid = |p: V3| {
            blocks.iter().any(|b| (0..3).all(|i| b.low[i] - 0.02 < p[i] && p[i] < b.high[i] + 0.02))
        };
        assert!(is_solid([0.3, 0.3, 0.75]) && is_solid([-0.57, -0.37, 0.3]));
        assert!(!is_solid([0.3, 0.0, 0.4]), "under the table");
    }
}
