//! Adam for each group of parameters, in one pass over memory: the derivative is turned into that of
//! the stored value, regularized, used, and set to 0 for the next step while it is in a register; the
//! activated value is written on the way out.

use crate::Model;
use crate::model::{retain_rows, sigmoid};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;
use scenesplat_rasterizer::backward::Gradients;

/// Gaussians of one task.
const CHUNK: usize = 1024;

/// Decay of the two moments, and what keeps the quotient finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamSettings {
    /// Of the mean and of the mean square.
    pub betas: [f64; 2],
    /// Added to the root.
    pub eps: f64,
}

impl Default for AdamSettings {
    /// Those of every trainer of Gaussians: 0.9, 0.999, 1e-15.
    fn default() -> Self {
        Self { betas: [0.9, 0.999], eps: 1e-15 }
    }
}

/// Learning rates of the groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Of the centers, already scaled to the scene and scheduled.
    pub means: f64,
    /// Of the logarithms of the scales.
    pub scales: f64,
    /// Of the quaternions.
    pub quats: f64,
    /// Of the logits.
    pub opacities: f64,
    /// Of the first harmonic.
    pub sh0: f64,
    /// Of the others.
    pub sh_rest: f64,
}

/// Weights of `mean(opacity)` and `mean(scale)` over all Gaussians, seen or not.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Regularisers {
    /// λ of the mean opacity.
    pub opacity: f32,
    /// λ of the mean standard deviation.
    pub scale: f32,
}

/// The moments of one group. `[rows, width]` flattened
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
}

/// What one step is made of, in the precision of the loop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Update {
    keep: [f32; 2],
    take: [f32; 2],
    /// 1 / √(1 − β₂ᵗ).
    root: f32,
    eps: f32,
}

impl Update {
    /// Of step `t`, 1 for the first; and what learning rates are divided by.
    pub(crate) fn at(settings: &AdamSettings, t: u64) -> (Self, f64) {
        let [a, b] = settings.betas;
        let corrections = [a, b].map(|beta| 1.0 - beta.powf(t as f64));
        let update = Self {
            keep: [a as f32, b as f32],
            take: [(1.0 - a) as f32, (1.0 - b) as f32],
            root: (1.0 / corrections[1].sqrt()) as f32,
            eps: settings.eps as f32,
        };
        (update, corrections[0])
    }

    /// One value.
    #[inline(always)]
    fn one(&self, p: &mut f32, m: &mut f32, v: &mut f32, g: f32, rate: f32) {
        let first = self.keep[0] * *m + self.take[0] * g;
        let second = self.keep[1] * *v + self.take[1] * (g * g);
        // Numbers this small take a hundred times as long and change a value by less than 1e-19 of the
        // rate: a Gaussian that is not seen gets there in a thousand steps.
        *m = if first.abs() < f32::MIN_POSITIVE { 0.0 } else { first };
        *v = if second < f32::MIN_POSITIVE { 0.0 } else { second };
        *p -= rate * (*m / (v.sqrt() * self.root + self.eps));
    }
}

impl Moments {
    /// Zeros for that many values.
    pub fn zeros(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len] }
    }

    /// One step, number `t` from 1, of values with their derivatives, which become 0.
    ///
    /// # Panics
    /// If lengths differ (a bug of the caller).
    pub fn step(
        &mut self,
        values: &mut [f32],
        gradients: &mut [f32],
        settings: &AdamSettings,
        t: u64,
        rate: f64,
    ) {
        let (update, correction) = Update::at(settings, t);
        self.run(&update, values, gradients, (rate / correction) as f32);
    }

    fn run(&mut self, update: &Update, values: &mut [f32], gradients: &mut [f32], rate: f32) {
        assert!(values.len() == gradients.len() && values.len() == self.first.len());
        let parts = values
            .par_chunks_mut(4 * CHUNK)
            .zip(gradients.par_chunks_mut(4 * CHUNK))
            .zip(self.first.par_chunks_mut(4 * CHUNK))
            .zip(self.second.par_chunks_mut(4 * CHUNK));
        parts.for_each(|(((p, g), m), v)| {
            compiled(
                #[inline(always)]
                || {
                    let n = p.len();
                    let (g, m, v) = (&mut g[..n], &mut m[..n], &mut v[..n]);
                    for i in 0..n {
                        update.one(&mut p[i], &mut m[i], &mut v[i], g[i], rate);
                        g[i] = 0.0;
                    }
                },
            );
        });
    }

    pub(crate) fn zero_row(&mut self, row: usize, width: usize) {
        self.first[row * width..(row + 1) * width].fill(0.0);
        self.second[row * width..(row + 1) * width].fill(0.0);
    }

    fn grow(&mut self, rows: usize, width: usize) {
        self.first.resize(self.first.len() + rows * width, 0.0);
        self.second.resize(self.second.len() + rows * width, 0.0);
    }

    fn retain(&mut self, keep: &[bool], width: usize) {
        retain_rows(&mut self.first, keep, width);
        retain_rows(&mut self.second, keep, width);
    }
}

/// Adam of all groups of a [`Model`].
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    settings: AdamSettings,
    pub(crate) means: Moments,
    pub(crate) scales: Moments,
    pub(crate) quats: Moments,
    pub(crate) opacities: Moments,
    pub(crate) sh: Moments,
    /// Steps so far; all groups and Gaussians share the number.
    pub(crate) steps: u64,
    sh_stride: usize,
}

impl Adam {
    /// For a model, before the first step.
    pub fn new(model: &Model, settings: AdamSettings) -> Self {
        let n = model.len();
        let sh_stride = model.sh_stride();
        Self {
            settings,
            means: Moments::zeros(3 * n),
            scales: Moments::zeros(3 * n),
            quats: Moments::zeros(4 * n),
            opacities: Moments::zeros(n),
            sh: Moments::zeros(sh_stride * n),
            steps: 0,
            sh_stride,
        }
    }

    /// One step of all groups. `gradients` are those of activated values, and become 0.
    ///
    /// Bands of harmonics above `sh_degree` are left alone: their derivatives and moments are 0.
    ///
    /// # Panics
    /// If arrays differ in length (a bug of the caller).
    pub fn step(
        &mut self,
        model: &mut Model,
        gradients: &mut Gradients,
        rates: &Rates,
        regularisers: Regularisers,
        sh_degree: u8,
    ) {
        let n = model.len();
        assert!(gradients.opacities.len() == n && self.opacities.first.len() == n);
        self.steps += 1;
        let (update, correction) = Update::at(&self.settings, self.steps);
        let rate = |rate: f64| (rate / correction) as f32;
        let g = &mut model.gaussians;
        let means = gradients.means.as_flattened_mut();
        self.means.run(&update, g.means.as_flattened_mut(), means, rate(rates.means));
        let quats = gradients.quats.as_flattened_mut();
        self.quats.run(&update, g.quats.as_flattened_mut(), quats, rate(rates.quats));
        let count = n.max(1) as f32;
        let shape = Activated { update, rate: rate(rates.scales) };
        let moments = &mut self.scales;
        let arrays = (
            model.log_scales.as_flattened_mut(),
            g.scales.as_flattened_mut(),
            gradients.scales.as_flattened_mut(),
        );
        let mean_scale = regularisers.scale / (3.0 * count);
        shape.run(moments, arrays, |s, g| s * (g + mean_scale), f32::exp);
        let shape = Activated { update, rate: rate(rates.opacities) };
        let arrays = (&mut model.logits[..], &mut g.opacities[..], &mut gradients.opacities[..]);
        let mean_opacity = regularisers.opacity / count;
        let slope = |o: f32, g: f32| o * (1.0 - o) * (g + mean_opacity);
        shape.run(&mut self.opacities, arrays, slope, sigmoid);
        let bands = (usize::from(sh_degree) + 1).pow(2) * 3;
        let rates = [rate(rates.sh0), rate(rates.sh_rest)];
        self.harmonics(&update, &mut g.sh, &mut gradients.sh, bands, rates);
    }

    fn harmonics(
        &mut self,
        update: &Update,
        sh: &mut [f32],
        gradients: &mut [f32],
        active: usize,
        rates: [f32; 2],
    ) {
        let stride = self.sh_stride;
        let active = active.min(stride);
        let mut of_value = [rates[1]; 48];
        of_value[..3].fill(rates[0]);
        let size = CHUNK * stride;
        let parts = sh
            .par_chunks_mut(size)
            .zip(gradients.par_chunks_mut(size))
            .zip(self.sh.first.par_chunks_mut(size))
            .zip(self.sh.second.par_chunks_mut(size));
        parts.for_each(|(((p, g), m), v)| {
            compiled(
                #[inline(always)]
                || {
                    for first in (0..p.len()).step_by(stride) {
                        let at = first..first + active;
                        let (p, g) = (&mut p[at.clone()], &mut g[at.clone()]);
                        let (m, v) = (&mut m[at.clone()], &mut v[at]);
                        let rates = &of_value[..active];
                        for i in 0..active {
                            update.one(&mut p[i], &mut m[i], &mut v[i], g[i], rates[i]);
                            g[i] = 0.0;
                        }
                    }
                },
            );
        });
    }

    fn groups(&mut self) -> [(&mut Moments, usize); 5] {
        [
            (&mut self.means, 3),
            (&mut self.scales, 3),
            (&mut self.quats, 4),
            (&mut self.opacities, 1),
            (&mut self.sh, self.sh_stride),
        ]
    }

    /// Forgets the moments of a Gaussian.
    pub(crate) fn zero_row(&mut self, row: usize) {
        self.groups().into_iter().for_each(|(moments, width)| moments.zero_row(row, width));
    }

    /// Forgets the moments of all opacities.
    pub(crate) fn zero_opacities(&mut self) {
        self.opacities.first.fill(0.0);
        self.opacities.second.fill(0.0);
    }

    /// Makes room for new Gaussians, without moments.
    pub(crate) fn grow(&mut self, rows: usize) {
        self.groups().into_iter().for_each(|(moments, width)| moments.grow(rows, width));
    }

    /// Keeps the moments of some rows.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.groups().into_iter().for_each(|(moments, width)| moments.retain(keep, width));
    }
}

/// A group whose stored values are not the drawn ones.
struct Activated {
    update: Update,
    rate: f32,
}

impl Activated {
    /// `slope` makes the derivative of the stored value of the activated one and its derivative.
    fn run(
        &self,
        moments: &mut Moments,
        (stored, drawn, gradients): (&mut [f32], &mut [f32], &mut [f32]),
        slope: impl Fn(f32, f32) -> f32 + Sync,
        activate: impl Fn(f32) -> f32 + Sync,
    ) {
        assert!(stored.len() == gradients.len() && stored.len() == moments.first.len());
        let parts = stored
            .par_chunks_mut(CHUNK)
            .zip(drawn.par_chunks_mut(CHUNK))
            .zip(gradients.par_chunks_mut(CHUNK))
            .zip(moments.first.par_chunks_mut(CHUNK))
            .zip(moments.second.par_chunks_mut(CHUNK));
        parts.for_each(|((((p, a), g), m), v)| {
            compiled(
                #[inline(always)]
                || {
                    let n = p.len();
                    let (a, g, m, v) = (&mut a[..n], &mut g[..n], &mut m[..n], &mut v[..n]);
                    for i in 0..n {
                        let slope = slope(a[i], g[i]);
                        self.update.one(&mut p[i], &mut m[i], &mut v[i], slope, self.rate);
                        g[i] = 0.0;
                    }
                },
            );
            for (a, p) in a.iter_mut().zip(p) {
                *a = activate(*p);
            }
        });
    }
}

#[cfg(test)]
mod tests;
