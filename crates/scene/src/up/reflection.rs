//! What a shiny floor shows below itself: the room once more, on its head.

use super::evidence::inner_bounds;
use super::surface::Surface;
use crate::bounds::Bounds;
use crate::frame::{Matrix3, matrix};
use std::collections::HashSet;

/// Slabs that the height is cut in; a surface is looked for in two that touch.
const SLABS: usize = 64;

/// Cells per side in which the coverage of a slab is counted.
const PLAN: usize = 24;

/// A floor covers so much of the ground plan, and has so many times the rows of a slab in the middle.
const LEAST_COVER: f64 = 0.6;
const PEAK: f64 = 3.0;

/// Cells along the longest side in which both sides are compared.
const CELLS: f64 = 48.0;

/// So much of a reflection lies where the other side of the floor has something; of two storeys, less.
const ALIKE: f64 = 0.9;

/// Surface times rows of a reflection, as part of that on the other side: less is dirt, and of more nobody knows which is
/// the room.
const SHARES: std::ops::Range<f64> = 1e-3..0.8;

/// A level surface in which a scene is reflected.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reflection {
    /// Height of the surface, and how far it reaches above and below.
    height: f64,
    reach: f64,
    /// Whether the reflection lies below it.
    is_below: bool,
}

/// Leaves out what is a reflection in a level surface, in the first of some frames in which there is one. The third row
/// of a frame is its height.
pub(super) fn leave_out(surface: &mut Surface, frames: impl IntoIterator<Item = Matrix3>) {
    let areas: Vec<f64> = surface.pieces.iter().map(|piece| piece.area).collect();
    for rows in frames {
        let turn = matrix(&rows);
        let places: Vec<[f64; 3]> =
            surface.pieces.iter().map(|piece| (turn * piece.place).to_array()).collect();
        if let Some(reflection) = Reflection::of(&places, &areas, &inner_bounds(&places)) {
            let mut heights = places.iter().map(|place| place[2]);
            surface.pieces.retain(|_| heights.next().is_some_and(|h| reflection.keeps(h)));
            return;
        }
    }
}

impl Reflection {
    /// Whether a height belongs to the scene itself.
    fn keeps(&self, height: f64) -> bool {
        let above = height - self.height;
        if self.is_below { above >= -self.reach } else { above <= self.reach }
    }

    /// The reflection of a scene in a level surface, if it has one.
    ///
    /// `places`: the third axis is the height; `areas`: how much of each is seen; `bounds`: of nearly all of them.
    fn of(places: &[[f64; 3]], areas: &[f64], bounds: &Bounds) -> Option<Self> {
        let (low, extent) = (bounds.low, bounds.extent());
        if !extent.into_iter().all(|e| e > 0.0 && e.is_finite()) {
            return None;
        }
        let reach = extent[2] / SLABS as f64;
        let height =
            height_of(places, low[2] + fullest(places, low, extent)? as f64 * reach, reach)?;
        let of_side = |above: bool| {
            let is_there = move |h: f64| {
                if above { h > height + reach } else { h < height - reach }
            };
            places.iter().zip(areas).filter(move |(place, _)| is_there(place[2]))
        };
        let area = |above: bool| of_side(above).map(|(_, area)| area).sum::<f64>();
        // Planes through few points are as large as those through many.
        let weight = |above: bool| area(above) * of_side(above).count() as f64;
        let is_below = weight(false) <= weight(true);
        if !SHARES.contains(&(weight(!is_below) / weight(is_below))) {
            return None;
        }
        let cell = bounds.largest_extent() / CELLS;
        let cell_of = |place: [f64; 3]| place.map(|v| (v / cell).floor() as i64);
        let there: HashSet<[i64; 3]> =
            of_side(is_below).flat_map(|(place, _)| neighbors(cell_of(*place))).collect();
        let is_alike = |[x, y, z]: &[f64; 3]| there.contains(&cell_of([*x, *y, 2.0 * height - z]));
        let alike = of_side(!is_below).filter(|(place, _)| is_alike(place));
        let alike: f64 = alike.map(|(_, area)| area).sum();
        (alike >= ALIKE * area(!is_below)).then_some(Self { height, reach, is_below })
    }
}

/// A cell and those that touch it.
fn neighbors([x, y, z]: [i64; 3]) -> impl Iterator<Item = [i64; 3]> {
    (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1])
}

/// The height of the surface in two slabs from a height on: what is in the middle of all that lies there.
fn height_of(places: &[[f64; 3]], from: f64, slab: f64) -> Option<f64> {
    let there = from..from + 2.0 * slab;
    let mut heights: Vec<f64> = places.iter().map(|p| p[2]).filter(|h| there.contains(h)).collect();
    let middle = heights.len() / 2;
    let (_, height, _) =
        (!heights.is_empty()).then(|| heights.select_nth_unstable_by(middle, f64::total_cmp))?;
    Some(*height)
}

/// The first of the two slabs, away from both ends, that hold the fullest level surface.
fn fullest(places: &[[f64; 3]], low: [f64; 3], extent: [f64; 3]) -> Option<usize> {
    let mut counts = [0usize; SLABS];
    let mut plans = vec![[false; PLAN * PLAN]; SLABS];
    let mut any = [false; PLAN * PLAN];
    for place in places {
        let share = |a: usize| (place[a] - low[a]) / extent[a];
        if (0..3).any(|a| !(0.0..=1.0).contains(&share(a))) {
            continue;
        }
        let index = |a: usize, count: usize| ((share(a) * count as f64) as usize).min(count - 1);
        let (slab, cell) = (index(2, SLABS), index(0, PLAN) * PLAN + index(1, PLAN));
        counts[slab] += 1;
        plans[slab][cell] = true;
        any[cell] = true;
    }
    let mut sorted = counts;
    sorted.sort_unstable();
    let usual = sorted[SLABS / 2].max(1) as f64;
    let all = any.iter().filter(|cell| **cell).count() as f64;
    let covers = |slab: usize| {
        let both = plans[slab].iter().zip(&plans[slab + 1]);
        both.filter(|(a, b)| **a || **b).count() as f64 >= LEAST_COVER * all
    };
    let rows = |slab: usize| counts[slab] + counts[slab + 1];
    let inner = 2..SLABS - 3;
    let peak = inner.filter(|&slab| covers(slab)).max_by_key(|&slab| (rows(slab), SLABS - slab))?;
    (rows(peak) as f64 >= 2.0 * PEAK * usual).then_some(peak)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of a room of 5 × 4 m and so high, from a height on: floor, four walls, and a table in a corner.
    fn room(from: f64, height: f64, corner: f64) -> Vec<[f64; 3]> {
        let mut bits = 7u64;
        let mut next = || {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (bits >> 40) as f64 / f64::from(1 << 24)
        };
        let mut places = Vec::new();
        for _ in 0..4000 {
            let (x, y, z) = (5.0 * next(), 4.0 * next(), from + height * next());
            places.extend([[x, y, from], [x, y, from], [x, 0.0, z], [x, 4.0, z]]);
            places.extend([[0.0, y, z], [5.0, y, z]]);
            let table = [corner + 1.5 * next(), corner + 1.5 * next(), from + 0.75 * next()];
            places.extend([table; 3]);
        }
        places
    }

    fn of(places: &[[f64; 3]], seen: impl Fn(usize) -> f64) -> Option<Reflection> {
        let ends = |a: usize, end: fn(f64, f64) -> f64| {
            places.iter().map(|p| p[a]).reduce(end).unwrap_or_default()
        };
        let low = [0, 1, 2].map(|a| ends(a, f64::min));
        let extent = [0, 1, 2].map(|a| ends(a, f64::max) - low[a]);
        let areas: Vec<f64> = (0..places.len()).map(seen).collect();
        Reflection::of(places, &areas, &Bounds { low, high: [0, 1, 2].map(|a| low[a] + extent[a]) })
    }

    #[test]
    fn a_room_on_its_head_is_a_reflection_a_storey_and_a_ball_are_none() {
        let upper = room(0.0, 2.6, 0.2);
        assert_eq!(of(&upper, |_| 1.0), None);
        let below: Vec<[f64; 3]> = upper.iter().map(|p| [p[0], p[1], -p[2]]).collect();
        let both = [upper.clone(), below].concat();
        let faint = |i: usize| if i < upper.len() { 1.0 } else { 0.5 };
        let found = of(&both, faint).unwrap();
        assert!(found.keeps(1.0) && found.keeps(0.0) && !found.keeps(-0.3), "{found:?}");
        // On its head, the other half goes.
        let turned: Vec<[f64; 3]> = both.iter().map(|p| [p[0], p[1], -p[2]]).collect();
        let found = of(&turned, faint).unwrap();
        assert!(found.keeps(-1.0) && found.keeps(0.0) && !found.keeps(0.3), "{found:?}");
        // Nobody knows which of two equal halves is the room.
        assert_eq!(of(&both, |_| 1.0), None);
        // Another storey has its things elsewhere.
        let storeys = [room(2.8, 2.6, 0.2), room(0.0, 2.6, 3.0)].concat();
        assert_eq!(of(&storeys, |i| if i < upper.len() { 1.0 } else { 0.5 }), None);
        let ball: Vec<[f64; 3]> = (0..9000)
            .map(|i| {
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 9000.0;
                let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * f64::from(i));
                [r * phi.cos(), r * phi.sin(), z]
            })
            .collect();
        assert_eq!(of(&ball, |_| 1.0), None);
        assert_eq!(of(&[], |_| 1.0), None);
        assert_eq!(of(&[[1.0; 3]; 3], |_| 1.0), None);
    }
}
