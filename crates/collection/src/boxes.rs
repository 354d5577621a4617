//! Which superpixels of a box are the thing in it.

use scenesplat_rasterizer::lifting::SegmentMap;
use std::collections::BTreeMap;

/// Depths on both sides of a border that differ by more than this part are of two things.
const STEP: f32 = 0.08;
/// How far from the border depth is read, pixels: rendered depth is smeared over edges.
const AWAY: usize = 3;
/// Part of a superpixel that has to be in the box.
const INSIDE: f64 = 0.6;
/// Part of a surface of one color that has to be in the box.
const WITHIN: f64 = 0.5;
/// Least part of the box that a thing fills: less is not what the box was drawn around.
const FILLED: f64 = 0.1;

/// Superpixels with what is known of them.
pub(crate) struct Parts {
    /// Number of pixels of each.
    pixels: Vec<u32>,
    /// Median of the depths of each; infinity where none is known.
    depth: Vec<f32>,
    /// Neighbors of each that are of one surface with it.
    joined: Vec<Vec<usize>>,
    /// The surface of one color that each is of.
    surface: Vec<usize>,
    /// Number of pixels of these.
    surface_pixels: Vec<u32>,
}

impl Parts {
    /// Of maps in which every pixel has an id: small pieces, and surfaces of one color.
    pub(crate) fn of(map: &SegmentMap, surfaces: &SegmentMap, depth: Option<&[f32]>) -> Self {
        let count = map.num_ids();
        let known = |at: usize| depth.map(|d| d[at]).filter(|z| z.is_finite() && *z > 0.0);
        let (mut pixels, mut depths) = (vec![0; count], vec![Vec::new(); count]);
        for (at, id) in map.ids().iter().enumerate() {
            pixels[usize::from(*id)] += 1;
            depths[usize::from(*id)].extend(known(at));
        }
        let median = |values: &mut Vec<f32>| {
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f32::INFINITY)
        };
        let depth = depths.iter_mut().map(median).collect();
        let mut joined = vec![Vec::new(); count];
        for ((a, b), gaps) in gaps(map, known) {
            if gaps.mean().is_some_and(|gap| gap <= f64::from(STEP)) {
                joined[a].push(b);
                joined[b].push(a);
            }
        }
        let mut surface_pixels = vec![0; surfaces.num_ids()];
        let mut shared: Vec<BTreeMap<usize, u32>> = vec![BTreeMap::new(); count];
        for (id, surface) in map.ids().iter().zip(surfaces.ids()) {
            surface_pixels[usize::from(*surface)] += 1;
            *shared[usize::from(*id)].entry(usize::from(*surface)).or_default() += 1;
        }
        // The one that it shares most with, of equal ones the first.
        let most = |shared: &BTreeMap<usize, u32>| {
            shared
                .iter()
                .rev()
                .max_by_key(|(_, pixels)| **pixels)
                .map_or(0, |(surface, _)| *surface)
        };
        let surface = shared.iter().map(most).collect();
        Self { pixels, depth, joined, surface, surface_pixels }
    }

    /// Their number.
    pub(crate) fn len(&self) -> usize {
        self.pixels.len()
    }
}

/// Differences of depth along a border.
#[derive(Default)]
struct Gaps {
    sum: f64,
    count: u32,
    /// Places where but one side has a depth.
    half: u32,
}

impl Gaps {
    /// The mean, unless most of the border has a depth on one side only.
    fn mean(&self) -> Option<f64> {
        (self.count > self.half).then(|| self.sum / f64::from(self.count))
    }
}

fn gaps(map: &SegmentMap, known: impl Fn(usize) -> Option<f32>) -> BTreeMap<(usize, usize), Gaps> {
    let (width, ids) = (map.width() as usize, map.ids());
    let mut borders: BTreeMap<(usize, usize), Gaps> = BTreeMap::new();
    let mut meet = |p: usize, q: usize, step: usize| {
        let (a, b) = (ids[p], ids[q]);
        if a == b {
            return;
        }
        // As far into both as they reach.
        let mut from = p;
        let mut to = q;
        for _ in 1..AWAY {
            let (before, behind) = (from.checked_sub(step), to + step);
            let same_row = |x: usize, y: usize| step > 1 || x / width == y / width;
            match before {
                Some(before)
                    if behind < ids.len()
                        && ids[before] == a
                        && ids[behind] == b
                        && same_row(before, behind) =>
                {
                    (from, to) = (before, behind);
                }
                _ => break,
            }
        }
        let border = borders.entry((usize::from(a.min(b)), usize::from(a.max(b)))).or_default();
        match (known(from), known(to)) {
            (Some(a), Some(b)) => {
                border.sum += f64::from((a - b).abs() / a.min(b));
                border.count += 1;
            }
            (None, None) => border.count += 1,
            _ => border.half += 1,
        }
    };
    for at in 0..ids.len() {
        if at % width + 1 < width {
            meet(at, at + 1, 1);
        }
        if at + width < ids.len() {
            meet(at, at + width, width);
        }
    }
    borders
}

/// The superpixels of the thing in a box: those of one surface that fill most of its middle, near ones first; none if
/// they fill too little of it.
pub(crate) fn chosen(
    parts: &Parts,
    map: &SegmentMap,
    [left, top, right, bottom]: [f32; 4],
) -> Vec<usize> {
    let width = map.width() as usize;
    let half = [(right - left) / 2.0, (bottom - top) / 2.0];
    let middle = [left + half[0], top + half[1]];
    let range = |from: f32, to: f32, end: u32| {
        (from.floor().max(0.0) as usize)..(to.ceil().max(0.0) as usize).min(end as usize)
    };
    // Pixels in the box, and their weight: the middle says most.
    let mut inside: BTreeMap<usize, (u32, f64)> = BTreeMap::new();
    for y in range(top, bottom, map.height()) {
        for x in range(left, right, map.width()) {
            let off = |place: usize, k: usize| ((place as f32 + 0.5 - middle[k]) / half[k]).abs();
            let (dx, dy) = (off(x, 0), off(y, 1));
            if dx < 1.0 && dy < 1.0 {
                let found = inside.entry(usize::from(map.ids()[y * width + x])).or_default();
                found.0 += 1;
                found.1 += f64::from((1.0 - dx) * (1.0 - dy));
            }
        }
    }
    let mut of_surfaces: BTreeMap<usize, u32> = BTreeMap::new();
    for (part, (pixels, _)) in &inside {
        *of_surfaces.entry(parts.surface[*part]).or_default() += pixels;
    }
    // A floor that goes on beyond the box is not the chair on it.
    inside.retain(|part, (pixels, _)| {
        let surface = parts.surface[*part];
        f64::from(*pixels) >= INSIDE * f64::from(parts.pixels[*part])
            && f64::from(of_surfaces[&surface]) >= WITHIN * f64::from(parts.surface_pixels[surface])
    });
    let mut left_over: Vec<usize> = inside.keys().copied().collect();
    let mut best: (f64, Vec<usize>) = (0.0, Vec::new());
    let area = f64::from(4.0 * half[0] * half[1]);
    while let Some(&first) = left_over.first() {
        let (mut group, mut at) = (vec![first], 0);
        left_over.remove(0);
        while let Some(&part) = group.get(at) {
            for other in &parts.joined[part] {
                if let Ok(place) = left_over.binary_search(other) {
                    left_over.remove(place);
                    group.push(*other);
                }
            }
            at += 1;
        }
        let pixels: f64 = group.iter().map(|part| f64::from(inside[part].0)).sum();
        let weight: f64 = group.iter().map(|part| inside[part].1).sum();
        // Of two surfaces the nearer one is the thing: through the back of a chair the wall is in the middle.
        let near: f64 =
            group.iter().map(|part| inside[part].1 / f64::from(parts.depth[*part].max(0.1))).sum();
        let all_unknown = near == 0.0;
        let score = if all_unknown { weight * 1e-3 } else { near };
        if pixels >= FILLED * area && score > best.0 {
            best = (score, group);
        }
    }
    best.1.sort_unstable();
    best.1
}

#[cfg(test)]
mod by_hand;
