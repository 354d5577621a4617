//! Losses for backbones that learn from scenes without labels.
//!
//! | term | compares | function |
//! |---|---|---|
//! | SimDINO | a vector for each scene, between views | [`sim_dino`] |
//! | SimDINO of rows | rows matched between views | [`sim_dino_rows`] |
//! | iBOT, as the original computes it | rows of masked Gaussians with the teacher's | [`masked_cosine`] |
//! | iBOT, as it is named | distributions over prototypes, of masked Gaussians | [`masked_cross_entropy`] |
//! | DINO | distributions over prototypes, between views | [`view_cross_entropy`] |
//! | masked Gaussian modeling | attributes of masked Gaussians with what they are | [`masked_gaussians`] |
//!
//! Targets over prototypes come from [`Centering`] or [`sinkhorn_knopp`]. A teacher's rows get no
//! gradient. Numbers and hard input are those of the [crate]: f64 sums, no row that counts gives `None`,
//! a value that counts and is not finite is an error that names it.

mod coding_rate;
mod distributions;
mod masked_cosine;
mod masked_gaussians;
mod sim_dino;
mod stored;
mod targets;

pub use distributions::{masked_cross_entropy, view_cross_entropy};
pub use masked_cosine::masked_cosine;
pub use masked_gaussians::{AttributeColumns, GaussianDistance, masked_gaussians};
pub use sim_dino::{Expansion, SimDino, SimDinoOutput, sim_dino, sim_dino_rows};
pub use targets::{Centering, sinkhorn_knopp};
