//! Training: the loop, what plugs into it, and how parameters change.
//!
//! The parts of a training run that decide the numbers, each a plain value or a pure function:
//!
//! - [`AdamW`] behind the object-safe [`Optimizer`] trait, over [`ParamGroup`]s with their own rates;
//! - [`clip_grad_norm`], which also refuses gradients that are not finite, by name;
//! - [`Schedule`]s, [`OneCycle`] and [`CosineSchedule`]: functions of the step, so there is nothing
//!   to save and a resumed run needs no replay;
//! - [`ema_update`] for teacher networks.
//!
//! The loop that calls them is [`Trainer::fit`]. It takes a [`TrainingModule`] (a model and how it
//! learns, see [`tasks`]) and a [`DataModule`] (a loader of batches, and [`Evaluator`]s); [`callbacks`] watch
//! it; [`checkpoint`]s let it go on after an interruption with the bits it would have had.
//!
//! # Determinism
//! Parameters are visited in name order and sums over elements are taken in a fixed order, so
//! a step gives the same bits whatever the number of threads.
//!
//! # One training step
//!
//! ```
//! use candle_core::{Device, Tensor, Var};
//! use scenesplat_trainers::{
//!     AdamW, AdamWConfig, OneCycle, Optimizer, Schedule, clip_grad_norm, group_by_keyword,
//! };
//! use std::collections::BTreeMap;
//!
//! let weight = Var::new(&[3.0_f32, -2.0], &Device::Cpu)?;
//! let params = BTreeMap::from([("weight".to_owned(), weight.clone())]);
//! let groups = group_by_keyword(&params, 0.1, 0.0, &[]);
//! let mut optimizer = AdamW::new(groups, AdamWConfig::default())?;
//! let schedule = OneCycle::default();
//! for step in 0..100 {
//!     let loss = weight.sqr()?.sum_all()?;
//!     let mut grads = loss.backward()?;
//!     clip_grad_norm(&params, &mut grads, 1.0)?;
//!     optimizer.step(&grads, &schedule.hyperparameters(step, 100))?;
//! }
//! assert!(weight.sqr()?.sum_all()?.to_scalar::<f32>()? < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod average;
pub mod callbacks;
pub mod checkpoint;
pub mod collective;
mod config;
mod data_module;
mod error;
pub mod evaluators;
mod event;
mod freeze;
pub mod gradients;
mod health;
mod identity;
mod lr_finder;
mod module;
pub mod optim;
mod selection;
mod tally;
pub mod tasks;
mod trainer;

pub use average::Average;
pub use collective::{Alone, Collective, CollectiveError, ThreadRank};
pub use config::{CheckpointConfig, HealthConfig, TrainerConfig};
pub use data_module::DataModule;
pub use error::TrainError;
pub use event::{Callback, End, Evaluator, Event, Flow, Progress};
pub use identity::{Change, Identity};
pub use lr_finder::{LrCurve, LrFinderConfig, LrPoint, find_lr};
pub use module::{AfterStep, HasBackbone, StepContext, StepOutput, TrainingModule};
pub use optim::{
    AdamW, AdamWConfig, CosineSchedule, KeywordGroup, OneCycle, Optimizer, ParamGroup, Schedule,
    StepHyperparameters, WithWeightDecay, clip_grad_norm, ema_update, grad_norm, group_by_keyword,
};
pub use selection::Criterion;
pub use tally::Tally;
pub use trainer::Trainer;
