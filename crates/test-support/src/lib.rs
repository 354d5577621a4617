//! What the tests of several crates share. No crate of the workspace depends on it outside tests, and it
//! depends on none of them, so that tests of every crate can use it.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::missing_panics_doc,
    reason = "a test that cannot set itself up should stop"
)]

mod experiment;
mod golden;
pub mod graph_file;
pub mod reference;
mod schema;
mod shared;
mod small_encoder;
mod small_siglip;

pub use experiment::{Network, SMALL_SEGMENTATION};
pub use golden::{Golden, compare_relative, relative_error};
pub use schema::schema_problems;
pub use shared::{repository, shared};
pub use small_encoder::SmallEncoder;
pub use small_siglip::small_siglip;
