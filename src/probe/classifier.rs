//! The probe itself.

use super::rows::Learned;
use super::{LabelRegime, ProbeError};
use candle_core::{D, Device, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use scenesplat_losses::cross_entropy;
use scenesplat_models::layers::Linear;
use scenesplat_models::{Compute, ParamStore};
use scenesplat_trainers::{
    AdamW, AdamWConfig, OneCycle, Optimizer, Schedule, clip_grad_norm, group_by_keyword,
};
use serde::Serialize;

/// Width inside of [`ProbeKind::Mlp3`].
const HIDDEN: usize = 256;
/// Rows of a step.
const BATCH: usize = 4096;
/// Steps whose losses are averaged for the report.
const LAST: usize = 20;

/// What stands on the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProbeKind {
    /// One linear layer: what the rows say openly.
    Linear,
    /// Three linear layers with GELUs between: what they say at all, row by row.
    Mlp3,
    /// A decoder over all scales, one block each, and a linear layer. On what the network reads, which has
    /// one scale, and on objects stand three linear layers in its place.
    Decoder,
}

/// How a probe is trained.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbeSettings {
    /// What stands on the rows.
    pub kind: ProbeKind,
    /// How many labels it learns from.
    pub labels: LabelRegime,
    /// Steps of AdamW, at least 1: on 4096 random rows, for a decoder on a scene.
    pub steps: u64,
    /// Largest learning rate, above 0.
    pub lr: f64,
    /// Weight decay, 0 or more.
    pub weight_decay: f64,
    /// Seed of everything that is random.
    pub seed: u64,
    /// Whether objects are probed too.
    pub objects: bool,
}

impl Default for ProbeSettings {
    fn default() -> Self {
        Self {
            kind: ProbeKind::Linear,
            labels: LabelRegime::All,
            steps: 500,
            lr: 0.005,
            weight_decay: 0.02,
            seed: 0,
            objects: true,
        }
    }
}

impl ProbeSettings {
    /// Checks every setting.
    ///
    /// # Errors
    /// Names the first that is out of range.
    pub fn check(&self) -> Result<(), ProbeError> {
        let wrong = |setting, value: String, expected| {
            Err(ProbeError::Setting { setting, value, expected })
        };
        if self.steps == 0 {
            return wrong("steps", "0".to_owned(), "1 or more");
        }
        if !(self.lr.is_finite() && self.lr > 0.0) {
            return wrong("lr", self.lr.to_string(), "a finite number above 0");
        }
        if !(self.weight_decay.is_finite() && self.weight_decay >= 0.0) {
            return wrong("weight_decay", self.weight_decay.to_string(), "0 or more");
        }
        match self.labels {
            LabelRegime::Share(share) if !(share > 0.0 && share <= 1.0) => {
                wrong("labels", share.to_string(), "a share above 0, at most 1")
            }
            LabelRegime::PerScene(0) => wrong("labels", "0".to_owned(), "1 or more a scene"),
            _ => Ok(()),
        }
    }
}

/// Mean and deviation of the channels.
#[derive(Debug, Clone)]
pub struct Fit {
    mean: Tensor,
    inverse: Tensor,
}

impl Fit {
    /// Of rows `[R, C]`; a channel that is the same everywhere is left out (it becomes 0).
    ///
    /// # Errors
    /// If rows cannot be read.
    pub fn new(rows: &Tensor) -> Result<Self, ProbeError> {
        let (n, width) = rows.dims2()?;
        let values = rows.flatten_all()?.to_vec1::<f32>()?;
        let (mut mean, mut square) = (vec![0.0f64; width], vec![0.0f64; width]);
        for row in values.chunks_exact(width.max(1)) {
            mean.iter_mut().zip(row).for_each(|(m, v)| *m += f64::from(*v));
        }
        mean.iter_mut().for_each(|m| *m /= n.max(1) as f64);
        for row in values.chunks_exact(width.max(1)) {
            for ((s, m), v) in square.iter_mut().zip(&mean).zip(row) {
                *s += (f64::from(*v) - m).powi(2);
            }
        }
        let inverse = square.iter().zip(&mean).map(|(s, m)| {
            let deviation = (s / n.max(1) as f64).sqrt();
            // Below the rounding of f32 there is nothing but that.
            if deviation > 1e-6 * (m.abs() + 1e-6) { (1.0 / deviation) as f32 } else { 0.0 }
        });
        let inverse: Vec<f32> = inverse.collect();
        let mean: Vec<f32> = mean.iter().map(|m| *m as f32).collect();
        let row = |v: Vec<f32>| Tensor::from_vec(v, (1, width), &Device::Cpu);
        Ok(Self { mean: row(mean)?, inverse: row(inverse)? })
    }

    fn apply(&self, rows: &Tensor) -> candle_core::Result<Tensor> {
        rows.broadcast_sub(&self.mean)?.broadcast_mul(&self.inverse)
    }
}

/// A trained probe.
pub(super) struct Classifier {
    fit: Fit,
    layers: Vec<Linear>,
    width: usize,
    /// Mean loss of the last steps.
    pub loss: f64,
}

impl Classifier {
    /// Learns from rows, with labels below `classes`.
    ///
    /// # Errors
    /// If something is not finite.
    pub fn train(
        learned: &Learned,
        classes: usize,
        settings: &ProbeSettings,
    ) -> Result<Self, ProbeError> {
        let (n, width) = learned.rows.dims2()?;
        let fit = Fit::new(&learned.rows)?;
        let store = ParamStore::trainable(settings.seed);
        let sizes = match settings.kind {
            ProbeKind::Linear => vec![width, classes],
            ProbeKind::Mlp3 | ProbeKind::Decoder => vec![width, HIDDEN, HIDDEN, classes],
        };
        let layer = |(i, pair): (usize, &[usize])| {
            let vb = store.builder().pp(format!("probe.{i}"));
            Linear::with(Compute::default(), pair[0], pair[1], true, vb)
        };
        let layers: Vec<Linear> =
            sizes.windows(2).enumerate().map(layer).collect::<Result<_, _>>()?;
        let mut probe = Self { fit, layers, width, loss: f64::NAN };
        let params = store.parameters();
        let groups = group_by_keyword(&params, settings.lr, settings.weight_decay, &[]);
        let mut optimizer = AdamW::new(groups, AdamWConfig::default())?;
        let schedule = OneCycle::default();
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        rng.set_stream(u64::MAX);
        let mut last = Vec::new();
        for step in 0..settings.steps {
            let rows: Vec<u32> = if n <= BATCH {
                (0..n as u32).collect()
            } else {
                (0..BATCH)
                    .map(|_| ((u128::from(rng.next_u64()) * n as u128) >> 64) as u32)
                    .collect()
            };
            let labels: Vec<i32> = rows.iter().map(|&row| learned.labels[row as usize]).collect();
            let x = learned.rows.index_select(&Tensor::new(rows, &Device::Cpu)?, 0)?;
            let Some(loss) = cross_entropy(&probe.logits(&x)?, &labels, 0.0, None)? else {
                return Err(ProbeError::NoLabels);
            };
            let mut grads = loss.backward()?;
            clip_grad_norm(&params, &mut grads, 3.0)?;
            optimizer.step(&grads, &schedule.hyperparameters(step, settings.steps))?;
            last.push(f64::from(loss.to_scalar::<f32>()?));
        }
        let tail = &last[last.len().saturating_sub(LAST)..];
        probe.loss = tail.iter().sum::<f64>() / tail.len() as f64;
        Ok(probe)
    }

    /// Width of the rows.
    pub fn width(&self) -> usize {
        self.width
    }

    fn logits(&self, rows: &Tensor) -> candle_core::Result<Tensor> {
        let mut x = self.fit.apply(rows)?;
        let last = self.layers.len() - 1;
        for (i, layer) in self.layers.iter().enumerate() {
            x = if i < last { layer.forward_gelu(&x, None)? } else { layer.forward(&x)? };
        }
        Ok(x)
    }

    /// The class of each row. `[M, C] → [M]`
    pub fn classes(&self, rows: &Tensor) -> Result<Vec<i32>, ProbeError> {
        let mut all = Vec::with_capacity(rows.dim(0)?);
        for first in (0..rows.dim(0)?).step_by(BATCH) {
            let count = BATCH.min(rows.dim(0)? - first);
            let best = self.logits(&rows.narrow(0, first, count)?)?.detach().argmax(D::Minus1)?;
            all.extend(best.to_vec1::<u32>()?.into_iter().map(|class| class as i32));
        }
        Ok(all)
    }
}

#[cfg(test)]
mod by_hand;

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(n: usize) -> Learned {
        // Two classes apart along one of three channels; the third never changes.
        let labels: Vec<i32> = (0..n as i32).map(|i| i % 2).collect();
        let values = (0..n).flat_map(|i| {
            let noise = ((i * 7919) % 13) as f32 / 13.0;
            [100.0 + 5.0 * (i % 2) as f32 + noise, noise, 3.0]
        });
        let rows = Tensor::from_vec(values.collect::<Vec<f32>>(), (n, 3), &Device::Cpu).unwrap();
        Learned { rows, labels }
    }

    #[test]
    fn classes_that_a_line_divides_are_told_apart() {
        for kind in [ProbeKind::Linear, ProbeKind::Mlp3] {
            let settings = ProbeSettings { kind, steps: 150, lr: 0.02, ..ProbeSettings::default() };
            let learned = rows(400);
            let probe = Classifier::train(&learned, 2, &settings).unwrap();
            assert_eq!(probe.classes(&learned.rows).unwrap(), learned.labels, "{kind:?}");
            assert!(probe.loss < 0.1, "{kind:?}: {}", probe.loss);
            let again = Classifier::train(&learned, 2, &settings).unwrap();
            assert_eq!(again.loss.to_bits(), probe.loss.to_bits());
        }
    }

    #[test]
    fn few_rows_and_bad_settings() {
        let settings = ProbeSettings { steps: 3, ..ProbeSettings::default() };
        for n in [1, 2] {
            let learned = rows(n);
            let probe = Classifier::train(&learned, 2, &settings).unwrap();
            assert_eq!(probe.classes(&learned.rows).unwrap().len(), n);
        }
        let refused = |settings: ProbeSettings| settings.check().unwrap_err().to_string();
        assert!(refused(ProbeSettings { steps: 0, ..settings }).contains("steps"));
        assert!(refused(ProbeSettings { lr: 0.0, ..settings }).contains("lr"));
        let labels = LabelRegime::Share(0.0);
        assert!(refused(ProbeSettings { labels, ..settings }).contains("labels"));
        let labels = LabelRegime::PerScene(0);
        assert!(refused(ProbeSettings { labels, ..settings }).contains("labels"));
    }

    #[test]
    fn logits_are_what_the_last_layer_gives() {
        let settings = ProbeSettings { steps: 150, lr: 0.02, ..ProbeSettings::default() };
        let learned = rows(100);
        let probe = Classifier::train(&learned, 2, &settings).unwrap();
        let logits = probe.logits(&learned.rows).unwrap().flatten_all().unwrap();
        let least = logits.to_vec1::<f32>().unwrap().into_iter().fold(0.0, f32::min);
        // A GELU gives nothing below -0.17.
        assert!(least < -0.5, "{least}");
    }

    #[test]
    fn a_probe_without_weight_decay_still_learns() {
        let (lr, weight_decay) = (0.02, 0.0);
        let settings = ProbeSettings { steps: 150, lr, weight_decay, ..ProbeSettings::default() };
        let learned = rows(400);
        let probe = Classifier::train(&learned, 2, &settings).unwrap();
        assert_eq!(probe.classes(&learned.rows).unwrap(), learned.labels);
        // At a rate of 0 it would stay above 0.27, ln(1 + exp(-1.15)): first weights are at most 0.58, and classes
        // lie at -1 and 1.
        assert!(probe.loss < 0.1, "{}", probe.loss);
    }
}
