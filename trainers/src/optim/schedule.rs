use super::StepHyperparameters;
use crate::TrainError;
use crate::error::check_setting;
use scenesplat_kernels::settings;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// What varies over a run, as a pure function of the step: nothing to checkpoint, nothing to replay.
///
/// `step` counts from 0 and is the number of steps done; `total` is the planned number. Beyond the
/// end, the value of the last step holds.
pub trait Schedule: Send {
    /// Factor on every learning rate at `step` of `total`.
    fn factor(&self, step: u64, total: u64) -> f64;

    /// Momentum at `step` of `total`; `None` leaves it to the optimizer.
    fn beta1(&self, _step: u64, _total: u64) -> Option<f64> {
        None
    }

    /// Weight decay of all groups at `step` of `total`; `None` leaves each group its own.
    fn weight_decay(&self, _step: u64, _total: u64) -> Option<f64> {
        None
    }

    /// What a checkpoint shall compare before a run goes on; nothing by default.
    fn settings(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    /// All of them, as an optimizer takes them.
    fn hyperparameters(&self, step: u64, total: u64) -> StepHyperparameters {
        StepHyperparameters {
            lr_scale: self.factor(step, total),
            beta1: self.beta1(step, total),
            weight_decay: self.weight_decay(step, total),
        }
    }
}

settings! {
    /// One rise and one longer fall of the learning rate, with the momentum going the other way.
    ///
    /// With `T` steps in all, the rise ends at `e1 = warmup·T − 1` and the fall at `e2 = T − 1`, both
    /// real numbers. At step `n`, with `p = n / e1` during the rise and `p = (n − e1) / (e2 − e1)` after,
    /// a value goes from `a` to `b` as `b + (a − b)/2 · (1 + cos(π p))`:
    ///
    /// | | start | `e1` | end |
    /// |---|---|---|---|
    /// | factor | `1/div_factor` | 1 | `1/(div_factor · final_div_factor)` |
    /// | beta1 | `max_beta1` | `min_beta1` | `max_beta1` |
    ///
    /// In a short run (`warmup · T < 1`) the rise ends before step 0, which is then already falling.
    ///
    /// # Source
    /// `torch.optim.lr_scheduler.OneCycleLR` with cosine annealing and two phases, with the defaults of
    /// SceneSplat be9d5e1 — whose optimizer's own beta1 of 0.9 is never used, because the scheduler
    /// cycles it. Differs: a step beyond the end holds the last value instead of raising; a rise of
    /// length 0 (`T = 20` at 5 %) counts as complete instead of dividing by zero.
    #[derive(Copy)]
    pub struct OneCycle {
        /// Part of the run in which the rate rises, `0..=1`.
        pub warmup: f64 = 0.05,
        /// Peak rate over first rate.
        pub div_factor: f64 = 10.0,
        /// First rate over last rate.
        pub final_div_factor: f64 = 1000.0,
        /// Momentum at the peak rate.
        pub min_beta1: f64 = 0.85,
        /// Momentum at the first and last step.
        pub max_beta1: f64 = 0.95,
    }
}

impl OneCycle {
    /// Checks settings that come from a file.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn check(&self) -> Result<(), TrainError> {
        let Self { warmup, div_factor, final_div_factor, min_beta1, max_beta1 } = *self;
        check_setting("warmup", warmup, (0.0..=1.0).contains(&warmup), "in 0..=1")?;
        for (field, value) in [("div_factor", div_factor), ("final_div_factor", final_div_factor)] {
            check_setting(field, value, value.is_finite() && value > 0.0, "above 0")?;
        }
        for (field, value) in [("min_beta1", min_beta1), ("max_beta1", max_beta1)] {
            check_setting(field, value, (0.0..1.0).contains(&value), "in 0..1")?;
        }
        Ok(())
    }

    fn value(&self, step: u64, total: u64, first: f64, peak: f64, last: f64) -> f64 {
        let end = total.saturating_sub(1);
        let (n, end) = (step.min(end) as f64, end as f64);
        let turn = self.warmup * total as f64 - 1.0;
        if n <= turn {
            cosine(first, peak, if turn > 0.0 { n / turn } else { 1.0 })
        } else {
            cosine(peak, last, if end > turn { (n - turn) / (end - turn) } else { 1.0 })
        }
    }
}

impl Schedule for OneCycle {
    fn factor(&self, step: u64, total: u64) -> f64 {
        let first = 1.0 / self.div_factor;
        self.value(step, total, first, 1.0, first / self.final_div_factor)
    }

    fn beta1(&self, step: u64, total: u64) -> Option<f64> {
        Some(self.value(step, total, self.max_beta1, self.min_beta1, self.max_beta1))
    }

    fn settings(&self) -> serde_json::Value {
        named("one_cycle", self)
    }
}

/// A straight warm-up, then half a cosine from one value to another.
///
/// With `w = ⌊warmup · T⌋`: at step `n < w` the value is `warmup_from + (from − warmup_from) ·
/// n/(w − 1)`, which reaches `from` at the last warm-up step; then
/// `to + (from − to)/2 · (1 + cos(π (n − w)/(T − w)))`, and `to` from step `T` on.
///
/// For learning rates, where it is a [`Schedule`], and for the other quantities that
/// self-supervised training varies: see the three constructors.
///
/// # Source
/// `CosineScheduler` of the self-supervised trainer, SceneSplat be9d5e1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CosineSchedule {
    /// Part of the run that is warm-up, `0..=1`.
    pub warmup: f64,
    /// Value at step 0, if there is a warm-up.
    pub warmup_from: f64,
    /// Value at the end of the warm-up.
    pub from: f64,
    /// Value at the end.
    pub to: f64,
}

impl CosineSchedule {
    /// From one value to another without warm-up.
    pub fn new(from: f64, to: f64) -> Self {
        Self { warmup: 0.0, warmup_from: from, from, to }
    }

    /// Momentum of the teacher, 0.9 → 1; used after optimizer step `n` as `value(n, total)`.
    pub fn teacher_momentum() -> Self {
        Self::new(0.9, 1.0)
    }

    /// Weight decay, 0.04 → 0.4. The original sets `value(n, total)` after optimizer step `n`, so it
    /// holds for step `n + 1`; the very first step uses the configured decay, 0.001.
    pub fn weight_decay() -> Self {
        Self::new(0.04, 0.4)
    }

    /// Temperature of the teacher: straight from 0.04 to 0.07 in the first 60 %, then 0.07.
    pub fn teacher_temperature() -> Self {
        Self { warmup: 0.6, warmup_from: 0.04, from: 0.07, to: 0.07 }
    }

    /// Checks settings that come from a file.
    ///
    /// # Errors
    /// If a value is not finite or the warm-up is no part of the run.
    pub fn check(&self) -> Result<(), TrainError> {
        let Self { warmup, warmup_from, from, to } = *self;
        check_setting("warmup", warmup, (0.0..=1.0).contains(&warmup), "in 0..=1")?;
        for (field, value) in [("warmup_from", warmup_from), ("from", from), ("to", to)] {
            check_setting(field, value, value.is_finite(), "finite")?;
        }
        Ok(())
    }

    /// The value at `step` of `total`.
    pub fn value(&self, step: u64, total: u64) -> f64 {
        if step >= total {
            return self.to;
        }
        // Rounds down, and never below 0 or beyond the run.
        let warmup = ((self.warmup * total as f64) as u64).min(total);
        if step < warmup {
            let part = if warmup > 1 { step as f64 / (warmup - 1) as f64 } else { 0.0 };
            return self.warmup_from + (self.from - self.warmup_from) * part;
        }
        cosine(self.from, self.to, (step - warmup) as f64 / (total - warmup) as f64)
    }
}

impl Schedule for CosineSchedule {
    fn factor(&self, step: u64, total: u64) -> f64 {
        self.value(step, total)
    }

    fn settings(&self) -> serde_json::Value {
        named("cosine", self)
    }
}

/// A schedule of the learning rate, and one of the weight decay beside it: step `n` decays by
/// `decay.value(n, total)`.
pub struct WithWeightDecay<S> {
    /// Of the learning rate and momentum.
    pub rate: S,
    /// Of the weight decay.
    pub decay: CosineSchedule,
}

impl<S: Schedule> Schedule for WithWeightDecay<S> {
    fn factor(&self, step: u64, total: u64) -> f64 {
        self.rate.factor(step, total)
    }

    fn beta1(&self, step: u64, total: u64) -> Option<f64> {
        self.rate.beta1(step, total)
    }

    fn weight_decay(&self, step: u64, total: u64) -> Option<f64> {
        Some(self.decay.value(step, total))
    }

    fn settings(&self) -> serde_json::Value {
        let decay = named("cosine", &self.decay);
        match self.rate.settings() {
            serde_json::Value::Object(mut settings) => {
                settings.insert("weight_decay".to_owned(), decay);
                settings.into()
            }
            other => serde_json::json!({ "rate": other, "weight_decay": decay }),
        }
    }
}

impl<S: Schedule + ?Sized> Schedule for Box<S> {
    fn factor(&self, step: u64, total: u64) -> f64 {
        (**self).factor(step, total)
    }

    fn beta1(&self, step: u64, total: u64) -> Option<f64> {
        (**self).beta1(step, total)
    }

    fn weight_decay(&self, step: u64, total: u64) -> Option<f64> {
        (**self).weight_decay(step, total)
    }

    fn settings(&self) -> serde_json::Value {
        (**self).settings()
    }
}

/// Settings with the name by which files choose them.
fn named(name: &str, settings: &impl Serialize) -> serde_json::Value {
    // Plain numbers: nothing that JSON could refuse.
    let mut value = serde_json::to_value(settings).unwrap_or_default();
    if let Some(fields) = value.as_object_mut() {
        fields.insert("type".to_owned(), name.into());
    }
    value
}

/// From `a` at 0 to `b` at 1, flat at both ends.
fn cosine(a: f64, b: f64, part: f64) -> f64 {
    b + (a - b) / 2.0 * ((PI * part).cos() + 1.0)
}
