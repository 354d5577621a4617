//! Image networks on a plain CPU, with weights from local files.
//!
//! | what | module |
//! |---|---|
//! | pictures in another size, equal to Pillow's to the bit | [`resize`] |
//! | masks of a click or a box | [`sam2`] |

mod error;
mod layers;
pub mod resize;
pub mod sam2;
mod weights;

pub use error::VisionError;
