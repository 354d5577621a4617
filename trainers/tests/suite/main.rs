//! The loop, its tasks and what it keeps; one program, for linking takes longer than compiling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../support/line.rs"]
mod line;
#[path = "../support/mod.rs"]
mod support;

mod autoencoder;
mod checkpoint_files;
mod distillation;
mod fit;
mod nothing;
mod optimizer;
mod own_task;
mod pipeline;
mod ranks;
mod resume;
mod schedules;
mod self_distillation;
mod self_supervised;
mod self_supervised_golden;
mod step_inputs;
mod sync_batch_norm;
mod tasks;
mod teacher;
mod terms;
mod wiring;
