//! Exposure and white balance from picture to picture.

use super::super::strength::{LIGHT_AUTOMATIC, LIGHT_BALANCE, LIGHT_LOG_GAIN};
use super::super::{Effect, frame_rng};
use crate::rng::normal_pair;
use scenesplat_scene::linear_light::luminance;

/// Time in which a camera makes up for 1 − 1/e of a change of brightness, seconds.
const LAG_SECONDS: f64 = 0.5;
/// Time between two pictures, seconds.
const FRAME_SECONDS: f64 = 0.5;
/// Most that automatic exposure changes, natural logarithm: two stops.
const MOST_AUTOMATIC: f64 = 2.0 * std::f64::consts::LN_2;
/// Mean light below which a camera takes a picture for no darker.
const DARK: f64 = 1e-3;
/// Pictures over which white balance goes from one random value to the next.
const BALANCE_FRAMES: u64 = 8;
/// Where its indices begin, apart from those of frames.
const BALANCE_INDEX: u64 = 1 << 32;

/// What a camera remembers of the pictures that it took before.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Automatic {
    /// Mean light of the first picture.
    reference: Option<f64>,
    /// Logarithm of the gain that it has come to.
    log_gain: f64,
}

impl Automatic {
    /// The gain for a picture of that mean light: what the ones before asked for, with a lag of the first
    /// order.
    pub(super) fn follow(&mut self, mean: f64) -> f64 {
        let mean = mean.max(DARK);
        let reference = *self.reference.get_or_insert(mean);
        let now = self.log_gain;
        let wanted = (reference / mean).ln().clamp(-MOST_AUTOMATIC, MOST_AUTOMATIC);
        self.log_gain += (1.0 - (-FRAME_SECONDS / LAG_SECONDS).exp()) * (wanted - self.log_gain);
        now
    }
}

/// Mean light of a picture.
pub(super) fn mean_light(linear: &[[f64; 3]]) -> f64 {
    linear.iter().map(|pixel| luminance(*pixel)).sum::<f64>() / linear.len().max(1) as f64
}

/// Where white balance has drifted at a frame: standard normal every few frames, lines between.
fn drift(seed: u64, frame: u64) -> f64 {
    let knot = |k: u64| normal_pair(&mut frame_rng(seed, Effect::Light, BALANCE_INDEX + k, 0))[0];
    let (from, part) = (frame / BALANCE_FRAMES, (frame % BALANCE_FRAMES) as f64);
    let part = part / BALANCE_FRAMES as f64;
    (1.0 - part) * knot(from) + part * knot(from + 1)
}

/// What linear light is multiplied by: red, green, blue.
///
/// `exp(N(0, σ))`, times a part of what automatic exposure would do; red and blue drift apart.
pub(super) fn gains(severity: f64, seed: u64, frame: u64, automatic: f64) -> [f64; 3] {
    let [random, _] = normal_pair(&mut frame_rng(seed, Effect::Light, frame, 0));
    let log = LIGHT_LOG_GAIN * severity * random + LIGHT_AUTOMATIC * severity * automatic;
    let balance = LIGHT_BALANCE * severity * drift(seed, frame);
    let gain = log.exp();
    [gain * balance.exp(), gain, gain * (-balance).exp()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn automatic_exposure_lags_behind_by_hand() {
        let mut camera = Automatic::default();
        assert_eq!(camera.follow(0.2), 0.0);
        // Twice as bright: nothing yet, then 1 − 1/e of a stop, then 1 − 1/e² of it.
        let stop = -std::f64::consts::LN_2;
        assert_eq!(camera.follow(0.4), 0.0);
        assert!((camera.follow(0.4) - stop * (1.0 - (-1f64).exp())).abs() < 1e-12);
        assert!((camera.follow(0.4) - stop * (1.0 - (-2f64).exp())).abs() < 1e-12);
        // Darkness asks for two stops at most, and for no infinity.
        for _ in 0..50 {
            camera.follow(0.0);
        }
        assert!((camera.follow(0.0) - MOST_AUTOMATIC).abs() < 1e-9);
    }

    #[test]
    fn gains_have_the_stated_spread_and_balance_drifts_slowly() {
        let n = 4000;
        let all: Vec<[f64; 3]> = (0..n).map(|frame| gains(2.0, 7, frame, 0.0)).collect();
        let sd = |values: &[f64]| {
            (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
        };
        let green: Vec<f64> = all.iter().map(|g| g[1].ln()).collect();
        assert!((sd(&green) / (2.0 * LIGHT_LOG_GAIN) - 1.0).abs() < 0.06, "{}", sd(&green));
        let balance: Vec<f64> = all.iter().map(|g| 0.5 * (g[0] / g[2]).ln()).collect();
        // Lines between normal values have two thirds of their variance.
        let want = 2.0 * LIGHT_BALANCE * (2f64 / 3.0).sqrt();
        assert!((sd(&balance) / want - 1.0).abs() < 0.15, "{} {want}", sd(&balance));
        let steps: Vec<f64> = balance.windows(2).map(|w| w[1] - w[0]).collect();
        assert!(sd(&steps) < 0.25 * sd(&balance));
        assert!(all.iter().all(|g| (g[0] * g[2] / (g[1] * g[1]) - 1.0).abs() < 1e-9));
    }
}
