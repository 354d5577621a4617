//! Drifting light: on one and the same surface, it is lighter at one end of the scene than at the other.
//!
//! Pairs of patches that lie in one plane and have about the same hue are compared; their differences of
//! light are explained by one gradient, robustly. Texture, shading and shadows have none that holds for
//! all surfaces. Of rooms alone: objects are rounder, and shaded.

use super::noise::color;
use super::planes::Shell;
use super::table::{Patch, Plane, Table, quantile_of, scramble};
use super::{Figure, Measured, Outcome};
use rayon::prelude::*;
use scenesplat_scene::linear_light::linear;
use scenesplat_scene::vector::dot;

/// Other patches that each patch is compared with, most of which lie in other planes.
const TRIES: u64 = 96;
/// Normals of one plane agree so well, and patches lie across it by at most so much of their distance.
const SAME_NORMAL: f64 = 0.96;
const ACROSS: f64 = 0.06;
/// Distances of pairs, in half diagonals of the scene.
const APART: [f64; 2] = [0.05, 0.8];
/// Surfaces whose light differs by more, in stops, or whose hue does, are different ones.
const SAME_LIGHT: f64 = 1.0;
const SAME_HUE: f64 = 0.6;
/// Values of a display that tell the light.
const RANGE: [f64; 2] = [0.08, 0.97];
/// Fewer pairs have no gradient that holds for all.
const FEWEST_PAIRS: usize = 500;

/// A patch of a surface, with what light falls on it.
struct Spot {
    place: [f64; 3],
    plane: Plane,
    /// Stops.
    light: f64,
    /// Red over blue, and green over both, stops.
    hue: [f64; 2],
}

/// Two patches of one surface.
struct Pair {
    apart: [f64; 3],
    light: f64,
    hue: f64,
}

pub(super) fn measure(table: &Table<'_>, shell: &Shell) -> Outcome {
    shell.is_room()?;
    let spots: Vec<Spot> = table.flat().filter_map(|(p, plane)| spot(table, p, plane)).collect();
    let half = 0.5 * table.bounds.diagonal();
    let pairs: Vec<Pair> = (0..spots.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let spots = &spots;
            (0..TRIES).filter_map(move |t| {
                let j = (scramble(i as u64 * TRIES + t) % spots.len() as u64) as usize;
                pair(&spots[i], &spots[j], half)
            })
        })
        .collect();
    if pairs.len() < FEWEST_PAIRS {
        return Err("there are too few patches in common planes");
    }
    let light = gradient(&pairs, |p| p.light);
    let hue = gradient(&pairs, |p| p.hue);
    let length = |g: [f64; 3]| dot(g, g).sqrt() * half;
    let drift = length(light);
    Ok(Measured {
        measure: Figure::new("exposure_drift", drift, "stops to either end"),
        more: vec![
            Figure::new("balance_drift", length(hue), "stops of red over blue to either end"),
            Figure::new("clipped", clipped(table), ""),
            Figure::new("pairs", pairs.len() as f64, ""),
        ],
        strength: drift,
        regions: Vec::new(),
    })
}

/// Share of the Gaussians that are as light as a display can show, in some channel.
fn clipped(table: &Table<'_>) -> f64 {
    let is_clipped = |row: u32| color(table, row as usize).iter().any(|v| *v >= 0.996);
    let count = table.patches.iter().filter(|p| is_clipped(p.row)).count();
    count as f64 / table.patches.len() as f64
}

fn spot(table: &Table<'_>, patch: &Patch, plane: Plane) -> Option<Spot> {
    let middle =
        |i: usize| quantile_of(patch.near.iter().map(|&row| color(table, row as usize)[i]), 0.5);
    let [r, g, b] = [middle(0)?, middle(1)?, middle(2)?];
    if ![r, g, b].iter().all(|v| (RANGE[0]..=RANGE[1]).contains(v)) {
        return None;
    }
    let [r, g, b] = [r, g, b].map(|v| linear(v).log2());
    Some(Spot {
        place: table.place(patch),
        plane,
        light: (r + g + b) / 3.0,
        hue: [r - b, g - 0.5 * (r + b)],
    })
}

fn pair(a: &Spot, b: &Spot, half: f64) -> Option<Pair> {
    let apart: [f64; 3] = std::array::from_fn(|i| b.place[i] - a.place[i]);
    let distance = dot(apart, apart).sqrt();
    let (n, m) = (a.plane.axes[2], b.plane.axes[2]);
    let across = dot(n, apart).abs().max(dot(m, apart).abs());
    let (light, hue) = (b.light - a.light, b.hue[0] - a.hue[0]);
    let same = (APART[0] * half..=APART[1] * half).contains(&distance)
        && dot(n, m).abs() >= SAME_NORMAL
        && across <= ACROSS * distance
        && light.abs() <= SAME_LIGHT
        && hue.abs() <= SAME_HUE
        && (b.hue[1] - a.hue[1]).abs() <= 0.5 * SAME_HUE;
    same.then_some(Pair { apart, light, hue })
}

/// The gradient that explains the differences best (Tukey's biweight, by reweighting).
fn gradient(pairs: &[Pair], value: impl Fn(&Pair) -> f64) -> [f64; 3] {
    let mut g = [0.0; 3];
    for _ in 0..12 {
        let rest = |p: &Pair| value(p) - dot(g, p.apart);
        let spread = quantile_of(pairs.iter().map(|p| rest(p).abs()), 0.5).unwrap_or(0.0);
        let cut = 4.685 * spread.max(1e-6) / 0.6745;
        let mut matrix = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        let mut trace = 0.0;
        for p in pairs {
            let r = rest(p) / cut;
            if r.abs() >= 1.0 {
                continue;
            }
            let weight = (1.0 - r * r).powi(2) / dot(p.apart, p.apart).sqrt();
            for a in 0..3 {
                right[a] += weight * p.apart[a] * value(p);
                trace += weight * p.apart[a] * p.apart[a];
                for b in 0..3 {
                    matrix[a][b] += weight * p.apart[a] * p.apart[b];
                }
            }
        }
        // Where all planes are parallel nothing is known across them: no gradient there.
        (0..3).for_each(|a| matrix[a][a] += 1e-3 * trace);
        g = solve(matrix, right);
    }
    g
}

/// Solves three equations by Cramer's rule; 0 where there is no solution.
fn solve(m: [[f64; 3]; 3], right: [f64; 3]) -> [f64; 3] {
    use scenesplat_scene::vector::cross;
    let columns: [[f64; 3]; 3] = std::array::from_fn(|i| [m[0][i], m[1][i], m[2][i]]);
    let det = dot(columns[0], cross(columns[1], columns[2]));
    std::array::from_fn(|i| {
        let mut c = columns;
        c[i] = right;
        let value = dot(c[0], cross(c[1], c[2])) / det;
        if value.is_finite() { value } else { 0.0 }
    })
}
