//! Networks and their operations, but for goldens, gradients and weights; one program, for linking takes longer than compiling.

mod determinism;
mod litept;
mod lpips;
mod point_networks;
mod precision;
mod rasterize;
mod recompute;
mod shortcuts;
