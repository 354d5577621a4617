//! How sharp a picture is: the variance of its Laplacian.
//!
//! The number depends on the size of the picture and on what it shows. Bring all frames of a data
//! set to one width first ([`shrink_to_width`], say 640), and compare a frame with its neighbors
//! in time ([`super::frame_filter`]), not with a fixed number: a blank wall is never sharp.

use super::ImageError;
use super::view::check_size;
use rayon::prelude::*;

/// Gray values, a byte each, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayImage {
    values: Vec<u8>,
    width: usize,
}

impl GrayImage {
    /// Takes gray values, `[H · width]`.
    ///
    /// # Errors
    /// If there is no pixel, or the last row is not whole.
    pub fn new(values: Vec<u8>, width: usize) -> Result<Self, ImageError> {
        let height = values.len().checked_div(width).unwrap_or(0);
        check_size("gray image", [width, height, 1], values.len())?;
        Ok(Self { values, width })
    }

    /// Gray of sRGB bytes, `[H · width, 3]`: `0.299 R + 0.587 G + 0.114 B`, rounded to nearest.
    ///
    /// # Errors
    /// As [`GrayImage::new`].
    ///
    /// # Source
    /// The weights of OpenCV, whose fixed-point rounding may differ by 1.
    pub fn from_rgb(rgb: &[[u8; 3]], width: usize) -> Result<Self, ImageError> {
        let gray = |c: &[u8; 3]| {
            let [r, g, b] = c.map(u32::from);
            ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
        };
        Self::new(rgb.iter().map(gray).collect(), width)
    }

    /// The values, `[H, W]`.
    pub fn values(&self) -> &[u8] {
        &self.values
    }

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.values.len() / self.width
    }
}

/// The picture at most `width` pixels wide, each pixel the mean of the area it covers, rounded to
/// nearest; a narrower picture is not changed.
///
/// The height follows, rounded to nearest and at least 1.
///
/// # Errors
/// If `width` is 0.
pub fn shrink_to_width(image: &GrayImage, width: usize) -> Result<GrayImage, ImageError> {
    if width == 0 {
        let (field, expected) = ("width", "at least 1 pixel");
        return Err(ImageError::Setting { field, value: 0.0, expected });
    }
    if image.width <= width {
        return Ok(image.clone());
    }
    let height =
        ((image.height() as f64 * width as f64 / image.width as f64).round() as usize).max(1);
    let (across, down) = (shares(image.width, width), shares(image.height(), height));
    let mut values = vec![0; width * height];
    values.par_chunks_mut(width).zip(&down).for_each(|(out, (top, rows))| {
        // The rows first: one pass over each row of the source.
        let mut line = vec![0.0; image.width];
        for (row, share) in image.values[top * image.width..].chunks(image.width).zip(rows) {
            for (sum, &v) in line.iter_mut().zip(row) {
                *sum += share * f64::from(v);
            }
        }
        for (out, (left, columns)) in out.iter_mut().zip(&across) {
            let mean: f64 = columns.iter().zip(&line[*left..]).map(|(s, v)| s * v).sum();
            *out = mean.round() as u8;
        }
    });
    GrayImage::new(values, width)
}

/// For each new pixel: the first old one it touches and the shares of those from there, sum 1.
fn shares(from: usize, to: usize) -> Vec<(usize, Vec<f64>)> {
    let step = from as f64 / to as f64;
    let share = |i: usize| {
        let (start, end) = (i as f64 * step, ((i + 1) as f64 * step).min(from as f64));
        let first = start.floor() as usize;
        let last = (end.ceil() as usize).min(from);
        let part = |j: usize| ((j + 1) as f64).min(end) - (j as f64).max(start);
        let parts: Vec<f64> = (first..last).map(part).collect();
        let sum: f64 = parts.iter().sum();
        (first, parts.into_iter().map(|p| p / sum).collect())
    };
    (0..to).map(share).collect()
}

/// Variance (of the population) of the Laplacian `[0 1 0; 1 −4 1; 0 1 0]` of gray bytes, the
/// picture mirrored at its border pixels, which are not repeated.
///
/// Exact: the sums are whole numbers. A picture one pixel wide or high is its own mirror.
///
/// # Source
/// `cv2.Laplacian(grey, CV_64F).var()`.
pub fn variance_of_laplacian(image: &GrayImage) -> f64 {
    let (width, height) = (image.width, image.height());
    let row = |y: usize| &image.values[y * width..(y + 1) * width];
    let (sum, squares) = (0..height)
        .into_par_iter()
        .map(|y| {
            let above = row(if y > 0 { y - 1 } else { 1.min(height - 1) });
            let below = row(if y + 1 < height { y + 1 } else { height.saturating_sub(2) });
            laplacian_sums(above, row(y), below)
        })
        .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    let count = (width * height) as f64;
    let mean = sum as f64 / count;
    (squares as f64 / count - mean * mean).max(0.0)
}

/// Sum and sum of squares of the Laplacian of a row.
fn laplacian_sums(above: &[u8], row: &[u8], below: &[u8]) -> (i64, i64) {
    let last = row.len() - 1;
    let at = |x: usize, left: usize, right: usize| {
        let v = |b: u8| i32::from(b);
        v(above[x]) + v(below[x]) + v(row[left]) + v(row[right]) - 4 * v(row[x])
    };
    let (mut sum, mut squares) = (0i64, 0i64);
    let mut add = |value: i32| {
        sum += i64::from(value);
        squares += i64::from(value * value);
    };
    add(at(0, 1.min(last), 1.min(last)));
    for x in 1..last.max(1) {
        add(at(x, x - 1, x + 1));
    }
    if last > 0 {
        add(at(last, last - 1, last - 1));
    }
    (sum, squares)
}
