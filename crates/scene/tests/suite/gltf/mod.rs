//! Gaussians in glTF files: attributes, containers, nodes.

mod attributes;
mod containers;
mod nodes;
pub(crate) mod placement;
mod refused;
mod spz_inside;
mod writing;
