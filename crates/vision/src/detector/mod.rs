//! Things in a picture, as boxes with the names of COCO's classes.
//!
//! [`Detector`] runs NanoDet from a graph of TensorFlow.js in files that the user fetches; nothing but the layers of such a
//! graph is known here, so any network of the same layers and outputs can be read.
//!
//! # Source
//! NanoDet (github.com/RangiLyu/nanodet, Apache 2.0): boxes as distributions over distances (generalized focal loss).

mod attributes;
mod classes;
mod decode;
mod graph;
mod operations;
#[cfg(test)]
mod tests;

pub use classes::COCO;
pub use decode::{Detection, DetectorSettings};

use crate::VisionError;
use crate::resize::{Filter, resize_planes};
use decode::{Head, decode, keep_best};
use graph::{Graph, HELP};
use operations::Tensor;
use scenesplat_scene::picture::RgbPicture;
use std::path::{Path, PathBuf};

/// Pixels on a side of what the network sees.
const SIDE: usize = 416;
/// Means and deviations of blue, green and red, 0 to 255.
const MEAN: [f32; 3] = [103.53, 116.28, 123.675];
const DEVIATION: [f32; 3] = [57.375, 57.12, 58.395];

/// A network that finds things.
pub struct Detector {
    graph: Graph,
    heads: Vec<Head>,
    settings: DetectorSettings,
    path: PathBuf,
}

impl std::fmt::Debug for Detector {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (path, settings) = (&self.path, &self.settings);
        f.debug_struct("Detector")
            .field("path", path)
            .field("settings", settings)
            .finish_non_exhaustive()
    }
}

impl Detector {
    /// Reads a graph, such as `nanodet.json`, and the weights beside it, and runs it once.
    ///
    /// # Errors
    /// If a file cannot be read or is no such graph, a layer is of a kind that is not known, shapes do not fit, or the
    /// outputs are not NanoDet's for the classes of COCO; the message names file and node. If a setting is out of range.
    pub fn open(path: &Path, settings: DetectorSettings) -> Result<Self, VisionError> {
        settings.check()?;
        let graph = Graph::open(path)?;
        let mut detector = Self { graph, heads: Vec::new(), settings, path: path.to_owned() };
        let gray = Tensor::floats(vec![1, 3, SIDE, SIDE], vec![0.0; 3 * SIDE * SIDE]);
        let outputs = detector.graph.run(gray).map_err(|problem| detector.bad(problem))?;
        let shapes: Vec<(&str, &[usize])> =
            outputs.iter().map(|(name, t)| (*name, &*t.shape)).collect();
        detector.heads = decode::heads(&shapes, SIDE).map_err(|problem| detector.bad(problem))?;
        Ok(detector)
    }

    fn bad(&self, problem: String) -> VisionError {
        VisionError::Model { path: self.path.clone(), problem, help: HELP }
    }

    /// What counts as found.
    pub fn settings(&self) -> DetectorSettings {
        self.settings
    }

    /// The files that it was read from, the graph first.
    pub fn files(&self) -> &[PathBuf] {
        &self.graph.files
    }

    /// Bytes of its weights as they are computed with.
    pub fn bytes(&self) -> usize {
        self.graph.bytes
    }

    /// The things in a picture, best score first. Boxes are in pixels of the picture and inside it.
    ///
    /// The picture is squeezed to a square. With [`DetectorSettings::tiles`] parts of it are looked at as well, where small
    /// things are larger. A picture's results depend on nothing else, nor on threads.
    ///
    /// # Errors
    /// If the picture has no pixels, or the network's values are not finite.
    pub fn detect(&self, picture: &RgbPicture) -> Result<Vec<Detection>, VisionError> {
        let (width, height) = (picture.width(), picture.height());
        let mut found = self.look(picture, [0, 0, width, height])?;
        for tile in tiles(width, height, self.settings.tiles) {
            let part = crop(picture, tile);
            // What a tile cuts off is not the thing.
            found.extend(
                self.look(&part, tile)?
                    .into_iter()
                    .filter(|d| !is_cut(d.area, tile, [width, height])),
            );
        }
        Ok(keep_best(found, &self.settings))
    }

    /// The things in a part of a picture, in pixels of the whole.
    fn look(&self, part: &RgbPicture, tile: [u32; 4]) -> Result<Vec<Detection>, VisionError> {
        let side = SIDE as u32;
        let planes = resize_planes(part, side, side, Filter::Bilinear)?;
        let plane = |channel: usize| &planes[channel * SIDE * SIDE..][..SIDE * SIDE];
        let mut input = Vec::with_capacity(planes.len());
        for (k, plane) in [plane(2), plane(1), plane(0)].into_iter().enumerate() {
            input.extend(plane.iter().map(|v| (v * 255.0 - MEAN[k]) / DEVIATION[k]));
        }
        let outputs = self.graph.run(Tensor::floats(vec![1, 3, SIDE, SIDE], input));
        let outputs = outputs.map_err(|problem| self.bad(problem))?;
        let mut found = Vec::new();
        for head in &self.heads {
            let values = |at: usize| outputs[at].1.as_floats().map_err(|problem| self.bad(problem));
            let (scores, distances) = (values(head.scores)?, values(head.distances)?);
            if !scores.iter().chain(distances).all(|v| v.is_finite()) {
                return Err(self.bad("its outputs are not finite".to_owned()));
            }
            found.extend(decode(head, scores, distances, &self.settings));
        }
        let [left, top, width, height] = tile;
        let scale = [width, height].map(|pixels| pixels as f32 / SIDE as f32);
        for thing in &mut found {
            let [x, y] = [left as f32, top as f32];
            let fit = |v: f32, k: usize, pixels: u32| (v * scale[k]).clamp(0.0, pixels as f32);
            let [x0, y0, x1, y1] = thing.area;
            thing.area = [
                fit(x0, 0, width) + x,
                fit(y0, 1, height) + y,
                fit(x1, 0, width) + x,
                fit(y1, 1, height) + y,
            ];
        }
        Ok(found)
    }
}

/// Parts of a picture (left, top, width, height): `count` on a side, each as wide as leaves half of it shared with its
/// neighbor. Pictures that are not larger than what the network sees have none.
fn tiles(width: u32, height: u32, count: u32) -> Vec<[u32; 4]> {
    if count < 2 || (width as usize) <= SIDE && (height as usize) <= SIDE {
        return Vec::new();
    }
    let along = |length: u32| {
        let size = (2 * length).div_ceil(count + 1).max(1);
        let first = move |i: u32| u64::from(i) * u64::from(length - size) / u64::from(count - 1);
        (0..count).map(move |i| (first(i) as u32, size))
    };
    let row =
        |(top, tall): (u32, u32)| along(width).map(move |(left, wide)| [left, top, wide, tall]);
    along(height).flat_map(row).collect()
}

fn crop(picture: &RgbPicture, [left, top, width, height]: [u32; 4]) -> RgbPicture {
    RgbPicture::from_fn(width, height, |x, y| picture.get(left + x, top + y).unwrap_or_default())
}

/// Whether a box ends at a side of the tile that is none of the picture's.
fn is_cut(area: [f32; 4], [left, top, width, height]: [u32; 4], picture: [u32; 2]) -> bool {
    // Part of the tile's side that still counts as its end.
    const NEAR: f32 = 0.02;
    let near =
        |place: f32, end: u32, length: u32| (place - end as f32).abs() <= NEAR * length as f32;
    left > 0 && near(area[0], left, width)
        || top > 0 && near(area[1], top, height)
        || left + width < picture[0] && near(area[2], left + width, width)
        || top + height < picture[1] && near(area[3], top + height, height)
}
