//! What turns pictures into rows of features.

use crate::CollectError;
use scenesplat_scene::picture::RgbPicture;

/// Describes pictures by rows of one width.
///
/// A row depends on its picture alone, not on the others of the batch.
pub trait PictureEncoder: Send + Sync {
    /// What it is and with which weights: what is computed once is kept under this name, so other rows need another
    /// name.
    fn name(&self) -> String;

    /// Values of a row, at least 1.
    fn width(&self) -> usize;

    /// One row per picture, finite, not all 0, any norm. `[pictures, width]`
    ///
    /// # Errors
    /// If a picture cannot be encoded.
    fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError>;

    /// The row of a whole frame; by default that of any picture.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    fn encode_frame(&self, frame: &RgbPicture) -> Result<Vec<f32>, CollectError> {
        self.encode(std::slice::from_ref(frame))
    }
}
