//! A gain and an offset per picture and channel: what a camera's automatic exposure did.

use crate::{AdamSettings, Moments};

/// Values of a picture: three gains, three offsets.
const VALUES: usize = 6;
/// Pull toward gain 1 and offset 0: without it the scene could become darker and all gains larger.
const PULL: f32 = 0.01;

/// Exposures of all frames, learned beside the scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Exposure {
    /// `[F, 6]` flattened.
    pub(crate) values: Vec<f32>,
    /// Of each frame.
    pub(crate) moments: Vec<Moments>,
    /// Steps of each frame.
    pub(crate) steps: Vec<u64>,
}

impl Exposure {
    /// Gain 1 and offset 0.
    pub(crate) fn new(frames: usize) -> Self {
        Self {
            values: [1.0, 1.0, 1.0, 0.0, 0.0, 0.0].repeat(frames),
            moments: vec![Moments::zeros(VALUES); frames],
            steps: vec![0; frames],
        }
    }

    /// Gains and offsets of a frame.
    pub fn of(&self, frame: usize) -> [f32; VALUES] {
        std::array::from_fn(|k| self.values[frame * VALUES + k])
    }

    /// `gain · rgb + offset`.
    pub(crate) fn apply(&self, frame: usize, rgb: &[f32], out: &mut Vec<f32>) {
        let [r, g, b, x, y, z] = self.of(frame);
        out.clear();
        let pixels = rgb.as_chunks::<3>().0;
        out.extend(pixels.iter().flat_map(|p| [r * p[0] + x, g * p[1] + y, b * p[2] + z]));
    }

    /// Learns from the derivative with respect to the picture that [`apply`](Self::apply) made, and turns it
    /// into that of `rgb`.
    pub(crate) fn learn(&mut self, frame: usize, rgb: &[f32], slope: &mut [f32], rate: f64) {
        let before = self.of(frame);
        let mut sums = [0.0f64; VALUES];
        for (p, s) in rgb.as_chunks::<3>().0.iter().zip(slope.as_chunks_mut::<3>().0) {
            for c in 0..3 {
                sums[c] += f64::from(s[c]) * f64::from(p[c]);
                sums[3 + c] += f64::from(s[c]);
                s[c] *= before[c];
            }
        }
        let rest = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
        let mut slopes: [f32; VALUES] =
            std::array::from_fn(|k| sums[k] as f32 + PULL * (before[k] - rest[k]));
        self.steps[frame] += 1;
        let values = &mut self.values[frame * VALUES..(frame + 1) * VALUES];
        let t = self.steps[frame];
        self.moments[frame].step(values, &mut slopes, &AdamSettings::default(), t, rate);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture that was taken with another gain and offset: they are found.
    #[test]
    fn finds_what_the_camera_did() {
        let rgb: Vec<f32> = (0..300).map(|i| 0.5 + 0.5 * (i as f32).sin()).collect();
        let seen: Vec<f32> = rgb.iter().map(|v| 0.8 * v + 0.05).collect();
        let mut exposure = Exposure::new(2);
        let mut out = Vec::new();
        for _ in 0..3000 {
            exposure.apply(1, &rgb, &mut out);
            let mut slope: Vec<f32> =
                out.iter().zip(&seen).map(|(a, b)| 2.0 * (a - b) / 100.0).collect();
            exposure.learn(1, &rgb, &mut slope, 1e-3);
        }
        let found = exposure.of(1);
        assert!(found[..3].iter().all(|g| (g - 0.8).abs() < 0.03), "{found:?}");
        assert!(found[3..].iter().all(|o| (o - 0.05).abs() < 0.02), "{found:?}");
        assert_eq!(exposure.of(0), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_picture_gets_its_slope_through_the_gain() {
        let mut exposure = Exposure::new(2);
        exposure.values[6..9].copy_from_slice(&[2.0, 3.0, 0.5]);
        let mut slope = [1.0, -1.0, 4.0, 0.0, 2.0, 1.0];
        exposure.learn(1, &[0.5; 6], &mut slope, 0.01);
        // The gain with which the picture was made, not the one after the step.
        assert_eq!(slope, [2.0, -3.0, 2.0, 0.0, 6.0, 0.5]);
        // An offset has the slopes as they came, 1, 1 and 5, a gain those times the picture, and both are pulled back to
        // where they rest. The first moment is a tenth of it.
        let pulled = |gain: f32| 0.5 + PULL * (gain - 1.0);
        let want = [pulled(2.0), pulled(3.0), 2.0 + pulled(0.5), 1.0, 1.0, 5.0];
        for (moment, want) in exposure.moments[1].first.iter().zip(want) {
            assert!((moment - 0.1 * want).abs() < 1e-6, "{:?}", exposure.moments[1].first);
        }
    }

    #[test]
    fn each_frame_has_its_own_gains_and_offsets() {
        let mut exposure = Exposure::new(3);
        assert_eq!(exposure.of(2), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        exposure.values[6..12].copy_from_slice(&[2.0, 0.5, 4.0, 0.25, -0.5, 1.0]);
        let mut out = vec![7.0; 9];
        exposure.apply(1, &[0.5, 1.0, 0.25, 0.0, 2.0, 1.0], &mut out);
        assert_eq!(out, [1.25, 0.0, 2.0, 0.25, 0.5, 5.0]);
        // Without a slope it is pulled back alone: by 0.01 of what it is off, of which a moment takes a tenth.
        exposure.learn(1, &[0.5; 3], &mut [0.0; 3], 0.125);
        for (moment, off) in exposure.moments[1].first.iter().zip([1.0, -0.5, 3.0, 0.25, -0.5, 1.0])
        {
            assert!((moment - 0.001 * off).abs() < 1e-8, "{:?}", exposure.moments[1].first);
        }
        // The first step of Adam has the length of the rate.
        for (got, want) in
            exposure.of(1).into_iter().zip([1.875, 0.625, 3.875, 0.125, -0.375, 0.875])
        {
            assert!((got - want).abs() < 1e-5, "{:?}", exposure.of(1));
        }
        assert_eq!(
            (exposure.steps.clone(), exposure.of(0)),
            (vec![0, 1, 0], Exposure::new(1).of(0))
        );
        assert_eq!(exposure.moments[2], Moments::zeros(6));
    }
}
