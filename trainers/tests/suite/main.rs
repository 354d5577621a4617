//! The loop, its tasks, its optimizer and what it keeps.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod support;

mod autoencoder;
mod checkpoint_files;
mod distillation;
mod fit;
mod golden;
mod lr_finder;
mod nothing;
mod optimizer;
mod optimizer_by_hand;
mod own_task;
mod pipeline;
mod ranks;
mod resume;
mod schedules;
mod self_distillation;
mod self_supervised;
mod self_supervised_fits;
mod self_supervised_golden;
mod self_supervised_settings;
mod self_supervised_terms;
mod step_inputs;
mod sync_batch_norm;
mod tasks;
mod tasks_by_hand;
mod teacher;
mod terms;
mod wiring;
