//! Changing scenes: what is kept, what turns with the scene, what joining loses.

use super::gltf::placement::{covariance, shine};
use crate::common::random_scene;
use half::f16;
use scenesplat_scene::edit::{
    CropBox, EulerAngles, Offset, SampleSize, SceneEdit, UpSource, merge,
};
use scenesplat_scene::{
    GaussianScene, LabelledPoints, LanguageCode, LanguageCodebook, LanguageFeatures, Similarity, Up,
};

/// A scene with every array.
fn full(rows: usize, degree: u8, seed: u64) -> GaussianScene {
    let mut scene = random_scene(rows, degree, seed);
    for (row, coord) in scene.coord.iter_mut().enumerate() {
        *coord = [coord[0] / 5.0, coord[1] / 3.0, coord[2] / 10.0];
        scene.log_scale[row][2] -= 2.0;
    }
    scene.segment = Some((0..rows as i32).map(|row| row % 4).collect());
    scene.segment_score = Some((0..rows).map(|row| row as f32 / 7.0).collect());
    scene.instance = Some((0..rows as i32).map(|row| row % 3 - 1).collect());
    scene.normal = Some(vec![[0.0, 0.6, 0.8]; rows]);
    scene.valid_feat_mask = Some((0..rows).map(|row| row % 2 == 0).collect());
    let codebook = LanguageCodebook { mean: vec![1.0, 2.0], axes: vec![0.5, 0.25] };
    let half = |count: usize| (0..count).map(|i| f16::from_f32(i as f32)).collect::<Vec<_>>();
    scene.lang_code = Some(LanguageCode { values: half(rows), codebook });
    scene.lang_feat = Some(LanguageFeatures { values: half(rows * 2), dim: 2 });
    let coord = scene.coord.clone();
    let labels = scene.segment.clone();
    scene.labelled_points =
        Some(LabelledPoints { coord, segment: labels, instance: Some(vec![2; rows]) });
    scene.check_rows().unwrap();
    scene
}

#[test]
fn everything_turns_with_the_scene() {
    let before = full(40, 4, 5);
    let angles = EulerAngles([25.0, -130.0, 75.0]);
    let m = angles.matrix();
    let turn = |v: [f64; 3]| m.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2]);
    let edit = SceneEdit { rotate: Some(angles), ..SceneEdit::default() };
    let (after, report) = edit.apply(before.clone()).unwrap();
    assert!(report.rows.is_none() && report.up.is_none());
    let close = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-5;
    for row in 0..before.len() {
        let due = turn(before.coord[row].map(f64::from));
        assert!((0..3).all(|i| close(after.coord[row][i], due[i])), "{row}");
        let due = turn([0.0, 0.6, 0.8]);
        assert!((0..3).all(|i| close(after.normal.as_ref().unwrap()[row][i], due[i])));
        // Σ' = R Σ Rᵀ.
        let (old, new) = (covariance(&before, row), covariance(&after, row));
        for i in 0..3 {
            for j in 0..3 {
                let due: f64 = (0..3)
                    .flat_map(|a| (0..3).map(move |b| (a, b)))
                    .map(|(a, b)| m[i][a] * old[a][b] * m[j][b])
                    .sum();
                assert!((new[i][j] - due).abs() < 1e-6, "{row}: {} {due}", new[i][j]);
            }
        }
        // The color from a direction is the one from the same side of the thing before.
        for d in [[1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.48, -0.64, 0.6]] {
            let (a, b) = (shine(&after, row, 1, turn(d)), shine(&before, row, 1, d));
            assert!((a - b).abs() < 2e-5, "{row}: {a} {b}");
        }
    }
    let points = after.labelled_points.as_ref().unwrap();
    assert_eq!(points.coord, after.coord);
    // What has no direction is as it was.
    assert_eq!(after.sh_dc, before.sh_dc);
    assert_eq!((&after.segment, &after.instance), (&before.segment, &before.instance));
    assert_eq!((&after.lang_code, &after.lang_feat), (&before.lang_code, &before.lang_feat));
    assert_eq!(after.segment_score, before.segment_score);
    // And back.
    let back = SceneEdit { rotate: Some("0,0,-75".parse().unwrap()), ..SceneEdit::default() };
    let (back, _) = back.apply(after).unwrap();
    let back = ["0,130,0", "-25,0,0"].into_iter().fold(back, |scene, text| {
        let rotate = Some(text.parse().unwrap());
        SceneEdit { rotate, ..SceneEdit::default() }.apply(scene).unwrap().0
    });
    for row in 0..before.len() {
        assert!((0..3).all(|i| close(back.coord[row][i], before.coord[row][i].into())));
        let d = [0.48, -0.64, 0.6];
        assert!((shine(&back, row, 1, d) - shine(&before, row, 1, d)).abs() < 4e-5);
    }
}

#[test]
fn a_move_leaves_everything_but_positions() {
    let before = full(20, 2, 9);
    let edit = SceneEdit { translate: Some(Offset([1.0, -2.0, 0.5])), ..SceneEdit::default() };
    let (mut after, _) = edit.apply(before.clone()).unwrap();
    for (new, old) in after.coord.iter().zip(&before.coord) {
        assert_eq!(*new, [old[0] + 1.0, old[1] - 2.0, old[2] + 0.5]);
    }
    assert_eq!(after.labelled_points.as_ref().unwrap().coord, after.coord);
    after.coord.clone_from(&before.coord);
    after.labelled_points.clone_from(&before.labelled_points);
    assert_eq!(after, before);
    for far in [1e39, -1e300] {
        let edit = SceneEdit { translate: Some(Offset([0.0, far, 0.0])), ..SceneEdit::default() };
        assert!(edit.apply(before.clone()).unwrap_err().to_string().contains("finite"));
    }
}

#[test]
fn the_given_direction_becomes_up() {
    let before = full(10, 1, 3);
    for up in Up::AXES {
        let edit = SceneEdit { up: Some(UpSource::Given(up)), ..SceneEdit::default() };
        let (after, report) = edit.apply(before.clone()).unwrap();
        let along = |p: &[f32; 3]| (0..3).map(|a| up.vector()[a] as f32 * p[a]).sum::<f32>();
        for (new, old) in after.coord.iter().zip(&before.coord) {
            assert_eq!(new[2], along(old), "{up}");
        }
        let found = report.up.unwrap();
        assert!(found.given && found.direction == up && report.level.is_none());
    }
    // A direction that is up already changes no bit.
    let edit = SceneEdit { up: Some(UpSource::Given(Up::PLUS_Z)), ..SceneEdit::default() };
    assert_eq!(edit.apply(before.clone()).unwrap().0, before);
}

#[test]
fn crops_and_samples_keep_whole_rows_in_order() {
    let scene = full(2000, 1, 1);
    let edit = SceneEdit {
        crop: Some("-1,-1,-1,1,1,1".parse().unwrap()),
        sample: Some(SampleSize::Count(50)),
        ..SceneEdit::default()
    };
    let (cut, report) = edit.apply(scene.clone()).unwrap();
    let rows = report.rows.unwrap();
    assert_eq!((cut.len(), rows.len()), (50, 50));
    assert!(rows.is_sorted());
    assert!(cut.coord.iter().flatten().all(|v| v.abs() <= 1.0));
    let mut due = scene.select_rows(&rows).unwrap();
    due.labelled_points.clone_from(&cut.labelled_points);
    assert_eq!(cut, due);
    let again = edit.apply(scene.clone()).unwrap().1.rows.unwrap();
    assert_eq!(again, rows);
    let other = SceneEdit { seed: 1, ..edit }.apply(scene).unwrap().1.rows.unwrap();
    assert_ne!(other, rows);
}

#[test]
fn labelled_points_are_cropped_too() {
    let scene = full(300, 0, 2);
    let crop: Option<CropBox> = Some("-1,-1,-1,1,1,1".parse().unwrap());
    let (cut, _) = SceneEdit { crop, ..SceneEdit::default() }.apply(scene).unwrap();
    let points = cut.labelled_points.unwrap();
    assert!(!cut.coord.is_empty() && cut.coord.len() < 300);
    assert_eq!((points.coord, points.segment), (cut.coord, cut.segment));
}

#[test]
fn a_part_of_few_is_at_least_one() {
    let edit = SceneEdit { sample: Some("1%".parse().unwrap()), ..SceneEdit::default() };
    assert_eq!(edit.apply(full(2, 0, 1)).unwrap().0.len(), 1);
    assert_eq!(edit.apply(GaussianScene::default()).unwrap().0.len(), 0);
}

#[test]
fn an_empty_box_says_where_the_scene_is() {
    let crop = Some("900,0,0,901,1,1".parse().unwrap());
    let edit = SceneEdit { crop, ..SceneEdit::default() };
    let error = edit.apply(full(9, 0, 1)).unwrap_err();
    assert!(error.to_string().contains("the scene lies in"));
}

#[test]
fn millimetres_become_metres() {
    let scene = full(20, 0, 1);
    let edit = SceneEdit { scale: Some(0.001), ..SceneEdit::default() };
    let (small, report) = edit.apply(scene.clone()).unwrap();
    assert_eq!(report.rows, None);
    assert!((small.coord[7][1] - scene.coord[7][1] / 1000.0).abs() < 1e-9);
    assert!((small.scale(7)[0] * 1000.0 / scene.scale(7)[0] - 1.0).abs() < 1e-5);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e39] {
        let edit = SceneEdit { scale: Some(bad), ..SceneEdit::default() };
        assert!(edit.apply(scene.clone()).is_err());
    }
}

#[test]
fn lower_degrees_keep_the_lower_bands() {
    let scene = full(3, 2, 1);
    let edit = SceneEdit { sh_degree: Some(1), ..SceneEdit::default() };
    let (cut, _) = edit.apply(scene.clone()).unwrap();
    assert_eq!(cut.sh_rest[9..18], scene.sh_rest[24..33]);
    cut.check_rows().unwrap();
    let none = SceneEdit { sh_degree: Some(0), ..SceneEdit::default() }.apply(scene).unwrap().0;
    assert!(none.sh_rest.is_empty() && none.sh_degree == 0);
}

#[test]
fn nonsense_is_refused() {
    for text in ["", "1,2,3", "1,1,1,0,2,2", "nan,0,0,1,1,1", "a,b,c,d,e,f"] {
        assert!(text.parse::<CropBox>().is_err(), "{text}");
    }
    for text in ["0", "-1", "0%", "101%", "x", "1.5"] {
        assert!(text.parse::<SampleSize>().is_err(), "{text}");
    }
}

#[test]
fn scenes_that_are_alike_lose_nothing() {
    let (a, b) = (full(5, 2, 1), full(7, 2, 2));
    let (both, report) = merge(vec![a.clone(), b.clone()]).unwrap();
    assert_eq!((both.len(), &report.rows[..]), (12, &[5, 7][..]));
    assert_eq!(report.notes, ["instances were numbered on from scene to scene"]);
    let first: Vec<usize> = (0..5).collect();
    let mut left = both.select_rows(&first).unwrap();
    left.labelled_points.clone_from(&a.labelled_points);
    assert_eq!(left, a);
    // Instances 0 and 1, and 2 of the points, are taken.
    let instances = &both.instance.as_ref().unwrap()[5..];
    assert_eq!(instances, [-1, 3, 4, -1, 3, 4, -1]);
    let points = both.labelled_points.as_ref().unwrap();
    assert_eq!(points.coord.len(), 12);
    assert_eq!(points.instance.as_ref().unwrap()[4..6], [2, 5]);
    assert_eq!(both.segment.as_ref().unwrap()[5..], b.segment.unwrap());
    assert_eq!(both.sh_rest[5 * 24..], b.sh_rest);
    assert_eq!(both.lang_feat.as_ref().unwrap().values[10..], b.lang_feat.unwrap().values);
    assert!(merge(Vec::new()).is_err());
    assert_eq!(merge(vec![a.clone()]).unwrap().0, a);
}

#[test]
fn what_does_not_go_together_is_said() {
    let mut a = full(2, 1, 1);
    let mut b = full(3, 3, 2);
    b.lang_code.as_mut().unwrap().codebook.mean[0] = 9.0;
    b.lang_feat = Some(LanguageFeatures { values: vec![f16::ONE; 9], dim: 3 });
    b.normal = None;
    a.segment = None;
    a.segment_score = None;
    let (both, report) = merge(vec![a.clone(), b.clone()]).unwrap();
    both.check_rows().unwrap();
    assert_eq!((both.sh_degree, both.sh_rest.len()), (3, 5 * 45));
    assert_eq!(both.sh_rest[..9], a.sh_rest[..9]);
    assert!(both.sh_rest[9..45].iter().all(|v| *v == 0.0));
    let d = [0.48, -0.64, 0.6];
    assert_eq!(shine(&both, 1, 1, d), shine(&a, 1, 1, d));
    assert_eq!(shine(&both, 3, 1, d), shine(&b, 1, 1, d));
    assert_eq!(both.segment.as_ref().unwrap()[..3], [-1, -1, 0]);
    assert!(both.lang_code.is_none() && both.lang_feat.is_none() && both.normal.is_none());
    let all = report.notes.join("\n");
    for part in [
        "class labels got no label (scene 1)",
        "codebooks",
        "of 2 and of 3 numbers",
        "normals were dropped",
        "bands of spherical harmonics became 0 (scene 1)",
    ] {
        assert!(all.contains(part), "{part:?} in\n{all}");
    }
    // Features of one scene only: the rows of the other are marked as having none.
    b.lang_feat = None;
    b.valid_feat_mask = None;
    let (both, _) = merge(vec![a, b]).unwrap();
    assert_eq!(both.valid_feat_mask.unwrap(), [true, false, false, false, false]);
    assert_eq!(both.lang_feat.unwrap().values.len(), 10);
}

#[test]
fn turns_keep_the_scene_where_nothing_is_asked() {
    let scene = full(30, 3, 8);
    assert_eq!(SceneEdit::default().apply(scene.clone()).unwrap().0, scene);
    let mut same = scene.clone();
    same.transform(&Similarity::IDENTITY);
    assert_eq!(same, scene);
}
