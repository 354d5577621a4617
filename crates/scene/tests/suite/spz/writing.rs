//! What is written, and the report on what a file cannot hold.

use crate::common::spz::{HERE, compare_within_steps, gunzip, read, write, write_with};
use crate::common::{random_scene, write_as};
use scenesplat_scene::{GaussianScene, SceneFormat, WriteOptions};

#[test]
fn versions_hold_the_same_scene() {
    let scene = random_scene(20_000, 3, 1);
    for version in 2..=4 {
        let bytes = write(&scene, version);
        let header = if version == 4 { bytes.clone() } else { gunzip(&bytes) };
        assert_eq!(&header[..4], b"NGSP");
        assert_eq!(header[4..15], [version, 0, 0, 0, 0x20, 0x4e, 0, 0, 3, 12, 0]);
        compare_within_steps(&scene, &read(&bytes).scene, version);
    }
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
    let mut ends = scene.clone();
    ends.sh_rest[..24].copy_from_slice(&[1.0, -1.0, 0.99].repeat(8));
    assert!(limits(&ends).is_empty());

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
    let (low, high) = (random_scene(30, 1, 3), random_scene(3, 4, 1));
    let mut ragged = low.clone();
    ragged.quat.pop();
    for (scene, spz_version, due) in [
        (&low, 0, "2, 3 or 4"),
        (&low, 1, "2, 3 or 4"),
        (&low, 5, "2, 3 or 4"),
        (&high, 2, "degree 4"),
        (&high, 3, "degree 4"),
        (&ragged, 4, "29"),
    ] {
        let options = WriteOptions { spz_version, ..WriteOptions::default() };
        let error = write_as(scene, &path, SceneFormat::Spz, &options).unwrap_err().to_string();
        assert!(error.contains(due), "{error}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
