//! Settings of a run.

use crate::error::check_setting;
use crate::{Criterion, TrainError};
use scenesplat_kernels::settings;
use std::path::PathBuf;

settings! {
    /// Settings of the training loop. Data, model, loss and optimizer have their own.
    pub struct TrainerConfig {
        /// Seed of all that is random inside a step.
        pub seed: u64 = 0,
        /// Passes over the data.
        pub epochs: u64 = 1,
        /// Optimizer steps in all, in place of `epochs`; the last epoch may end early. Off if absent.
        // Not written where it is off: runs from before it was there go on.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub max_steps: Option<u64> = None,
        /// Batches whose gradients are averaged for one optimizer step, at least 1.
        pub accumulate: u64 = 1,
        /// Batch norms take the statistics of all batches of a step together, which then are as many as there are processes
        /// (`accumulate`): each has one of them. Otherwise those of each batch.
        // Not written where it is off: runs from before it was there go on.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        pub sync_batch_norm: bool = false,
        /// Largest joint norm of the gradients; larger ones are scaled down. Off if absent.
        pub clip_norm: Option<f64> = None,
        /// Steps between two lines of the log, at least 1.
        pub log_every: u64 = 10,
        /// Epochs between two evaluations; 0 evaluates after the last one only.
        pub eval_every: u64 = 1,
        /// Computes the inside of blocks again in the backward pass instead of keeping it.
        pub recompute: bool = false,
        /// Decay of a moving average of the parameters, `0..1`; evaluations and exports then use the
        /// average. Off if absent.
        pub ema: Option<f64> = None,
        /// Parameters and batch statistics that stay as they are: parts of names. Each part must be in
        /// some name. A batch norm whose statistics are frozen normalizes by them in training too.
        pub freeze: Vec<String> = Vec::new(),
        /// Parameters that may go without gradient, such as a head whose term starts later: parts of
        /// names.
        pub idle: Vec<String> = Vec::new(),
        /// Largest share of the scenes that may be left out, and of their rows that may be dropped when
        /// they are read; the run stops at the end of an epoch with more, `0..=1`.
        pub max_left_out: f64 = 0.1,
        /// Checkpoints.
        pub checkpoint: CheckpointConfig = CheckpointConfig::default(),
        /// Alarms about features and statistics that collapse.
        pub health: HealthConfig = HealthConfig::default(),
    }

    /// When checkpoints are written and which stay.
    pub struct CheckpointConfig {
        /// Folder of the checkpoints; none are written without it.
        pub dir: Option<PathBuf> = None,
        /// Steps between two; 0 writes at the end of epochs.
        pub every_steps: u64 = 0,
        /// How many of the last ones stay, at least 1; the best one stays besides.
        pub keep: usize = 1,
        /// Measurement whose best value marks the best checkpoint, e.g. `zero_shot/f-mIoU`, or a list of
        /// several whose mean does.
        pub best: Option<Criterion> = None,
        /// Whether a smaller value is better.
        pub smaller_is_better: bool = false,
    }

    /// When features count as collapsed. Looked at on a seeded sample of the output rows.
    pub struct HealthConfig {
        /// Steps between two looks; 0 never looks.
        pub every_steps: u64 = 100,
        /// Alarm if the effective rank of the features falls below this.
        pub min_effective_rank: f64 = 1.5,
        /// Alarm if the mean cosine between rows, their common mean taken off, rises above this.
        pub max_centred_cosine: f64 = 0.9,
        /// Alarm if a channel's running variance falls below this.
        pub min_running_var: f64 = 1e-10,
        /// Alarm if a channel's running variance rises above this.
        pub max_running_var: f64 = 1e10,
        /// Looks in a row with an alarm about the features after which the run ends with an error; 0 only
        /// raises alarms.
        pub stop_after: u64 = 0,
    }
}

impl TrainerConfig {
    /// Optimizer steps of a run whose epochs have so many.
    pub fn total_steps(&self, steps_per_epoch: u64) -> u64 {
        self.max_steps.unwrap_or(self.epochs * steps_per_epoch)
    }

    /// Settings that a resumed run may change: what they do not touch are the steps. With
    /// `recompute`, gradients are the same up to the rounding of sums.
    pub const MAY_CHANGE: [&str; 9] = [
        "log_every",
        "eval_every",
        "recompute",
        "idle",
        "max_left_out",
        "checkpoint.dir",
        "checkpoint.every_steps",
        "checkpoint.keep",
        "health",
    ];

    /// Checks settings that come from a file.
    ///
    /// # Errors
    /// Names the first setting that is out of its range.
    pub fn check(&self) -> Result<(), TrainError> {
        let at_least_one =
            |field, value: u64| check_setting(field, value as f64, value >= 1, "at least 1");
        at_least_one("epochs", self.epochs)?;
        at_least_one("max_steps", self.max_steps.unwrap_or(1))?;
        at_least_one("accumulate", self.accumulate)?;
        at_least_one("log_every", self.log_every)?;
        at_least_one("checkpoint.keep", self.checkpoint.keep as u64)?;
        let share = (0.0..=1.0).contains(&self.max_left_out);
        check_setting("max_left_out", self.max_left_out, share, "in 0..=1")?;
        if let Some(norm) = self.clip_norm {
            check_setting("clip_norm", norm, norm.is_finite() && norm > 0.0, "above 0")?;
        }
        if let Some(decay) = self.ema {
            check_setting("ema", decay, (0.0..1.0).contains(&decay), "in 0..1")?;
        }
        Ok(())
    }
}
