//! Exposure and white balance of pictures, by the colours of what several of them show.

/// Times that colours and gains are fitted to each other: pictures far apart agree through those between.
const ROUNDS: usize = 60;
/// Distance, natural logarithm, within which all colours count alike.
const NEAR: f64 = 0.01;
/// Pictures that must show a Gaussian, and Gaussians that a picture must share with others.
const FEWEST_PICTURES: usize = 3;
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
    /// Sums of distances are made small, not of squares: colours over pictures and gains over Gaussians in
    /// turn, as medians by weighted means.
    pub(super) fn log_gains(&self) -> Vec<Option<[f64; 3]>> {
        let points = self.pictures.iter().flatten().map(|(i, _)| *i as usize + 1).max();
        let mut count = vec![0; points.unwrap_or(0)];
        self.pictures.iter().flatten().for_each(|(i, _)| count[*i as usize] += 1);
        let is_shared = |i: u32| count[i as usize] >= FEWEST_PICTURES;
        let enough =
            |p: &Vec<(u32, [f64; 3])>| p.iter().filter(|(i, _)| is_shared(*i)).count() >= FEWEST_GAUSSIANS;
        let used: Vec<bool> = self.pictures.iter().map(enough).collect();
        let mut gains = vec![[0.0; 3]; self.pictures.len()];
        for c in 0..3 {
            // Gaussian, picture, logarithm of the colour.
            let seen: Vec<(usize, usize, f64)> = self
                .pictures
                .iter()
                .enumerate()
                .filter(|(k, _)| used[*k])
                .flat_map(|(k, picture)| picture.iter().map(move |(i, v)| (*i, k, v[c])))
                .filter(|(i, _, _)| is_shared(*i))
                .map(|(i, k, v)| (i as usize, k, v))
                .collect();
            let mut gain = vec![0.0; self.pictures.len()];
            let mut color = vec![0.0; count.len()];
            for round in 0..ROUNDS {
                // In the first round all count alike, then each less the farther off it is: a median's weights.
                let weight = |i: usize, k: usize, v: f64, color: &[f64], gain: &[f64]| {
                    if round == 0 { 1.0 } else { 1.0 / (v - color[i] - gain[k]).abs().max(NEAR) }
                };
                let mut sums = vec![(0.0, 0.0); color.len()];
                for &(i, k, v) in &seen {
                    let w = weight(i, k, v, &color, &gain);
                    sums[i] = (sums[i].0 + w * (v - gain[k]), sums[i].1 + w);
                }
                color.iter_mut().zip(&sums).filter(|(_, s)| s.1 > 0.0).for_each(|(c, s)| *c = s.0 / s.1);
                let mut sums = vec![(0.0, 0.0); gain.len()];
                for &(i, k, v) in &seen {
                    let w = weight(i, k, v, &color, &gain);
                    sums[k] = (sums[k].0 + w * (v - color[i]), sums[k].1 + w);
                }
                gain.iter_mut().zip(&sums).filter(|(_, s)| s.1 > 0.0).for_each(|(g, s)| *g = s.0 / s.1);
            }
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
}
