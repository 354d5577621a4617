//! Which settings no other beats, where more time stops to pay, and the cheapest of each class.

use serde::{Deserialize, Serialize};

/// Classes of quality, as shares of the reference's; those of MLPerf Inference, and one below.
pub const CLASSES: [f64; 3] = [0.999, 0.99, 0.95];

/// Which of the points no other beats: none is both no dearer and no worse, and better in one. Of
/// equal points the first is kept. Points that are not finite are never kept.
///
/// `points`: cost, lower is better, and worth, higher is better.
pub fn front(points: &[[f64; 2]]) -> Vec<bool> {
    let finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
    let beats = |(i, [c, w]): (usize, &[f64; 2]), (j, [d, v]): (usize, &[f64; 2])| {
        c <= d && w >= v && (c < d || w > v || i < j)
    };
    let kept = |(j, point): (usize, &[f64; 2])| {
        finite(point)
            && !points
                .iter()
                .enumerate()
                .any(|(i, other)| i != j && finite(other) && beats((i, other), (j, point)))
    };
    points.iter().enumerate().map(kept).collect()
}

/// Where a front bends most: the point farthest above the line from its cheapest to its best point, time
/// on a logarithmic scale. `None` for fewer than three points, or where none lies above the line.
///
/// `front`: cost above 0, ascending, and worth.
///
/// # Source
/// The criterion of Satopää et al., "Finding a Kneedle in a Haystack", 2011, without smoothing.
pub fn knee(front: &[[f64; 2]]) -> Option<usize> {
    let (first, last) = (front.first()?, front.last()?);
    let (wide, high) = ((last[0] / first[0]).ln(), last[1] - first[1]);
    if front.len() < 3 || !(wide > 0.0 && high > 0.0) {
        return None;
    }
    let above = |p: &[f64; 2]| (p[1] - first[1]) / high - (p[0] / first[0]).ln() / wide;
    let best = (0..front.len()).max_by(|&a, &b| {
        let (a_above, b_above) = (above(&front[a]), above(&front[b]));
        // Of equal ones the cheaper.
        a_above.total_cmp(&b_above).then(b.cmp(&a))
    })?;
    (above(&front[best]) > 1e-9).then_some(best)
}

/// The cheapest setting of a class of quality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClassWinner {
    /// Least share of the reference's quality.
    pub share: f64,
    /// The setting; none where not even the reference was measured.
    pub setting: Option<String>,
    /// Its cost, seconds.
    pub seconds_p50: Option<f64>,
    /// Its quality.
    pub quality: Option<f64>,
}

/// The cheapest point whose worth is at least that share of the reference's.
pub fn cheapest_of_class(points: &[[f64; 2]], reference: f64, share: f64) -> Option<usize> {
    let keeps = |&i: &usize| points[i][1] >= share * reference && points[i][0].is_finite();
    (0..points.len()).filter(keeps).min_by(|&a, &b| points[a][0].total_cmp(&points[b][0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_front_is_what_no_other_point_beats() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..200 {
            // Few values, so that points share a cost, a worth, or both.
            let points: Vec<[f64; 2]> = (0..rng.random_range(1..12))
                .map(|_| [(); 2].map(|()| f64::from(rng.random_range(0..5))))
                .collect();
            let no_worse = |a: [f64; 2], b: [f64; 2]| a[0] <= b[0] && a[1] >= b[1];
            for (i, kept) in front(&points).into_iter().enumerate() {
                let beaten = points.iter().enumerate().any(|(j, other)| {
                    // Of equal points the first stays.
                    no_worse(*other, points[i]) && (*other != points[i] || j < i)
                });
                assert_eq!(kept, !beaten, "{points:?}: {i}");
            }
        }
        assert_eq!(front(&[[1.0, 0.5], [f64::NAN, 1.0]]), [true, false]);
        assert_eq!(front(&[]), Vec::<bool>::new());
    }

    #[test]
    fn the_knee_is_where_more_time_stops_to_pay() {
        assert_eq!(knee(&[[1.0, 0.1], [2.0, 0.8], [10.0, 0.85], [100.0, 0.9]]), Some(1));
        // On the line, below it, and with nothing between.
        assert_eq!(knee(&[[1.0, 0.0], [10.0, 0.5], [100.0, 1.0]]), None);
        assert_eq!(knee(&[[1.0, 0.0], [10.0, 0.2], [100.0, 1.0]]), None);
        assert_eq!(knee(&[[1.0, 0.0], [10.0, 1.0]]), None);
        assert_eq!(knee(&[]), None);
    }

    #[test]
    fn a_class_is_won_by_its_cheapest() {
        let points = [[5.0, 0.80], [1.0, 0.70], [2.0, 0.795], [3.0, 0.7999]];
        let winner = |share| cheapest_of_class(&points, 0.8, share);
        assert_eq!(CLASSES.map(winner), [Some(3), Some(2), Some(2)]);
        assert_eq!(winner(0.5), Some(1));
        assert_eq!(winner(1.1), None);
    }

    #[test]
    fn knees_and_classes_of_equal_points_are_the_cheaper_ones() {
        assert_eq!(CLASSES, [0.999, 0.99, 0.95]);
        // From 1 s to 1000 s in three decades, from 0 to 0.9: 0.4 and 0.7 are 0.4/0.9 − 1/3 and 0.7/0.9 − 2/3 above.
        assert_eq!(knee(&[[1.0, 0.0], [10.0, 0.4], [100.0, 0.7], [1000.0, 0.9]]), Some(1));
        assert_eq!(knee(&[[1.0, 0.0], [10.0, 0.4], [100.0, 0.72], [1000.0, 0.9]]), Some(2));
        // As far above the line as each other.
        assert_eq!(knee(&[[1.0, 0.0], [4.0, 0.5], [16.0, 0.75], [256.0, 1.0]]), Some(1));
        // No range of time or of worth.
        assert_eq!(knee(&[[1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]), None);
        assert_eq!(knee(&[[1.0, 0.5], [2.0, 0.6], [3.0, 0.5]]), None);
        let points = [[2.0, 0.5], [f64::INFINITY, 0.9], [1.0, 0.4], [1.0, 0.4]];
        assert_eq!(
            (cheapest_of_class(&points, 0.4, 1.0), cheapest_of_class(&points, 0.5, 1.0)),
            (Some(2), Some(0))
        );
        assert_eq!(cheapest_of_class(&points, 0.9, 1.0), None);
        assert_eq!(
            front(&[[1.0, f64::INFINITY], [f64::NEG_INFINITY, 1.0], [2.0, 0.5]]),
            [false, false, true]
        );
    }
}
