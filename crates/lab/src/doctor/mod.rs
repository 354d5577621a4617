//! Hard cases that run on the user's machine and build: one catalogue as data, and what runs it.
//!
//! A [`Case`] has a name, a [`Level`] (files, operators, training, scenes), where it comes from, what
//! is expected ([`Policy`]), a tolerance with its reason, and a function that makes its input and judges
//! what the library makes of it. Inputs are made, not stored: the same in every run. Operators are
//! compared with references in f64 that stand in this module, written by the formula; each is computed
//! by one thread and by several, which must give the same bits. Beside the error stand [`Measures`] with
//! [`Bounds`] of their own: units in the last place, the direction of gradients, errors that lean to a side.
//!
//! ```
//! use scenesplat_lab::doctor::{Doctor, catalogue};
//!
//! let folder = std::env::temp_dir().join(format!("doctor-{}", std::process::id()));
//! let case = catalogue().into_iter().find(|c| c.name == "ply-quat-w-zero").unwrap();
//! let verdict = Doctor::new(&folder)?.run(&case);
//! assert!(verdict.passed, "{:?}", verdict.failure);
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![allow(clippy::type_complexity, reason = "tables of names, origins and functions")]

mod case;
mod catalogue;
mod inputs;
mod measures;
mod noise;
mod operators;
mod report;
mod runner;
mod scenes;
mod soak;
mod stability;
mod table;
mod training;
mod trial;
mod verdict;

pub use case::{Case, Finding, Level, Policy};
pub use catalogue::{catalogue, nearest_names};
pub use measures::{Bounds, Measures, SignBias};
pub use report::{DoctorReport, IsaReport, Surroundings};
pub use runner::Doctor;
pub use soak::{SoakKind, SoakMemory, SoakProblem, SoakReport, SoakSettings, soak, soak_round};
pub use stability::{
    GradientCheck, PoisonCheck, StabilityRecipe, StabilityReport, StabilityRun, StabilitySettings,
    stability,
};
pub use trial::{Failure, Trial};
pub use verdict::Verdict;
