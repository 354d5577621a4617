//! Clusters that become segments: connected, and joined where neighbors are alike.

use crate::surface::{COLOR, NORMAL, PLANE, Pixels};
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// What is joined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Similarity {
    /// How different neighbors may be, in units of the clusters' distance.
    pub(crate) limit: f32,
    /// Pixels below which a segment joins a neighbor in any case.
    pub(crate) smallest: u32,
}

/// Two neighbors and how different they are.
#[derive(Debug, Clone, Copy)]
struct Edge {
    difference: f32,
    a: u32,
    b: u32,
}

/// The segment of each pixel, numbered from 0 in the order of first pixels.
pub(crate) fn merge(pixels: &Pixels, clusters: &[u32], similarity: Similarity) -> Vec<u32> {
    let parts = connected(pixels, clusters);
    let count = parts.iter().max().map_or(0, |&id| id as usize + 1);
    let mut edges = edges(pixels, &parts, count);
    // Equal differences by number: the same segments on any machine.
    edges.sort_by(|x, y| x.difference.total_cmp(&y.difference).then((x.a, x.b).cmp(&(y.a, y.b))));
    let mut sets = Sets::new(count);
    for &part in &parts {
        sets.pixels[part as usize] += 1;
    }
    for edge in &edges {
        let (a, b) = (sets.root(edge.a), sets.root(edge.b));
        // Large segments have to be more alike than their parts are already.
        let bound = |sets: &Sets, s: u32| {
            let members = sets.members[s as usize] as f32;
            (sets.inner[s as usize] + similarity.limit / members).max(similarity.limit / 2.0)
        };
        if a != b
            && edge.difference <= bound(&sets, a).min(bound(&sets, b))
            && similarity.limit > 0.0
        {
            sets.join(a, b, edge.difference);
        }
    }
    // A segment that is too small joins its most similar neighbor, again until all are large enough.
    for edge in &edges {
        let (a, b) = (sets.root(edge.a), sets.root(edge.b));
        let least = sets.pixels[a as usize].min(sets.pixels[b as usize]);
        if a != b && least < similarity.smallest {
            sets.join(a, b, edge.difference);
        }
    }
    let mut number = vec![u32::MAX; count];
    let mut next = 0;
    parts
        .iter()
        .map(|&part| {
            let root = sets.root(part) as usize;
            if number[root] == u32::MAX {
                number[root] = next;
                next += 1;
            }
            number[root]
        })
        .collect()
}

/// Connected parts of clusters (four neighbors), numbered in the order of first pixels.
fn connected(pixels: &Pixels, clusters: &[u32]) -> Vec<u32> {
    let (width, height) = (pixels.width, pixels.height);
    let mut parts = vec![u32::MAX; clusters.len()];
    let (mut next, mut waiting) = (0, Vec::new());
    for first in 0..clusters.len() {
        if parts[first] != u32::MAX {
            continue;
        }
        parts[first] = next;
        waiting.push(first);
        while let Some(at) = waiting.pop() {
            let (x, y) = (at % width, at / width);
            let around = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then_some(at + 1),
                (y > 0).then(|| at - width),
                (y + 1 < height).then_some(at + width),
            ];
            for other in around.into_iter().flatten() {
                if parts[other] == u32::MAX && clusters[other] == clusters[first] {
                    parts[other] = next;
                    waiting.push(other);
                }
            }
        }
        next += 1;
    }
    parts
}

/// Neighbors with their differences: of mean colors, and of surfaces along their border.
fn edges(pixels: &Pixels, parts: &[u32], count: usize) -> Vec<Edge> {
    let mut color = vec![(DVec3::ZERO, 0.0f64); count];
    for (&part, lab) in parts.iter().zip(&pixels.lab) {
        let (sum, number) = &mut color[part as usize];
        *sum += lab.as_dvec3();
        *number += 1.0;
    }
    let mean = |part: u32| {
        let (sum, number) = color[part as usize];
        (sum / number).as_vec3()
    };
    let mut borders: BTreeMap<(u32, u32), (f64, u32)> = BTreeMap::new();
    let mut meet = |p: usize, q: usize| {
        let (a, b) = (parts[p].min(parts[q]), parts[p].max(parts[q]));
        if a != b {
            let (sum, number) = borders.entry((a, b)).or_default();
            *sum += f64::from(crease(pixels, p, q));
            *number += 1;
        }
    };
    for at in 0..parts.len() {
        if at % pixels.width + 1 < pixels.width {
            meet(at, at + 1);
        }
        if at + pixels.width < parts.len() {
            meet(at, at + pixels.width);
        }
    }
    let edge = |((a, b), (sum, number)): ((u32, u32), (f64, u32))| {
        let apart = mean(a).distance_squared(mean(b)) / (COLOR * COLOR);
        let surface = (sum / f64::from(number)) as f32;
        Edge { difference: (apart + surface).sqrt(), a, b }
    };
    borders.into_iter().map(edge).collect()
}

/// How much a surface bends and steps between two pixels, squared.
fn crease(pixels: &Pixels, p: usize, q: usize) -> f32 {
    let (points, normals) = (&pixels.surface.points, &pixels.surface.normals);
    match (points[p].z > 0.0, points[q].z > 0.0) {
        (false, false) => return 0.0,
        (true, true) => {}
        _ => return 1.0,
    }
    let between = points[q] - points[p];
    let depth = points[p].z.min(points[q].z);
    let off = normals[p].dot(between).abs().min(normals[q].dot(between).abs()) / depth;
    // Normals are means over 5 × 5 pixels: seen from two pixels to either side, a crease is whole.
    let turned = beyond(pixels, p, q).distance_squared(beyond(pixels, q, p));
    (off / PLANE).powi(2).min(25.0) + turned / (NORMAL * NORMAL)
}

/// The normal three pixels from `q` behind `p`, or the nearest to that in the picture.
fn beyond(pixels: &Pixels, p: usize, q: usize) -> Vec3 {
    let (width, height) = (pixels.width as isize, pixels.height as isize);
    let place = |at: usize| (at as isize % width, at as isize / width);
    let ((px, py), (qx, qy)) = (place(p), place(q));
    let x = (px + 3 * (px - qx)).clamp(0, width - 1);
    let y = (py + 3 * (py - qy)).clamp(0, height - 1);
    let far = (y * width + x) as usize;
    let near = pixels.surface.points[p].z;
    // Behind an edge there is another surface.
    let same = (pixels.surface.points[far].z - near).abs() <= 0.05 * near;
    pixels.surface.normals[if same { far } else { p }]
}

/// Sets of parts that became one.
struct Sets {
    parent: Vec<u32>,
    /// Largest difference inside.
    inner: Vec<f32>,
    members: Vec<u32>,
    pixels: Vec<u32>,
}

impl Sets {
    fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
            inner: vec![0.0; count],
            members: vec![1; count],
            pixels: vec![0; count],
        }
    }

    fn root(&mut self, mut of: u32) -> u32 {
        while self.parent[of as usize] != of {
            let up = self.parent[of as usize];
            self.parent[of as usize] = self.parent[up as usize];
            of = up;
        }
        of
    }

    fn join(&mut self, a: u32, b: u32, difference: f32) {
        let (to, from) = (a.min(b) as usize, a.max(b) as usize);
        self.parent[from] = to as u32;
        self.inner[to] = self.inner[to].max(self.inner[from]).max(difference);
        self.members[to] += self.members[from];
        self.pixels[to] += self.pixels[from];
    }
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Surface;

    /// A ridge along the middle column: what is left of it looks to the left, what is right of it to the right.
    fn ridge(width: usize, height: usize) -> Pixels {
        let side = |at: usize| if at % width < width / 2 { -1.0f32 } else { 1.0 };
        let points = (0..width * height)
            .map(|at| Vec3::new((at % width) as f32 * 0.001, (at / width) as f32 * 0.001, 2.0));
        let normals =
            (0..width * height).map(|at| Vec3::new(0.2 * side(at), 0.0, -1.0).normalize());
        let surface = Surface { points: points.collect(), normals: normals.collect() };
        Pixels { width, height, lab: vec![Vec3::ZERO; width * height], surface }
    }

    #[test]
    fn a_crease_counts_the_same_however_long_its_border_is() {
        let of = |height: usize| {
            let pixels = ridge(8, height);
            let parts: Vec<u32> = (0..8 * height).map(|at| u32::from(at % 8 >= 4)).collect();
            let edges = edges(&pixels, &parts, 2);
            assert_eq!((edges.len(), edges[0].a, edges[0].b), (1, 0, 1));
            edges[0].difference
        };
        let want = 2.0 * 0.2 / (1.0f32 + 0.04).sqrt() / 0.4;
        assert!((of(1) - want).abs() < 1e-2, "{} {want}", of(1));
        assert!((of(1) - of(12)).abs() < 1e-4, "{} {}", of(1), of(12));
    }

    #[test]
    fn normals_are_looked_up_in_the_picture_whatever_its_sides() {
        // From column 4 away from column 3: column 7, or the last; upward the first row.
        for (width, height) in [(9, 5), (5, 9)] {
            let pixels = Pixels {
                width,
                height,
                lab: vec![Vec3::ZERO; width * height],
                surface: Surface {
                    points: vec![Vec3::Z; width * height],
                    normals: (0..width * height).map(|at| Vec3::X * at as f32).collect(),
                },
            };
            let at = |x: usize, y: usize| y * width + x;
            let seen = |p: usize, q: usize| beyond(&pixels, p, q).x as usize;
            assert_eq!(seen(at(4, 2), at(3, 2)), at(7.min(width - 1), 2));
            assert_eq!(seen(at(1, 4), at(1, 3)), at(1, 7.min(height - 1)));
            assert_eq!(seen(at(1, 1), at(1, 2)), at(1, 0));
        }
    }

    #[test]
    fn a_segment_of_three_has_to_be_more_alike_than_a_single_one() {
        let joined = |lightness: &[f32]| {
            let count = lightness.len();
            let lab = lightness.iter().map(|&l| Vec3::new(l, 0.0, 0.0)).collect();
            let surface = Surface::unknown(count);
            let pixels = Pixels { width: count, height: 1, lab, surface };
            let clusters: Vec<u32> = (0..count as u32).collect();
            merge(&pixels, &clusters, Similarity { limit: 1.0, smallest: 0 })
        };
        // 10 of lightness are a difference of 1. A single superpixel may differ by the limit, 1: 0.8 joins.
        assert_eq!(joined(&[6.0, 14.0]), [0, 0]);
        // Three that differ by 0.3 become one segment. It may differ by 0.3 + 1/3 = 0.63: 0.6 joins, 0.8 does not.
        assert_eq!(joined(&[0.0, 3.0, 6.0, 14.0]), [0, 0, 0, 1]);
        assert_eq!(joined(&[0.0, 3.0, 6.0, 12.0]), [0, 0, 0, 0]);
    }
}
