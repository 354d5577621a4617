//! Scenes and cameras in every format: read, written, edited, and refused.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../common/mod.rs"]
mod common;

mod cameras;
mod colors;
mod compressed_ply;
mod editing;
mod gltf;
mod hostile;
mod inria_ply;
mod kept;
mod ksplat;
mod labelled_ply;
mod npy;
mod pictures;
mod place;
mod ply_container;
mod real_files;
mod round_trip;
mod sog;
mod sog_streamed;
mod splat;
mod spz;
mod usd;
mod writing;
mod wrong_files;
