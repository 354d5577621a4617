//! Gaussians in glTF files: attributes, containers, nodes, and damaged files.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod attributes;
mod containers;
mod document;
mod nodes;
mod placement;
mod refused;
mod spz_inside;
mod writing;
