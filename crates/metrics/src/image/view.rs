//! A borrowed picture.

use super::ImageError;

/// Values of a picture, row by row from the top, channels inside: `[H, W, C]`, nominally 0 to 1.
#[derive(Debug, Clone, Copy)]
pub struct ImageView<'a> {
    values: &'a [f32],
    width: usize,
    height: usize,
    channels: usize,
}

impl<'a> ImageView<'a> {
    /// Borrows `values` as a picture.
    ///
    /// # Errors
    /// If there is no pixel or no channel, or the sizes do not give the number of values.
    pub fn new(
        values: &'a [f32],
        width: usize,
        height: usize,
        channels: usize,
    ) -> Result<Self, ImageError> {
        check_size("image", [width, height, channels], values.len())?;
        Ok(Self { values, width, height, channels })
    }

    /// The values, `[H, W, C]`.
    pub fn values(&self) -> &'a [f32] {
        self.values
    }

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Values per pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Values per row.
    pub(super) fn stride(&self) -> usize {
        self.width * self.channels
    }

    /// The values of a row.
    pub(super) fn row(&self, y: usize) -> &'a [f32] {
        &self.values[y * self.stride()..(y + 1) * self.stride()]
    }

    /// Checks that every value is finite.
    pub(super) fn check_finite(&self, what: &'static str) -> Result<(), ImageError> {
        check_finite(what, self.values, self.width, self.channels)
    }
}

/// Checks that a picture of this width, height and number of channels has `len` values, and any at all.
pub(super) fn check_size(
    what: &'static str,
    [width, height, channels]: [usize; 3],
    len: usize,
) -> Result<(), ImageError> {
    let product = width.checked_mul(height).and_then(|v| v.checked_mul(channels));
    if product != Some(len) {
        return Err(ImageError::Shape { what, width, height, channels, len });
    }
    let error = ImageError::Empty { what, width, height, channels };
    (len > 0).then_some(()).ok_or(error)
}

/// Checks that every value of an `[H, W, C]` array is finite.
pub(super) fn check_finite(
    what: &'static str,
    values: &[f32],
    width: usize,
    channels: usize,
) -> Result<(), ImageError> {
    // A sum of finite numbers times 0 is 0: no branch until something is wrong.
    let is_clean = |block: &[f32]| block.iter().map(|v| v * 0.0).sum::<f32>() == 0.0;
    if values.chunks(4096).all(is_clean) {
        return Ok(());
    }
    let Some(i) = values.iter().position(|v| !v.is_finite()) else { return Ok(()) };
    let (pixel, channel) = (i / channels, i % channels);
    let (x, y) = (pixel % width, pixel / width);
    Err(ImageError::NonFinite { what, x, y, channel, value: values[i] })
}

/// Checks that two pictures can be compared.
pub(super) fn check_pair(pred: &ImageView<'_>, truth: &ImageView<'_>) -> Result<(), ImageError> {
    let size = |v: &ImageView<'_>| [v.width, v.height, v.channels];
    if size(pred) != size(truth) {
        return Err(ImageError::SizesDiffer { pred: size(pred), truth: size(truth) });
    }
    pred.check_finite("first image")?;
    truth.check_finite("second image")
}
