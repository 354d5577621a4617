//! Agreement with numbers that the original implementation computed.

mod convolution;
mod emulated;
mod full_size;
mod modules;
mod padding;
mod serialization;
pub mod tiny_networks;
