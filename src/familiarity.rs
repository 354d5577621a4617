//! Out-of-distribution score of a scene: the distance of its features to those of the rooms that it was fitted on.
//!
//! A closed-set network answers whatever it is shown: a bicycle is a "sofa", a garden a "bed", and the cosines of such
//! answers are as high as those of right ones. Where the features lie says more: their distance to the nearest of some
//! centers of features of rooms, measured in the spread that features have around their centers (the Mahalanobis
//! distance to the nearest of several means with one covariance). One figure for a scene: the median over its rows.

use crate::cholesky;
use crate::inference::{EncodeError, SceneFeatures};
use crate::network::NetworkError;
use rayon::prelude::*;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use scenesplat_kernels::normalize::normalize_rows;
use scenesplat_kernels::random::{sample_rng, unit};
use scenesplat_scene::quantile::quantile;
use std::collections::HashMap;

const EMBEDDED: &[u8] = include_bytes!("../assets/embedded/familiarity.safetensors");

/// Rounds of moving centers to the mean of what is nearest to them.
const ROUNDS: usize = 20;
/// Added to each variance, so that directions in which features hardly vary do not decide.
const LEAST_VARIANCE: f64 = 1e-4;
/// Factor on the largest score of a room: above it a scene is out of distribution.
const STRANGE: f32 = 1.25;
/// Most rows of a scene that are scored, about: its median needs no more.
const MOST_ROWS: usize = 8192;

/// Where features of a kind of scene lie.
#[derive(Debug, Clone, PartialEq)]
pub struct Familiarity {
    width: usize,
    /// Centers, already multiplied by `whiten`. `[centres, width]`
    centres: Vec<f32>,
    /// The inverse of the Cholesky factor of the covariance around the centers, lower triangular. `[width, width]`
    whiten: Vec<f32>,
    /// Least and largest score of the rooms that it was checked on.
    rooms: [f32; 2],
    /// SHA-256 of the weights that the features are of.
    weights: String,
}

impl Familiarity {
    /// That of the network inside the program.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn embedded() -> Result<Self, NetworkError> {
        Self::from_safetensors(EMBEDDED).map_err(|problem| {
            let problem = format!("assets/embedded/familiarity.safetensors: {problem}");
            NetworkError::from(candle_core::Error::Msg(problem))
        })
    }

    fn from_safetensors(bytes: &[u8]) -> Result<Self, String> {
        let text = |error: safetensors::SafeTensorError| error.to_string();
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(text)?;
        let weights = header.metadata().as_ref().and_then(|m| m.get("weights").cloned());
        let file = SafeTensors::deserialize(bytes).map_err(text)?;
        let take = |name: &str| {
            let tensor = file.tensor(name).map_err(text)?;
            let values = tensor.data().chunks_exact(4);
            let values: Vec<f32> =
                values.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            match values.iter().all(|v| v.is_finite()) && tensor.dtype() == Dtype::F32 {
                true => Ok((tensor.shape().to_vec(), values)),
                false => Err(format!("{name} is not of finite f32 numbers")),
            }
        };
        let ((whiten_shape, whiten), (shape, centres)) = (take("whiten")?, take("centres")?);
        let width = whiten_shape.first().copied().unwrap_or_default();
        let (_, rooms) = take("rooms")?;
        match (&rooms[..], &whiten_shape[..], &shape[..]) {
            (&[least, most], &[_, w], &[count, c]) if w == width && c == width && count > 0 => {
                let (rooms, weights) = ([least, most], weights.unwrap_or_default());
                Ok(Self { width, centres, whiten, rooms, weights })
            }
            _ => Err(format!("centers {shape:?}, whiten {whiten_shape:?}, rooms {rooms:?}")),
        }
    }

    /// Fits centers and spread to rows of unit length, in the order given; the same rows and seed give the same
    /// result. No scene is out of distribution before [`with_rooms`](Self::with_rooms). `rows`: `[n, width]`
    ///
    /// # Panics
    /// If there are fewer rows than centers, or none (a bug of the caller).
    pub fn fit(rows: &[f32], width: usize, centres: usize, seed: u64) -> Self {
        let n = rows.len() / width;
        assert!(n >= centres && centres > 0, "{n} rows for {centres} centers");
        let row = |i: usize| &rows[i * width..][..width];
        // Each next center is the row farthest from those before, of some that are drawn: rare things get one, too.
        let mut rng = sample_rng(seed, 0, 0);
        let mut draw = || ((unit(&mut rng) * n as f64) as usize).min(n - 1);
        let mut means: Vec<f32> = row(draw()).to_vec();
        while means.len() < centres * width {
            let far = |i: usize| nearest(row(i), &means, width).1;
            let tried: Vec<usize> = (0..24).map(|_| draw()).collect();
            let best = tried.into_iter().map(|i| (far(i), i));
            let (_, next) = best.fold((-1.0, 0), |a, b| if b.0 > a.0 { b } else { a });
            means.extend_from_slice(row(next));
        }
        for _ in 0..ROUNDS {
            means = means_of(rows, &means, width);
        }
        let of: Vec<usize> =
            rows.par_chunks_exact(width).map(|r| nearest(r, &means, width).0).collect();
        let mut covariance = vec![0.0_f64; width * width];
        for (i, centre) in of.iter().enumerate() {
            let mean = &means[centre * width..][..width];
            let off: Vec<f64> = row(i).iter().zip(mean).map(|(a, b)| f64::from(a - b)).collect();
            for a in 0..width {
                for b in 0..=a {
                    covariance[a * width + b] += off[a] * off[b];
                }
            }
        }
        for a in 0..width {
            for b in 0..=a {
                covariance[a * width + b] /= n as f64;
            }
            covariance[a * width + a] += LEAST_VARIANCE;
        }
        let whiten: Vec<f32> =
            inverse_cholesky(&covariance, width).iter().map(|v| *v as f32).collect();
        let mut found = Self {
            width,
            centres: Vec::new(),
            whiten,
            rooms: [f32::INFINITY; 2],
            weights: String::new(),
        };
        found.centres = means.chunks_exact(width).flat_map(|m| found.whitened(m)).collect();
        found
    }

    /// With the limits from the scores of rooms that it was not fitted on. `weights`: SHA-256 of the
    /// weights.
    ///
    /// # Panics
    /// If there is no room.
    #[must_use]
    pub fn with_rooms(self, strangeness: &[f32], weights: String) -> Self {
        let least = strangeness.iter().copied().fold(f32::INFINITY, f32::min);
        let most = strangeness.iter().copied().fold(0.0, f32::max);
        assert!(least.is_finite(), "no room");
        Self { rooms: [least, most], weights, ..self }
    }

    /// As a file that [`embedded`](Self::embedded) reads.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, safetensors::SafeTensorError> {
        let bytes =
            |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let count = self.centres.len() / self.width;
        let rooms = bytes(&self.rooms);
        let (centres, whiten) = (bytes(&self.centres), bytes(&self.whiten));
        let views = [
            ("centres", TensorView::new(Dtype::F32, vec![count, self.width], &centres)?),
            ("rooms", TensorView::new(Dtype::F32, vec![2], &rooms)?),
            ("whiten", TensorView::new(Dtype::F32, vec![self.width, self.width], &whiten)?),
        ];
        let words = HashMap::from([("weights".to_owned(), self.weights.clone())]);
        safetensors::serialize(views, Some(words))
    }

    /// Values of a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Scenes above this are out of distribution: a quarter above the largest score of a room.
    pub fn limit(&self) -> f32 {
        STRANGE * self.rooms[1]
    }

    /// Least and largest score of the rooms that it was checked on.
    pub fn rooms(&self) -> [f32; 2] {
        self.rooms
    }

    fn whitened(&self, row: &[f32]) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.width);
        for (a, factors) in self.whiten.chunks_exact(self.width).enumerate() {
            // In a fixed order, in f64: the same bits everywhere.
            let sum: f64 = factors[..=a]
                .iter()
                .zip(row)
                .map(|(f, v)| f64::from(*f) * f64::from(*v))
                .fold(0.0, |sum, v| sum + v);
            out.push(sum as f32);
        }
        out
    }

    /// Distance of a row of unit length to the nearest center, in standard deviations.
    pub fn distance(&self, row: &[f32]) -> f32 {
        nearest(&self.whitened(row), &self.centres, self.width).1.sqrt()
    }

    /// The out-of-distribution score: the median distance of the rows (of some 8,000 spread evenly, if it has more). `None` if
    /// no row has a direction, or the features are of another width: codes, or those of another network.
    ///
    /// # Errors
    /// If features went to a file and cannot be read.
    pub fn strangeness(&self, features: &SceneFeatures) -> Result<Option<f32>, EncodeError> {
        if features.width() != self.width {
            return Ok(None);
        }
        let step = features.num_slots().div_ceil(MOST_ROWS).max(1);
        let mut rows = Vec::new();
        for slot in (0..features.num_slots()).step_by(step) {
            rows.extend(features.slot_rows(slot..slot + 1)?);
        }
        normalize_rows(&mut rows, self.width);
        let distances = rows.par_chunks_exact(self.width).map(|row| {
            // A row of zeros is one still.
            let has_direction = row.iter().any(|v| *v != 0.0);
            has_direction.then(|| self.distance(row)).filter(|d| d.is_finite())
        });
        let mut distances: Vec<f32> = distances.collect::<Vec<_>>().into_iter().flatten().collect();
        Ok(quantile(&mut distances, 0.5))
    }
}

/// Number and squared distance of the nearest of some rows, the first of equals.
fn nearest(row: &[f32], all: &[f32], width: usize) -> (usize, f32) {
    let square = |other: &[f32]| {
        row.iter().zip(other).map(|(a, b)| (a - b) * (a - b)).fold(0.0, |sum, v| sum + v)
    };
    let distances = all.chunks_exact(width).map(square).enumerate();
    distances.fold((0, f32::INFINITY), |a, b| if b.1 < a.1 { b } else { a })
}

/// The mean of the rows that are nearest to each center; one that has none stays where it is.
fn means_of(rows: &[f32], means: &[f32], width: usize) -> Vec<f32> {
    let of: Vec<usize> = rows.par_chunks_exact(width).map(|r| nearest(r, means, width).0).collect();
    let mut sums = vec![0.0_f64; means.len()];
    let mut counts = vec![0_u32; means.len() / width];
    for (centre, row) in of.iter().zip(rows.chunks_exact(width)) {
        counts[*centre] += 1;
        let sum = &mut sums[centre * width..][..width];
        sum.iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(*v));
    }
    let mean = |(i, sum): (usize, &f64)| match counts[i / width] {
        0 => means[i],
        count => (sum / f64::from(count)) as f32,
    };
    sums.iter().enumerate().map(mean).collect()
}

/// The inverse of the lower factor L of a positive definite matrix L·Lᵀ, of which the lower half is given.
fn inverse_cholesky(matrix: &[f64], n: usize) -> Vec<f64> {
    let factor = cholesky::factor(matrix, n);
    let mut inverse = vec![0.0; n * n];
    for column in 0..n {
        for row in column..n {
            let unit = if row == column { 1.0 } else { 0.0 };
            let dot: f64 =
                (column..row).map(|k| factor[row * n + k] * inverse[k * n + column]).sum();
            inverse[row * n + column] = (unit - dot) / factor[row * n + row];
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    /// Two groups around two directions, wide in one direction and narrow in another.
    fn rows(n: usize) -> Vec<f32> {
        let mut rng = sample_rng(3, 0, 0);
        let mut noise = |by: f64| (by * (2.0 * unit(&mut rng) - 1.0)) as f32;
        (0..n)
            .flat_map(|i| {
                let (wide, narrow) = (noise(0.3), noise(0.01));
                if i % 2 == 0 { [1.0, wide, narrow] } else { [wide, 1.0, narrow] }
            })
            .collect()
    }

    #[test]
    fn distances_are_in_the_spread_around_the_nearest_centre() {
        let rows = rows(4000);
        let found = Familiarity::fit(&rows, 3, 2, 5);
        // By hand: the covariance of a uniform number ± a is a²/3; each group is wide in its own direction, half of the
        // rows each, so both directions share 0.09/3/2.
        let wide = (0.09_f64 / 6.0 + LEAST_VARIANCE).sqrt();
        let narrow = (1e-4_f64 / 3.0 + LEAST_VARIANCE).sqrt();
        let close = |got: f32, want: f64| {
            assert!((f64::from(got) / want - 1.0).abs() < 0.05, "{got} {want}");
        };
        close(found.distance(&[1.0, 0.2, 0.0]), 0.2 / wide);
        close(found.distance(&[0.2, 1.0, 0.0]), 0.2 / wide);
        close(found.distance(&[1.0, 0.0, 0.2]), 0.2 / narrow);
        assert!(found.distance(&[0.0, -1.0, 0.0]) > 6.0);
        // Of a scene the median, whatever the length of rows; those without direction have no say.
        let some = [[2.0, 0.4, 0.0], [3.0, 0.6, 0.0], [0.0; 3], [f32::NAN, 0.0, 0.0]].concat();
        let norm = 1.04_f32.sqrt();
        let want = found.distance(&[1.0 / norm, 0.2 / norm, 0.0]);
        let features = SceneFeatures::from_rows(some, 3).unwrap();
        let got = found.strangeness(&features).unwrap().unwrap();
        assert!((got - want).abs() < 1e-5 * want, "{got} {want}");
        let none = SceneFeatures::from_rows(vec![0.0; 6], 3).unwrap();
        assert_eq!(found.strangeness(&none).unwrap(), None);
        let wider = SceneFeatures::from_rows(vec![1.0; 8], 4).unwrap();
        assert_eq!(found.strangeness(&wider).unwrap(), None);
    }

    #[test]
    fn the_same_rows_give_the_same_bits_for_any_number_of_threads() {
        let rows = rows(3000);
        let fit = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Familiarity::fit(&rows, 3, 7, 1))
        };
        assert_eq!(fit(1), fit(3));
        let limits = fit(1).with_rooms(&[4.0, 8.0, 6.0], "of what".to_owned());
        assert_eq!((limits.rooms(), limits.limit()), ([4.0, 8.0], 10.0));
        let bytes = limits.to_safetensors().unwrap();
        assert_eq!(Familiarity::from_safetensors(&bytes), Ok(limits));
        assert!(Familiarity::from_safetensors(&bytes[..200]).is_err());
    }

    #[test]
    fn whitening_by_hand() {
        // L = [[2, 0], [1, 3]]: L·Lᵀ = [[4, 2], [2, 10]]; L⁻¹ = [[1/2, 0], [−1/6, 1/3]].
        let found = inverse_cholesky(&[4.0, 0.0, 2.0, 10.0], 2);
        let want = [0.5, 0.0, -1.0 / 6.0, 1.0 / 3.0];
        assert!(found.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-15), "{found:?}");
    }

    #[test]
    fn rooms_are_familiar_to_the_network_inside_the_program_and_a_heap_is_strange() {
        use crate::embedded;
        use crate::inference::SceneEncoder;
        use crate::{Network, WeightOptions, Weights};
        use scenesplat_rooms::{SyntheticRoomSettings, generate};
        let familiar = Familiarity::embedded().unwrap();
        // One program makes both (crates/lab/examples/lab/embedded_assets.rs).
        assert_eq!(familiar.weights, embedded::sha256(), "fitted to other weights");
        let network = Network::load(
            embedded::config().unwrap(),
            &Weights::Embedded,
            WeightOptions::default(),
        )
        .unwrap();
        let settings = SyntheticRoomSettings { seed: 778, ..Default::default() };
        let room = generate(&settings).unwrap().scene;
        let of = |scene: &scenesplat_scene::GaussianScene| {
            let features = SceneEncoder::new(&network).encode(scene, &mut |_| Ok(())).unwrap();
            familiar.strangeness(&features).unwrap().unwrap()
        };
        let usual = of(&room);
        // The same Gaussians anywhere in a ball: neither floor nor walls, nor things.
        let mut heap = room;
        let mut rng = sample_rng(9, 0, 0);
        for p in &mut heap.coord {
            let direction = scenesplat_kernels::random::direction(&mut rng);
            let radius = unit(&mut rng);
            *p = direction.map(|v| (v * radius) as f32);
        }
        let strange = of(&heap);
        println!("a room {usual:.2}, a heap {strange:.2}, limit {:.2}", familiar.limit());
        assert!(usual < familiar.limit() && strange > 1.15 * familiar.limit(), "{usual} {strange}");
    }
}
