//! Exposure and white balance of pictures, by the colours of what several of them show.

/// Times that the weights of outliers are found anew.
const ROUNDS: usize = 12;
/// Distance, natural logarithm, within which all colours count alike.
const NEAR: f64 = 0.01;
/// Pictures that must show a Gaussian, and Gaussians that a picture must share with others.
const FEWEST_PICTURES: usize = 2;
const FEWEST_GAUSSIANS: usize = 20;

/// What pictures show of Gaussians.
#[derive(Debug, Clone, Default)]
pub(super) struct SharedColors {
    /// For each picture: Gaussian, logarithms of linear red, green, blue.
    pictures: Vec<Vec<(u32, [f64; 3])>>,
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

impl SharedColors {
    /// Adds a picture.
    pub(super) fn add(&mut self, picture: Vec<(u32, [f64; 3])>) {
        self.pictures.push(picture);
    }

    /// The gain of each picture against the median of what all show, as logarithms of red, green, blue; the
    /// median picture has 0. `None` for pictures that share too little.
    ///
    /// The sum of the distances of all colours from `colour of the Gaussian + gain of the picture` is made
    /// small, not that of their squares: what stands before a Gaussian in one picture counts little.
    pub(super) fn log_gains(&self) -> Vec<Option<[f64; 3]>> {
        let points = self.pictures.iter().flatten().map(|(i, _)| *i as usize + 1).max();
        let mut count = vec![0; points.unwrap_or(0)];
        self.pictures.iter().flatten().for_each(|(i, _)| count[*i as usize] += 1);
        let is_shared = |i: u32| count[i as usize] >= FEWEST_PICTURES;
        let enough = |p: &Vec<(u32, [f64; 3])>| {
            p.iter().filter(|(i, _)| is_shared(*i)).count() >= FEWEST_GAUSSIANS
        };
        let used: Vec<bool> = self.pictures.iter().map(enough).collect();
        let mut gains = vec![[0.0; 3]; self.pictures.len()];
        for c in 0..3 {
            // Gaussian, picture, logarithm of the colour.
            let mut seen: Vec<(usize, usize, f64)> = self
                .pictures
                .iter()
                .enumerate()
                .filter(|(k, _)| used[*k])
                .flat_map(|(k, picture)| picture.iter().map(move |(i, v)| (*i, k, v[c])))
                .filter(|(i, _, _)| is_shared(*i))
                .map(|(i, k, v)| (i as usize, k, v))
                .collect();
            seen.sort_unstable_by_key(|(i, k, _)| (*i, *k));
            let gain = fit(&seen, self.pictures.len());
            gains.iter_mut().zip(&gain).for_each(|(all, own)| all[c] = *own);
        }
        for c in 0..3 {
            let mut all: Vec<f64> =
                gains.iter().zip(&used).filter(|(_, used)| **used).map(|(g, _)| g[c]).collect();
            let middle = if all.is_empty() { 0.0 } else { median(&mut all) };
            gains.iter_mut().for_each(|g| g[c] -= middle);
        }
        gains.into_iter().zip(used).map(|(gain, used)| used.then_some(gain)).collect()
    }
}

/// Gains of pictures by (Gaussian, picture, logarithm of a colour), sorted: least squares with weights that make
/// of them a sum of distances. The colours are eliminated, so pictures far apart are compared through all
/// those between at once. What is connected with nothing else stays near 0.
fn fit(seen: &[(usize, usize, f64)], pictures: usize) -> Vec<f64> {
    let mut gain = vec![0.0; pictures];
    let mut weights = vec![1.0; seen.len()];
    for _ in 0..ROUNDS {
        let mut matrix = vec![0.0; pictures * pictures];
        let mut right = vec![0.0; pictures];
        let mut at = 0;
        for group in seen.chunk_by(|a, b| a.0 == b.0) {
            let w = &weights[at..at + group.len()];
            at += group.len();
            let all: f64 = w.iter().sum();
            let mean = group.iter().zip(w).map(|((_, _, v), w)| w * v).sum::<f64>() / all;
            for ((_, k, v), w_k) in group.iter().zip(w) {
                right[*k] += w_k * (v - mean);
                matrix[k * pictures + k] += w_k;
                for ((_, l, _), w_l) in group.iter().zip(w) {
                    matrix[k * pictures + l] -= w_k * w_l / all;
                }
            }
        }
        gain = solve(matrix, right);
        let mut at = 0;
        for group in seen.chunk_by(|a, b| a.0 == b.0) {
            let w = &mut weights[at..at + group.len()];
            at += group.len();
            let all: f64 = w.iter().sum();
            let color =
                group.iter().zip(&*w).map(|((_, k, v), w)| w * (v - gain[*k])).sum::<f64>() / all;
            for ((_, k, v), w) in group.iter().zip(w) {
                *w = 1.0 / (v - color - gain[*k]).abs().max(NEAR);
            }
        }
    }
    gain
}

/// The solution of a system with a positive semidefinite matrix (Cholesky), its smallest one.
fn solve(mut matrix: Vec<f64>, mut right: Vec<f64>) -> Vec<f64> {
    let n = right.len();
    let trace: f64 = (0..n).map(|k| matrix[k * n + k]).sum();
    // Of a common factor nothing is known: this makes it 0.
    let ridge = 1e-9 * trace.max(1.0) / n.max(1) as f64;
    (0..n).for_each(|k| matrix[k * n + k] += ridge);
    for j in 0..n {
        for i in j..n {
            let known: f64 = (0..j).map(|k| matrix[i * n + k] * matrix[j * n + k]).sum();
            let left = matrix[i * n + j] - known;
            matrix[i * n + j] =
                if i == j { left.max(ridge).sqrt() } else { left / matrix[j * n + j] };
        }
    }
    for i in 0..n {
        let known: f64 = (0..i).map(|k| matrix[i * n + k] * right[k]).sum();
        right[i] = (right[i] - known) / matrix[i * n + i];
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| matrix[k * n + i] * right[k]).sum();
        right[i] = (right[i] - known) / matrix[i * n + i];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{sample_rng, unit};

    #[test]
    fn gains_come_back_from_overlapping_pictures_in_spite_of_outliers() {
        let mut rng = sample_rng(3, 0, 0);
        let colors: Vec<[f64; 3]> =
            (0..400).map(|_| [0; 3].map(|_: i32| -0.2 - 2.0 * unit(&mut rng))).collect();
        let truth: Vec<[f64; 3]> =
            (0..15).map(|_| [0; 3].map(|_: i32| 0.6 * unit(&mut rng) - 0.3)).collect();
        let mut shared = SharedColors::default();
        for (k, gain) in truth.iter().enumerate() {
            // Each shows 120 in a row, a fifth of them something else that stands before.
            let row = (0..120).map(|j| {
                let i = (25 * k + j) % 400;
                let off = if j % 5 == 0 { 1.5 * unit(&mut rng) } else { 0.02 * unit(&mut rng) };
                (i as u32, std::array::from_fn(|c| colors[i][c] + gain[c] + off))
            });
            shared.add(row.collect());
        }
        shared.add(vec![(5, [0.0; 3]); 3]);
        let found = shared.log_gains();
        assert_eq!(found.len(), 16);
        assert_eq!(found[15], None, "it shares too little");
        for c in 0..3 {
            let mut off: Vec<f64> =
                truth.iter().zip(&found).map(|(t, f)| t[c] - f.unwrap()[c]).collect();
            let middle = median(&mut off);
            assert!(off.iter().all(|v| (v - middle).abs() < 0.06), "{off:?}");
        }
        assert!(SharedColors::default().log_gains().is_empty());
    }

    #[test]
    fn systems_are_solved() {
        // By hand: [[4, 2], [2, 3]] · (1, 2) = (8, 8).
        let found = solve(vec![4.0, 2.0, 2.0, 3.0], vec![8.0, 8.0]);
        assert!((found[0] - 1.0).abs() < 1e-7 && (found[1] - 2.0).abs() < 1e-7, "{found:?}");
        // Differences alone: the smallest solution.
        let found = solve(vec![1.0, -1.0, -1.0, 1.0], vec![1.0, -1.0]);
        assert!((found[0] - 0.5).abs() < 1e-6 && (found[1] + 0.5).abs() < 1e-6, "{found:?}");
    }
}
