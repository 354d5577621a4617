//! Gradients against goldens, an f64 reference and central differences.

mod edges;
mod goldens;
mod small_scene;
mod workspace;
