//! Which Gaussians lie in some balls.

use rayon::prelude::*;
use std::collections::HashMap;

/// Whether each point lies in one of the balls (center, radius); empty if there is no ball. `coord`: `[N, 3]`
///
/// Balls with a number that is not finite, or of radius 0, hold nothing.
pub(super) fn inside(balls: &[[f32; 4]], coord: &[[f32; 3]]) -> Vec<bool> {
    let usable = |b: &&[f32; 4]| b.iter().all(|v| v.is_finite()) && b[3] > 0.0;
    let balls: Vec<&[f32; 4]> = balls.iter().filter(usable).collect();
    let Some(widest) = balls.iter().map(|b| b[3]).max_by(f32::total_cmp) else {
        return Vec::new();
    };
    // In cells as wide as the widest ball, one reaches no farther than the cells next to its own.
    let cell = |p: &[f32]| -> [i64; 3] {
        std::array::from_fn(|a| (f64::from(p[a]) / f64::from(widest)).floor() as i64)
    };
    let mut cells: HashMap<[i64; 3], Vec<&[f32; 4]>> = HashMap::new();
    for ball in balls {
        let at = cell(ball);
        for x in -1..=1 {
            for y in -1..=1 {
                for z in -1..=1 {
                    let near = [(at[0], x), (at[1], y), (at[2], z)];
                    cells.entry(near.map(|(c, d)| c.saturating_add(d))).or_default().push(ball);
                }
            }
        }
    }
    let holds = |p: &[f32; 3], ball: &[f32; 4]| {
        let square = |a: usize| (f64::from(p[a]) - f64::from(ball[a])).powi(2);
        square(0) + square(1) + square(2) <= f64::from(ball[3]).powi(2)
    };
    coord
        .par_iter()
        .map(|p| cells.get(&cell(p)).is_some_and(|near| near.iter().any(|ball| holds(p, ball))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_hold_what_is_in_them_as_by_looking_at_all() {
        let number = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1000) as f32 / 100.0 - 5.0;
        let coord: Vec<[f32; 3]> =
            (0..3000).map(|i| std::array::from_fn(|k| number(i, k))).collect();
        let mut balls: Vec<[f32; 4]> = (0..9)
            .map(|i| [number(i, 5), number(i, 6), number(i, 7), 0.3 + 0.2 * i as f32])
            .collect();
        balls.extend([[f32::NAN, 0.0, 0.0, 9.0], [0.0, 0.0, 0.0, 0.0], [0.0; 4]]);
        let found = inside(&balls, &coord);
        let all = |p: &[f32; 3]| {
            balls[..9].iter().any(|b| {
                (0..3).map(|a| f64::from(p[a] - b[a]).powi(2)).sum::<f64>()
                    <= f64::from(b[3]).powi(2)
            })
        };
        assert_eq!(found, coord.iter().map(all).collect::<Vec<_>>());
        assert!((100..2500).contains(&found.iter().filter(|is| **is).count()));
        assert!(inside(&balls[9..], &coord).is_empty() && inside(&[], &coord).is_empty());
        let odd = [[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0], [1e30; 3]];
        assert_eq!(inside(&balls, &odd), [false; 3]);
    }
}
