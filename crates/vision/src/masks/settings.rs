//! What the automatic mask generator is asked for.

use crate::VisionError;
use serde::{Deserialize, Serialize};

/// Which of a point's three masks are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Part, larger part and whole.
    All,
    /// The whole alone: objects.
    Whole,
}

/// Settings of [`AutomaticMasks`](super::AutomaticMasks).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaskSettings {
    /// Points on each side of the grid over the picture.
    pub points_per_side: usize,
    /// Points that are answered at once; changes memory, not results.
    pub points_per_batch: usize,
    /// Masks with a predicted IoU above this are kept.
    pub pred_iou: f32,
    /// Masks at least this stable are kept: pixels above `stability_offset` over those above its opposite.
    pub stability: f32,
    /// Where stability cuts, logits.
    pub stability_offset: f32,
    /// Boxes of one crop that overlap more than this are one object (IoU).
    pub box_nms: f32,
    /// Layers of crops besides the picture: layer i cuts it into 2ⁱ × 2ⁱ.
    pub crop_layers: usize,
    /// Boxes of different crops that overlap more than this are one object (IoU).
    pub crop_nms: f32,
    /// How far the crops of the first layer overlap, of the picture's shorter side.
    pub crop_overlap: f64,
    /// The grid of each further layer has this many times fewer points on a side.
    pub point_downscale: usize,
    /// Holes and sprinkles of at most so many pixels of the network's masks are filled and removed; 0 leaves them.
    pub min_region: usize,
    /// Which masks of a point.
    pub level: Level,
}

impl Default for MaskSettings {
    fn default() -> Self {
        Self::original()
    }
}

impl MaskSettings {
    /// The defaults of SAM 2's own generator.
    pub fn original() -> Self {
        Self {
            points_per_side: 32,
            points_per_batch: 64,
            pred_iou: 0.8,
            stability: 0.95,
            stability_offset: 1.0,
            box_nms: 0.7,
            crop_layers: 0,
            crop_nms: 0.7,
            crop_overlap: 512.0 / 1500.0,
            point_downscale: 1,
            min_region: 0,
            level: Level::All,
        }
    }

    /// Those of SceneSplat's labels (from the authors' later public code): objects, with a layer of crops.
    pub fn scenesplat() -> Self {
        Self {
            pred_iou: 0.7,
            stability: 0.85,
            crop_layers: 1,
            min_region: 100,
            level: Level::Whole,
            ..Self::original()
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// If one is out of its range; the message names it.
    pub fn check(&self) -> Result<(), VisionError> {
        let shares = [
            ("pred_iou", f64::from(self.pred_iou)),
            ("stability", f64::from(self.stability)),
            ("box_nms", f64::from(self.box_nms)),
            ("crop_nms", f64::from(self.crop_nms)),
            ("crop_overlap", self.crop_overlap),
        ];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(VisionError::config(field, value, "0 to 1 is possible"));
            }
        }
        if !(self.stability_offset >= 0.0 && self.stability_offset.is_finite()) {
            let help = "a number from 0 on";
            return Err(VisionError::config("stability_offset", self.stability_offset, help));
        }
        for (field, value, most) in [
            ("points_per_side", self.points_per_side, 1024),
            ("points_per_batch", self.points_per_batch, 1 << 16),
            ("point_downscale", self.point_downscale, 1024),
        ] {
            if value == 0 || value > most {
                return Err(VisionError::config(field, value, "1 to 1024 is possible"));
            }
        }
        if self.crop_layers > 4 {
            return Err(VisionError::config("crop_layers", self.crop_layers, "at most 4"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limits_are_those_of_the_authors() {
        let (own, labels) = (MaskSettings::original(), MaskSettings::scenesplat());
        assert_eq!((own.pred_iou, own.stability, own.min_region), (0.8, 0.95, 0));
        assert_eq!((labels.pred_iou, labels.stability, labels.min_region), (0.7, 0.85, 100));
        assert_eq!((own.crop_layers, labels.crop_layers), (0, 1));
    }

    #[test]
    fn every_number_is_that_of_the_authors_generator() {
        // SAM2AutomaticMaskGenerator's own arguments; SceneSplat's are those of the authors' later public code.
        let own = MaskSettings {
            points_per_side: 32,
            points_per_batch: 64,
            pred_iou: 0.8,
            stability: 0.95,
            stability_offset: 1.0,
            box_nms: 0.7,
            crop_layers: 0,
            crop_nms: 0.7,
            crop_overlap: 512.0 / 1500.0,
            point_downscale: 1,
            min_region: 0,
            level: Level::All,
        };
        assert_eq!(MaskSettings::original(), own);
        assert_eq!(MaskSettings::default(), own);
        let labels = MaskSettings {
            pred_iou: 0.7,
            stability: 0.85,
            crop_layers: 1,
            min_region: 100,
            level: Level::Whole,
            ..own
        };
        assert_eq!(MaskSettings::scenesplat(), labels);
        // A file may leave out what is the default.
        let read: MaskSettings = serde_json::from_str(r#"{"level": "whole"}"#).unwrap();
        assert_eq!(read, MaskSettings { level: Level::Whole, ..own });
        assert!(serde_json::from_str::<MaskSettings>(r#"{"levels": 3}"#).is_err());
    }

    #[test]
    fn settings_are_possible_up_to_their_limits() {
        type Change = fn(&mut MaskSettings);
        let all: [(Change, &str); 24] = [
            (|s| (s.pred_iou, s.stability, s.box_nms) = (0.0, 0.0, 0.0), ""),
            (|s| (s.pred_iou, s.stability, s.box_nms) = (1.0, 1.0, 1.0), ""),
            (|s| (s.crop_nms, s.crop_overlap, s.stability_offset) = (1.0, 1.0, 0.0), ""),
            (|s| (s.points_per_side, s.point_downscale) = (1024, 1024), ""),
            (|s| (s.points_per_batch, s.crop_layers) = (1 << 16, 4), ""),
            (|s| s.pred_iou = 1.1, "pred_iou is 1.1"),
            (|s| s.pred_iou = -0.5, "pred_iou is -0.5: 0 to 1"),
            (|s| s.stability = 1.5, "stability is 1.5"),
            (|s| s.stability = f32::NAN, "stability is NaN"),
            (|s| s.box_nms = -1.0, "box_nms is -1"),
            (|s| s.crop_nms = 1.5, "crop_nms is 1.5"),
            (|s| s.crop_nms = f32::NAN, "crop_nms is NaN"),
            (|s| s.crop_overlap = 1.01, "crop_overlap is 1.01"),
            (|s| s.crop_overlap = -0.01, "crop_overlap is -0.01"),
            (|s| s.stability_offset = -0.5, "stability_offset is -0.5: a number from 0 on"),
            (|s| s.stability_offset = f32::INFINITY, "stability_offset is inf"),
            (|s| s.stability_offset = f32::NAN, "stability_offset is NaN"),
            (|s| s.points_per_side = 1025, "points_per_side is 1025: 1 to"),
            (|s| s.points_per_batch = 0, "points_per_batch is 0"),
            (|s| s.points_per_batch = (1 << 16) + 1, "points_per_batch is 65537"),
            (|s| s.point_downscale = 0, "point_downscale is 0"),
            (|s| s.point_downscale = 1025, "point_downscale is 1025"),
            (|s| s.crop_layers = 5, "crop_layers is 5: at most 4"),
            (|s| s.min_region = usize::MAX, ""),
        ];
        for (change, message) in all {
            let mut settings = MaskSettings::original();
            change(&mut settings);
            let found = settings.check().map_or_else(|error| error.to_string(), |()| String::new());
            assert!(found.contains(message) && found.is_empty() == message.is_empty(), "{found}");
        }
    }
}
