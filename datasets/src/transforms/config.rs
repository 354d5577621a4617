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
    ChromaticAutoContrast: "Stretches colors.";
    ChromaticTranslation: "Shifts colors.";
    ChromaticJitter: "Changes each color a little.";
    ColorJitter: "Changes brightness, contrast, saturation and hue.";
    RandomGrayscale: "Takes colors away.";
    ColorSolarize: "Turns bright colors into their negative.";
    VoxelBlur: "Blurs over voxels.";
    GridSample: "Keeps one Gaussian of a cell.";
    SphereCrop: "Keeps the Gaussians near a center.";
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
    use crate::transforms::testing::{applied, at};
    use crate::transforms::{language_pretraining, semantic_segmentation, validation};
    use serde_json::{Value, json};

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
    }

    fn step(kind: &str, settings: &Value) -> TransformConfig {
        let mut step = json!({ "type": kind });
        step.as_object_mut().unwrap().extend(settings.as_object().unwrap().clone());
        serde_json::from_value(step).unwrap()
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        for (kind, field, bad) in [
            ("limit_values", "divide", json!(0.0)),
            ("limit_values", "scale", json!([1.0, 0.0])),
            ("limit_values", "opacity_floor", json!(1.5)),
            ("random_dropout", "ratio", json!(1.0)),
            ("random_dropout", "probability", json!(-0.5)),
            ("random_rotate", "angle", json!([1.0, 0.0])),
            ("random_rotate", "probability", json!(1.5)),
            ("random_rotate_target_angle", "angles", json!([])),
            ("random_rotate_target_angle", "probability", json!(1.5)),
            ("random_scale", "factor", json!([0.0, 1.0])),
            ("random_scale", "factor", json!([1.1, 0.9])),
            ("random_flip", "probability", json!(2.0)),
            ("random_jitter", "sigma", json!(-1.0)),
            ("random_jitter", "clip", json!(0.0)),
            ("elastic_distortion", "probability", json!(2.0)),
            ("chromatic_auto_contrast", "probability", json!(2.0)),
            ("chromatic_translation", "ratio", json!(0.0)),
            ("chromatic_jitter", "probability", json!(2.0)),
            ("chromatic_jitter", "std", json!(0.0)),
            ("color_jitter", "brightness", json!(-0.1)),
            ("color_jitter", "hue", json!(0.6)),
            ("random_grayscale", "probability", json!(1.1)),
            ("color_solarize", "threshold", json!(300.0)),
            ("voxel_blur", "sigma", json!([0.0, 1.0])),
            ("voxel_blur", "sigma", json!([1.0, 9.0])),
            ("voxel_blur", "grid_size", json!(0.0)),
            ("grid_sample", "grid_size", json!(-1.0)),
            ("sphere_crop", "point_max", json!(0)),
            ("ratio_crop", "ratio", json!([0.5, 0.1])),
            ("ratio_crop", "point_max", json!(0)),
        ] {
            let error = step(kind, &json!({ field: bad })).build().unwrap_err().to_string();
            assert!(error.contains(&format!("{kind}.{field}: ")), "{error}");
        }
        for (fields, part) in [([[0.0, 1.0]], "granularity"), ([[1.0, -1.0]], "magnitude")] {
            let error = step("elastic_distortion", &json!({ "fields": fields })).build();
            assert!(error.unwrap_err().to_string().contains(part));
        }
    }

    #[test]
    fn steps_take_no_row_one_and_two_in_one_place() {
        let always = json!({ "probability": 1.0 });
        for (kind, settings) in [
            ("limit_values", json!({})),
            ("center_shift", json!({})),
            ("capture_effects", json!({ "effects": "holes=3,surface=1,noise=2" })),
            ("random_dropout", json!({ "ratio": 0.99, "probability": 1.0 })),
            ("random_rotate", always.clone()),
            ("random_rotate_target_angle", always.clone()),
            ("random_scale", json!({})),
            ("random_flip", always.clone()),
            ("random_jitter", json!({})),
            ("elastic_distortion", always.clone()),
            ("chromatic_auto_contrast", always.clone()),
            ("chromatic_translation", always.clone()),
            ("chromatic_jitter", always.clone()),
            ("color_jitter", always.clone()),
            ("random_grayscale", always.clone()),
            ("color_solarize", always.clone()),
            ("voxel_blur", always),
            ("grid_sample", json!({})),
            ("sphere_crop", json!({ "point_max": 1 })),
            ("ratio_crop", json!({ "ratio": [0.0, 0.1], "point_max": 10 })),
        ] {
            let step = step(kind, &settings).build().unwrap();
            for rows in 0..3 {
                let out = applied(step.as_ref(), &at(&vec![[1.0; 3]; rows]), 1);
                assert!(out.len() <= rows && out.is_empty() == (rows == 0), "{kind} of {rows}");
                assert!(out.coord.iter().flatten().all(|v| v.is_finite()), "{kind} of {rows}");
            }
        }
    }
}
