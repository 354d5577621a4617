//! Points on the faces of a mesh, evenly by area, with color, normal and the nearest edge.

use super::mesh::{Mesh, Triangle};
use super::seen::Views;
use crate::shape::FAR;
use crate::vector::{V3, add_times, basis, cross, dot, length, mix, sub, times, unit_or};
use scenesplat_kernels::random::{sample_rng, unit};

/// Points per square meter, and the fewest and most of a model.
const DENSITY: f64 = 10_000.0;
const FEWEST: f64 = 1_500.0;
const MOST: f64 = 40_000.0;

/// Glass is seen badly: so many points of it, for each of another surface.
const OF_GLASS: f64 = 0.35;

/// Faces that meet at a larger angle (30 degrees) have an edge between them: its cosine.
const CREASE: f64 = 0.866;

/// A point of a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) coord: [f32; 3],
    /// Unit, toward those who see it; and along the nearest edge; in 1/32767.
    pub(super) normal: [i16; 3],
    pub(super) tangent: [i16; 3],
    /// Distance of the nearest edge, meters.
    pub(super) edge: f32,
    pub(super) color: [u8; 3],
}

/// A point before it is known which side of its face is the outside.
struct Drawn {
    triangle: usize,
    coord: V3,
    normal: V3,
    color: V3,
    /// In how many pictures it is seen, from the side of the normal and from the other.
    count: [u32; 2],
}

/// Points of a mesh: those that are seen from outside, then the others.
pub(super) struct Points {
    pub(super) all: Vec<Point>,
    pub(super) num_seen: usize,
    /// Area that they stand for, square meters; glass and holes count by what there is to see.
    pub(super) area: f64,
}

pub(super) fn sample(mesh: &Mesh, seed: u64) -> Points {
    let glass = |t: &Triangle| mesh.paints[t.paint as usize].is_glass;
    let areas: Vec<f64> = (mesh.triangles.iter())
        .map(|t| length(t.cross()) / 2.0 * if glass(t) { OF_GLASS } else { 1.0 })
        .collect();
    let total: f64 = areas.iter().sum();
    let count = (total * DENSITY).clamp(FEWEST, MOST) as usize;
    let creases = creases(&mesh.triangles);
    let views = Views::of(mesh);
    let mut rng = sample_rng(seed, 0, 0);
    let mut drawn = Vec::with_capacity(count);
    let (mut at, mut end) = (0, areas[0]);
    for number in 0..count {
        // One point in each of equal parts of the area.
        let target = (number as f64 + unit(&mut rng)) / count as f64 * total;
        while target > end && at + 1 < areas.len() {
            at += 1;
            end += areas[at];
        }
        let triangle = &mesh.triangles[at];
        let root = unit(&mut rng).sqrt();
        let (s, t) = (1.0 - root, root * unit(&mut rng));
        let Some(color) = color(mesh, triangle, [1.0 - s - t, s, t]) else { continue };
        let [a, b, c] = triangle.corners;
        let coord: V3 = std::array::from_fn(|i| a[i] * (1.0 - s - t) + b[i] * s + c[i] * t);
        let normal = unit_or(triangle.cross(), [0.0, 0.0, 1.0]);
        let count = views.count(coord, normal);
        drawn.push(Drawn { triangle: at, coord, normal, color, count });
    }
    let (mut seen, mut hidden) = (Vec::with_capacity(count), Vec::new());
    for of_triangle in drawn.chunk_by(|a, b| a.triangle == b.triangle) {
        // Files do not agree which way faces look: the side that is seen counts, and of sheets that are seen
        // from both sides now one, now the other.
        let [front, back] = of_triangle
            .iter()
            .fold([0, 0], |sum, one| [sum[0] + one.count[0], sum[1] + one.count[1]]);
        let is_sheet = front.min(back) * 3 > front.max(back);
        for one in of_triangle {
            let turned = if is_sheet { (seen.len() + hidden.len()) % 2 == 1 } else { back > front };
            let normal = if turned { times(one.normal, -1.0) } else { one.normal };
            let triangle = &mesh.triangles[one.triangle];
            let (tangent, edge) = nearest_edge(triangle, creases[one.triangle], one.coord, normal);
            let point = Point {
                coord: one.coord.map(|v| v as f32),
                normal: normal.map(small),
                tangent: tangent.map(small),
                edge: edge as f32,
                color: one.color.map(|c| c.clamp(0.0, 255.0) as u8),
            };
            if one.count != [0, 0] { seen.push(point) } else { hidden.push(point) }
        }
    }
    let num_seen = seen.len();
    let area = total * (num_seen + hidden.len()) as f64 / count as f64;
    seen.append(&mut hidden);
    Points { all: seen, num_seen, area }
}

fn small(v: f64) -> i16 {
    (v.clamp(-1.0, 1.0) * 32767.0).round() as i16
}

/// The vector that `small` shortened.
pub(super) fn long(v: [i16; 3]) -> V3 {
    v.map(|v| f64::from(v) / 32767.0)
}

/// `None` where the texture has a hole.
fn color(mesh: &Mesh, triangle: &Triangle, weights: V3) -> Option<V3> {
    let paint = &mesh.paints[triangle.paint as usize];
    match (&paint.texture, triangle.uv) {
        (Some(texture), Some(uv)) => {
            let place = |i: usize| (0..3).map(|k| uv[k][i] * weights[k]).sum();
            texture.at([place(0), place(1)])
        }
        _ => Some(paint.color),
    }
}

/// Of each triangle, which of its sides (the first from corner 0 to 1) are edges of the surface: its
/// border, or where it turns sharply.
fn creases(triangles: &[Triangle]) -> Vec<[bool; 3]> {
    // Files repeat corners: the same place, to a tenth of a millimeter, is the same corner.
    let key = |p: V3| p.map(|v| (v * 1e4).round() as i32);
    let mut sides: Vec<([[i32; 3]; 2], u32, u8)> = Vec::with_capacity(3 * triangles.len());
    for (index, triangle) in triangles.iter().enumerate() {
        for side in 0..3 {
            let (a, b) = (key(triangle.corners[side]), key(triangle.corners[(side + 1) % 3]));
            sides.push(([a.min(b), a.max(b)], index as u32, side as u8));
        }
    }
    sides.sort_unstable();
    let normal = |t: u32| unit_or(triangles[t as usize].cross(), [0.0, 0.0, 1.0]);
    let mut creases = vec![[false; 3]; triangles.len()];
    for same in sides.chunk_by(|a, b| a.0 == b.0) {
        let first = normal(same[0].1);
        // Sides do not agree which way they look.
        let is_smooth =
            same.len() > 1 && same[1..].iter().all(|s| dot(first, normal(s.1)).abs() > CREASE);
        if !is_smooth {
            same.iter().for_each(|s| creases[s.1 as usize][s.2 as usize] = true);
        }
    }
    creases
}

/// Direction along the nearest of a triangle's edges, or of its longest side, and how far the edge is.
fn nearest_edge(triangle: &Triangle, creases: [bool; 3], p: V3, normal: V3) -> (V3, f64) {
    let side = |k: usize| sub(triangle.corners[(k + 1) % 3], triangle.corners[k]);
    let mut best = (FAR, None);
    for k in (0..3).filter(|&k| creases[k]) {
        let along = unit_or(side(k), normal);
        let from = sub(p, triangle.corners[k]);
        let away = length(add_times(from, along, -dot(from, along)));
        if away < best.0 {
            best = (away, Some(along));
        }
    }
    let tangent = best.1.unwrap_or_else(|| {
        let longest =
            (1..3).fold(0, |best, k| if length(side(k)) > length(side(best)) { k } else { best });
        unit_or(side(longest), basis(normal)[0])
    });
    (tangent, best.0)
}

/// A point of the surface near a stored one: somewhere in the square that it stands for.
pub(super) fn spread(point: &Point, by: [f64; 2]) -> (V3, V3, V3) {
    let (normal, tangent) = (long(point.normal), long(point.tangent));
    let normal = unit_or(normal, [0.0, 0.0, 1.0]);
    let tangent = unit_or(tangent, basis(normal)[0]);
    let coord = point.coord.map(f64::from);
    let coord = add_times(add_times(coord, tangent, by[0]), cross(normal, tangent), by[1]);
    (coord, normal, tangent)
}

/// The mean color of points.
pub(super) fn mean_color(points: &[Point]) -> V3 {
    points.iter().enumerate().fold([0.0; 3], |mean, (number, point)| {
        mix(mean, point.color.map(f64::from), 1.0 / (number + 1) as f64)
    })
}
