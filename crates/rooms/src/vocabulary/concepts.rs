//! Directions that are nearly at right angles to each other.

use crate::dice::normal;
use scenesplat_kernels::random::sample_rng;

/// Chooses the directions; another value is another vocabulary, so networks depend on it.
const SEED: u64 = 0x5ce2_e5b1_a700_0001;

/// Rounds in which directions move away from each other.
const ROUNDS: usize = 60;

/// `count` unit vectors of length `dim`. Up to about `dim` of them the cosines of pairs come out
/// below 0.05.
pub(super) fn directions(count: usize, dim: usize) -> Vec<Vec<f64>> {
    let mut vectors: Vec<Vec<f64>> = (0..count)
        .map(|i| {
            let mut rng = sample_rng(SEED, dim as u64, i as u64);
            normalised((0..dim).map(|_| normal(&mut rng)).collect())
        })
        .collect();
    for _ in 0..ROUNDS {
        let before = vectors.clone();
        let cosines = products(&before);
        for (i, vector) in vectors.iter_mut().enumerate() {
            for (j, other) in before.iter().enumerate() {
                if i != j {
                    add_times(vector, other, -0.25 * cosines[i * count + j]);
                }
            }
            *vector = normalised(std::mem::take(vector));
        }
    }
    vectors
}

/// Dot products of all pairs of rows, `[rows, rows]`, with the bits of [`dot`]: each sum goes through its terms in order, and
/// several sums go on side by side, since one alone waits for its last addition.
fn products(rows: &[Vec<f64>]) -> Vec<f64> {
    const SUMS: usize = 8;
    let count = rows.len();
    let mut all = vec![0.0; count * count];
    for (i, row) in rows.iter().enumerate() {
        for from in (0..=i).step_by(SUMS) {
            // What is beyond the last row repeats it, and is not kept.
            let others: [&[f64]; SUMS] = std::array::from_fn(|at| &rows[(from + at).min(i)][..]);
            let mut sums = [-0.0; SUMS];
            for (k, value) in row.iter().enumerate() {
                for (sum, other) in sums.iter_mut().zip(others) {
                    *sum += value * other[k];
                }
            }
            for (j, sum) in (from..=i).zip(sums) {
                all[i * count + j] = sum;
                all[j * count + i] = sum;
            }
        }
    }
    all
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn normalised(mut vector: Vec<f64>) -> Vec<f64> {
    let norm = dot(&vector, &vector).sqrt().max(1e-12);
    vector.iter_mut().for_each(|v| *v /= norm);
    vector
}

/// `sum += vector · by`
pub(super) fn add_times(sum: &mut [f64], vector: &[f64], by: f64) {
    for (s, v) in sum.iter_mut().zip(vector) {
        *s += v * by;
    }
}

/// The unit vector in single precision.
pub(super) fn unit_f32(vector: &[f64]) -> Vec<f32> {
    let norm = dot(vector, vector).sqrt().max(1e-12);
    vector.iter().map(|v| (v / norm) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_nearly_at_right_angles() {
        for (count, dim, most) in [(65, 64, 0.05), (65, 128, 0.01), (65, 32, 0.6), (65, 768, 0.01)]
        {
            let vectors = directions(count, dim);
            let mut worst = 0.0_f64;
            let products = products(&vectors);
            for i in 0..count {
                assert!((dot(&vectors[i], &vectors[i]) - 1.0).abs() < 1e-12);
                for j in 0..count {
                    let product = dot(&vectors[i], &vectors[j]);
                    assert_eq!(products[i * count + j].to_bits(), product.to_bits());
                }
                for j in 0..i {
                    worst = worst.max(dot(&vectors[i], &vectors[j]).abs());
                }
            }
            assert!(worst < most, "{count} in {dim}: {worst}");
        }
    }
}
