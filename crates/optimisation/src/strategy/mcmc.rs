//! Optimisation as sampling: the dead are moved to the living, the number grows to a cap, centers are
//! shaken.

use super::{Refined, not_finite, runs};
use crate::error::{OptimiseError, within};
use crate::noise::add_noise;
use crate::random::{Counter, Purpose};
use crate::relocation::{Relocation, relocated};
use crate::sampling::draw;
use crate::{Adam, Model};
use serde::{Deserialize, Serialize};

/// Factor by which the number of Gaussians grows at once …
const GROWTH: f64 = 1.05;
/// … and that of few.
const QUICK_GROWTH: f64 = 2.0;

/// Settings of MCMC.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct McmcSettings {
    /// Most Gaussians.
    pub cap: usize,
    /// Strength of the noise over the learning rate of the centers.
    pub noise: f64,
    /// Gaussians move at steps above this …
    pub refine_start: u64,
    /// … and below this …
    pub refine_stop: u64,
    /// … that are multiples of this.
    pub refine_every: u64,
    /// Opacity up to which a Gaussian is dead.
    pub min_opacity: f32,
    /// How shapes are split.
    pub relocation: Relocation,
    /// Fewer Gaussians than this double instead of growing by a twentieth: a few hundred first points would otherwise
    /// stay few in a short run. 0 as in gsplat.
    pub few: usize,
}

impl Default for McmcSettings {
    /// Those of gsplat.
    fn default() -> Self {
        Self {
            cap: 1_000_000,
            noise: 5e5,
            refine_start: 500,
            refine_stop: 25_000,
            refine_every: 100,
            min_opacity: 0.005,
            relocation: Relocation::Gsplat15,
            few: 0,
        }
    }
}

impl McmcSettings {
    pub(crate) fn check(&self) -> Result<(), OptimiseError> {
        within("cap", self.cap as f64, (1..u32::MAX as usize).contains(&self.cap), "1 to 2³² − 2")?;
        let noise = self.noise.is_finite() && self.noise >= 0.0;
        within("noise", self.noise, noise, "finite, at least 0")?;
        within("refine_every", self.refine_every as f64, self.refine_every > 0, "at least 1")?;
        let opacity = self.min_opacity > 0.0 && self.min_opacity < 1.0;
        within("min_opacity", self.min_opacity.into(), opacity, "between 0 and 1")
    }

    /// How many come of so many, but for the cap.
    pub(crate) fn grown(&self, gaussians: usize) -> usize {
        let growth = if gaussians < self.few { QUICK_GROWTH } else { GROWTH };
        (growth * gaussians as f64) as usize
    }

    /// Moves and adds, if it is time; gives what was done.
    pub(crate) fn refine(
        &self,
        model: &mut Model,
        adam: &mut Adam,
        seed: u64,
        step: u64,
    ) -> Refined {
        let time = step > self.refine_start
            && step < self.refine_stop
            && step.is_multiple_of(self.refine_every);
        if !time {
            return Refined::default();
        }
        let (relocated, not_finite) = self.relocate(model, adam, seed, step);
        let added = self.add(model, adam, seed, step);
        Refined { relocated, not_finite, added, ..Refined::default() }
    }

    /// Puts each dead Gaussian where a living one is, drawn in proportion to opacity.
    fn relocate(&self, model: &mut Model, adam: &mut Adam, seed: u64, step: u64) -> (usize, usize) {
        let broken = not_finite(model);
        let mut weights = model.gaussians.opacities.clone();
        let mut dead = Vec::new();
        for (i, weight) in weights.iter_mut().enumerate() {
            if broken[i] || !(*weight > self.min_opacity) {
                dead.push(i);
                *weight = 0.0;
            }
        }
        let drawn = draw(&weights, dead.len(), &Counter::new(seed, Purpose::Relocate, step));
        let count = broken.iter().filter(|b| **b).count();
        let mut next = dead.iter();
        for (source, copies) in runs(&drawn) {
            self.split(model, source, copies);
            adam.zero_row(source);
            for &to in next.by_ref().take(copies) {
                model.copy_row(source, to);
                if broken[to] {
                    // Others keep theirs, as in the reference; these would break their new place.
                    adam.zero_row(to);
                }
            }
        }
        (drawn.len(), if drawn.is_empty() { 0 } else { count })
    }

    /// Appends copies of Gaussians that are drawn in proportion to opacity.
    fn add(&self, model: &mut Model, adam: &mut Adam, seed: u64, step: u64) -> usize {
        let n = model.len();
        let target = self.cap.min(self.grown(n));
        let counter = Counter::new(seed, Purpose::Add, step);
        let drawn = draw(&model.gaussians.opacities, target.saturating_sub(n), &counter);
        for (source, copies) in runs(&drawn) {
            self.split(model, source, copies);
            (0..copies).for_each(|_| model.push_copy(source));
        }
        adam.grow(drawn.len());
        drawn.len()
    }

    /// Gives a Gaussian the shape of one of `copies + 1`.
    fn split(&self, model: &mut Model, row: usize, copies: usize) {
        let (opacity, scale) = (model.gaussians.opacities[row], model.gaussians.scales[row]);
        let copies = u32::try_from(copies + 1).unwrap_or(u32::MAX);
        let (opacity, scale) = relocated(opacity, scale, copies, self.relocation);
        model.set_shape(row, opacity, scale);
    }

    /// Shakes all centers; `rate` is that of the centers.
    pub(crate) fn shake(&self, model: &mut Model, rate: f64, seed: u64, step: u64) {
        if self.noise > 0.0 {
            add_noise(model, (rate * self.noise) as f32, seed, step);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AdamSettings, Stored};

    fn model(logits: &[f32]) -> (Model, Adam) {
        let row = |(i, logit): (usize, &f32)| Stored {
            mean: [i as f32, 0.0, 0.0],
            log_scale: [-2.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            logit: *logit,
        };
        let rows: Vec<Stored> = logits.iter().enumerate().map(row).collect();
        let sh = (0..3 * rows.len()).map(|i| i as f32).collect();
        let model = Model::from_arrays(&rows, sh, 0).unwrap();
        let mut adam = Adam::new(&model, AdamSettings::default());
        adam.means.first.fill(1.0);
        (model, adam)
    }

    const NOW: u64 = 600;

    #[test]
    fn the_dead_move_to_the_living() {
        // Rows 0 and 2 are dead, 3 holds NaN; only row 1 lives.
        let (mut model, mut adam) = model(&[-9.0, 2.0, -20.0, f32::NAN]);
        let settings = McmcSettings { cap: 4, ..McmcSettings::default() };
        let done = settings.refine(&mut model, &mut adam, 1, NOW);
        assert_eq!(done, Refined { relocated: 3, not_finite: 1, ..Refined::default() });
        let (o, s) =
            relocated(1.0 / (1.0 + (-2.0f32).exp()), [(-2.0f32).exp(); 3], 4, settings.relocation);
        for i in 0..4 {
            assert_eq!(model.gaussians.means[i], [1.0, 0.0, 0.0]);
            assert_eq!(model.gaussians.sh[3 * i..3 * i + 3], [3.0, 4.0, 5.0]);
            assert!((model.gaussians.opacities[i] - o).abs() < 1e-6);
            assert!((model.gaussians.scales[i][0] - s[0]).abs() < 1e-6);
        }
        // Of the source and of the broken one the moments are gone, of the dead they stay.
        let first: Vec<f32> = adam.means.first.iter().step_by(3).copied().collect();
        assert_eq!(first, [1.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn numbers_grow_to_the_cap_and_only_in_time() {
        let (mut model, mut adam) = model(&[1.0; 100]);
        let settings = McmcSettings { cap: 107, ..McmcSettings::default() };
        for step in [0, 500, 599, 25_000] {
            assert!(!settings.refine(&mut model, &mut adam, 1, step).is_any());
        }
        assert_eq!(settings.refine(&mut model, &mut adam, 1, NOW).added, 5);
        assert_eq!(settings.refine(&mut model, &mut adam, 1, 700).added, 2);
        assert_eq!(settings.refine(&mut model, &mut adam, 1, 800).added, 0);
        assert_eq!((model.len(), adam.means.first.len()), (107, 321));
        // Few double.
        let quick = McmcSettings { cap: 1000, few: 200, ..settings };
        for want in [214, 224] {
            quick.refine(&mut model, &mut adam, 1, NOW);
            assert_eq!(model.len(), want);
        }
        model.gaussians.check().unwrap();
    }

    #[test]
    fn nobody_alive_is_left_as_it_is() {
        let (mut model, mut adam) = model(&[-9.0; 3]);
        let before = model.clone();
        let settings = McmcSettings { cap: 3, ..McmcSettings::default() };
        assert!(!settings.refine(&mut model, &mut adam, 1, NOW).is_any());
        assert_eq!(model, before);
    }

    #[test]
    fn a_new_copy_and_its_source_share_the_opacity() {
        let (mut model, mut adam) = model(&[1.0]);
        let settings = McmcSettings { cap: 2, few: 10, ..McmcSettings::default() };
        assert_eq!(settings.refine(&mut model, &mut adam, 1, NOW).added, 1);
        // Both together hide as much as the one before: 1 − (1 − o)².
        let before = 1.0 / (1.0 + (-1.0f64).exp());
        let want = 1.0 - (1.0 - before).sqrt();
        for row in 0..2 {
            let found = f64::from(model.gaussians.opacities[row]);
            assert!((found - want).abs() < 1e-6, "{row}: {found} {want}");
        }
        assert_eq!(model.gaussians.scales[0], model.gaussians.scales[1]);
        assert_eq!(model.row(0), model.row(1));
    }

    #[test]
    fn the_defaults_are_those_of_gsplat_and_ranges_are_checked() {
        let good = McmcSettings::default();
        let want = McmcSettings {
            cap: 1_000_000,
            noise: 5e5,
            refine_start: 500,
            refine_stop: 25_000,
            refine_every: 100,
            min_opacity: 0.005,
            relocation: Relocation::Gsplat15,
            few: 0,
        };
        assert_eq!(good, want);
        good.check().unwrap();
        McmcSettings { cap: 1, noise: 0.0, refine_every: 1, ..good }.check().unwrap();
        let cases = [
            (McmcSettings { cap: 0, ..good }, "cap is 0"),
            (McmcSettings { cap: u32::MAX as usize, ..good }, "cap is 4294967295"),
            (McmcSettings { noise: -1.0, ..good }, "noise is -1"),
            (McmcSettings { noise: f64::INFINITY, ..good }, "noise is inf"),
            (McmcSettings { refine_every: 0, ..good }, "refine_every is 0"),
            (McmcSettings { min_opacity: 0.0, ..good }, "min_opacity is 0"),
            (McmcSettings { min_opacity: 1.0, ..good }, "min_opacity is 1"),
        ];
        for (settings, want) in cases {
            let error = settings.check().unwrap_err().to_string();
            assert!(error.starts_with(want), "{error}");
        }
        // 1.05 · 39 = 40.95 and 1.05 · 40 = 42; below `few` twice as many.
        let quick = McmcSettings { few: 39, ..good };
        assert_eq!([38, 39, 40].map(|n| quick.grown(n)), [76, 40, 42]);
    }

    #[test]
    fn the_dead_go_to_drawn_sources_in_order_and_then_more_are_added() {
        // Rows 1, 3 and 6 are dead: below the limit, at it, and of no finite center.
        let (mut given, mut adam) = model(&[0.5, -7.0, 1.5, 0.0, -0.5, 2.0, 1.0]);
        given.set_shape(3, 0.005, [0.3; 3]);
        given.gaussians.means[6][1] = f32::INFINITY;
        let least = given.gaussians.opacities[3];
        let settings =
            McmcSettings { cap: 9, few: 100, min_opacity: least, ..McmcSettings::default() };
        for (k, moments) in
            [&mut adam.means, &mut adam.opacities, &mut adam.sh].into_iter().enumerate()
        {
            moments.first.fill(1.0 + k as f32);
            moments.second.fill(2.0 + k as f32);
        }
        let (mut slow, mut left) = (given.clone(), adam.clone());
        let done = settings.refine(&mut given, &mut adam, 8, NOW);
        assert_eq!((done.relocated, done.not_finite, done.added, done.removed), (3, 1, 2, 0));
        // By hand: first the three dead, then two copies of any.
        let mut weights = slow.gaussians.opacities.clone();
        [1, 3, 6].into_iter().for_each(|dead: usize| weights[dead] = 0.0);
        let split = |model: &mut Model, row: usize, copies: u32| {
            let (o, s) = (model.gaussians.opacities[row], model.gaussians.scales[row]);
            let (o, s) = relocated(o, s, copies, Relocation::Gsplat15);
            model.set_shape(row, o, s);
        };
        let count = |drawn: &[u32], row: u32| drawn.iter().filter(|r| **r == row).count() as u32;
        let drawn = draw(&weights, 3, &Counter::new(8, Purpose::Relocate, NOW));
        for source in 0..7 {
            if count(&drawn, source) > 0 {
                split(&mut slow, source as usize, count(&drawn, source) + 1);
                left.zero_row(source as usize);
            }
        }
        for (dead, source) in [1, 3, 6].into_iter().zip(&drawn) {
            slow.copy_row(*source as usize, dead);
        }
        left.zero_row(6);
        let drawn = draw(&slow.gaussians.opacities, 2, &Counter::new(8, Purpose::Add, NOW));
        for source in 0..7 {
            if count(&drawn, source) > 0 {
                split(&mut slow, source as usize, count(&drawn, source) + 1);
                (0..count(&drawn, source)).for_each(|_| slow.push_copy(source as usize));
            }
        }
        left.grow(2);
        assert_eq!((&given, &adam), (&slow, &left));
        assert_eq!((adam.means.second.len(), adam.quats.first.len()), (27, 36));
        // Noise has the rate times the strength; none without it.
        McmcSettings { noise: 2e5, ..settings }.shake(&mut given, 1e-3, 8, NOW);
        add_noise(&mut slow, 200.0, 8, NOW);
        assert_eq!(given, slow);
        McmcSettings { noise: 0.0, ..settings }.shake(&mut given, 1e-3, 8, NOW);
        assert_eq!(given, slow);
    }
}
