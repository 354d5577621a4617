//! Order and chance around transforms: what is done first, what is tossed for anew, and what a color
//! step leaves alone. References are written out here.

use scenesplat_datasets::transforms::{TransformConfig, build_transforms};
use scenesplat_datasets::{
    BatchLoader, DataError, DataSource, Dataset, InputFeatures, LoaderSettings, Sample,
    SceneDataset, SceneLoader, SourceScene, SyntheticRooms, TrainBatch, mix_pairs, sample_rng,
};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::{GaussianScene, RepairReport};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;

fn steps(list: Value) -> Vec<Arc<dyn scenesplat_datasets::Transform>> {
    let list: Vec<TransformConfig> = serde_json::from_value(list).unwrap();
    build_transforms(&list).unwrap()
}

/// The sample after a step.
fn stepped(step: &Value, sample: &Sample, seed: u64) -> Sample {
    let mut sample = sample.clone();
    steps(json!([step]))[0].apply(&mut sample, &mut sample_rng(seed, 0, 0)).unwrap();
    sample
}

/// One scene of two Gaussians.
struct Two(Vec<String>);
impl DataSource for Two {
    fn scene_ids(&self) -> &[String] {
        &self.0
    }
    fn load(&self, _: &str) -> Result<SourceScene, DataError> {
        let scene = GaussianScene {
            coord: vec![[1.0, 0.0, 0.0], [3.0, 2.0, 0.0]],
            log_scale: vec![[-3.0; 3]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacity_logit: vec![1.0; 2],
            sh_dc: vec![[0.2; 3]; 2],
            ..GaussianScene::default()
        };
        Ok(SourceScene { scene, report: RepairReport { source_rows: 2, ..<_>::default() } })
    }
}

#[test]
fn transforms_follow_each_other_as_they_are_listed() {
    let turn = json!({ "type": "random_rotate", "angle": [0.5, 0.5], "probability": 1.0 });
    let centre = json!({ "type": "center_shift" });
    let got = |list: Value| {
        let source = Arc::new(Two(vec!["two".to_owned()]));
        SceneDataset::new(source, steps(list), 1, 1).unwrap().get(0, 0).unwrap().coord
    };
    let near = |a: &[[f32; 3]], b: [[f32; 3]; 2]| {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5)
    };
    // A quarter turn about the origin takes (x, y) to (−y, x); the middle is (2, 1), then (−1, 2).
    let turned = got(json!([turn]));
    assert!(near(&turned, [[0.0, 1.0, 0.0], [-2.0, 3.0, 0.0]]), "{turned:?}");
    let mirror = json!({ "type": "limit_values", "divide": 4.0 });
    let jumps = json!({ "type": "grid_sample", "grid_size": 1.5, "keep": "first" });
    // Shrunk first, both lie in one cell of 1.5; sampled first, in two.
    assert_eq!(got(json!([mirror, jumps])).len(), 1);
    assert_eq!(got(json!([jumps, mirror])).len(), 2);
    let shifted = got(json!([turn, centre]));
    assert!(near(&shifted, [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]]), "{shifted:?}");
}

fn mixing(seed: u64, mix_probability: f64) -> LoaderSettings {
    LoaderSettings { seed, workers: 0, mix_probability, shuffle: false, ..<_>::default() }
}

fn loader(settings: LoaderSettings) -> SceneLoader {
    let source = SyntheticRooms::new(20, SyntheticRoomSettings::with_count(300, 0), 3).unwrap();
    let steps = steps(
        json!([{ "type": "center_shift" }, { "type": "grid_sample", "grid_size": 0.2, "keep": "first" }]),
    );
    let data = SceneDataset::new(Arc::new(source), steps, 1, 1).unwrap();
    SceneLoader::new(Arc::new(data), InputFeatures::default(), settings).unwrap()
}

#[test]
fn mixing_is_tossed_for_anew_for_each_batch_epoch_and_seed() {
    let mixed = |seed, probability, epoch| -> Vec<bool> {
        let mut loader = loader(mixing(seed, probability));
        let batches = loader.epoch(epoch, 0).map(Result::unwrap);
        batches.map(|batch: TrainBatch| batch.num_samples() == 1).collect()
    };
    assert_eq!(mixed(1, 0.0, 0), [false; 10]);
    assert_eq!(mixed(1, 1.0, 0), [true; 10]);
    let epochs: BTreeSet<Vec<bool>> = (0..8).map(|epoch| mixed(1, 0.5, epoch)).collect();
    assert!(epochs.len() >= 7, "epochs toss alike: {epochs:?}");
    let seeds: BTreeSet<Vec<bool>> = (0..8).map(|seed| mixed(seed, 0.5, 0)).collect();
    assert!(seeds.len() >= 7, "seeds toss alike: {seeds:?}");
    // 80 tosses at 0.8: 64 expected, five standard deviations are 18.
    let count: usize =
        (0..8).map(|epoch| mixed(2, 0.8, epoch).iter().filter(|m| **m).count()).sum();
    assert!((46..=80).contains(&count) && count != 80, "{count}");
}

#[test]
fn exact_mixing_keeps_every_row() {
    let rows = |exact: bool| -> usize {
        let count =
            |settings| -> usize { loader(settings).epoch(0, 0).map(|b| b.unwrap().len()).sum() };
        count(mixing(1, 0.0)) - count(LoaderSettings { mix_exact: exact, ..mixing(1, 1.0) })
    };
    assert_eq!(rows(true), 0, "both Gaussians of a cell are kept");
    assert!(rows(false) > 0, "one Gaussian of a cell is kept");
}

/// A room with everything that a sample may have.
fn room() -> Sample {
    let scene = generate(&SyntheticRoomSettings::with_count(1200, 3)).unwrap().scene;
    let n = scene.len();
    let mut sample = Sample::from_scene("room", scene);
    sample.valid_feat = Some((0..n).map(|row| row % 3 == 0).collect());
    sample
}

#[test]
fn steps_change_what_they_are_for_and_nothing_else() {
    /// Fields of a sample that differ.
    fn changed(a: &Sample, b: &Sample) -> Vec<&'static str> {
        let parts = [
            ("coord", a.coord != b.coord),
            ("color", a.color != b.color),
            ("opacity", a.opacity != b.opacity),
            ("scale", a.scale != b.scale),
            ("quat", a.quat != b.quat),
            ("normal", a.normal != b.normal),
            ("segment", a.segment != b.segment),
            ("instance", a.instance != b.instance),
            ("valid_feat", a.valid_feat != b.valid_feat),
        ];
        parts.into_iter().filter(|(_, differs)| *differs).map(|(name, _)| name).collect()
    }
    let room = room();
    for (step, due) in [
        (json!({ "type": "chromatic_auto_contrast", "probability": 1.0 }), vec!["color"]),
        (json!({ "type": "chromatic_translation", "probability": 1.0 }), vec!["color"]),
        (json!({ "type": "chromatic_jitter", "probability": 1.0 }), vec!["color"]),
        (json!({ "type": "random_jitter" }), vec!["coord"]),
        (json!({ "type": "center_shift" }), vec!["coord"]),
        (json!({ "type": "random_scale", "factor": [1.5, 1.5] }), vec!["coord", "scale"]),
        (json!({ "type": "random_flip", "probability": 1.0 }), vec!["coord", "quat", "normal"]),
        (json!({ "type": "random_rotate", "probability": 1.0 }), vec!["coord", "quat", "normal"]),
        (
            json!({ "type": "elastic_distortion", "probability": 1.0 }),
            vec!["coord", "scale", "quat", "normal"],
        ),
    ] {
        assert_eq!(changed(&room, &stepped(&step, &room, 5)), due, "{step}");
    }
}

#[test]
fn rows_that_are_left_out_take_their_labels_along() {
    let room = room();
    // Each row is known by its place: opacity says which it was.
    let mut marked = room.clone();
    marked.opacity = (0..room.len()).map(|row| row as f32).collect();
    for step in [
        json!({ "type": "sphere_crop", "point_max": 300 }),
        json!({ "type": "random_dropout", "ratio": 0.5, "probability": 1.0 }),
        json!({ "type": "grid_sample", "grid_size": 0.4 }),
    ] {
        let sample = stepped(&step, &marked, 2);
        assert!(sample.len() < room.len() && !sample.is_empty(), "{step}");
        for (row, place) in sample.opacity.iter().map(|o| *o as usize).enumerate() {
            let place_of = |values: &Option<Vec<i32>>| values.as_ref().unwrap()[place];
            assert_eq!(sample.coord[row], room.coord[place], "{step}");
            assert_eq!(sample.color[row], room.color[place], "{step}");
            assert_eq!(sample.segment.as_ref().unwrap()[row], place_of(&room.segment), "{step}");
            assert_eq!(sample.instance.as_ref().unwrap()[row], place_of(&room.instance), "{step}");
            assert_eq!(
                sample.valid_feat.as_ref().unwrap()[row],
                room.valid_feat.as_ref().unwrap()[place],
                "{step}"
            );
        }
    }
}

/// Gaussians in a row of cells that begins at x, with these instances.
fn in_a_row(x: f32, instance: &[i32]) -> Sample {
    let n = instance.len();
    Sample {
        id: "row".to_owned(),
        coord: (0..n).map(|i| [x + i as f32 + 0.5, 0.5, 0.5]).collect(),
        color: vec![[70.0, 80.0, 90.0]; n],
        opacity: vec![0.5; n],
        scale: vec![[0.1; 3]; n],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        instance: Some(instance.to_vec()),
        grid_coord: (0..n as i32).map(|i| [i, 0, 0]).collect(),
        grid_size: 1.0,
        ..Sample::default()
    }
}

#[test]
fn instances_of_a_scene_mixed_in_follow_those_of_the_first() {
    let mixed = |first: &[i32], second: &[i32]| {
        let pair = vec![in_a_row(0.0, first), in_a_row(50.0, second)];
        mix_pairs(pair, false, &mut sample_rng(1, 0, 0)).unwrap().remove(0).instance.unwrap()
    };
    assert_eq!(mixed(&[4, -1, 0], &[0, 2, -1, 0]), [4, -1, 0, 5, 7, -1, 5]);
    assert_eq!(mixed(&[-1, -1], &[0, 2, -1]), [-1, -1, 0, 2, -1]);
}

#[test]
fn half_turns_stay_half_turns() {
    // w = 0 has no sign that could be made positive.
    for quat in [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]] {
        for step in [
            json!({ "type": "random_flip", "probability": 1.0 }),
            json!({ "type": "random_rotate", "angle": [0.0, 0.0], "probability": 1.0 }),
        ] {
            let mut sample = in_a_row(0.0, &[0]);
            sample.quat = vec![quat];
            // The same turn has either sign.
            assert_eq!(stepped(&step, &sample, 1).quat[0].map(f32::abs), quat, "{step}");
        }
    }
}

#[test]
fn contrast_leaves_a_constant_channel() {
    let mut sample = in_a_row(0.0, &[0, 1, 2]);
    sample.color[1][2] = 10.0;
    let step = json!({ "type": "chromatic_auto_contrast", "probability": 1.0 });
    let sample = stepped(&step, &sample, 1);
    assert!(sample.color.iter().all(|c| c[..2] == [70.0, 80.0]), "{:?}", sample.color);
    assert!(sample.color[1][2] < 10.0 && sample.color[0][2] > 90.0, "{:?}", sample.color);
}
