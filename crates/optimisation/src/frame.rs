//! A picture to learn from.

use crate::error::{OptimiseError, expect, within};
use glam::DVec3;
use scenesplat_rasterizer::View;

/// Red, green and blue, row by row. `[H, W, 3]`
#[derive(Debug, Clone, PartialEq)]
pub enum Colors {
    /// 0 to 255: a quarter of the memory.
    Bytes(Vec<u8>),
    /// 0 to 1.
    Floats(Vec<f32>),
}

impl Default for Colors {
    /// No value.
    fn default() -> Self {
        Self::Bytes(Vec::new())
    }
}

impl Colors {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Bytes(values) => values.len(),
            Self::Floats(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A value, 0 to 1.
    pub fn at(&self, i: usize) -> f32 {
        match self {
            Self::Bytes(values) => f32::from(values[i]) / 255.0,
            Self::Floats(values) => values[i],
        }
    }

    /// All values, 0 to 1, into memory that is used again.
    pub fn put(&self, out: &mut Vec<f32>) {
        out.clear();
        match self {
            Self::Bytes(values) => out.extend(values.iter().map(|v| f32::from(*v) / 255.0)),
            Self::Floats(values) => out.extend_from_slice(values),
        }
    }

    /// Its memory, if it is of bytes.
    fn into_bytes(self) -> Vec<u8> {
        match self {
            Self::Bytes(values) => values,
            Self::Floats(_) => Vec::new(),
        }
    }

    /// Its memory, if it is of floats.
    fn into_floats(self) -> Vec<f32> {
        match self {
            Self::Floats(values) => values,
            Self::Bytes(_) => Vec::new(),
        }
    }

    /// Every value is finite.
    fn is_finite(&self) -> bool {
        match self {
            Self::Bytes(_) => true,
            Self::Floats(values) => values.iter().all(|v| v.is_finite()),
        }
    }
}

/// A posed picture, with depth and mask where there are any.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingFrame {
    /// For messages, and to tell whether a checkpoint is of the same frames.
    pub name: String,
    /// Where it was taken from; its size is that of the arrays.
    pub view: View,
    /// What was seen; where it is not opaque, on a black background: times `alpha`.
    pub rgb: Colors,
    /// Opacity, 0 to 255: where it is 0 nothing is there. `None` is opaque. `[H, W]`
    pub alpha: Option<Vec<u8>>,
    /// Along the camera's z axis, units of the scene; 0, negative and NaN where nothing was measured. `[H, W]`
    pub depth: Option<Vec<f32>>,
    /// 0 where a pixel does not count. `[H, W]`
    pub mask: Option<Vec<u8>>,
}

impl TrainingFrame {
    /// Checks the view and that arrays have its size.
    ///
    /// # Errors
    /// Names the frame and what does not fit.
    pub fn check(&self) -> Result<(), OptimiseError> {
        let pixels = self.view.pixels();
        let sizes = || {
            self.view.check()?;
            expect("picture", 3 * pixels, self.rgb.len())?;
            expect("alpha", pixels, self.alpha.as_ref().map_or(pixels, Vec::len))?;
            expect("depth", pixels, self.depth.as_ref().map_or(pixels, Vec::len))?;
            expect("mask", pixels, self.mask.as_ref().map_or(pixels, Vec::len))?;
            within("a value of the picture", f64::NAN, self.rgb.is_finite(), "finite")
        };
        sizes().map_err(|error| OptimiseError::Frame {
            frame: self.name.clone(),
            problem: error.to_string(),
            help: "picture, alpha, depth and mask have to have the size that its camera says",
        })
    }

    /// Its bytes in memory, as far as they grow with the picture.
    pub fn bytes(&self) -> usize {
        let colors = match &self.rgb {
            Colors::Bytes(values) => values.len(),
            Colors::Floats(values) => 4 * values.len(),
        };
        colors
            + self.depth.as_ref().map_or(0, |d| 4 * d.len())
            + self.mask.as_ref().map_or(0, Vec::len)
            + self.alpha.as_ref().map_or(0, Vec::len)
    }

    /// The picture on a background, 0 to 1, into memory that is used again.
    pub fn put_over(&self, background: [f32; 3], out: &mut Vec<f32>) {
        self.rgb.put(out);
        if let Some(alpha) = self.alpha.as_ref().filter(|_| background != [0.0; 3]) {
            for (pixel, &alpha) in out.as_chunks_mut::<3>().0.iter_mut().zip(alpha) {
                let free = 1.0 - f32::from(alpha) / 255.0;
                for (v, behind) in pixel.iter_mut().zip(background) {
                    *v += free * behind;
                }
            }
        }
    }

    /// Whether a pixel counts and shows something that is at least half opaque.
    pub fn shows(&self, pixel: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask[pixel] != 0)
            && self.alpha.as_ref().is_none_or(|alpha| alpha[pixel] >= 128)
    }

    /// The frame at half the size: means of four pixels, of depths those that were measured, masked
    /// where any of the four is. A last odd row or column is left out.
    pub fn halved(&self) -> Self {
        let (name, rgb) = (String::new(), Colors::default());
        let mut out = Self { name, view: self.view, rgb, alpha: None, depth: None, mask: None };
        self.halve_into(&mut out);
        out
    }

    /// [`halved`](Self::halved) into a frame whose memory is used again, whatever it was.
    pub fn halve_into(&self, out: &mut Self) {
        let (width, height) = (self.view.width as usize / 2, self.view.height as usize / 2);
        let from = self.view.width as usize;
        let four = move |x: usize, y: usize| {
            let at = 2 * y * from + 2 * x;
            [at, at + 1, at + from, at + from + 1]
        };
        let all = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
        let places = || all().flat_map(|(x, y)| [0, 1, 2].map(|c| four(x, y).map(|i| 3 * i + c)));
        let before = std::mem::take(&mut out.rgb);
        out.rgb = match &self.rgb {
            Colors::Bytes(v) => {
                let sum = |at: [usize; 4]| at.iter().map(|i| u32::from(v[*i])).sum::<u32>();
                let mean = |at| ((sum(at) + 2) / 4) as u8;
                Colors::Bytes(refilled(before.into_bytes(), places().map(mean)))
            }
            Colors::Floats(v) => {
                let mean = |at: [usize; 4]| at.iter().map(|i| v[*i]).sum::<f32>() / 4.0;
                Colors::Floats(refilled(before.into_floats(), places().map(mean)))
            }
        };
        let mean_of_known = |values: [f32; 4]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for z in values.into_iter().filter(|z| *z > 0.0 && z.is_finite()) {
                (sum, count) = (sum + z, count + 1.0);
            }
            if count > 0.0 { sum / count } else { 0.0 }
        };
        let depth = |of: &[f32]| {
            let values = all().map(|(x, y)| mean_of_known(four(x, y).map(|i| of[i])));
            refilled(out.depth.take().unwrap_or_default(), values)
        };
        out.depth = self.depth.as_deref().map(depth);
        let alpha = |of: &[u8]| {
            let mean = |(x, y)| {
                let sum: u32 = four(x, y).iter().map(|i| u32::from(of[*i])).sum();
                ((sum + 2) / 4) as u8
            };
            refilled(out.alpha.take().unwrap_or_default(), all().map(mean))
        };
        out.alpha = self.alpha.as_deref().map(alpha);
        let mask = |of: &[u8]| {
            let least = |(x, y)| four(x, y).map(|i| of[i]).into_iter().min().unwrap_or(0);
            refilled(out.mask.take().unwrap_or_default(), all().map(least))
        };
        out.mask = self.mask.as_deref().map(mask);
        let v = &self.view;
        out.view = View {
            fx: v.fx / 2.0,
            fy: v.fy / 2.0,
            cx: v.cx / 2.0,
            cy: v.cy / 2.0,
            width: width as u32,
            height: height as u32,
            ..*v
        };
        out.name.clone_from(&self.name);
    }
}

/// An array with other values.
fn refilled<T>(mut array: Vec<T>, values: impl Iterator<Item = T>) -> Vec<T> {
    array.clear();
    array.extend(values);
    array
}

/// 1.1 times the largest distance of a camera from the mean of all; 1 if all are at one place.
pub fn scale_of_cameras(frames: &[TrainingFrame]) -> f64 {
    let center = |f: &TrainingFrame| DVec3::from(f.view.centre().map(f64::from));
    let centers: Vec<DVec3> = frames.iter().map(center).collect();
    let mean = centers.iter().sum::<DVec3>() / centers.len().max(1) as f64;
    let most = 1.1 * centers.iter().map(|c| c.distance(mean)).fold(0.0, f64::max);
    if most > 1e-6 { most } else { 1.0 }
}

#[cfg(test)]
pub(crate) mod tests;
