//! Networks as a whole: what must not change a bit, what is refused, and hard scenes.

mod determinism;
mod emulated;
pub mod litept;
mod lpips;
mod point_networks;
mod precision;
mod rasterize;
mod recompute;
mod second_version;
mod shortcuts;
