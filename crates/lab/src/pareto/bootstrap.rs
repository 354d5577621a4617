//! How far a quality would move with other scenes of the same kind.

use super::ParetoError;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_metrics::{ConfusionMatrix, Metric};

/// Seed of the draws: the same scenes give the same bounds.
const SEED: u64 = 0x5EED_B007;
/// Draws; the bounds then move by less than their own last shown digit.
const DRAWS: usize = 1000;

/// Foreground mean `IoU` of all scenes together, and the bounds between which 95 % of its values lie
/// where as many scenes are drawn from these with replacement. With one scene there is no spread to
/// tell: the bounds are the value.
///
/// # Errors
/// If the matrices are not of one kind.
pub fn f_miou_with_bounds(scenes: &[ConfusionMatrix]) -> Result<Option<[f64; 3]>, ParetoError> {
    let pooled = |picks: &mut dyn Iterator<Item = usize>| -> Result<Option<f64>, ParetoError> {
        let Some(first) = picks.next() else { return Ok(None) };
        let mut sum = scenes[first].clone();
        for pick in picks {
            sum.merge(&scenes[pick])?;
        }
        Ok(sum.tester_report().foreground_mean_iou)
    };
    let Some(value) = pooled(&mut (0..scenes.len()))? else { return Ok(None) };
    if scenes.len() == 1 {
        return Ok(Some([value; 3]));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut values = Vec::with_capacity(DRAWS);
    for _ in 0..DRAWS {
        let picks: Vec<usize> =
            (0..scenes.len()).map(|_| rng.random_range(0..scenes.len())).collect();
        values.extend(pooled(&mut picks.into_iter())?);
    }
    values.sort_by(f64::total_cmp);
    Ok(Some([value, quantile(&values, 0.025), quantile(&values, 0.975)]))
}

/// A quantile of ascending values, between the two nearest; NaN of none.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = q.clamp(0.0, 1.0) * last as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    let high = (low + 1).min(last);
    sorted[low] + part * (sorted[high] - sorted[low])
}

/// As [`quantile`], of values in any order.
pub fn quantile_of(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    quantile(&sorted, q)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(right: u64, wrong: u64) -> ConfusionMatrix {
        let mut matrix = ConfusionMatrix::new(2).unwrap();
        let truth = vec![0; (right + wrong) as usize];
        let said: Vec<i32> = (0..right + wrong).map(|i| i32::from(i >= right)).collect();
        matrix.update((&said, &truth)).unwrap();
        matrix
    }

    #[test]
    fn bounds_hold_the_value_and_are_the_same_each_time() {
        let scenes: Vec<ConfusionMatrix> = (1..8).map(|i| matrix(10 * i, 50)).collect();
        let [value, low, high] = f_miou_with_bounds(&scenes).unwrap().unwrap();
        assert!(low < value && value < high, "{low} {value} {high}");
        assert_eq!(f_miou_with_bounds(&scenes).unwrap(), Some([value, low, high]));
        let one = f_miou_with_bounds(&scenes[..1]).unwrap().unwrap();
        assert!(one[0] == one[1] && one[1] == one[2]);
        assert_eq!(f_miou_with_bounds(&[]).unwrap(), None);
        // Equal scenes have no spread.
        let same = vec![matrix(30, 10); 5];
        let [value, low, high] = f_miou_with_bounds(&same).unwrap().unwrap();
        assert!((value - low).abs() < 1e-12 && (high - value).abs() < 1e-12);
    }

    #[test]
    fn quantiles_lie_between_the_nearest() {
        assert_eq!(quantile_of(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile_of(&[1.0, 2.0], 0.95), 1.95);
        assert_eq!(quantile_of(&[7.0], 0.95), 7.0);
        assert!(quantile_of(&[], 0.5).is_nan());
    }

    #[test]
    fn the_bounds_hold_95_percent_of_the_draws() {
        let sizes = [20u64, 30, 40, 50];
        let widths = sizes.map(|count| {
            // Equally large scenes of which 0, 1, 2, ... rows are right: a draw's value goes with the
            // mean share of right rows, which is almost normal. It is 1/2, and its deviation that of
            // evenly spaced shares over the root of their number.
            let most = count - 1;
            let scenes: Vec<ConfusionMatrix> =
                (0..count).map(|right| matrix(right, most - right)).collect();
            let [value, low, high] = f_miou_with_bounds(&scenes).unwrap().unwrap();
            let (n, most) = (count as f64, most as f64);
            let deviation = ((n * n - 1.0) / 12.0).sqrt() / most / n.sqrt();
            (high - low) / value / (deviation / 0.5)
        });
        // 95 % of a normal distribution are 3.92 deviations wide, 90 % only 3.29.
        let mean = widths.iter().sum::<f64>() / widths.len() as f64;
        assert!((mean - 3.92).abs() < 0.3, "{mean} {widths:?}");
    }

    #[test]
    fn bounds_are_those_of_a_thousand_seeded_draws() {
        let scenes: Vec<ConfusionMatrix> =
            [(1, 9), (8, 2), (5, 40), (30, 3)].map(|(r, w)| matrix(r, w)).to_vec();
        let pooled = |picks: &[usize]| {
            let mut sum = scenes[picks[0]].clone();
            picks[1..].iter().for_each(|i| sum.merge(&scenes[*i]).unwrap());
            sum.tester_report().foreground_mean_iou.unwrap()
        };
        let mut rng = ChaCha8Rng::seed_from_u64(0x5EED_B007);
        let mut all: Vec<f64> =
            (0..1000).map(|_| pooled(&[(); 4].map(|()| rng.random_range(0..4)))).collect();
        all.sort_by(f64::total_cmp);
        // Places 24.975 and 974.025 of 0 to 999.
        let want = [
            pooled(&[0, 1, 2, 3]),
            all[24] + 0.975 * (all[25] - all[24]),
            all[974] + 0.025 * (all[975] - all[974]),
        ];
        let found = f_miou_with_bounds(&scenes).unwrap().unwrap();
        assert!((0..3).all(|i| (found[i] - want[i]).abs() < 1e-9), "{found:?} {want:?}");
        let other = ConfusionMatrix::new(3).unwrap();
        assert!(f_miou_with_bounds(&[scenes[0].clone(), other]).is_err());
        let ten = [0.0, 10.0, 20.0, 40.0];
        assert_eq!(
            [-1.0, 0.0, 0.25, 0.9, 1.0, 7.0].map(|q| quantile(&ten, q)),
            [0.0, 0.0, 7.5, 34.0, 40.0, 40.0]
        );
    }
}
