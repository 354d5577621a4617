//! Scenes as sets to learn from, and what a capture did to them; one program, for linking takes longer than
//! compiling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod chunking;
mod effect_plan;
mod effect_profile;
mod loader;
mod rooms_of_points;
mod sources;
mod weighted_mix;
mod wiring;

use scenesplat_test_support::shared;
