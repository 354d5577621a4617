//! One number a pixel from overlapping masks.

use super::MaskProposal;

/// Which segment each pixel belongs to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdMap {
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Number of the proposal at each pixel, −1 where there is none. `[height, width]`
    pub ids: Vec<i32>,
}

/// Paints the proposals over each other in their order, as SceneSplat's labels were: later ones lie on top.
///
/// Pixels of masks beyond the map are left out.
pub fn paint(proposals: &[MaskProposal], width: u32, height: u32) -> IdMap {
    paint_in(proposals, 0..proposals.len(), width, height)
}

fn paint_in(
    proposals: &[MaskProposal],
    order: impl Iterator<Item = usize>,
    width: u32,
    height: u32,
) -> IdMap {
    let mut ids = vec![-1; width as usize * height as usize];
    for index in order {
        for [x, y] in proposals[index].mask.pixels() {
            if x < width && y < height {
                ids[y as usize * width as usize + x as usize] = index as i32;
            }
        }
    }
    IdMap { width, height, ids }
}

/// A mask covered by more than this by a better and larger one is a part of it.
const COVERED: f64 = 0.85;

/// Paints whole objects: masks that lie to more than 85 % in a larger one with a better score (stability · predicted
/// IoU) are left out, the others are painted from the largest to the smallest.
pub fn paint_objects(proposals: &[MaskProposal], width: u32, height: u32) -> IdMap {
    let score = |p: &MaskProposal| p.stability * p.predicted_iou;
    let part = |small: &MaskProposal| {
        proposals.iter().any(|large| {
            large.mask.area() > small.mask.area()
                && score(large) > score(small)
                && large.mask.intersection(&small.mask) as f64 > COVERED * small.mask.area() as f64
        })
    };
    let mut order: Vec<usize> = (0..proposals.len()).filter(|i| !part(&proposals[*i])).collect();
    order.sort_by_key(|i| std::cmp::Reverse(proposals[*i].mask.area()));
    paint_in(proposals, order.into_iter(), width, height)
}

#[cfg(test)]
mod tests {
    use super::super::Mask;
    use super::*;

    fn bar(x: u32, wide: u32, score: f32) -> MaskProposal {
        MaskProposal {
            mask: Mask::from_fn(8, 1, |u, _| u >= x && u < x + wide),
            predicted_iou: score,
            stability: 1.0,
            point: [0.0; 2],
            crop: [0, 0, 8, 1],
        }
    }

    #[test]
    fn later_masks_lie_on_top() {
        let all = [bar(0, 5, 0.9), bar(3, 4, 0.1)];
        assert_eq!(paint(&all, 8, 1).ids, [0, 0, 0, 1, 1, 1, 1, -1]);
        assert_eq!(paint(&all, 4, 1).ids, [0, 0, 0, 1]);
        assert_eq!(paint(&[], 2, 2).ids, [-1; 4]);
    }

    #[test]
    fn parts_of_better_objects_are_left_out() {
        // The second is a part with a worse score, the third one with a better score.
        let all = [bar(0, 6, 0.8), bar(1, 2, 0.7), bar(4, 2, 0.9), bar(5, 3, 0.1)];
        assert_eq!(paint_objects(&all, 8, 1).ids, [0, 0, 0, 0, 2, 2, 3, 3]);
    }

    #[test]
    fn parts_are_told_by_share_score_and_size() {
        let ids = |all: &[MaskProposal]| paint_objects(all, 8, 1).ids;
        // Stability counts: 0.9 · 0.5 is less than 0.6, so the small one is no part of a better one.
        let unsteady = MaskProposal { stability: 0.5, ..bar(0, 6, 0.9) };
        assert_eq!(ids(&[unsteady, bar(1, 2, 0.6)]), [0, 1, 1, 0, 0, 0, -1, -1]);
        // Half of it in the larger is not enough to be a part; the smaller is painted last.
        assert_eq!(ids(&[bar(5, 2, 0.1), bar(0, 6, 0.9)]), [1, 1, 1, 1, 1, 0, 0, -1]);
        // Equal areas and equal scores: nothing is a part, and the first of equals is painted first.
        assert_eq!(ids(&[bar(0, 3, 0.9), bar(0, 3, 0.8)]), [1, 1, 1, -1, -1, -1, -1, -1]);
        assert_eq!(ids(&[bar(0, 3, 0.9), bar(1, 2, 0.9)]), [0, 1, 1, -1, -1, -1, -1, -1]);
        // 17 of 20 columns are 85 %, which is not more.
        let long = |x: u32, wide: u32, score: f32| MaskProposal {
            mask: Mask::from_fn(60, 1, |u, _| u >= x && u < x + wide),
            ..bar(0, 1, score)
        };
        let id_of = |x| paint_objects(&[long(0, 40, 0.9), long(x, 20, 0.5)], 60, 1).ids[39];
        assert_eq!((id_of(23), id_of(22)), (1, 0));
        // A map of two rows takes the masks' own.
        let tall = MaskProposal { mask: Mask::from_fn(3, 2, |x, y| x + y == 2), ..bar(0, 1, 0.5) };
        let map = paint(&[tall], 3, 2);
        assert_eq!((map.width, map.height, map.ids), (3, 2, vec![-1, -1, 0, -1, 0, -1]));
    }
}
