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
pub(crate) mod tests {
    use super::*;

    pub(crate) fn view(width: u32, height: u32) -> View {
        View {
            world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 2.]],
            fx: width as f32,
            fy: width as f32,
            cx: width as f32 / 2.0,
            cy: height as f32 / 2.0,
            width,
            height,
        }
    }

    /// A black frame of that view, maybe with one depth everywhere.
    pub(crate) fn frame(view: View, depth: Option<f32>) -> TrainingFrame {
        let pixels = view.pixels();
        TrainingFrame {
            name: String::new(),
            view,
            rgb: Colors::Bytes(vec![0; 3 * pixels]),
            alpha: None,
            depth: depth.map(|z| vec![z; pixels]),
            mask: None,
        }
    }

    #[test]
    fn halves_by_hand() {
        let frame = TrainingFrame {
            name: "a".to_owned(),
            view: view(3, 2),
            rgb: Colors::Bytes((0..18).collect()),
            alpha: Some(vec![255, 127, 0, 8, 1, 0]),
            depth: Some(vec![1.0, f32::NAN, 9.0, 0.0, 2.0, 9.0]),
            mask: Some(vec![1, 1, 1, 1, 0, 1]),
        };
        frame.check().unwrap();
        let half = frame.halved();
        half.check().unwrap();
        // Into what a frame of another size and kind has left.
        let mut used = TrainingFrame {
            name: "b".to_owned(),
            view: view(4, 4),
            rgb: Colors::Floats(vec![0.5; 48]),
            alpha: None,
            depth: Some(vec![1.0; 16]),
            mask: None,
        };
        let floats = used.halved();
        assert_eq!((floats.rgb.clone(), floats.mask), (Colors::Floats(vec![0.5; 12]), None));
        frame.halve_into(&mut used);
        assert_eq!(used, half);
        // Pixels 0, 1, 3, 4: reds 0, 3, 9, 12.
        assert_eq!(half.rgb, Colors::Bytes(vec![6, 7, 8]));
        assert_eq!((half.alpha, half.depth), (Some(vec![98]), Some(vec![1.5])));
        assert_eq!(half.mask, Some(vec![0]));
        assert_eq!((half.view.width, half.view.height, half.view.cx), (1, 1, 0.75));
        let bad = TrainingFrame { rgb: Colors::Bytes(vec![0; 17]), ..frame };
        let error = bad.check().unwrap_err().to_string();
        assert!(error.contains("\"a\"") && error.contains("18") && error.contains("17"), "{error}");
    }

    #[test]
    fn the_scale_of_cameras_is_about_their_mean() {
        let at = |x: f32| {
            let mut view = view(4, 4);
            view.world_to_camera[0][3] = -x;
            frame(view, None)
        };
        // 1 from their mean at 11.
        assert!((scale_of_cameras(&[at(10.0), at(12.0)]) - 1.1).abs() < 1e-6);
        assert_eq!(scale_of_cameras(&[at(10.0), at(10.0)]), 1.0);
        assert_eq!(scale_of_cameras(&[]), 1.0);
    }

    #[test]
    fn a_picture_is_put_over_a_background_once() {
        // Colors are multiplied by alpha already: 0.2 + (1 − 0.4) · 0.5.
        let mut frame = frame(view(1, 1), None);
        frame.rgb = Colors::Bytes(vec![51, 102, 0]);
        frame.alpha = Some(vec![102]);
        let mut out = Vec::new();
        frame.put_over([0.5, 1.0, 0.0], &mut out);
        assert!(out.iter().zip([0.5, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{out:?}");
        frame.put_over([0.0; 3], &mut out);
        assert!(out.iter().zip([0.2, 0.4, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{out:?}");
    }
}
