//! Steps by name.

use super::{
    CaptureEffects, CenterShift, ChromaticAutoContrast, ChromaticJitter, ChromaticTranslation,
    ColorJitter, ColorSolarize, ElasticDistortion, GridSample, LimitValues, MeasuredEffects,
    RandomDropout, RandomFlip, RandomGrayscale, RandomJitter, RandomRotate,
    RandomRotateTargetAngle, RandomScale, RatioCrop, SphereCrop, Views, VoxelBlur,
};
use crate::{DataError, Transform};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

macro_rules! transform_config {
    ($($name:ident: $about:literal;)*) => {
        /// A step as configuration files give it: `type` is its name in small letters
        /// (`type = "random_rotate"`), the other entries are the fields of its struct.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "type", rename_all = "snake_case")]
        pub enum TransformConfig {
            $(#[doc = $about] $name($name),)*
        }

        impl TransformConfig {
            /// The step, checked.
            ///
            /// # Errors
            /// Names the first parameter that is out of range.
            pub fn build(&self) -> Result<Arc<dyn Transform>, DataError> {
                match self {
                    $(Self::$name(step) => {
                        step.check()?;
                        Ok(Arc::new(step.clone()))
                    })*
                }
            }
        }

        $(impl From<$name> for TransformConfig {
            fn from(step: $name) -> Self {
                Self::$name(step)
            }
        })*
    };
}

transform_config! {
    LimitValues: "Shrinks and limits values.";
    CenterShift: "Moves the scene to the origin.";
    CaptureEffects: "Damages the scene as a bad capture would have.";
    MeasuredEffects: "Damages the scene as the captures of the training scenes were.";
    RandomDropout: "Leaves out some Gaussians.";
    RandomRotate: "Turns by a uniform angle.";
    RandomRotateTargetAngle: "Turns by one of several angles.";
    RandomScale: "Grows or shrinks.";
    RandomFlip: "Mirrors.";
    RandomJitter: "Moves each Gaussian a little.";
    ElasticDistortion: "Bends.";
    ChromaticAutoContrast: "Stretches colours.";
    ChromaticTranslation: "Shifts colours.";
    ChromaticJitter: "Changes each colour a little.";
    ColorJitter: "Changes brightness, contrast, saturation and hue.";
    RandomGrayscale: "Takes colors away.";
    ColorSolarize: "Turns bright colors into their negative.";
    VoxelBlur: "Blurs over voxels.";
    GridSample: "Keeps one Gaussian of a cell.";
    SphereCrop: "Keeps the Gaussians near a centre.";
    RatioCrop: "Keeps a share of the Gaussians, near a random one.";
    Views: "Makes several views of the scene, as the last step.";
}

/// The steps, checked, in order.
///
/// # Errors
/// Names the first parameter that is out of range.
pub fn build_transforms(steps: &[TransformConfig]) -> Result<Vec<Arc<dyn Transform>>, DataError> {
    steps.iter().map(TransformConfig::build).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::{language_pretraining, semantic_segmentation, validation};

    #[test]
    fn steps_survive_a_file() {
        for steps in [language_pretraining(0.02), semantic_segmentation(0.02), validation(0.02)] {
            let text = serde_json::to_string(&steps).unwrap();
            assert_eq!(serde_json::from_str::<Vec<TransformConfig>>(&text).unwrap(), steps);
            assert_eq!(build_transforms(&steps).unwrap().len(), steps.len());
        }
    }

    #[test]
    fn names_and_defaults() {
        let read = |text: &str| serde_json::from_str::<TransformConfig>(text);
        let crop = read(r#"{"type": "sphere_crop", "point_max": 5}"#).unwrap();
        let expected = SphereCrop { point_max: 5, ..SphereCrop::default() };
        assert_eq!(crop, TransformConfig::SphereCrop(expected));
        for wrong in [
            r#"{"type": "sphere_crop", "pointmax": 5}"#,
            r#"{"type": "sphere"}"#,
            r#"{"point_max": 5}"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        let bad = read(r#"{"type": "grid_sample", "grid_size": -1.0}"#).unwrap();
        let error = bad.build().unwrap_err().to_string();
        assert!(error.contains("grid_sample.grid_size") && error.contains("-1"), "{error}");
    }
}
