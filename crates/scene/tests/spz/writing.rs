//! What is written comes back, and what cannot come back is reported.

use crate::common::{SplitMix, random_scene, shared};
use crate::{HERE, compare_within_steps, read, read_raw, write, write_with};
use scenesplat_scene::formats::spz::write_spz;
use scenesplat_scene::{
    GaussianScene, ReadOptions, SceneError, SpzFrame, WriteOptions, open_scene,
};
use std::io::Read;

/// Scenes that are hard to keep as they are.
fn hard_scenes() -> Vec<(String, GaussianScene)> {
    let mut scenes = Vec::new();
    for (rows, degree) in [(1, 0), (2, 1), (255, 2), (256, 3), (257, 0), (9000, 1)] {
        scenes.push((format!("{rows} random"), random_scene(rows, degree, rows as u64)));
    }
    let mut same = random_scene(1, 1, 3).select_rows(&[0; 257]).unwrap();
    scenes.push(("identical".to_owned(), same.clone()));
    same.coord.iter_mut().enumerate().for_each(|(i, p)| *p = [1.0 + i as f32 * 1e-6; 3]);
    scenes.push(("tiny range".to_owned(), same));
    for (i, far) in [2047.999, 2047.9999, 2048.0, 2048.0001, 1e6, 8_388_607.4, 1e9, 3e38]
        .into_iter()
        .flat_map(|far| [far, -far])
        .enumerate()
    {
        let mut scene = random_scene(40, 0, 100 + i as u64);
        scene.coord[7][i % 3] = far;
        scenes.push((format!("far: {far}"), scene));
    }
    let mut scene = random_scene(300, 2, 5);
    let mut rng = SplitMix(6);
    for row in 0..300 {
        let picks = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 0.7, -0.7, std::f32::consts::FRAC_1_SQRT_2];
        scene.quat[row] = [(); 4].map(|()| picks[rng.below(picks.len())]);
        let picks = [f32::INFINITY, f32::NEG_INFINITY, 30.0, -30.0, 6.3, -6.3, 0.0];
        scene.opacity_logit[row] = picks[rng.below(picks.len())];
        let picks = [f32::NEG_INFINITY, f32::INFINITY, -10.03, 5.97, -80.0, 0.03125, -0.03125];
        scene.log_scale[row] = [(); 3].map(|()| picks[rng.below(picks.len())]);
        let picks = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 3.34, -3.34, 100.0, 0.0];
        scene.sh_dc[row] = [(); 3].map(|()| picks[rng.below(picks.len())]);
        let picks = [-1.0, 1.0, 0.96875, -0.97, 2.2, -2.2, f32::NAN, 1e38, -0.03125, 0.0625];
        let width = scene.sh_rest_len() * 3;
        for v in &mut scene.sh_rest[row * width..][..width] {
            *v = picks[rng.below(picks.len())];
        }
    }
    scenes.push(("corners".to_owned(), scene));
    scenes
}

#[test]
fn written_read_and_written_again_is_the_same_file() {
    let options = |spz_version, spz_frame| WriteOptions {
        spz_version,
        spz_frame,
        overwrite: true,
        ..WriteOptions::default()
    };
    for (name, scene) in hard_scenes() {
        // Positions are the same in all versions.
        let versions = if name.starts_with("far") { 4..=4 } else { 2..=4 };
        for version in versions {
            for frame in [SpzFrame::Rub, SpzFrame::Raw] {
                let options = options(version, frame);
                let (first, _) = write_with(&scene, &options);
                let read = |bytes| match frame {
                    SpzFrame::Rub => read(bytes),
                    SpzFrame::Raw => read_raw(bytes),
                };
                let back = read(&first);
                assert_eq!(back.scene.len(), scene.len(), "{name}");
                assert!(back.report.is_clean(), "{name}: {}", back.report);
                let (second, _) = write_with(&back.scene, &options);
                assert!(first == second, "{name}, version {version}, {frame:?}");
                assert_eq!(read(&second).scene, back.scene);
            }
        }
    }
    let degree_4 = random_scene(700, 4, 9);
    let first = write(&degree_4, 4);
    assert_eq!(write(&read(&first).scene, 4), first);
    for name in ["real/parity/playbot_lod4.ply", "real/objects/hamburger.ply"] {
        let Some(path) = shared(name) else { continue };
        let scene = open_scene(&path, &ReadOptions::default()).unwrap().scene;
        for version in 2..=4 {
            let first = write(&scene, version);
            assert!(write(&read(&first).scene, version) == first, "{name}, version {version}");
        }
    }
}

#[test]
fn versions_hold_the_same_scene_and_any_number_of_threads_the_same_bytes() {
    let scene = random_scene(20_000, 3, 1);
    let one = rayon_pool(1);
    for version in 2..=4 {
        let bytes = write(&scene, version);
        let header = if version == 4 {
            bytes[..15].to_vec()
        } else {
            let mut head = vec![0; 15];
            flate2::read::GzDecoder::new(&bytes[..]).read_exact(&mut head).unwrap();
            head
        };
        assert_eq!(&header[..4], b"NGSP");
        assert_eq!(header[4..], [version, 0, 0, 0, 0x20, 0x4e, 0, 0, 3, 12, 0]);
        assert_eq!(one.install(|| write(&scene, version)), bytes);
        let back = read(&bytes);
        assert_eq!(one.install(|| read(&bytes)), back);
        compare_within_steps(&scene, &back.scene, version);
    }
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

#[test]
fn the_report_names_what_does_not_fit() {
    let mut scene = random_scene(100, 2, 4);
    scene.sh_dc.iter_mut().flatten().for_each(|v| *v = v.clamp(-1.0, 1.0));
    scene.opacity_logit.iter_mut().for_each(|v| *v = v.clamp(-5.0, 5.0));
    let limits = |scene: &GaussianScene| write_with(scene, &WriteOptions::default()).1.limits;
    assert!(limits(&scene).is_empty(), "{:?}", limits(&scene));
    let only = |change: &dyn Fn(&mut GaussianScene)| {
        let mut scene = scene.clone();
        change(&mut scene);
        let limits = limits(&scene);
        assert_eq!(limits.len(), 1, "{limits:?}");
        limits[0].clone()
    };

    let limit = only(&|s| (s.log_scale[3][1], s.log_scale[9][0]) = (-12.0, f32::NEG_INFINITY));
    assert_eq!((limit.field, limit.rows, limit.first_row), ("log_scale", 2, 3));
    assert_eq!(limit.largest_change, f64::INFINITY);
    let limit = only(&|s| s.log_scale[4][2] = 7.0);
    assert_eq!((limit.first_row, limit.largest_change), (4, 1.0625));

    let limit = only(&|s| s.sh_rest[24 * 5 + 20] = 2.2);
    assert_eq!((limit.field, limit.rows, limit.first_row), ("sh_rest", 1, 5));
    assert!((limit.largest_change - 1.2).abs() < 0.01);
    // A sign is turned by the frame, and then the other end counts; both are within rounding.
    assert!(
        limits(&{
            let mut scene = scene.clone();
            scene.sh_rest[..24].copy_from_slice(&[1.0, -1.0, 0.99].repeat(8));
            scene
        })
        .is_empty()
    );

    let limit = only(&|s| s.sh_dc[6][2] = -5.0);
    assert_eq!((limit.field, limit.first_row), ("sh_dc", 6));
    assert!((limit.largest_change - (5.0 - 10.0 / 3.0)).abs() < 1e-5);

    let limit = only(&|s| {
        s.opacity_logit[7] = 9.0;
        s.opacity_logit[8] = -30.0;
        s.opacity_logit[9] = f32::INFINITY;
        s.opacity_logit[10] = f32::NEG_INFINITY;
    });
    assert_eq!((limit.field, limit.rows, limit.first_row), ("opacity_logit", 2, 7));
    // Alpha 1 / (1 + e⁻⁹) becomes 1.
    assert!((limit.largest_change - 1.233_945_76e-4).abs() < 1e-12, "{limit:?}");

    let limit = only(&|s| s.quat[2] = [0.0; 4]);
    assert_eq!((limit.field, limit.rows, limit.first_row), ("quat", 1, 2));

    // One far row makes all the others coarse, and the report says which.
    let limit = only(&|s| s.coord[42] = [0.0, 1e6, 0.0]);
    assert_eq!(limit.field, "coord");
    assert!(
        limit.limit.contains("steps of 0.125 m") && limit.limit.contains("row 42"),
        "{limit:?}"
    );
    assert!(limit.rows > 90 && limit.largest_change > 0.05 && limit.largest_change <= 0.0625);

    let mut far = scene.clone();
    far.coord[11] = [2e7, 0.0, 0.0];
    let limits = limits(&far);
    let clipped = limits.iter().find(|l| l.limit.contains("clipped")).unwrap();
    assert_eq!((clipped.rows, clipped.first_row), (1, 11));
    assert_eq!(clipped.largest_change, 2e7 - 8_388_607.0);
    assert!(limits.iter().any(|l| l.limit.contains("steps of 1 m")));
}

#[test]
fn what_cannot_be_written_is_refused_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(HERE);
    let try_to = |scene: &GaussianScene, version, going: bool| {
        let options = WriteOptions { spz_version: version, ..WriteOptions::default() };
        let result = write_spz(scene, &path, &options, &mut |_| going);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        result.unwrap_err()
    };
    let scene = random_scene(20_000, 1, 3);
    for version in [0, 1, 5] {
        let error = try_to(&scene, version, true).to_string();
        assert!(error.contains("2, 3 or 4"), "{error}");
    }
    for version in [2, 3] {
        let error = try_to(&random_scene(3, 4, 1), version, true).to_string();
        assert!(error.contains("degree 4") && error.contains("version 4"), "{error}");
    }
    for version in 2..=4 {
        assert!(matches!(try_to(&scene, version, false), SceneError::Stopped));
        let mut bad = scene.clone();
        bad.coord[70][1] = f32::NAN;
        bad.opacity_logit[90] = f32::NAN;
        let error = try_to(&bad, version, true).to_string();
        assert!(error.contains("element 70") && error.contains("coord"), "{error}");
        let mut ragged = scene.clone();
        ragged.quat.pop();
        assert!(matches!(try_to(&ragged, version, true), SceneError::RowCount { .. }));
    }
}

#[test]
fn progress_goes_up_to_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let scene = random_scene(60_000, 1, 8);
    for version in 2..=4 {
        let mut seen = vec![0.0];
        let options = WriteOptions { spz_version: version, ..WriteOptions::default() };
        write_spz(&scene, &dir.path().join(HERE), &options, &mut |done| {
            seen.push(done);
            true
        })
        .unwrap();
        assert!(seen.len() > 6 && seen.is_sorted() && seen.iter().all(|&v| v <= 1.0), "{seen:?}");
    }
}
