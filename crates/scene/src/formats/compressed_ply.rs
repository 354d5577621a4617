//! PLY files with packed integers in chunks of 256 Gaussians, as SuperSplat writes them.
//!
//! Bounds of positions, logarithms of scales and colors are stored per chunk; a Gaussian is four
//! 32-bit integers within them, and a byte per coefficient of higher harmonics. To add results to
//! a file without packing it again use [`super::ply::write_ply_with_columns`].

mod chunk;
mod code;
pub(super) mod order;
mod reader;
mod writer;

pub use reader::{is_compressed, read_compressed_ply};
pub(super) use writer::write_compressed_ply;

const VERTEX: &str = "vertex";
const CHUNK: &str = "chunk";
const SH: &str = "sh";
/// Gaussians that share bounds.
const CHUNK_ROWS: usize = 256;

/// Bounds that every version of the format has.
const BOUNDS: [&str; 12] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
];
/// Bounds of colors; without them colors are 0 to 1.
const COLOR_BOUNDS: [&str; 6] = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
