//! Rows drawn in proportion to a weight.

use crate::random::Counter;

/// Draws `count` rows with replacement, each in proportion to its weight, in ascending order.
///
/// Sums are f64, so any number of rows can be drawn from. Weights that are not above 0 are never drawn;
/// nothing is drawn if there is no other.
pub(crate) fn draw(weights: &[f32], count: usize, counter: &Counter) -> Vec<u32> {
    let good = |w: f32| if w > 0.0 && w.is_finite() { f64::from(w) } else { 0.0 };
    let total: f64 = weights.iter().map(|w| good(*w)).sum();
    if !(total > 0.0) || count == 0 {
        return Vec::new();
    }
    let mut places: Vec<f64> =
        (0..count.div_ceil(4)).flat_map(|i| counter.units(i)).take(count).collect();
    places.sort_by(f64::total_cmp);
    let (mut drawn, mut next) = (Vec::with_capacity(count), 0);
    let (mut sum, mut last) = (0.0, 0);
    for (row, weight) in weights.iter().enumerate() {
        let weight = good(*weight);
        if weight == 0.0 {
            continue;
        }
        (sum, last) = (sum + weight, row as u32);
        while next < count && places[next] * total < sum {
            drawn.push(row as u32);
            next += 1;
        }
    }
    // The product may round to the total.
    drawn.resize(count, last);
    drawn
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    #[test]
    fn in_proportion_to_the_weights() {
        let counter = Counter::new(1, Purpose::Add, 2);
        let weights = [0.0, 1.0, f32::NAN, 3.0, -1.0];
        let n = 40_000;
        let drawn = draw(&weights, n, &counter);
        assert!(drawn.is_sorted() && drawn.len() == n);
        let ones = drawn.iter().filter(|r| **r == 1).count();
        assert!(drawn.iter().all(|r| [1, 3].contains(r)));
        // Five standard deviations.
        assert!((ones as f64 - 0.25 * n as f64).abs() < 5.0 * (0.1875 * n as f64).sqrt());
        assert!(draw(&[0.0, f32::INFINITY], 3, &counter).is_empty());
        assert!(draw(&weights, 0, &counter).is_empty());
    }

    #[test]
    fn every_draw_has_a_number_of_its_own() {
        // Of 10,000 equal rows 1000 draws hit about 952 different ones.
        let mut drawn = draw(&[1.0; 10_000], 1000, &Counter::new(3, Purpose::Add, 5));
        drawn.dedup();
        assert!((900..1000).contains(&drawn.len()), "{}", drawn.len());
    }

    #[test]
    fn a_row_is_drawn_where_a_unit_falls_among_the_running_sums() {
        // Running sums 0.5, 2.5 and 4 of rows 0, 2 and 4; seven draws need two rows of four units.
        let counter = Counter::new(11, Purpose::Relocate, 3);
        let mut units: Vec<f64> = [counter.units(0), counter.units(1)].concat()[..7].to_vec();
        units.sort_by(f64::total_cmp);
        let row_at = |u: f64| {
            if 4.0 * u < 0.5 {
                0
            } else if 4.0 * u < 2.5 {
                2
            } else {
                4
            }
        };
        let want: Vec<u32> = units.into_iter().map(row_at).collect();
        assert_eq!(draw(&[0.5, 0.0, 2.0, f32::NAN, 1.5], 7, &counter), want);
    }
}
