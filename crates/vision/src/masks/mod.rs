//! Masks of everything in a picture, without prompts: SAM 2's automatic mask generator.

mod crops;
mod mask;
mod nms;
mod paint;
mod regions;
mod settings;
#[cfg(test)]
mod tests;
pub(crate) mod upscale;

pub use mask::Mask;
pub use nms::{MaskNms, keep_masks};
pub use paint::{IdMap, paint, paint_objects};
pub use settings::{Level, MaskSettings};

use crate::VisionError;
use crate::sam2::{MASKS, MaskPrediction, PromptPoint, Sam2, Sam2Picture};
use crops::Crop;
use nms::keep_boxes;
use rayon::prelude::*;
use scenesplat_scene::picture::RgbPicture;
use upscale::{Place, upscale};

/// A network that answers clicks.
pub trait ClickNetwork: Sync {
    /// What it knows of one picture.
    type Seen: Sync;

    /// Looks at a picture.
    ///
    /// # Errors
    /// If it cannot.
    fn see(&self, picture: &RgbPicture) -> Result<Self::Seen, VisionError>;

    /// Side of a mask's logits.
    fn mask_side(&self) -> usize;

    /// The masks at points of the picture, column and row in pixels, one click each.
    ///
    /// # Errors
    /// If a point is not finite.
    fn click(
        &self,
        seen: &Self::Seen,
        points: &[[f32; 2]],
    ) -> Result<Vec<MaskPrediction>, VisionError>;
}

impl ClickNetwork for Sam2 {
    type Seen = Sam2Picture;

    fn see(&self, picture: &RgbPicture) -> Result<Sam2Picture, VisionError> {
        self.encode(picture)
    }

    fn mask_side(&self) -> usize {
        Sam2::mask_side(self)
    }

    fn click(
        &self,
        seen: &Sam2Picture,
        points: &[[f32; 2]],
    ) -> Result<Vec<MaskPrediction>, VisionError> {
        let prompts: Vec<_> = points.iter().map(|at| vec![PromptPoint::inside(*at)]).collect();
        self.predict(seen, &prompts)
    }
}

/// A mask that the generator found.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskProposal {
    /// Its pixels.
    pub mask: Mask,
    /// The IoU that the network expects it to have, 0 to 1.
    pub predicted_iou: f32,
    /// Pixels above the upper cut over those above the lower one, 0 to 1.
    pub stability: f32,
    /// The click, column and row in the picture.
    pub point: [f32; 2],
    /// The crop that was looked at: left, top, right, bottom, the last two beyond it.
    pub crop: [u32; 4],
}

/// How many masks each step left, for one picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MaskCounts {
    /// Answers of the network.
    pub answered: usize,
    /// With a sufficient predicted IoU.
    pub expected: usize,
    /// Stable ones.
    pub stable: usize,
    /// Not cut off by the edge of a crop.
    pub whole: usize,
    /// Not twice within a crop.
    pub single: usize,
    /// Not twice among the crops.
    pub kept: usize,
}

/// Pixels to the edge of a crop at which a box counts as cut off.
const EDGE: u32 = 20;

/// Finds masks of everything in a picture by clicking on a grid of points.
///
/// Each answer passes in this order: predicted IoU, small regions (on the network's logits), stability at full
/// resolution, cut at 0, boxes near an edge of a crop that is none of the picture, NMS of boxes within the crop by
/// predicted IoU, and NMS among crops that prefers small crops.
///
/// # Source
/// `SAM2AutomaticMaskGenerator` of SAM 2 (2b90b9f), without mask-to-mask refinement. Differs: an empty mask has no box and
/// is dropped; small regions are cleaned only of masks that pass the predicted IoU, which changes nothing.
#[derive(Debug)]
pub struct AutomaticMasks<'a, N: ClickNetwork = Sam2> {
    network: &'a N,
    settings: MaskSettings,
}

/// Of masks of the same thing the one of the smallest crop, which shows it largest, is the best.
fn closeness([left, top, right, bottom]: [u32; 4]) -> f64 {
    1.0 / (f64::from(right - left) * f64::from(bottom - top))
}

impl<'a, N: ClickNetwork> AutomaticMasks<'a, N> {
    /// A generator with these settings.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(network: &'a N, settings: MaskSettings) -> Result<Self, VisionError> {
        settings.check()?;
        Ok(Self { network, settings })
    }

    /// The masks of a picture, in the generator's order: masks of the smallest crops first, within a crop the surest
    /// first.
    ///
    /// # Errors
    /// If the picture has no pixels.
    pub fn generate(&self, picture: &RgbPicture) -> Result<Vec<MaskProposal>, VisionError> {
        Ok(self.generate_counted(picture)?.0)
    }

    /// [`generate`](Self::generate), and how many masks each step left.
    ///
    /// # Errors
    /// As [`generate`](Self::generate).
    pub fn generate_counted(
        &self,
        picture: &RgbPicture,
    ) -> Result<(Vec<MaskProposal>, MaskCounts), VisionError> {
        let (width, height) = (picture.width(), picture.height());
        if width == 0 || height == 0 {
            return Err(VisionError::input("picture", format!("{width} × {height} pixels")));
        }
        let mut counts = MaskCounts::default();
        let mut all = Vec::new();
        for crop in crops::crops(width, height, &self.settings) {
            all.extend(self.of_crop(picture, crop, &mut counts)?);
        }
        if self.settings.crop_layers > 0 {
            let scores: Vec<f64> = all.iter().map(|p| closeness(p.crop)).collect();
            all = best(all, &scores, f64::from(self.settings.crop_nms));
        }
        counts.kept = all.len();
        Ok((all, counts))
    }

    fn of_crop(
        &self,
        picture: &RgbPicture,
        crop: Crop,
        counts: &mut MaskCounts,
    ) -> Result<Vec<MaskProposal>, VisionError> {
        let [left, top, right, bottom] = crop.bounds;
        let (width, height) = (right - left, bottom - top);
        let seen = self.network.see(&cut(picture, crop.bounds))?;
        let points = crops::points(crop.layer, width, height, &self.settings);
        let place =
            Place { picture: [picture.width(), picture.height()], left, top, width, height };
        let mut found: Vec<MaskProposal> = Vec::new();
        for points in points.chunks(self.settings.points_per_batch) {
            let answers = self.network.click(&seen, points)?;
            let each: Vec<_> = answers
                .into_par_iter()
                .zip(points)
                .map(|(answer, point)| self.of_answer(&answer, *point, place))
                .collect();
            for (proposals, of_point) in each {
                counts.add(of_point);
                found.extend(proposals);
            }
        }
        let scores: Vec<f64> = found.iter().map(|p| f64::from(p.predicted_iou)).collect();
        let single = best(found, &scores, f64::from(self.settings.box_nms));
        counts.single += single.len();
        Ok(single)
    }

    /// The masks of one click that pass.
    fn of_answer(
        &self,
        answer: &MaskPrediction,
        point: [f32; 2],
        place: Place,
    ) -> (Vec<MaskProposal>, MaskCounts) {
        let side = self.network.mask_side();
        let mut counts = MaskCounts::default();
        let mut found = Vec::new();
        let levels = match self.settings.level {
            // The first is the answer for prompts that leave no choice; a click does.
            Level::All => 1..MASKS,
            Level::Whole => MASKS - 1..MASKS,
        };
        for level in levels {
            counts.answered += 1;
            let predicted_iou = answer.iou[level];
            // Not above: a NaN goes too.
            if predicted_iou.is_nan() || predicted_iou <= self.settings.pred_iou {
                continue;
            }
            counts.expected += 1;
            let mut logits = answer.logits[level * side * side..(level + 1) * side * side].to_vec();
            regions::clean(&mut logits, side, self.settings.min_region);
            let up = upscale(&logits, side, place, self.settings.stability_offset);
            if up.stability.is_nan() || up.stability < self.settings.stability {
                continue;
            }
            let Some(bounds) = up.mask.bounds() else { continue };
            counts.stable += 1;
            if is_cut_off(bounds, place) {
                continue;
            }
            counts.whole += 1;
            found.push(MaskProposal {
                mask: up.mask,
                predicted_iou,
                stability: up.stability,
                point: [point[0] + place.left as f32, point[1] + place.top as f32],
                crop: [place.left, place.top, place.left + place.width, place.top + place.height],
            });
        }
        (found, counts)
    }
}

impl MaskCounts {
    fn add(&mut self, other: Self) {
        self.answered += other.answered;
        self.expected += other.expected;
        self.stable += other.stable;
        self.whole += other.whole;
    }
}

/// Whether a side of the box is near that side of the crop and not near that of the picture.
fn is_cut_off(bounds: [u32; 4], place: Place) -> bool {
    let Place { picture, left, top, width, height } = place;
    let crop = [left, top, left + width, top + height];
    let whole = [0, 0, picture[0], picture[1]];
    (0..4).any(|i| bounds[i].abs_diff(crop[i]) <= EDGE && bounds[i].abs_diff(whole[i]) > EDGE)
}

/// What stays after NMS of the boxes, best first.
fn best(proposals: Vec<MaskProposal>, scores: &[f64], most: f64) -> Vec<MaskProposal> {
    // A proposal has pixels.
    let boxes: Vec<[u32; 4]> =
        proposals.iter().map(|p| p.mask.bounds().unwrap_or_default()).collect();
    let mut places: Vec<Option<MaskProposal>> = proposals.into_iter().map(Some).collect();
    keep_boxes(&boxes, scores, most).into_iter().filter_map(|i| places[i].take()).collect()
}

/// A part of the picture.
fn cut(picture: &RgbPicture, [left, top, right, bottom]: [u32; 4]) -> RgbPicture {
    RgbPicture::from_fn(right - left, bottom - top, |x, y| {
        picture.get(left + x, top + y).unwrap_or_default()
    })
}
