//! Which of several overlapping masks stay.

use super::{MaskProposal, mask::Mask};

/// Overlap of two boxes (left, top, right, bottom) over what they cover together. Lengths are differences of pixel
/// numbers, as the original takes them: the box of a single row has no area.
fn box_iou(a: [u32; 4], b: [u32; 4]) -> f64 {
    let length = |low: u32, high: u32| f64::from(high.saturating_sub(low));
    let area = |b: [u32; 4]| length(b[0], b[2]) * length(b[1], b[3]);
    let both = length(a[0].max(b[0]), a[2].min(b[2])) * length(a[1].max(b[1]), a[3].min(b[3]));
    // NaN for two boxes without area, which then are not above anything.
    both / (area(a) + area(b) - both)
}

/// Indices of the boxes that stay, best score first: each that overlaps no better one by more than `most`. Equal scores
/// keep their order.
pub(super) fn keep_boxes(boxes: &[[u32; 4]], scores: &[f64], most: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..boxes.len()).collect();
    order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        if !kept.iter().any(|k| box_iou(boxes[*k], boxes[i]) > most) {
            kept.push(i);
        }
    }
    kept
}

/// Limits of [`keep_masks`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaskNms {
    /// A mask that overlaps a better one by more than this (IoU of pixels) goes.
    pub iou: f64,
    /// A mask whose stability · predicted IoU is not above this goes.
    pub score: f64,
    /// A mask with at least 85 % of its pixels in another one that it is less than half of goes if its share of that one
    /// is below this.
    pub inner: f64,
    /// Masks of at most so many pixels go.
    pub least_area: u64,
}

impl Default for MaskNms {
    /// Those of SceneSplat's labels (from the authors' later public code).
    fn default() -> Self {
        Self { iou: 0.8, score: 0.7, inner: 0.5, least_area: 10 }
    }
}

/// Share of a smaller mask that must lie in a larger one, and most of the larger that it may be, to be inner.
const INSIDE: f64 = 0.85;
const LESS_THAN: f64 = 0.5;

/// LangSplat's mask NMS: indices of the proposals that stay, in their order.
///
/// If no score is above the limit, the three best scores stand in for those above it: what the original means to do,
/// where it stops.
///
/// # Source
/// `masks_update` and `mask_nms` of LangSplat as SceneSplat's labels use them. All pairs are compared, not only those with
/// masks that stay.
pub fn keep_masks(proposals: &[MaskProposal], limits: &MaskNms) -> Vec<usize> {
    let scores: Vec<f64> =
        proposals.iter().map(|p| f64::from(p.stability) * f64::from(p.predicted_iou)).collect();
    let mut order: Vec<usize> = (0..proposals.len()).collect();
    order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
    let mut stays: Vec<bool> = scores.iter().map(|s| *s > limits.score).collect();
    if !stays.contains(&true) {
        order.iter().take(3).for_each(|i| stays[*i] = true);
    }
    let masks: Vec<&Mask> = proposals.iter().map(|p| &p.mask).collect();
    for (rank, &worse) in order.iter().enumerate() {
        for &better in &order[..rank] {
            let both = masks[better].intersection(masks[worse]) as f64;
            if both == 0.0 {
                continue;
            }
            let (a, b) = (masks[better].area() as f64, masks[worse].area() as f64);
            if both / (a + b - both) > limits.iou {
                stays[worse] = false;
            }
            // The smaller goes, whichever has the better score.
            let product = both / a * (both / b);
            let goes =
                |inside: f64, of: f64| inside >= INSIDE && of < LESS_THAN && product < limits.inner;
            if goes(both / b, both / a) {
                stays[worse] = false;
            }
            if goes(both / a, both / b) {
                stays[better] = false;
            }
        }
    }
    (0..proposals.len()).filter(|i| stays[*i] && masks[*i].area() > limits.least_area).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_by_hand() {
        // 10 × 10 each; the second overlaps the first by 80 of 120, the third by none.
        let boxes = [[0, 0, 10, 10], [2, 0, 12, 10], [20, 0, 30, 10], [0, 0, 10, 10]];
        assert_eq!(keep_boxes(&boxes, &[0.5, 0.9, 0.1, 0.5], 0.7), [1, 0, 2]);
        assert_eq!(keep_boxes(&boxes, &[0.5, 0.9, 0.1, 0.5], 0.6), [1, 2]);
        // Equal scores: the first stays, and stays first.
        assert_eq!(keep_boxes(&boxes, &[1.0; 4], 0.6), [0, 2]);
        // Boxes without area overlap nothing.
        assert_eq!(keep_boxes(&[[3, 3, 3, 9]; 2], &[1.0; 2], 0.7), [0, 1]);
    }

    fn proposal(x: u32, wide: u32, score: f32) -> MaskProposal {
        MaskProposal {
            mask: Mask::from_fn(100, 10, |u, _| u >= x && u < x + wide),
            predicted_iou: score,
            stability: 1.0,
            point: [0.0; 2],
            crop: [0, 0, 100, 10],
        }
    }

    #[test]
    fn each_limit_of_masks_alone() {
        let keep = |all: &[MaskProposal]| keep_masks(all, &MaskNms::default());
        // 90 of 100 pixels alike: IoU 9/11 = 0.818.
        let twice = [proposal(0, 10, 0.8), proposal(1, 10, 0.9)];
        assert_eq!(keep(&twice), [1]);
        // 80 of 100: IoU 2/3.
        assert_eq!(keep(&[proposal(0, 10, 0.8), proposal(2, 10, 0.9)]), [0, 1]);
        // A low score.
        assert_eq!(keep(&[proposal(0, 10, 0.7), proposal(50, 10, 0.71)]), [1]);
        // Inside a larger one: a fifth of it goes, three quarters of it stay.
        assert_eq!(keep(&[proposal(0, 50, 0.8), proposal(5, 10, 0.9)]), [0]);
        assert_eq!(keep(&[proposal(0, 50, 0.9), proposal(5, 10, 0.8)]), [0]);
        assert_eq!(keep(&[proposal(0, 40, 0.9), proposal(5, 30, 0.8)]), [0, 1]);
        // 8 of 10 pixels inside are too few.
        assert_eq!(keep(&[proposal(0, 50, 0.9), proposal(42, 10, 0.8)]), [0, 1]);
        // The score is the product with stability: 0.9 · 0.7 is too little.
        let unsteady = MaskProposal { stability: 0.7, ..proposal(0, 10, 0.9) };
        assert_eq!(keep(&[unsteady, proposal(50, 10, 0.8)]), [1]);
        // Ten pixels are too few, eleven are not.
        let mut small = [proposal(0, 1, 0.9), proposal(50, 2, 0.9)];
        assert_eq!(keep(&small), [1]);
        // None above: the best three.
        small = [proposal(0, 5, 0.1), proposal(50, 2, 0.2)];
        assert_eq!(keep(&small), [0, 1]);
        assert_eq!(keep(&[]), [0; 0]);
    }

    #[test]
    fn limits_are_met_at_their_edges_and_kept_apart() {
        let keep = |all: &[MaskProposal], limits: &MaskNms| keep_masks(all, limits);
        let default = MaskNms::default();
        assert_eq!(default, MaskNms { iou: 0.8, score: 0.7, inner: 0.5, least_area: 10 });
        // 16 of 20 columns are both: an IoU of 0.8 is not above 0.8. Of 17 of 20 the better stays.
        let pair = |wide| [proposal(0, 20, 0.9), proposal(0, wide, 0.8)];
        let apart = MaskNms { inner: 0.0, ..default };
        assert_eq!(keep(&pair(16), &apart), [0, 1]);
        assert_eq!(keep(&pair(17), &apart), [0]);
        // 17 of 20 columns inside are 0.85, 16 are not. They are 0.34 of the larger: the product is 0.289.
        let inside = |x| [proposal(0, 50, 0.9), proposal(x, 20, 0.8)];
        assert_eq!(keep(&inside(33), &default), [0]);
        assert_eq!(keep(&inside(34), &default), [0, 1]);
        assert_eq!(keep(&inside(33), &MaskNms { inner: 0.288, ..default }), [0, 1]);
        assert_eq!(keep(&inside(33), &MaskNms { inner: 0.290, ..default }), [0]);
        // Wholly inside, and half of the larger: not less than half. 0.9 of it is still below the IoU's limit.
        let half = |wide| [proposal(0, 40, 0.9), proposal(0, wide, 0.8)];
        assert_eq!(keep(&half(20), &MaskNms { inner: 1.0, ..default }), [0, 1]);
        assert_eq!(keep(&half(19), &MaskNms { inner: 1.0, ..default }), [0]);
        // The least area and the score are settings, too; none above the score are the best three.
        let three = [0.5, 0.2, 0.4, 0.3].map(|s| proposal((s * 100.0) as u32, 3, s));
        assert_eq!(keep(&three, &default), [0, 2, 3]);
        assert_eq!(keep(&three, &MaskNms { score: 0.25, ..default }), [0, 2, 3]);
        assert_eq!(keep(&three, &MaskNms { score: 0.35, ..default }), [0, 2]);
        assert_eq!(keep(&three, &MaskNms { least_area: 30, ..default }), [0; 0]);
        assert_eq!(keep(&three, &MaskNms { least_area: 29, ..default }), [0, 2, 3]);
    }

    #[test]
    fn boxes_overlap_on_both_axes() {
        // 10 × 4 and 6 × 8 that share 4 × 3 = 12: 12 / (40 + 48 − 12) = 0.1579.
        let (a, b) = ([0, 0, 10, 4], [6, 1, 12, 9]);
        assert!((box_iou(a, b) - 12.0 / 76.0).abs() < 1e-12);
        assert!((box_iou(b, a) - 12.0 / 76.0).abs() < 1e-12);
        // Side by side, and above each other: nothing in common.
        assert_eq!((box_iou(a, [10, 0, 20, 4]), box_iou(a, [0, 5, 10, 9])), (0.0, 0.0));
        // Exactly the limit stays.
        assert_eq!(keep_boxes(&[[0, 0, 10, 10], [0, 0, 5, 10]], &[1.0, 0.5], 0.5), [0, 1]);
    }
}
