//! Pictures as files: PNG read and written, JPEG read.
//!
//! The one place where the crates of this workspace decode pictures. Sizes are bounded before
//! memory is reserved: by [`MAX_PIXELS`], and for PNG by what its bytes can unpack to.

pub(crate) mod jpeg;
mod orientation;
mod png;
mod rgb;
mod sampling;

pub use orientation::orientation;
pub use rgb::RgbPicture;
pub use sampling::{is_one_shape, is_scaled, nearest};

use crate::SceneError;
use crate::input_file::InputFile;
use std::path::Path;

/// The most pixels of a picture that is read: 134 million, larger than any camera's.
pub const MAX_PIXELS: u64 = 1 << 27;

const SUPPORTED: &str = "PNG and JPEG pictures can be read";

/// What the samples of a pixel are, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// Brightness.
    Gray,
    /// Brightness, opacity.
    GrayAlpha,
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue, opacity.
    Rgba,
}

impl Channels {
    /// Samples per pixel.
    pub fn count(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::GrayAlpha => 2,
            Self::Rgb => 3,
            Self::Rgba => 4,
        }
    }
}

/// The samples of a picture, row by row from the top, pixel by pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Samples {
    /// 0 to 255. Fewer bits in the file are spread over that range.
    Eight(Vec<u8>),
    /// 0 to 65535.
    Sixteen(Vec<u16>),
}

/// A picture as its file holds it: no gamma, color profile or orientation mark is applied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    channels: Channels,
    samples: Samples,
}

impl Picture {
    /// Puts a picture together; `None` unless there is one sample per channel and pixel.
    pub fn new(width: u32, height: u32, channels: Channels, samples: Samples) -> Option<Self> {
        let expected = (width as usize).checked_mul(height as usize)?.checked_mul(channels.count());
        let got = match &samples {
            Samples::Eight(values) => values.len(),
            Samples::Sixteen(values) => values.len(),
        };
        (expected == Some(got)).then_some(Self { width, height, channels, samples })
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// What the samples of a pixel are.
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// The samples, `[H, W, C]`.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Takes the samples out, `[H, W, C]`.
    pub fn into_samples(self) -> Samples {
        self.samples
    }

    /// Whether any pixel is less than opaque.
    pub fn is_transparent(&self) -> bool {
        let n = self.channels.count();
        if matches!(self.channels, Channels::Gray | Channels::Rgb) {
            return false;
        }
        match &self.samples {
            Samples::Eight(v) => v.chunks_exact(n).any(|p| p[n - 1] != u8::MAX),
            Samples::Sixteen(v) => v.chunks_exact(n).any(|p| p[n - 1] != u16::MAX),
        }
    }

    /// Red, green and blue from 0 to 1, `[H, W, 3]`; gray is all three. Opacity is left out.
    pub fn to_rgb_f32(&self) -> Vec<f32> {
        match &self.samples {
            Samples::Eight(v) => self.rgb(v, |s| f32::from(s) / 255.0),
            Samples::Sixteen(v) => self.rgb(v, |s| f32::from(s) / 65535.0),
        }
    }

    /// Red, green and blue from 0 to 255; gray is all three. Opacity is left out, of 16 bits the
    /// nearest of 8 are kept.
    pub fn to_rgb8(&self) -> RgbPicture {
        let flat = match &self.samples {
            Samples::Eight(v) => self.rgb(v, |s| s),
            Samples::Sixteen(v) => self.rgb(v, eight_bits),
        };
        RgbPicture::of(self.width, self.height, flat.as_chunks::<3>().0.to_vec())
    }

    /// Opacity from 0 to 255, `[H, W]`; of 16 bits the nearest of 8 are kept. `None` if all of it is opaque.
    pub fn alpha8(&self) -> Option<Vec<u8>> {
        let n = self.channels.count();
        self.is_transparent().then(|| match &self.samples {
            Samples::Eight(v) => v.chunks_exact(n).map(|p| p[n - 1]).collect(),
            Samples::Sixteen(v) => v.chunks_exact(n).map(|p| eight_bits(p[n - 1])).collect(),
        })
    }

    /// Red, green and blue from 0 to 255 on a black background: each times the opacity of its pixel.
    pub fn over_black(&self) -> RgbPicture {
        let mut flat = self.to_rgb8();
        if let Some(alpha) = self.alpha8() {
            for (pixel, &a) in flat.pixels_mut().iter_mut().zip(&alpha) {
                *pixel = pixel.map(|v| ((u32::from(v) * u32::from(a) + 127) / 255) as u8);
            }
        }
        flat
    }

    fn rgb<S: Copy, T: Copy>(&self, samples: &[S], value: impl Fn(S) -> T) -> Vec<T> {
        let n = self.channels.count();
        let places = match self.channels {
            Channels::Gray | Channels::GrayAlpha => [0, 0, 0],
            Channels::Rgb | Channels::Rgba => [0, 1, 2],
        };
        let pixel = |p: &[S]| places.map(|c| value(p[c]));
        samples.chunks_exact(n).flat_map(pixel).collect()
    }
}

/// The nearest value of 8 bits.
fn eight_bits(value: u16) -> u8 {
    ((u32::from(value) + 128) / 257) as u8
}

/// Reads a PNG or JPEG picture, told apart by its first bytes.
///
/// # Errors
/// If the file cannot be read, is neither, is damaged or cut short, or has more than
/// [`MAX_PIXELS`] pixels.
pub fn read_picture(path: &Path) -> Result<Picture, SceneError> {
    decode_picture(InputFile::open(path)?.bytes(), path)
}

/// Reads a PNG picture and nothing else: for numbers that a lossy format would change.
///
/// # Errors
/// As [`read_picture`].
pub fn read_png(path: &Path) -> Result<Picture, SceneError> {
    let file = InputFile::open(path)?;
    if !png::is_png(file.bytes()) {
        return Err(SceneError::format(path, "is no PNG", ""));
    }
    png::decode(file.bytes(), path)
}

/// Reads a PNG picture whose values are numbers, as they are stored: those of a palette are the indices into it, and
/// of fewer than 8 bits nothing is spread. Of both kinds one gray picture of 8 bits is given.
///
/// # Errors
/// As [`read_png`].
pub fn read_png_numbers(path: &Path) -> Result<Picture, SceneError> {
    let file = InputFile::open(path)?;
    if !png::is_png(file.bytes()) {
        return Err(SceneError::format(path, "is no PNG", ""));
    }
    png::decode_numbers(file.bytes(), path)
}

/// As [`read_picture`], from the bytes of a file; `path` is for messages.
///
/// # Errors
/// As [`read_picture`].
pub fn decode_picture(bytes: &[u8], path: &Path) -> Result<Picture, SceneError> {
    if png::is_png(bytes) {
        return png::decode(bytes, path);
    }
    if jpeg::is_jpeg(bytes) {
        return jpeg::decode(bytes, path);
    }
    let problem = if bytes.is_empty() { "is empty" } else { "is no picture that can be read" };
    Err(SceneError::format(path, problem, SUPPORTED))
}

impl Picture {
    /// The picture as a PNG file.
    ///
    /// # Errors
    /// If it has no pixels, or more than a PNG file can hold.
    pub fn encode_png(&self) -> std::io::Result<Vec<u8>> {
        png::encode(self)
    }
}

/// Refuses a size before memory is reserved for it.
fn check_size(width: u64, height: u64, path: &Path) -> Result<(), SceneError> {
    // Neither is above 2³², so the product fits.
    if width * height > MAX_PIXELS {
        let problem = format!("has {width} × {height} pixels");
        let help = format!("pictures of at most {MAX_PIXELS} pixels are read");
        return Err(SceneError::format(path, problem, help));
    }
    if width == 0 || height == 0 {
        return Err(SceneError::format(path, format!("has {width} × {height} pixels"), ""));
    }
    Ok(())
}
