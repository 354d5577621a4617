//! Optimizers, schedules, and what is done to gradients and parameters between steps.

mod adamw;
mod clip;
mod ema;
mod groups;
mod schedule;
mod slices;

pub use adamw::{AdamW, AdamWConfig};
pub use clip::{clip_grad_norm, grad_norm};
pub use ema::ema_update;
pub use groups::{KeywordGroup, ParamGroup, group_by_keyword};
pub use schedule::{CosineSchedule, OneCycle, Schedule, WithWeightDecay};

use crate::TrainError;
use candle_core::{Tensor, backprop::GradStore};
use std::collections::BTreeMap;

/// What changes from step to step; the rest belongs to the optimizer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepHyperparameters {
    /// Factor on every group's learning rate, at least 0.
    pub lr_scale: f64,
    /// Momentum of all groups for this step, in `0..1`; the optimizer's own if `None`.
    pub beta1: Option<f64>,
    /// Weight decay of all groups for this step, at least 0; each group's own if `None`.
    pub weight_decay: Option<f64>,
}

impl Default for StepHyperparameters {
    fn default() -> Self {
        Self { lr_scale: 1.0, beta1: None, weight_decay: None }
    }
}

/// Updates parameters from gradients; its whole state can be saved.
///
/// The optimizer owns handles of its parameters. It is object-safe, so a trainer can hold any, and
/// what a schedule varies comes in as an argument, so there is no second place that stores it.
pub trait Optimizer: Send {
    /// One update. Parameters without a gradient stay as they are, their counters too.
    ///
    /// Reads gradients without keeping them: nothing of the graph lives on.
    ///
    /// # Errors
    /// If a gradient is not finite, too large, or of another shape or type than its parameter, or a
    /// hyperparameter is out of range. Nothing has changed then.
    fn step(
        &mut self,
        grads: &GradStore,
        hyperparameters: &StepHyperparameters,
    ) -> Result<(), TrainError>;

    /// What a checkpoint shall compare before a run goes on; nothing by default.
    fn settings(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    /// Moments and counters, by name: copies that later steps leave alone.
    ///
    /// # Errors
    /// If a tensor cannot be copied.
    fn state(&self) -> Result<BTreeMap<String, Tensor>, TrainError>;

    /// Restores what [`state`](Self::state) gave; the next step is then bit for bit the one that
    /// would have followed.
    ///
    /// # Errors
    /// If an entry is missing, unknown, or of another shape or type. Nothing has changed then.
    fn load_state(&mut self, state: &BTreeMap<String, Tensor>) -> Result<(), TrainError>;
}
