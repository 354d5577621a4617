//! A picture to draw on.

use super::{Channels, Picture, Samples};

/// Red, green and blue of 8 bits, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RgbPicture {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 3]>,
}

impl RgbPicture {
    /// A picture of one color.
    pub fn filled(width: u32, height: u32, color: [u8; 3]) -> Self {
        let pixels = vec![color; width as usize * height as usize];
        Self { width, height, pixels }
    }

    /// A picture whose pixels are a function of column and row.
    pub fn from_fn(width: u32, height: u32, color: impl Fn(u32, u32) -> [u8; 3]) -> Self {
        let color = &color;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| color(x, y))).collect();
        Self { width, height, pixels }
    }

    /// A picture of these pixels; `None` unless there are `width · height`.
    pub fn from_pixels(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Option<Self> {
        let fits = (width as usize).checked_mul(height as usize) == Some(pixels.len());
        fits.then_some(Self { width, height, pixels })
    }

    /// As [`from_pixels`](Self::from_pixels), where the number is known to be right.
    pub(super) fn of(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Self {
        debug_assert_eq!(pixels.len(), width as usize * height as usize);
        Self { width, height, pixels }
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[[u8; 3]] {
        &self.pixels
    }

    /// All pixels, to change them.
    pub(super) fn pixels_mut(&mut self) -> &mut [[u8; 3]] {
        &mut self.pixels
    }

    /// All pixels with column and row.
    pub fn enumerate(&self) -> impl Iterator<Item = (u32, u32, [u8; 3])> {
        let width = self.width as usize;
        let place = move |at: usize| ((at % width) as u32, (at / width) as u32);
        self.pixels.iter().enumerate().map(move |(at, color)| {
            let (x, y) = place(at);
            (x, y, *color)
        })
    }

    /// The color of a pixel, `None` outside.
    pub fn get(&self, x: u32, y: u32) -> Option<[u8; 3]> {
        self.index(x, y).map(|at| self.pixels[at])
    }

    /// Paints a pixel; outside nothing happens.
    pub fn set(&mut self, x: u32, y: u32, color: [u8; 3]) {
        if let Some(at) = self.index(x, y) {
            self.pixels[at] = color;
        }
    }

    fn index(&self, x: u32, y: u32) -> Option<usize> {
        let inside = x < self.width && y < self.height;
        inside.then(|| y as usize * self.width as usize + x as usize)
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// If it has no pixels.
    pub fn encode_png(&self) -> std::io::Result<Vec<u8>> {
        let samples = Samples::Eight(self.pixels.as_flattened().to_vec());
        let (width, height) = (self.width, self.height);
        Picture { width, height, channels: Channels::Rgb, samples }.encode_png()
    }
}
