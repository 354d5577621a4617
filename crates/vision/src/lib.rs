//! Image networks on a plain CPU, with weights from local files.
//!
//! | what | module |
//! |---|---|
//! | pictures in another size, equal to Pillow's to the bit | [`resize`] |
//! | masks of a click or a box | [`sam2`] |
//! | masks of everything in a picture | [`masks`] |
//! | vectors of pictures and texts | [`siglip`] |
//! | boxes with names | [`detector`] |
//! | either from an ONNX file (feature `onnx`) | `onnx` |

mod cross_attention;
pub mod detector;
mod error;
mod layers;
pub mod masks;
#[cfg(feature = "onnx")]
pub mod onnx;
pub mod resize;
pub mod sam2;
pub mod siglip;
#[cfg(test)]
mod test_files;
mod weights;

pub use detector::{Detection, Detector, DetectorSettings};
pub use error::VisionError;
pub use masks::{AutomaticMasks, IdMap, MaskProposal, MaskSettings, paint};
pub use sam2::{Sam2, Sam2Config};
pub use siglip::{SiglipImageEncoder, SiglipTextEncoder};
