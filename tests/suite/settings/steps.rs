//! The same for the steps of transforms, on a scene.

use super::known;
use scenesplat::datasets::transforms::TransformConfig;
use scenesplat::datasets::{Sample, sample_rng};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::LabelledPoints;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Step, field, value before and after; fields that are not named have their defaults.
const FIELDS: &[(&str, &str, &str, &str)] = &[
    ("limit_values", "divide", "1.0", "2.0"),
    ("limit_values", "scale", "null", "[0.02, 0.03]"),
    ("limit_values", "opacity_floor", "0.0", "1.0"),
    ("center_shift", "apply_z", "true", "false"),
    ("capture_effects", "effects", "\"holes=2\"", "\"holes=1..3,noise=2\""),
    ("capture_effects", "probability", "0.1", "0.9"),
    ("measured_effects", "most", "\"noise=1\"", "\"noise=3\""),
    ("measured_effects", "found", "[\"noise=3\"]", "[\"holes=2,noise=1\"]"),
    ("measured_effects", "probability", "0.1", "0.9"),
    ("random_dropout", "ratio", "0.2", "0.5"),
    ("random_dropout", "probability", "0.1", "0.9"),
    ("random_rotate", "angle", "[-1.0, 1.0]", "[-0.1, 0.1]"),
    ("random_rotate", "axis", "\"z\"", "\"x\""),
    ("random_rotate", "center", "\"origin\"", "\"bounding_box\""),
    ("random_rotate", "probability", "0.1", "0.9"),
    ("random_rotate", "exact", "false", "true"),
    ("random_rotate_target_angle", "angles", "[0.5, 1.0]", "[1.5]"),
    ("random_rotate_target_angle", "axis", "\"z\"", "\"y\""),
    ("random_rotate_target_angle", "center", "\"origin\"", "{\"point\": [1.0, 2.0, 3.0]}"),
    ("random_rotate_target_angle", "probability", "0.1", "0.9"),
    ("random_rotate_target_angle", "exact", "false", "true"),
    ("random_scale", "factor", "[0.9, 1.1]", "[1.2, 1.3]"),
    ("random_flip", "probability", "0.1", "0.9"),
    ("random_flip", "exact", "false", "true"),
    ("random_jitter", "sigma", "0.005", "0.002"),
    ("random_jitter", "clip", "0.01", "0.005"),
    ("elastic_distortion", "fields", "[[0.2, 0.4]]", "[[0.2, 0.5]]"),
    ("elastic_distortion", "probability", "0.1", "0.9"),
    ("elastic_distortion", "exact", "false", "true"),
    ("chromatic_auto_contrast", "probability", "0.1", "0.9"),
    ("chromatic_translation", "probability", "0.1", "0.9"),
    ("chromatic_translation", "ratio", "0.05", "0.1"),
    ("chromatic_jitter", "probability", "0.1", "0.9"),
    ("chromatic_jitter", "std", "0.05", "0.1"),
    ("color_jitter", "brightness", "0.4", "0.1"),
    ("color_jitter", "contrast", "0.4", "0.1"),
    ("color_jitter", "saturation", "0.2", "0.1"),
    ("color_jitter", "hue", "0.1", "0.05"),
    ("color_jitter", "probability", "0.1", "0.9"),
    ("random_grayscale", "probability", "0.1", "0.9"),
    ("color_solarize", "probability", "0.1", "0.9"),
    ("color_solarize", "threshold", "128.0", "64.0"),
    ("voxel_blur", "probability", "0.1", "0.9"),
    ("voxel_blur", "sigma", "[1.0, 2.0]", "[0.5, 0.6]"),
    ("voxel_blur", "grid_size", "0.3", "0.2"),
    ("grid_sample", "grid_size", "0.3", "0.2"),
    ("grid_sample", "keep", "\"random\"", "\"first\""),
    ("grid_sample", "keep_full", "false", "true"),
    ("grid_sample", "thin_labelled_points", "true", "false"),
    ("grid_sample", "exact", "false", "true"),
    ("sphere_crop", "point_max", "500", "400"),
    ("sphere_crop", "center", "\"random\"", "\"middle\""),
    ("sphere_crop", "exact", "false", "true"),
    ("ratio_crop", "ratio", "[0.4, 1.0]", "[0.2, 0.3]"),
    ("ratio_crop", "point_max", "500", "400"),
    ("views", "groups", ONE_VIEW, TWO_VIEWS),
];

const ONE_VIEW: &str =
    r#"[{"kind": "global", "views": [[{"type": "grid_sample", "grid_size": 0.3}]]}]"#;
const TWO_VIEWS: &str = r#"[{"kind": "global", "shared": [{"type": "center_shift"}],
    "crop": {"ratio": [0.4, 1.0], "point_max": 500, "center": "major"}, "views": [
    [{"type": "grid_sample", "grid_size": 0.3}], [{"type": "grid_sample", "grid_size": 0.2}]]}]"#;

/// Fields that another one needs.
const BESIDE: &[(&str, &str, &str)] = &[
    ("capture_effects", "effects", "\"noise=3\""),
    ("measured_effects", "most", "\"holes=3,noise=3\""),
    ("measured_effects", "found", "[\"noise=2\"]"),
    ("voxel_blur", "grid_size", "0.3"),
    ("grid_sample", "grid_size", "0.3"),
    ("sphere_crop", "point_max", "500"),
    // Beyond half a turn quaternions change their sign.
    ("random_rotate", "angle", "[1.5, 1.5]"),
];

fn room() -> Sample {
    let scene = generate(&SyntheticRoomSettings::with_count(2000, 3)).unwrap().scene;
    let mut sample = Sample::from_scene("room", scene);
    sample.coord.iter_mut().flatten().for_each(|c| *c += 0.7);
    let coord: Vec<[f32; 3]> = sample.coord.iter().step_by(7).copied().collect();
    let segment = Some((0..coord.len() as i32).map(|i| i % 3 - 1).collect());
    sample.labelled_points = Some(LabelledPoints { coord, segment, instance: None });
    sample
}

fn applied(step: &Value, room: &Sample, seed: u64) -> Sample {
    let step: TransformConfig = serde_json::from_value(step.clone()).unwrap();
    let mut sample = room.clone();
    step.build().unwrap().apply(&mut sample, &mut sample_rng(seed, 0, 0)).unwrap();
    sample
}

#[test]
fn every_field_of_a_step_does_something() {
    let rows: BTreeSet<(String, String)> =
        FIELDS.iter().map(|(step, field, ..)| ((*step).to_owned(), (*field).to_owned())).collect();
    let known: BTreeSet<(String, String)> = known::steps()
        .into_iter()
        .flat_map(|(step, fields)| fields.into_iter().map(move |field| (step.clone(), field)))
        .collect();
    assert_eq!(rows, known, "each field of each step has a row");
    let room = room();
    for (name, field, before, after) in FIELDS {
        let mut step = json!({ "type": name });
        for (other, field, value) in BESIDE {
            if other == name {
                step[*field] = serde_json::from_str(value).unwrap();
            }
        }
        let with = |value: &str| {
            let mut step = step.clone();
            step[*field] = serde_json::from_str(value).unwrap();
            step
        };
        let (a, b) = (with(before), with(after));
        let differs = (0..20).any(|seed| applied(&a, &room, seed) != applied(&b, &room, seed));
        assert!(differs, "{name}.{field} does nothing");
        if *field == "probability" {
            // As often as it says, within five standard deviations of 200 tosses.
            let changed = |step: &Value| {
                (0..200).filter(|&seed| applied(step, &room, seed) != room).count() as f64
            };
            let most = |p: f64| 5.0 * (200.0 * p * (1.0 - p)).sqrt();
            for (step, p) in [(&a, 0.1), (&b, 0.9)] {
                // The flip tosses for two axes, the jitter for four changes.
                let tosses = match *name {
                    "random_flip" => 2,
                    "color_jitter" => 4,
                    _ => 1,
                };
                let p = 1.0 - f64::powi(1.0 - p, tosses);
                let n = changed(step);
                assert!((n - 200.0 * p).abs() < most(p), "{name}: {n} of 200, {p}");
            }
        }
    }
}
