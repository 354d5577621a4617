//! From a network's outputs to boxes.

use super::classes::COCO;
use crate::VisionError;

/// Distances in steps of a head, 0 to 10: a distribution for each side of a box.
const BINS: usize = 11;
/// Scores of other classes that are kept beside the best one's.
const OTHERS: usize = 4;
/// Scores below this say nothing.
const LEAST: f32 = 0.05;
/// How much surer a box has to be that covers the whole picture: what fills it is mostly a room that was taken for a thing.
const LARGE: f32 = 0.2;

/// What counts as found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorSettings {
    /// Least score of a small box, above 0.05, below 1; one that covers the whole picture needs 0.2 more, others in
    /// proportion.
    pub score: f32,
    /// Of two boxes that overlap by more than this (IoU, 0 to 1), whatever their classes, the better one is kept.
    pub overlap: f32,
    /// Parts of the picture on a side that are looked at beside the whole, 1 (none) to 4.
    pub tiles: u32,
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self { score: 0.3, overlap: 0.6, tiles: 2 }
    }
}

impl DetectorSettings {
    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), VisionError> {
        if !(self.score > LEAST && self.score < 1.0) {
            return Err(VisionError::config(
                "score of a detector",
                self.score,
                "above 0.05 and below 1",
            ));
        }
        if !(0.0..=1.0).contains(&self.overlap) {
            return Err(VisionError::config("overlap of boxes", self.overlap, "0 to 1"));
        }
        if !(1..=4).contains(&self.tiles) {
            return Err(VisionError::config("tiles of a detector", self.tiles, "1 to 4"));
        }
        Ok(())
    }
}

/// A thing in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Left, top, right, bottom, pixels from the corner of the first.
    pub area: [f32; 4],
    /// Classes (of [`COCO`]) and their scores, 0 to 1, best first, at least one and at most five.
    pub scores: Vec<(usize, f32)>,
}

impl Detection {
    /// The best class.
    pub fn class(&self) -> usize {
        self.scores.first().map_or(0, |(class, _)| *class)
    }

    /// Its score.
    pub fn score(&self) -> f32 {
        self.scores.first().map_or(0.0, |(_, score)| *score)
    }
}

/// Where the outputs of a grid of places are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Head {
    /// Which outputs.
    pub(super) scores: usize,
    pub(super) distances: usize,
    /// Places on a side.
    pub(super) places: usize,
    /// Pixels between two places.
    pub(super) stride: usize,
}

/// Pairs the outputs, whose names say nothing: scores of all classes, and distances, of as many places.
pub(super) fn heads(outputs: &[(&str, &[usize])], side: usize) -> Result<Vec<Head>, String> {
    let mut heads = Vec::new();
    for (at, (name, shape)) in outputs.iter().enumerate() {
        let &[1, places, width] = *shape else {
            return Err(format!("output {name:?} has shape {shape:?}"));
        };
        match width {
            _ if width == COCO.len() => {}
            _ if width == 4 * BINS => continue,
            _ => {
                return Err(format!(
                    "output {name:?} has {width} columns, not 80 scores or 44 distances"
                ));
            }
        }
        let across = places.isqrt();
        let other = outputs.iter().position(|(_, shape)| **shape == [1, places, 4 * BINS]);
        let distances =
            other.ok_or_else(|| format!("output {name:?} has no distances of {places} places"))?;
        if across == 0 || across * across != places || !side.is_multiple_of(across) {
            return Err(format!(
                "output {name:?} has {places} places, which are no grid over {side} pixels"
            ));
        }
        heads.push(Head { scores: at, distances, places: across, stride: side / across });
    }
    if heads.is_empty() {
        return Err("no output has scores of 80 classes".to_owned());
    }
    heads.sort_by_key(|head| head.stride);
    Ok(heads)
}

/// What one grid found, in pixels of the square.
///
/// # Shapes
/// `scores`: `[places², 80]`, 0 to 1 · `distances`: `[places², 4, 11]`, logits
pub(super) fn decode(
    head: &Head,
    scores: &[f32],
    distances: &[f32],
    settings: &DetectorSettings,
) -> Vec<Detection> {
    let rows = scores.chunks_exact(COCO.len()).zip(distances.chunks_exact(4 * BINS));
    let mut found = Vec::new();
    for (at, (scores, distances)) in rows.enumerate() {
        let mut best: Vec<(usize, f32)> =
            scores.iter().copied().enumerate().filter(|(_, score)| *score >= LEAST).collect();
        best.sort_by(|a, b| b.1.total_cmp(&a.1));
        if best.first().is_none_or(|(_, score)| *score < settings.score) {
            continue;
        }
        best.truncate(1 + OTHERS);
        let middle = |place: usize| (place as f32 + 0.5) * head.stride as f32;
        let (x, y) = (middle(at % head.places), middle(at / head.places));
        let away = |side: usize| mean_bin(&distances[side * BINS..][..BINS]) * head.stride as f32;
        let area = [x - away(0), y - away(1), x + away(2), y + away(3)];
        let side = (head.places * head.stride) as f32;
        let along = |from: f32, to: f32| (to.min(side) - from.max(0.0)).max(0.0) / side;
        let share = along(area[0], area[2]) * along(area[1], area[3]);
        if best[0].1 < settings.score + LARGE * share {
            continue;
        }
        found.push(Detection { area, scores: best });
    }
    found
}

/// The mean of 0 to 10 under the softmax of their logits.
fn mean_bin(logits: &[f32]) -> f32 {
    let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut sum, mut weighted) = (0f64, 0f64);
    for (bin, logit) in logits.iter().enumerate() {
        let weight = f64::from(logit - most).exp();
        sum += weight;
        weighted += weight * bin as f64;
    }
    (weighted / sum) as f32
}

/// Those that overlap no better one, best first; equal scores keep their order.
pub(super) fn keep_best(mut found: Vec<Detection>, settings: &DetectorSettings) -> Vec<Detection> {
    found.retain(|d| d.area[2] > d.area[0] && d.area[3] > d.area[1]);
    found.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut kept: Vec<Detection> = Vec::new();
    for thing in found {
        let covered = |k: &Detection| iou(k.area, thing.area) > settings.overlap;
        if !kept.iter().any(covered) {
            kept.push(thing);
        }
    }
    kept
}

/// Area that two boxes share over what they cover together.
pub(super) fn iou(a: [f32; 4], b: [f32; 4]) -> f32 {
    let area = |b: [f32; 4]| (b[2] - b[0]).max(0.0) * (b[3] - b[1]).max(0.0);
    let both = area([a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]);
    let all = area(a) + area(b) - both;
    if all > 0.0 { both / all } else { 0.0 }
}
