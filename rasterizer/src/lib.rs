//! Pictures of 3D Gaussians on a CPU, their gradients, and labels lifted from pictures onto them.

pub mod lifting;
pub mod segments;
