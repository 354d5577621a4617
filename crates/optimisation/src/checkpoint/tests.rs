//! What comes back, what is refused, what is kept.

use super::*;
use crate::frame::tests::{frame, view};

fn given() -> TrainingFrame {
    let mut frame = frame(view(16, 12), Some(1.0));
    (frame.mask, frame.alpha) = (Some(vec![1; 16 * 12]), Some(vec![255; 16 * 12]));
    frame
}

#[test]
fn a_frame_of_which_anything_changed_is_another() {
    let mark = FrameMark::of(&given());
    let changed = |set: &dyn Fn(&mut TrainingFrame)| {
        let mut frame = given();
        set(&mut frame);
        FrameMark::of(&frame) != mark
    };
    assert!(!changed(&|_| ()));
    assert!(changed(&|f| f.name.push('b')));
    assert!(changed(&|f| f.view.world_to_camera[2][3] += 0.1));
    assert!(changed(&|f| f.view.cy += 1.0));
    assert!(changed(&|f| f.rgb = Colors::Bytes(vec![1; 3 * 16 * 12])));
    assert!(changed(&|f| f.depth = Some(vec![2.0; 16 * 12])));
    assert!(changed(&|f| f.mask = Some(vec![0; 16 * 12])));
    assert!(changed(&|f| f.alpha = Some(vec![0; 16 * 12])));
}

#[test]
fn every_count_is_its_own_after_a_resume() {
    let settings = OptimiseSettings { exposure: true, ..OptimiseSettings::scenesplat() };
    let points = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
    let model = crate::initial::from_points(&points, &[[0.5; 3]; 4], &settings.initial, 1).unwrap();
    let frames = [given()];
    let mut made = Optimiser::new(model, &frames, settings).unwrap();
    (made.step, made.adam.steps, made.scene_scale) = (7, 5, 2.5);
    made.exposure.steps = vec![3];
    made.adam.quats.second[2] = 4.0;
    let folder = tempfile::tempdir().unwrap();
    let path = made.save(folder.path(), &frames, 1).unwrap();
    let found = Optimiser::resume(&path, &frames, Some(settings)).unwrap();
    assert_eq!((found.step, found.adam.steps, found.scene_scale), (7, 5, 2.5));
    assert_eq!(found.exposure.steps, [3]);
    assert_eq!(found.adam.quats.second[2], 4.0);
    assert_eq!(found.model(), made.model());
}

/// An optimiser of five Gaussians and two frames, each of whose values is another.
fn told_apart(frames: &[TrainingFrame]) -> Optimiser {
    let mut settings = OptimiseSettings { exposure: true, ..OptimiseSettings::gsplat_default() };
    settings.initial.sh_degree = 1;
    let points: Vec<[f32; 3]> = (0..5).map(|i| [0.1 * i as f32, 0.3, 0.7]).collect();
    let model = crate::initial::from_points(&points, &[[0.5; 3]; 5], &settings.initial, 1).unwrap();
    let mut made = Optimiser::new(model, frames, settings).unwrap();
    let mut value = 0.0f32;
    let mut fill =
        |values: &mut [f32]| values.iter_mut().for_each(|v| (value, *v) = (value + 0.125, value));
    fill(made.model.gaussians.means.as_flattened_mut());
    fill(made.model.gaussians.quats.as_flattened_mut());
    fill(&mut made.model.gaussians.sh);
    fill(made.model.log_scales.as_flattened_mut());
    fill(&mut made.model.logits);
    let a = &mut made.adam;
    for m in [&mut a.means, &mut a.quats, &mut a.scales, &mut a.opacities, &mut a.sh] {
        fill(&mut m.first);
        fill(&mut m.second);
    }
    (made.doubling.sum, made.doubling.count) = (vec![0.0; 5], vec![0.0; 5]);
    fill(&mut made.doubling.sum);
    fill(&mut made.doubling.count);
    fill(&mut made.exposure.values);
    for m in &mut made.exposure.moments {
        fill(&mut m.first);
        fill(&mut m.second);
    }
    made.model.activate();
    (made.step, made.adam.steps, made.scene_scale) = (12, 9, 0.75);
    made.exposure.steps = vec![4, 8];
    made
}

fn two_frames() -> [TrainingFrame; 2] {
    let mut other = frame(view(20, 13), None);
    other.name = "other".to_owned();
    [given(), other]
}

#[test]
fn every_value_is_its_own_after_a_resume() {
    let frames = two_frames();
    let made = told_apart(&frames);
    let folder = tempfile::tempdir().unwrap();
    let place = made.save(folder.path(), &frames, 1).unwrap();
    assert_eq!(place, folder.path().join("step-000000012"));
    let found = Optimiser::resume(&place, &frames, None).unwrap();
    assert_eq!((&found.model, &found.adam), (&made.model, &made.adam));
    assert_eq!((&found.doubling, &found.exposure), (&made.doubling, &made.exposure));
    assert_eq!((found.step, found.scene_scale, found.settings), (12, 0.75, made.settings));
    let bytes = std::fs::read(place.join("arrays.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let shapes: [(&str, &[usize]); 8] = [
        ("means", &[5, 3]),
        ("quats", &[5, 4]),
        ("log_scales", &[5, 3]),
        ("logits", &[5]),
        ("sh", &[5, 4, 3]),
        ("exposure", &[2, 6]),
        ("adam.scales.second", &[15]),
        ("exposure.1.first", &[6]),
    ];
    for (name, shape) in shapes {
        assert_eq!(file.tensor(name).unwrap().shape(), shape, "{name}");
    }
    // 5 arrays of the model, 2 of doubling, the exposures; two moments of 5 groups and 2 frames.
    assert_eq!(file.names().len(), 8 + 10 + 4);
    let text = std::fs::read(place.join("state.json")).unwrap();
    let state: serde_json::Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(
        (&state["version"], &state["step"], &state["adam_steps"]),
        (&2.into(), &12.into(), &9.into())
    );
    assert_eq!(
        (&state["frames"][1]["width"], &state["frames"][1]["height"]),
        (&20.into(), &13.into())
    );
}

#[test]
fn what_is_of_another_run_or_damaged_is_refused_by_name() {
    let frames = two_frames();
    let made = told_apart(&frames);
    let folder = tempfile::tempdir().unwrap();
    let place = made.save(folder.path(), &frames, 1).unwrap();
    let refused = |frames: &[TrainingFrame], settings| {
        Optimiser::resume(&place, frames, settings).unwrap_err().to_string()
    };
    let other = OptimiseSettings { seed: 1, ..made.settings };
    assert!(refused(&frames, Some(other)).contains("was made with other settings"));
    let swapped = [frames[1].clone(), frames[0].clone()];
    assert!(refused(&swapped, None).contains("is of other frames: \"other\" is not \"\""));
    assert!(refused(&frames[..1], None).contains("is of 2 frames, not of 1"));
    let three = [&frames[..], &frames[..1]].concat();
    assert!(refused(&three, None).contains("is of 2 frames, not of 3"));
    let (state, arrays) = (place.join("state.json"), place.join("arrays.safetensors"));
    let (text, bytes) = (std::fs::read_to_string(&state).unwrap(), std::fs::read(&arrays).unwrap());
    // One array of too few values at a time.
    for name in [
        "means",
        "log_scales",
        "adam.quats.second",
        "doubling.count",
        "exposure",
        "exposure.1.second",
    ] {
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let views = file.tensors().into_iter().map(|(own, view)| {
            let cut = own == name;
            let shape = if cut { vec![1] } else { view.shape().to_vec() };
            let data = if cut { &view.data()[..4] } else { view.data() };
            (own, TensorView::new(Dtype::F32, shape, data).unwrap())
        });
        std::fs::write(&arrays, safetensors::serialize(views, None).unwrap()).unwrap();
        let error = refused(&frames, None);
        assert!(error.contains(&format!("{name} has 1 values, not ")), "{error}");
        assert!(error.contains("take an older checkpoint, or begin anew"), "{error}");
    }
    std::fs::write(&arrays, bytes).unwrap();
    std::fs::write(&state, text.replace("\"version\": 2", "\"version\": 1")).unwrap();
    assert!(refused(&frames, None).contains("is of version 1, this program reads 2"));
    std::fs::write(&state, "{").unwrap();
    assert!(refused(&frames, None).contains("state.json"));
}

#[test]
fn the_newest_are_kept_and_found() {
    let frames = two_frames();
    let mut made = told_apart(&frames);
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("runs");
    assert_eq!(newest_checkpoint(&root).unwrap(), None);
    let names = || {
        let mut names: Vec<u64> = std::fs::read_dir(&root)
            .unwrap()
            .filter_map(|e| e.unwrap().file_name().to_str()?.strip_prefix("step-")?.parse().ok())
            .collect();
        names.sort_unstable();
        names
    };
    for (step, keep, left) in [
        (2, 3, &[2][..]),
        (9, 3, &[2, 9]),
        (10, 3, &[2, 9, 10]),
        (30, 3, &[9, 10, 30]),
        // Those after it stay: of two it and the newest before it.
        (20, 2, &[10, 20, 30]),
        (40, 0, &[40]),
    ] {
        made.step = step;
        made.save(&root, &frames, keep).unwrap();
        assert_eq!(names(), left, "{step}");
    }
    // A folder without a state is none, and numbers are compared as such.
    std::fs::create_dir(root.join("step-99")).unwrap();
    std::fs::create_dir(root.join("step-x")).unwrap();
    std::fs::create_dir(root.join("step-5")).unwrap();
    std::fs::write(root.join("step-5/state.json"), "").unwrap();
    assert_eq!(newest_checkpoint(&root).unwrap(), Some(root.join("step-000000040")));
    let file = root.join("step-5/state.json");
    assert!(newest_checkpoint(&file).unwrap_err().to_string().contains("is it a folder?"));
    let mark = FrameMark::of(&frames[1]);
    let changes: [&dyn Fn(&mut TrainingFrame); 6] = [
        &|f| f.view.fx += 1.0,
        &|f| f.view.fy += 1.0,
        &|f| f.view.cx += 1.0,
        &|f| f.view.world_to_camera[0][1] += 0.1,
        &|f| (f.view.width, f.view.height) = (13, 20),
        &|f| f.rgb = Colors::Floats(vec![0.0; 780]),
    ];
    for (i, change) in changes.iter().enumerate() {
        let mut frame = frames[1].clone();
        change(&mut frame);
        assert_ne!(FrameMark::of(&frame), mark, "{i}");
    }
    assert_eq!(mark.hash.len(), 16);
    // FNV-1a of words of eight bytes, the last one filled with zeros.
    let mut hash = Hash(5);
    hash.add(&[1, 0, 0, 0, 0, 0, 0, 2, 3]);
    let prime = 0x0100_0000_01b3u64;
    let first = (5u64 ^ (1 + (2 << 56))).wrapping_mul(prime);
    assert_eq!(hash.0, (first ^ 3).wrapping_mul(prime));
}
