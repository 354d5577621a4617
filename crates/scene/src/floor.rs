//! Where the floors of a room are: what heights are measured from.
//!
//! The lowest rows are no floor: floaters lie below it, polished stone mirrors the room downwards, a
//! cellar or a pipe reaches deeper. A floor is a level slab that covers much of the ground plan with
//! surface that faces up; the lowest such slab is the floor, and one that has a storey above it is
//! the floor of that storey.

use crate::quantile::quantile;
use crate::quaternion::axes_by_size;
use crate::vector::dot;
use crate::{Bounds, GaussianScene};
use serde::Serialize;

/// Rows that are looked at.
const SAMPLE: usize = 200_000;

/// With fewer visible rows no plane is looked for.
const FEWEST_ROWS: usize = 30;

/// Fainter rows say nothing about surfaces; in a scene that is faint altogether, those fainter than
/// a quarter of the usual.
const FAINTEST: f32 = 0.1;
const FAINT_SHARE: f32 = 0.25;

/// A Gaussian is flat when its shortest axis is this part of the middle one.
const FLAT: f32 = 0.5;

/// Cosines between a normal and the vertical from which a surface is level, and up to which it is none.
const LEVEL: f64 = 0.9;
const STEEP: f64 = 0.5;

/// What a row counts that is level, has no normal, or is slanted; a steep one counts nothing.
const LEVEL_WEIGHT: u32 = 4;
const UNKNOWN_WEIGHT: u32 = 2;
const SLANTED_WEIGHT: u32 = 1;

/// Heights are counted in bins of so many meters, and a slab has so many bins: noise of a capture and
/// a rug lie within 7.5 cm.
const BIN: f64 = 0.025;
const SLAB: usize = 3;
const MOST_BINS: usize = 4096;

/// Side of a cell of the ground plan, meters, and the most cells along a side.
const CELL: f64 = 0.2;
const MOST_CELLS: usize = 64;

/// The lowest slab with this share of the fullest one's score is the floor: tables and mirror images
/// have less, a floor under much furniture has more.
const FLOOR_SHARE: f64 = 0.35;

/// Least share of the ground plan that a floor covers.
const LEAST_COVER: f64 = 0.1;

/// The next storey begins at least so far above a floor, meters, and what is below its floor by less
/// than the thickness of a ceiling is that ceiling.
const STOREY: f64 = 2.0;
const CEILING: f64 = 0.6;

/// A storey has rows this far above its floor, meters, at least this share of what the first one has.
const LIVED_IN: [f64; 2] = [0.4, 1.8];
const LIVED_SHARE: f64 = 0.25;

/// What belongs to a floor lies at most so far below it, meters.
const BELOW: f64 = 0.15;

/// Without a plane, this share of the rows lies below the ground.
const GROUND_SHARE: f64 = 0.01;

/// The floors of a scene, whose +z is up and whose unit is the meter.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Floors {
    /// Height of each floor, ascending, meters; at least one.
    pub heights: Vec<f64>,
    /// Share of the ground plan that the first one covers; 0 if no plane was found, and the height
    /// is that which one visible row in a hundred lies below.
    pub cover: f64,
    /// How much surface lies in the plane of the first one, and how evenly: the sum over the cells
    /// of the ground plan of what lies there, up to what is usual. Compares turns of one scene.
    #[serde(skip)]
    pub score: f64,
    /// Share of the visible rows that lie more than 5 cm below the first one.
    pub below: f64,
    /// Whether somebody said so.
    pub given: bool,
}

/// What is asked of a row.
#[derive(Debug, Clone, Copy)]
pub struct FloorRow {
    /// Center, meters.
    pub coord: [f32; 3],
    /// Opacity, 0..=1.
    pub opacity: f32,
    /// Standard deviations along the principal axes, any unit.
    pub scale: [f32; 3],
    /// Orientation `w, x, y, z`.
    pub quat: [f32; 4],
}

/// A row that counts.
struct Level {
    coord: [f64; 3],
    weight: u32,
}

impl Floors {
    /// One floor, as somebody says, meters.
    pub fn given(height: f64) -> Self {
        Self { heights: vec![height], cover: 1.0, score: 0.0, below: 0.0, given: true }
    }

    /// The height that one of the finite rows in a hundred lies below, for rows that hold no floor; 0 without rows.
    pub fn lowest(coord: &[[f32; 3]]) -> Self {
        Self::ground(coord.iter().map(|c| c[2]).filter(|z| z.is_finite()).collect())
    }

    /// No plane: the height that a hundredth of the rows lie below. Not the lowest: floaters lie anywhere.
    fn ground(mut z: Vec<f32>) -> Self {
        let height = match z.len() {
            0 => 0.0,
            n => *z.select_nth_unstable_by((n as f64 * GROUND_SHARE) as usize, f32::total_cmp).1,
        };
        Self { cover: 0.0, given: false, ..Self::given(f64::from(height)) }
    }

    /// The floors of a scene.
    pub fn of_scene(scene: &GaussianScene) -> Self {
        Self::of(scene.len(), |row| FloorRow {
            coord: scene.coord[row],
            opacity: scene.opacity(row),
            scale: scene.scale(row),
            quat: scene.quat[row],
        })
    }

    /// The floors of `num_rows` rows. The same for any number of threads; not finite rows are left out.
    /// Without any row the floor is at 0.
    pub fn of(num_rows: usize, row: impl Fn(usize) -> FloorRow) -> Self {
        let step = num_rows.div_ceil(SAMPLE).max(1);
        let rows: Vec<FloorRow> = (0..num_rows)
            .step_by(step)
            .map(row)
            .filter(|r| r.coord.iter().all(|c| c.is_finite()))
            .collect();
        let visible = visible(&rows);
        let ground = Self::ground(visible.iter().map(|r| r.coord[2]).collect());
        if visible.is_empty() {
            return ground;
        }
        let found = (visible.len() >= FEWEST_ROWS).then(|| Slabs::of(&visible).floors());
        let mut floors = found.flatten().unwrap_or(ground);
        let limit = floors.heights[0] - 0.05;
        let below = visible.iter().filter(|r| f64::from(r.coord[2]) < limit).count();
        floors.below = below as f64 / visible.len() as f64;
        floors
    }

    /// Whether there is a plane, rather than the lowest rows taken for one.
    pub fn has_plane(&self) -> bool {
        self.cover > 0.0
    }

    /// Height of the floor that what lies at `z` stands on: the highest that is not above it.
    pub fn below(&self, z: f32) -> f64 {
        let z = f64::from(z);
        let first = self.heights[0];
        self.heights.iter().copied().rfind(|floor| z >= floor - BELOW).unwrap_or(first)
    }

    /// Meters of `z` above [its floor](method@Self::below).
    pub fn height(&self, z: f32) -> f32 {
        (f64::from(z) - self.below(z)) as f32
    }
}

fn visible(rows: &[FloorRow]) -> Vec<&FloorRow> {
    let mut opacity: Vec<f32> = rows.iter().map(|r| r.opacity).collect();
    let usual = quantile(&mut opacity, 0.5).unwrap_or(0.0);
    let faintest = FAINTEST.min(FAINT_SHARE * usual);
    rows.iter().filter(|r| r.opacity >= faintest).collect()
}

/// How much a row speaks for a floor; 0 for walls.
fn weight(row: &FloorRow) -> u32 {
    let s = row.scale;
    let [short, middle, _] = axes_by_size(s);
    let q = row.quat.map(f64::from);
    let norm = dot([q[1], q[2], q[3]], [q[1], q[2], q[3]]) + q[0] * q[0];
    let is_flat = s[middle] > 0.0 && s[short] <= FLAT * s[middle];
    if !(is_flat && norm.is_finite() && norm > 0.0) {
        return UNKNOWN_WEIGHT;
    }
    match upright(q, short).abs() / norm {
        cos if cos >= LEVEL => LEVEL_WEIGHT,
        cos if cos >= STEEP => SLANTED_WEIGHT,
        _ => 0,
    }
}

/// Vertical component of a principal axis, times the square of the quaternion's norm.
fn upright([w, x, y, z]: [f64; 4], axis: usize) -> f64 {
    match axis {
        0 => 2.0 * (x * z - w * y),
        1 => 2.0 * (y * z + w * x),
        _ => w * w - x * x - y * y + z * z,
    }
}

/// Heights in bins, and the ground plan in cells.
struct Slabs {
    low: f64,
    bin: f64,
    /// Cell and weight of each row, by its bin; bin `b` has those from `starts[b]` on.
    rows: Vec<(u32, u32)>,
    starts: Vec<usize>,
    /// Rows that count, their heights ascending.
    levels: Vec<Level>,
    /// Heights of all visible rows, walls too, ascending.
    heights: Vec<f64>,
    num_cells: usize,
    /// Cells with any visible row.
    plan: usize,
}

impl Slabs {
    fn of(visible: &[&FloorRow]) -> Self {
        let span = |a: usize| {
            let mut values: Vec<f32> = visible.iter().map(|r| r.coord[a]).collect();
            let at = |values: &mut Vec<f32>, share| quantile(values, share).map_or(0.0, f64::from);
            [at(&mut values, 0.005), at(&mut values, 0.995)]
        };
        let [x, y, z] = [span(0), span(1), span(2)];
        let box_ = Bounds { low: [x[0], y[0], z[0]], high: [x[1], y[1], z[1]] };
        let extent = box_.extent();
        let side = CELL.max(extent[0].max(extent[1]) / MOST_CELLS as f64);
        let across = |a: usize| ((extent[a] / side) as usize + 1).min(MOST_CELLS + 1);
        let cells = [across(0), across(1)];
        let bin = BIN.max(extent[2] / MOST_BINS as f64);
        let num_bins = (extent[2] / bin) as usize + SLAB;
        let mut levels: Vec<Level> = Vec::with_capacity(visible.len());
        let mut heights = Vec::with_capacity(visible.len());
        let mut in_plan = vec![false; cells[0] * cells[1]];
        let cell = |p: [f64; 3]| {
            let at = |a: usize| (((p[a] - box_.low[a]) / side) as usize).min(cells[a] - 1);
            at(1) * cells[0] + at(0)
        };
        for row in visible {
            if box_.distance(row.coord) > 0.0 {
                continue;
            }
            let coord = row.coord.map(f64::from);
            in_plan[cell(coord)] = true;
            heights.push(coord[2]);
            let weight = weight(row);
            if weight > 0 {
                levels.push(Level { coord, weight });
            }
        }
        levels.sort_by(|a, b| a.coord[2].total_cmp(&b.coord[2]));
        heights.sort_by(f64::total_cmp);
        let bin_of = |z: f64| (((z - box_.low[2]) / bin) as usize).min(num_bins - 1);
        let rows = levels.iter().map(|l| (cell(l.coord) as u32, l.weight)).collect();
        let starts =
            (0..=num_bins).map(|b| levels.partition_point(|l| bin_of(l.coord[2]) < b)).collect();
        let plan = in_plan.iter().filter(|&&p| p).count();
        let num_cells = cells[0] * cells[1];
        Self { low: box_.low[2], bin, rows, starts, levels, heights, num_cells, plan }
    }

    /// Score and covered cells of the slab that begins at each bin. A cell counts what it holds, and no
    /// more than `most`.
    fn scores(&self, most: f64) -> Vec<(f64, usize)> {
        let mut held = vec![0u32; self.num_cells];
        let mut touched = Vec::new();
        (0..self.starts.len() - SLAB)
            .map(|b| {
                for &(cell, weight) in &self.rows[self.starts[b]..self.starts[b + SLAB]] {
                    if held[cell as usize] == 0 {
                        touched.push(cell);
                    }
                    held[cell as usize] += weight;
                }
                let (mut score, mut cover) = (0.0, 0);
                for cell in touched.drain(..) {
                    score += f64::from(held[cell as usize]).min(most);
                    cover += usize::from(held[cell as usize] >= LEVEL_WEIGHT);
                    held[cell as usize] = 0;
                }
                (score, cover)
            })
            .collect()
    }

    /// Scores in which much in few cells makes no floor, neither does a trace in many: a cell counts as
    /// much as the average one of the slab that covers most.
    fn capped_scores(&self) -> Vec<(f64, usize)> {
        let plain = self.scores(f64::INFINITY);
        let widest = plain.iter().map(|s| s.1).max().unwrap_or(0);
        // Of those that cover about as much, the one that holds most.
        let wide = plain.iter().filter(|s| s.1 as f64 >= 0.7 * widest as f64);
        let fullest = wide.max_by(|a, b| a.0.total_cmp(&b.0));
        let usual = fullest.map_or(f64::INFINITY, |s| s.0 / s.1.max(1) as f64);
        self.scores(usual)
    }

    fn floors(&self) -> Option<Floors> {
        let scores = self.capped_scores();
        let fullest = scores.iter().map(|s| s.0).fold(0.0, f64::max);
        if fullest <= 0.0 {
            return None;
        }
        // Slabs that hold as much as a floor, each the fullest within its reach.
        let is_peak = |b: usize| {
            let score = scores[b].0;
            let before = scores[b.saturating_sub(SLAB)..b].iter().all(|s| s.0 < score);
            let after =
                scores[b + 1..(b + 1 + SLAB).min(scores.len())].iter().all(|s| s.0 <= score);
            before && after
        };
        let cover = |b: usize| scores[b].1 as f64 / self.plan.max(1) as f64;
        let peaks: Vec<usize> = (0..scores.len())
            .filter(|&b| scores[b].0 >= FLOOR_SHARE * fullest && is_peak(b))
            .filter(|&b| cover(b) >= LEAST_COVER)
            .collect();
        let &first = peaks.first()?;
        let mut heights = vec![self.height(first)];
        let lived_in = self.rows_above(heights[0]);
        for (i, &peak) in peaks.iter().enumerate().skip(1) {
            let height = self.height(peak);
            // The floor above it is as full; a bed on a floor is not.
            let is_ceiling = peaks.get(i + 1).is_some_and(|&next| {
                self.height(next) - height < CEILING && scores[next].0 >= 0.8 * scores[peak].0
            });
            let is_high = height >= heights[heights.len() - 1] + STOREY;
            let lived = self.rows_above(height) as f64 >= LIVED_SHARE * lived_in as f64;
            if is_high && lived && !is_ceiling {
                heights.push(height);
            }
        }
        Some(Floors {
            heights,
            cover: cover(first),
            score: scores[first].0,
            below: 0.0,
            given: false,
        })
    }

    /// Median height of what counts in a slab.
    fn height(&self, slab: usize) -> f64 {
        let inside = &self.levels[self.starts[slab]..self.starts[slab + SLAB]];
        let half = inside.iter().map(|l| u64::from(l.weight)).sum::<u64>() / 2;
        let mut sum = 0;
        for level in inside {
            sum += u64::from(level.weight);
            if sum > half {
                return level.coord[2];
            }
        }
        self.low + self.bin * slab as f64
    }

    /// Rows where people would be on a floor.
    fn rows_above(&self, floor: f64) -> usize {
        let [from, to] = LIVED_IN.map(|h| self.heights.partition_point(|z| *z < floor + h));
        to - from
    }
}

#[cfg(test)]
mod tests;
