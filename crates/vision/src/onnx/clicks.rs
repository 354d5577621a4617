//! SAM 2 as two ONNX files: what looks at a picture, and what answers clicks.

use super::OnnxRuntime;
use super::model::{Array, Model, Port};
use crate::VisionError;
use crate::masks::ClickNetwork;
use crate::resize::{Filter, resize_planes, standardize};
use crate::sam2::{MASKS, MEAN, MaskPrediction, STD};
use scenesplat_scene::picture::RgbPicture;
use std::path::Path;

/// Side of the pictures where the file leaves it open.
const SIDE: usize = 1024;
/// Inputs of the decoder that are made here; every other one is an output of the encoder.
const POINTS: &str = "point_coords";
const LABELS: &str = "point_labels";
const MASK: &str = "mask_input";
const HAS_MASK: &str = "has_mask_input";
const IOU: &str = "iou_predictions";

/// A network that answers clicks, as `encoder.onnx` and `decoder.onnx` in a folder.
///
/// | file | inputs | outputs |
/// |---|---|---|
/// | `encoder.onnx` | one picture `[1, 3, side, side]`, squashed, standardised as SAM 2's | any, by name to the decoder |
/// | `decoder.onnx` | those, `point_coords` `[B, 1, 2]` in pixels of the square, `point_labels` `[B, 1]` (1), and perhaps `mask_input`, `has_mask_input` (all 0) | `low_res_masks` or `masks` `[B, 3 or 4, s, s]` logits, `iou_predictions` `[B, 3 or 4]` |
///
/// Of four masks the first is that for prompts without a choice; three are part, larger part and whole. The token that
/// stands for "no box" is the file's own matter.
pub struct OnnxClicks {
    encoder: Model,
    decoder: Model,
    /// Input of the encoder.
    picture: Port,
    side: usize,
    /// Names that go from the one to the other.
    between: Vec<String>,
    /// Name of the decoder's output.
    masks: &'static str,
    mask_side: usize,
    /// Clicks that the decoder takes at once; 0: any number.
    batch: usize,
}

/// What the encoder says of a picture.
pub struct OnnxSeen {
    arrays: Vec<Array>,
    /// Pixels of the square per pixel of the picture, across and down.
    scale: [f32; 2],
}

impl std::fmt::Debug for OnnxClicks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OnnxClicks").field("side", &self.side).finish_non_exhaustive()
    }
}

impl std::fmt::Debug for OnnxSeen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OnnxSeen").field("scale", &self.scale).finish_non_exhaustive()
    }
}

/// Names of the inputs of the decoder that the encoder gives.
fn between(encoder: &Model, decoder: &Model) -> Result<Vec<String>, VisionError> {
    let has = |name: &str| decoder.inputs.iter().any(|port| port.name == name);
    if let Some(missing) = [POINTS, LABELS].into_iter().find(|name| !has(name)) {
        return Err(decoder.bad(format!("has no input {missing:?}")));
    }
    let own = [POINTS, LABELS, MASK, HAS_MASK];
    let names = decoder.inputs.iter().map(|port| &port.name);
    let between: Vec<String> =
        names.filter(|name| !own.contains(&name.as_str())).cloned().collect();
    match between.iter().find(|name| !encoder.outputs.iter().any(|port| port.name == **name)) {
        Some(name) => {
            Err(decoder.bad(format!("its input {name:?} is no output of encoder.onnx, nor known")))
        }
        None => Ok(between),
    }
}

/// The name of the decoder's output, and the side of its masks; 0 where the file leaves it open.
fn masks(decoder: &Model) -> Result<(&'static str, usize), VisionError> {
    let output = |name: &str| decoder.outputs.iter().find(|port| port.name == name);
    let masks = ["low_res_masks", "masks"].into_iter().find(|name| output(name).is_some());
    let (Some(masks), Some(_)) = (masks, output(IOU)) else {
        return Err(decoder.bad("has to give masks (or low_res_masks) and iou_predictions"));
    };
    let shape = output(masks).map_or(&[][..], |port| &port.shape);
    match *shape {
        [_, -1 | 3 | 4, h, w] if h == w && (h == -1 || (4..=4096).contains(&h)) => {
            Ok((masks, h.max(0) as usize))
        }
        _ => {
            let expected = "[clicks, 3 or 4, side, side]";
            Err(decoder.bad(format!("its output {masks:?} is {shape:?}, expected {expected}")))
        }
    }
}

impl OnnxClicks {
    /// Reads `encoder.onnx` and `decoder.onnx`.
    ///
    /// # Errors
    /// If a file is missing, ONNX Runtime refuses it, or an input or output has another name, shape or type.
    pub fn open(runtime: &OnnxRuntime, folder: &Path) -> Result<Self, VisionError> {
        let encoder = Model::open(runtime, &folder.join("encoder.onnx"))?;
        let decoder = Model::open(runtime, &folder.join("decoder.onnx"))?;
        let [picture] = encoder.inputs.as_slice() else {
            return Err(
                encoder.bad(format!("has {} inputs, expected one picture", encoder.inputs.len()))
            );
        };
        let picture = picture.clone();
        let side = match encoder.picture_side(&picture)? {
            0 => SIDE,
            side => side,
        };
        let between = between(&encoder, &decoder)?;
        let (masks, mask_side) = masks(&decoder)?;
        let batch =
            decoder.inputs.iter().filter(|port| [POINTS, LABELS].contains(&port.name.as_str()));
        let batch =
            batch.filter_map(|port| usize::try_from(*port.shape.first()?).ok()).max().unwrap_or(0);
        let mut found = Self { encoder, decoder, picture, side, between, masks, mask_side, batch };
        if found.mask_side == 0 {
            // Sizes that the file leaves open show when it runs.
            let seen = found.see(&RgbPicture::filled(side as u32, side as u32, [127; 3]))?;
            let center = side as f32 / 2.0;
            let (masks, _) = found.answer(&seen, &[[center; 2]])?;
            found.mask_side = masks.shape[3] as usize;
        }
        Ok(found)
    }

    /// Masks and expected IoU of some clicks, in pixels of the square, no more than the file takes at once.
    fn answer(&self, seen: &OnnxSeen, points: &[[f32; 2]]) -> Result<(Array, Array), VisionError> {
        let count = points.len() as i64;
        let coords =
            Array { shape: vec![count, 1, 2], values: points.iter().flatten().copied().collect() };
        let labels = Array { shape: vec![count, 1], values: vec![1.0; points.len()] };
        // No mask is given: sizes that are open are those of the clicks, or of a mask that is a quarter of the square.
        let empty = |name: &str| -> Option<Array> {
            let port = self.decoder.inputs.iter().find(|port| port.name == name)?;
            let size = |(axis, &size): (usize, &i64)| match (size, axis) {
                (-1, 0) => count,
                (-1, 1) => 1,
                (-1, _) => self.side as i64 / 4,
                (size, _) => size,
            };
            let shape: Vec<i64> = port.shape.iter().enumerate().map(size).collect();
            let length = shape.iter().product::<i64>().clamp(0, 1 << 28) as usize;
            Some(Array { shape, values: vec![0.0; length] })
        };
        let (mask, has_mask) = (empty(MASK), empty(HAS_MASK));
        let mut inputs: Vec<(&str, &Array)> = vec![(POINTS, &coords), (LABELS, &labels)];
        inputs.extend(mask.as_ref().map(|array| (MASK, array)));
        inputs.extend(has_mask.as_ref().map(|array| (HAS_MASK, array)));
        inputs.extend(self.between.iter().map(String::as_str).zip(&seen.arrays));
        let mut found = self.decoder.run(&inputs, &[self.masks, IOU])?;
        let (iou, masks) = (found.pop(), found.pop());
        let (Some(masks), Some(iou)) = (masks, iou) else {
            return Err(self.decoder.bad("gave no masks"));
        };
        let fits = matches!(masks.shape[..], [n, k @ (3 | 4), h, w] if n == count && h == w
            && iou.shape == [n, k] && (self.mask_side == 0 || h == self.mask_side as i64));
        if !fits {
            let problem = format!(
                "gave {} {:?} and {IOU} {:?} for {count} clicks; expected [{count}, 3 or 4, side, side] and \
                 [{count}, 3 or 4]",
                self.masks, masks.shape, iou.shape
            );
            return Err(self.decoder.bad(problem));
        }
        Ok((masks, iou))
    }
}

impl ClickNetwork for OnnxClicks {
    type Seen = OnnxSeen;

    fn see(&self, picture: &RgbPicture) -> Result<OnnxSeen, VisionError> {
        let side = self.side as u32;
        let mut planes = resize_planes(picture, side, side, Filter::Bilinear)?;
        standardize(&mut planes, MEAN, STD);
        let input = Array { shape: vec![1, 3, self.side as i64, self.side as i64], values: planes };
        let wanted: Vec<&str> = self.between.iter().map(String::as_str).collect();
        let arrays = self.encoder.run(&[(&self.picture.name, &input)], &wanted)?;
        let scale = [picture.width(), picture.height()].map(|size| self.side as f32 / size as f32);
        Ok(OnnxSeen { arrays, scale })
    }

    fn mask_side(&self) -> usize {
        self.mask_side
    }

    fn click(
        &self,
        seen: &OnnxSeen,
        points: &[[f32; 2]],
    ) -> Result<Vec<MaskPrediction>, VisionError> {
        if let Some(point) = points.iter().find(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(VisionError::input("prompt", format!("has a point at {point:?}")));
        }
        let square: Vec<[f32; 2]> =
            points.iter().map(|p| [p[0] * seen.scale[0], p[1] * seen.scale[1]]).collect();
        let lot = if self.batch == 0 { square.len().max(1) } else { self.batch };
        let mut out = Vec::with_capacity(points.len());
        for points in square.chunks(lot) {
            // A file with a fixed number of clicks gets some twice.
            let mut filled = points.to_vec();
            filled.resize(if self.batch == 0 { points.len() } else { lot }, points[0]);
            let (masks, iou) = self.answer(seen, &filled)?;
            let (of_click, kinds) = (masks.values.len() / filled.len(), iou.shape[1] as usize);
            let area = of_click / kinds;
            for (logits, iou) in masks
                .values
                .chunks_exact(of_click)
                .zip(iou.values.chunks_exact(kinds))
                .take(points.len())
            {
                let mut own = [0.0; MASKS];
                own[MASKS - kinds..].copy_from_slice(iou);
                // The answer without a choice: of three the one that is expected to be best stands in.
                let mut all = Vec::with_capacity(MASKS * area);
                if kinds < MASKS {
                    let best =
                        (0..kinds).rev().max_by(|a, b| iou[*a].total_cmp(&iou[*b])).unwrap_or(0);
                    own[0] = iou[best];
                    all.extend_from_slice(&logits[best * area..(best + 1) * area]);
                }
                all.extend_from_slice(logits);
                out.push(MaskPrediction { logits: all, iou: own, object_score: 0.0 });
            }
        }
        Ok(out)
    }
}
