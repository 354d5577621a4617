//! Colors of materials, and of places on their textures.

use crate::vector::V3;
use scenesplat_scene::picture::{Channels, Picture, Samples};

/// A picture that covers the plane by repetition.
#[derive(Debug)]
pub(super) struct Texture {
    width: usize,
    height: usize,
    /// Red, green, blue, opacity.
    pixels: Vec<[u8; 4]>,
    /// Whether some of it is transparent.
    pub(super) has_holes: bool,
}

impl Texture {
    /// Of a picture; its own opacity, or that of another picture of any size. `None` without pixels.
    pub(super) fn new(picture: &Picture, opacity: Option<&Picture>) -> Option<Self> {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if width == 0 || height == 0 {
            return None;
        }
        let rgb = picture.to_rgb8();
        let own = match picture.channels() {
            Channels::GrayAlpha | Channels::Rgba => Some(last_channel(picture)),
            Channels::Gray | Channels::Rgb => None,
        };
        let mut pixels: Vec<[u8; 4]> =
            rgb.pixels().iter().map(|&[r, g, b]| [r, g, b, 255]).collect();
        if let Some(own) = own {
            pixels.iter_mut().zip(own).for_each(|(pixel, opacity)| pixel[3] = opacity);
        } else if let Some(map) = opacity.filter(|map| map.width() > 0 && map.height() > 0) {
            let (w, h) = (map.width() as usize, map.height() as usize);
            let values = last_channel(map);
            for (index, pixel) in pixels.iter_mut().enumerate() {
                let (x, y) = (index % width, index / width);
                pixel[3] = values[y * h / height * w + x * w / width];
            }
        }
        let has_holes = pixels.iter().any(|pixel| pixel[3] < 128);
        Some(Self { width, height, pixels, has_holes })
    }

    /// Color, 0..=255, between the four pixels around a place (the lower left corner of the picture is
    /// 0 0, the upper right one 1 1); `None` where the nearest of them is transparent.
    pub(super) fn at(&self, [u, v]: [f64; 2]) -> Option<V3> {
        let (x, y) = (u * self.width as f64 - 0.5, (1.0 - v) * self.height as f64 - 0.5);
        if !(x.is_finite() && y.is_finite()) {
            return None;
        }
        let wrap = |v: f64, n: usize| v.rem_euclid(n as f64) as usize % n;
        let pixel =
            |x: f64, y: f64| self.pixels[wrap(y, self.height) * self.width + wrap(x, self.width)];
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        if pixel((x + 0.5).floor(), (y + 0.5).floor())[3] < 128 {
            return None;
        }
        let mut color = [0.0; 3];
        for (dx, dy, weight) in [
            (0.0, 0.0, (1.0 - fx) * (1.0 - fy)),
            (1.0, 0.0, fx * (1.0 - fy)),
            (0.0, 1.0, (1.0 - fx) * fy),
            (1.0, 1.0, fx * fy),
        ] {
            let pixel = pixel(left + dx, top + dy);
            (0..3).for_each(|c| color[c] += weight * f64::from(pixel[c]));
        }
        Some(color)
    }
}

/// Opacity, or brightness of a picture without it.
fn last_channel(picture: &Picture) -> Vec<u8> {
    let n = picture.channels().count();
    match picture.samples() {
        Samples::Eight(samples) => samples.chunks_exact(n).map(|p| p[n - 1]).collect(),
        Samples::Sixteen(samples) => {
            samples.chunks_exact(n).map(|p| (p[n - 1] >> 8) as u8).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_between_pixels_and_beyond_the_border() {
        let samples = Samples::Eight(vec![200, 0, 0, 0, 100, 0, 0, 0, 80, 40, 40, 40]);
        let picture = Picture::new(2, 2, Channels::Rgb, samples).unwrap();
        let texture = Texture::new(&picture, None).unwrap();
        // Upper left, upper right, lower left pixels, and the middle of all four.
        assert_eq!(texture.at([0.25, 0.75]), Some([200.0, 0.0, 0.0]));
        assert_eq!(texture.at([0.75, 0.75]), Some([0.0, 100.0, 0.0]));
        assert_eq!(texture.at([0.25, 0.25]), Some([0.0, 0.0, 80.0]));
        assert_eq!(texture.at([0.5, 0.5]), Some([60.0, 35.0, 30.0]));
        assert_eq!(texture.at([-3.75, 5.75]), Some([200.0, 0.0, 0.0]));
        assert_eq!(texture.at([f64::NAN, 0.0]), None);
        assert!(!texture.has_holes);
    }

    #[test]
    fn transparent_places_have_no_colour() {
        let samples = Samples::Eight(vec![9, 9, 9, 255, 9, 9, 9, 0]);
        let picture = Picture::new(2, 1, Channels::Rgba, samples).unwrap();
        let texture = Texture::new(&picture, None).unwrap();
        assert!(texture.has_holes && texture.at([0.2, 0.5]).is_some());
        assert_eq!(texture.at([0.8, 0.5]), None);
        let grey = Picture::new(1, 2, Channels::Gray, Samples::Eight(vec![0, 255])).unwrap();
        let plain = Picture::new(1, 1, Channels::Gray, Samples::Eight(vec![50])).unwrap();
        let texture = Texture::new(&plain, Some(&grey)).unwrap();
        assert!(texture.has_holes, "the map is larger than the picture");
    }
}
