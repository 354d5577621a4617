//! The strategy of the original trainer: Gaussians whose center the picture pulls at are doubled, small
//! ones as they are, large ones as two halves; transparent and huge ones are removed.

use super::{Refined, not_finite, remove};
use crate::error::{OptimiseError, within};
use crate::model::logit;
use crate::random::{Counter, Purpose};
use crate::{Adam, Model, Stored};
use scenesplat_scene::vector::rotation;
use serde::{Deserialize, Serialize};

/// What the scales of a Gaussian that is halved are divided by.
const HALVED: f32 = 1.6;

/// Settings of the default strategy.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DefaultSettings {
    /// Opacity below which a Gaussian is removed.
    pub prune_opacity: f32,
    /// Mean length of the gradient of the center, half pictures, above which it is doubled.
    pub grow_gradient: f32,
    /// Largest standard deviation over the scale of the scene up to which it is doubled as it is.
    pub grow_scale: f32,
    /// The same above which it is removed, after the first reset.
    pub prune_scale: f32,
    /// At steps above this …
    pub refine_start: u64,
    /// … and below this …
    pub refine_stop: u64,
    /// … that are multiples of this.
    pub refine_every: u64,
    /// Steps after which opacities are set back.
    pub reset_every: u64,
    /// Most Gaussians: nothing is doubled above it.
    pub cap: usize,
}

impl Default for DefaultSettings {
    /// Those of gsplat; the cap is ours, against captures that grow without end.
    fn default() -> Self {
        Self {
            prune_opacity: 0.005,
            grow_gradient: 0.0002,
            grow_scale: 0.01,
            prune_scale: 0.1,
            refine_start: 500,
            refine_stop: 15_000,
            refine_every: 100,
            reset_every: 3000,
            cap: 3_000_000,
        }
    }
}

/// Gradients of centers on pictures, since the last refinement. `[N]` each
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DoublingState {
    pub(crate) sum: Vec<f32>,
    pub(crate) count: Vec<f32>,
}

impl DoublingState {
    /// Adds those of a picture of that size; `visible` are its rows.
    pub(crate) fn add(&mut self, screen: &[[f32; 2]], visible: &[u32], [width, height]: [u32; 2]) {
        self.sum.resize(screen.len(), 0.0);
        self.count.resize(screen.len(), 0.0);
        let half = [width as f32 / 2.0, height as f32 / 2.0];
        for &i in visible {
            let g = screen[i as usize];
            let (x, y) = (g[0] * half[0], g[1] * half[1]);
            self.sum[i as usize] += (x * x + y * y).sqrt();
            self.count[i as usize] += 1.0;
        }
    }

    fn clear(&mut self, rows: usize) {
        self.sum.clear();
        self.count.clear();
        self.sum.resize(rows, 0.0);
        self.count.resize(rows, 0.0);
    }
}

impl DefaultSettings {
    pub(crate) fn check(&self) -> Result<(), OptimiseError> {
        let opacity = self.prune_opacity > 0.0 && self.prune_opacity < 0.5;
        within("prune_opacity", self.prune_opacity.into(), opacity, "between 0 and 0.5")?;
        let every = [("refine_every", self.refine_every), ("reset_every", self.reset_every)];
        for (field, value) in every {
            within(field, value as f64, value > 0, "at least 1")?;
        }
        let sizes = [
            ("grow_gradient", self.grow_gradient),
            ("grow_scale", self.grow_scale),
            ("prune_scale", self.prune_scale),
        ];
        for (field, value) in sizes {
            within(field, value.into(), value > 0.0, "above 0")?;
        }
        Ok(())
    }

    /// Doubles and removes, if it is time; gives what was done.
    pub(crate) fn refine(
        &self,
        state: &mut DoublingState,
        (model, adam): (&mut Model, &mut Adam),
        scene_scale: f64,
        seed: u64,
        step: u64,
    ) -> Refined {
        if step >= self.refine_stop {
            return Refined::default();
        }
        let mut done = Refined::default();
        if step > self.refine_start && step.is_multiple_of(self.refine_every) {
            let scale = scene_scale as f32;
            let halves = self.grow(state, (model, adam), scale, seed, step, &mut done);
            self.prune((model, adam), &halves, scale, step, &mut done);
            state.clear(model.len());
        }
        if step > 0 && step.is_multiple_of(self.reset_every) {
            let most = logit(2.0 * self.prune_opacity);
            for l in &mut model.logits {
                *l = l.min(most);
            }
            model.activate();
            adam.zero_opacities();
            done.reset = true;
        }
        done
    }

    /// Doubles; gives which rows were halved and have to go.
    fn grow(
        &self,
        state: &DoublingState,
        (model, adam): (&mut Model, &mut Adam),
        scene_scale: f32,
        seed: u64,
        step: u64,
        done: &mut Refined,
    ) -> Vec<bool> {
        let n = model.len();
        let mut halved = vec![false; n];
        let mean = |i: usize| match (state.sum.get(i), state.count.get(i)) {
            (Some(sum), Some(count)) => sum / count.max(1.0),
            _ => 0.0,
        };
        let largest = |s: [f32; 3]| s[0].max(s[1]).max(s[2]);
        let counter = Counter::new(seed, Purpose::Split, step);
        for i in 0..n {
            if !(mean(i) > self.grow_gradient) || model.len() >= self.cap {
                continue;
            }
            if largest(model.gaussians.scales[i]) <= self.grow_scale * scene_scale {
                model.push_copy(i);
                done.added += 1;
            } else {
                for half in 0..2 {
                    let xi = counter.normals(2 * i + half);
                    let row = half_of(&model.row(i), model.gaussians.scales[i], xi);
                    let width = model.sh_stride();
                    model.push(&row, &[]);
                    model.gaussians.sh.extend_from_within(i * width..(i + 1) * width);
                }
                halved[i] = true;
                done.added += 2;
            }
        }
        adam.grow(done.added);
        halved
    }

    fn prune(
        &self,
        (model, adam): (&mut Model, &mut Adam),
        halved: &[bool],
        scene_scale: f32,
        step: u64,
        done: &mut Refined,
    ) {
        let broken = not_finite(model);
        done.not_finite = broken.iter().filter(|b| **b).count();
        let most =
            if step > self.reset_every { self.prune_scale * scene_scale } else { f32::INFINITY };
        let g = &model.gaussians;
        let stays = |i: usize| {
            let [x, y, z] = g.scales[i];
            !broken[i]
                && !halved.get(i).copied().unwrap_or(false)
                && g.opacities[i] >= self.prune_opacity
                && x.max(y).max(z) <= most
        };
        let keep: Vec<bool> = (0..model.len()).map(stays).collect();
        // A scene without a Gaussian has nothing to grow from.
        if keep.iter().any(|k| *k) {
            done.removed = keep.iter().filter(|k| !**k).count();
            remove(model, adam, &keep);
        }
    }
}

/// One of two halves: at a place drawn from the Gaussian itself.
fn half_of(row: &Stored, scale: [f32; 3], xi: [f32; 3]) -> Stored {
    let norm = row.quat.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    let r = rotation(row.quat.map(|v| v / norm));
    let along = [0, 1, 2].map(|k| scale[k] * xi[k]);
    let by = r.map(|r| r[0] * along[0] + r[1] * along[1] + r[2] * along[2]);
    Stored {
        mean: [0, 1, 2].map(|k| row.mean[k] + by[k]),
        log_scale: row.log_scale.map(|s| s - HALVED.ln()),
        ..*row
    }
}

#[cfg(test)]
mod by_hand;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AdamSettings;

    #[test]
    fn doubled_halved_removed() {
        // Small and pulled at, large and pulled at, still, transparent.
        let row = |(scale, opacity): (f32, f32)| Stored {
            mean: [0.0; 3],
            log_scale: [scale.ln(); 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            logit: logit(opacity),
        };
        let rows: Vec<Stored> =
            [(0.005, 0.5), (0.05, 0.5), (0.05, 0.5), (0.05, 0.001)].map(row).to_vec();
        let mut model = Model::from_arrays(&rows, vec![0.0; 12], 0).unwrap();
        let mut adam = Adam::new(&model, AdamSettings::default());
        let settings = DefaultSettings::default();
        let mut state = DoublingState::default();
        // Half of 20 × 10 pixels: lengths 1e-3, 1e-3, 1e-5, 1.
        let screen = [[1e-4, 0.0], [0.0, 2e-4], [1e-6, 0.0], [0.1, 0.0]];
        state.add(&screen, &[0, 1, 2], [20, 10]);
        let done = settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 600);
        assert_eq!(
            (done.added, done.removed),
            (3, 2),
            "one copy, two halves; the halved and the transparent"
        );
        assert_eq!((model.len(), adam.opacities.first.len(), state.sum.len()), (5, 5, 5));
        let scale = model.gaussians.scales[4][0];
        assert!((scale - 0.05 / 1.6).abs() < 1e-6 && model.gaussians.means[4] != [0.0; 3]);
        let done = settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 3000);
        assert!(done.reset && model.gaussians.opacities.iter().all(|o| *o <= 0.010_001));
        assert!(!settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 15_000).is_any());
    }

    fn row(scale: [f32; 3], opacity: f32) -> Stored {
        let quat = [1.0, 0.0, 0.0, 0.0];
        Stored { mean: [0.0; 3], log_scale: scale.map(f32::ln), quat, logit: logit(opacity) }
    }

    fn built(rows: &[Stored]) -> (Model, Adam) {
        let model = Model::from_arrays(rows, vec![0.0; 3 * rows.len()], 0).unwrap();
        let adam = Adam::new(&model, AdamSettings::default());
        (model, adam)
    }

    #[test]
    fn gradients_are_in_half_pictures_and_are_summed_per_picture() {
        let mut state = DoublingState::default();
        // (0.003 · 20, 0.004 · 5) has the length √(0.06² + 0.02²); the row that is not seen gets nothing.
        let screen = [[0.003, 0.004], [1.0, 1.0]];
        state.add(&screen, &[0], [40, 10]);
        state.add(&screen, &[0], [40, 10]);
        let length = (0.06f64.powi(2) + 0.02f64.powi(2)).sqrt();
        assert!((f64::from(state.sum[0]) - 2.0 * length).abs() < 1e-7, "{:?}", state.sum);
        assert_eq!((state.sum[1], &state.count), (0.0, &vec![2.0, 0.0]));
    }

    #[test]
    fn what_was_summed_counts_for_one_refinement() {
        let (mut model, mut adam) = built(&[row([0.005; 3], 0.5)]);
        let mut state = DoublingState { sum: vec![1.0], count: vec![1.0] };
        let settings = DefaultSettings::default();
        let refine = |state: &mut DoublingState, model: &mut Model, adam: &mut Adam, step| {
            settings.refine(state, (model, adam), 1.0, 1, step).added
        };
        assert_eq!(refine(&mut state, &mut model, &mut adam, 600), 1);
        assert_eq!((&state.sum, &state.count), (&vec![0.0; 2], &vec![0.0; 2]));
        assert_eq!(refine(&mut state, &mut model, &mut adam, 700), 0);
    }

    #[test]
    fn halves_lie_apart_along_the_long_axis() {
        let (mut model, mut adam) = built(&[row([1e-6, 0.5, 1e-6], 0.5)]);
        let mut state = DoublingState { sum: vec![1.0], count: vec![1.0] };
        let settings = DefaultSettings::default();
        settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 600);
        let [a, b] = [model.gaussians.means[0], model.gaussians.means[1]];
        assert_eq!(model.len(), 2);
        assert!((a[1] - b[1]).abs() > 1e-3, "{a:?} {b:?}");
        for k in [0, 2] {
            assert!(a[k].abs() < 1e-5 && b[k].abs() < 1e-5, "{a:?} {b:?}");
        }
    }

    #[test]
    fn the_longest_axis_decides_who_is_huge_and_only_after_a_reset() {
        let rows = [row([0.001, 0.2, 0.001], 0.5), row([0.09; 3], 0.5)];
        for (step, left) in [(2900, 2), (3100, 1)] {
            let (mut model, mut adam) = built(&rows);
            let mut state = DoublingState::default();
            let settings = DefaultSettings::default();
            settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, step);
            assert_eq!(model.len(), left, "{step}");
            assert!((model.gaussians.scales[left - 1][0] - 0.09).abs() < 1e-6);
        }
    }

    #[test]
    fn opacities_that_are_set_back_start_without_moments() {
        let (mut model, mut adam) = built(&[row([0.05; 3], 0.9), row([0.05; 3], 0.008)]);
        for moments in [&mut adam.opacities, &mut adam.means] {
            moments.first.fill(1.0);
            moments.second.fill(1.0);
        }
        let mut state = DoublingState::default();
        let settings = DefaultSettings::default();
        assert!(settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 3000).reset);
        // Twice the opacity at which Gaussians are removed, at most.
        let near = |i: usize, due: f32| (model.gaussians.opacities[i] - due).abs() < 1e-6;
        assert!(near(0, 0.01) && near(1, 0.008), "{:?}", model.gaussians.opacities);
        assert_eq!((&adam.opacities.first, &adam.opacities.second), (&vec![0.0; 2], &vec![0.0; 2]));
        assert!(adam.means.first.iter().all(|m| *m == 1.0));
    }

    #[test]
    fn one_refinement_ends_at_the_cap() {
        let (mut model, mut adam) = built(&[row([0.005; 3], 0.5); 3]);
        let mut state = DoublingState { sum: vec![1.0; 3], count: vec![1.0; 3] };
        let settings = DefaultSettings { cap: 4, ..DefaultSettings::default() };
        let done = settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 600);
        assert_eq!((done.added, model.len()), (1, 4));
    }

    #[test]
    fn no_two_halves_have_the_same_numbers() {
        // Three at one place, so that equal draws are equal places.
        let (mut model, mut adam) = built(&[row([0.5; 3], 0.5); 3]);
        let mut state = DoublingState { sum: vec![1.0; 3], count: vec![1.0; 3] };
        let settings = DefaultSettings::default();
        settings.refine(&mut state, (&mut model, &mut adam), 1.0, 1, 600);
        let mut places: Vec<[u32; 3]> =
            model.gaussians.means.iter().map(|m| m.map(f32::to_bits)).collect();
        places.sort_unstable();
        places.dedup();
        assert_eq!((model.len(), places.len()), (6, 6));
    }
}
