//! Depths in millimeters, in the pixels of their color camera.

use super::lens::{Lens, pixels};
use crate::DataError;
use crate::files::bad_file;
use crate::prepare::readers::hypersim::Array;
use scenesplat_scene::input_file::read_file;
use scenesplat_scene::picture::{Channels, MAX_PIXELS, Picture, Samples, is_one_shape, read_png};
use std::path::Path;

/// Steps of a written depth per meter: what `--depth-scale` is by default.
pub const STEPS_PER_METRE: f64 = 1000.0;

/// How far, in pixels of the depth, its own lens may be off the color's before it is resampled.
const MAX_SHIFT: f64 = 1.0;

/// Largest file of a depth that is read.
const MAX_FILE: u64 = 1 << 28;

/// The depth of a frame, as it is written.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameDepth {
    /// Gray, 16 bits: millimeters along the camera's axis, 0 = unknown.
    pub picture: Picture,
    /// Its own lens was not that of the colors: it was brought into their pixels.
    pub resampled: bool,
    /// Measured values that do not fit 16 bits and became unknown.
    pub too_far: usize,
}

/// Depths as a layout gives them.
#[derive(Debug)]
pub(super) struct DepthMap {
    pub(super) size: [u32; 2],
    /// Millimeters, 0 = unknown.
    pub(super) values: Vec<u16>,
    pub(super) too_far: usize,
}

impl DepthMap {
    /// Of numbers with so many steps per meter; 0 and 65535 are unknown.
    pub(super) fn of_steps(size: [u32; 2], mut values: Vec<u16>, steps: f64) -> Self {
        let mut too_far = 0;
        for value in &mut values {
            *value = match *value {
                u16::MAX => 0,
                value if steps == STEPS_PER_METRE => value,
                value => millimetres(f64::from(value) / steps, &mut too_far),
            };
        }
        Self { size, values, too_far }
    }

    /// Of meters; what is not finite and above 0 is unknown.
    pub(super) fn of_metres(size: [u32; 2], values: impl Iterator<Item = f64>) -> Self {
        let mut too_far = 0;
        let values = values.map(|value| millimetres(value, &mut too_far)).collect();
        Self { size, values, too_far }
    }

    /// Brings it into the pixels of a color camera, if it is not there already. `source` is for messages.
    pub(super) fn fit(
        self,
        color: Lens,
        own: Option<Lens>,
        source: &Path,
    ) -> Result<FrameDepth, DataError> {
        let picture_size = color.size.unwrap_or(self.size);
        let is_shaped = is_one_shape(self.size, picture_size);
        if let Some(size) = own.and_then(|own| own.size).filter(|size| *size != self.size) {
            let [[w, h], [own_w, own_h]] = [self.size, size];
            let problem =
                format!("its depth is {w} × {h}, its depth camera is for {own_w} × {own_h}");
            return Err(bad_file(source, problem, "are the depths those of this scan?"));
        }
        let Some(own) = own else {
            if is_shaped {
                return self.finish(false, source);
            }
            let [[w, h], [depth_w, depth_h]] = [picture_size, self.size];
            let problem = format!("is {w} × {h}, its depth {depth_w} × {depth_h}: another shape");
            return Err(bad_file(source, problem, "give depths that were made for the pictures"));
        };
        let here = color.resized(picture_size, self.size);
        let [w, h] = self.size.map(f64::from);
        // False for a lens that is not finite, too, which then gives no value at all.
        let fits = |corner: [f64; 2]| {
            let place = here.place_in(&own, corner);
            (0..2).all(|k| (place[k] - corner[k]).abs() <= MAX_SHIFT)
        };
        let fits = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]].into_iter().all(fits);
        if fits && is_shaped {
            return self.finish(false, source);
        }
        let to = if is_shaped { self.size } else { self.shaped_as(picture_size, color, own) };
        self.resampled(color.resized(picture_size, to), own, to).finish(true, source)
    }

    /// The size of a picture's shape at which a pixel is as fine as this map's finer side, at most the picture's own.
    fn shaped_as(&self, picture: [u32; 2], color: Lens, own: Lens) -> [u32; 2] {
        let ratio = (own.focal[0] / color.focal[0]).max(own.focal[1] / color.focal[1]);
        let ratio = if ratio.is_finite() { ratio.clamp(0.0, 1.0) } else { 1.0 };
        picture.map(|side| ((f64::from(side) * ratio).round() as u32).max(1))
    }

    /// What the pixels of another lens at the same place see, by nearest pixel.
    fn resampled(&self, to_lens: Lens, own: Lens, to: [u32; 2]) -> Self {
        let inside = |v: f64, side: u32| (v >= 0.0 && v < f64::from(side)).then_some(v as usize);
        let width = self.size[0] as usize;
        let mut values = Vec::with_capacity(to[0] as usize * to[1] as usize);
        for y in 0..to[1] {
            for x in 0..to[0] {
                let [u, v] = to_lens.place_in(&own, [f64::from(x) + 0.5, f64::from(y) + 0.5]);
                let at = inside(u, self.size[0]).zip(inside(v, self.size[1]));
                values.push(at.map_or(0, |(u, v)| self.values[v * width + u]));
            }
        }
        Self { size: to, values, too_far: self.too_far }
    }

    fn finish(self, resampled: bool, source: &Path) -> Result<FrameDepth, DataError> {
        let [width, height] = self.size;
        let samples = Samples::Sixteen(self.values);
        let picture = Picture::new(width, height, Channels::Gray, samples).ok_or_else(|| {
            let problem = format!("its depth has not {width} × {height} values");
            bad_file(source, problem, "fetch it again")
        })?;
        Ok(FrameDepth { picture, resampled, too_far: self.too_far })
    }
}

/// Meters as whole millimeters; 0 is unknown, and so is what is farther than 16 bits reach, which is counted.
fn millimetres(metres: f64, too_far: &mut usize) -> u16 {
    let steps = (metres * STEPS_PER_METRE).round();
    if !(steps.is_finite() && steps > 0.0) {
        return 0;
    }
    if steps >= f64::from(u16::MAX) {
        *too_far += 1;
        return 0;
    }
    steps as u16
}

/// Reads a gray PNG of 16 bits.
pub(super) fn read_png_depth(path: &Path, steps: f64) -> Result<DepthMap, DataError> {
    let picture = read_png(path)?;
    let size = [picture.width(), picture.height()];
    match (picture.channels(), picture.into_samples()) {
        (Channels::Gray, Samples::Sixteen(values)) => Ok(DepthMap::of_steps(size, values, steps)),
        (channels, _) => {
            let problem = format!("holds {channels:?} pixels, a depth is gray with 16 bits");
            Err(bad_file(path, problem, "give the depths as the benchmark ships them"))
        }
    }
}

/// Reads a binary PGM of 16 bits, whose numbers have their upper byte first.
pub(super) fn read_pgm_depth(path: &Path, steps: f64) -> Result<DepthMap, DataError> {
    let bytes = read_file(path, MAX_FILE)?;
    let bad = |problem: String| bad_file(path, problem, "the file is damaged: fetch it again");
    let Some(([width, height, largest], start)) = pgm_header(&bytes) else {
        return Err(bad("is no binary PGM (P5)".to_owned()));
    };
    if !(256..=65535).contains(&largest) {
        return Err(bad(format!("has values up to {largest}, a depth has 16 bits")));
    }
    let (pairs, rest) = bytes[start..].as_chunks::<2>();
    let count = pixels(width, height);
    if count == 0 || count > MAX_PIXELS || pairs.len() as u64 != count || !rest.is_empty() {
        let got = bytes.len() - start;
        return Err(bad(format!(
            "says it has {width} × {height} pixels and holds {got} bytes of them"
        )));
    }
    let values = pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect();
    Ok(DepthMap::of_steps([width, height], values, steps))
}

/// Width, height and largest value of a P5 file, and where its pixels begin.
fn pgm_header(bytes: &[u8]) -> Option<([u32; 3], usize)> {
    let mut at = bytes.starts_with(b"P5").then_some(2)?;
    let mut out = [0; 3];
    for number in &mut out {
        loop {
            match bytes.get(at)? {
                b'#' => at += bytes[at..].iter().position(|b| *b == b'\n')?,
                b if b.is_ascii_whitespace() => at += 1,
                _ => break,
            }
        }
        let digits = bytes[at..].iter().take_while(|b| b.is_ascii_digit()).count();
        *number = std::str::from_utf8(&bytes[at..at + digits]).ok()?.parse().ok()?;
        at += digits;
    }
    // One white space, then the pixels.
    bytes.get(at)?.is_ascii_whitespace().then_some((out, at + 1))
}

/// A depth along the axis from distances to the camera's center, meters.
pub(super) fn read_distance(path: &Path, lens: Lens) -> Result<DepthMap, DataError> {
    let array = Array::open(path)?;
    let size = match array.shape.as_slice() {
        &[height, width] => [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX)),
        _ => return Err(array.bad_shape("[height, width]")),
    };
    let lens = lens.resized(lens.size.unwrap_or(size), size);
    let width = size[0] as usize;
    let along = array.f32()?.into_iter().enumerate().map(move |(at, distance)| {
        let place = [(at % width) as f64 + 0.5, (at / width) as f64 + 0.5];
        let [x, y] = [0, 1].map(|k| (place[k] - lens.centre[k]) / lens.focal[k]);
        f64::from(distance) / (1.0 + x * x + y * y).sqrt()
    });
    Ok(DepthMap::of_metres(size, along))
}
