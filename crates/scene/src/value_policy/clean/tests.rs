use super::*;

fn scene(rows: usize) -> GaussianScene {
    GaussianScene {
        coord: (0..rows).map(|i| [i as f32, 0.0, 0.0]).collect(),
        log_scale: vec![[-4.0; 3]; rows],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; rows],
        opacity_logit: vec![0.5; rows],
        sh_dc: vec![[0.1, 0.2, 0.3]; rows],
        ..GaussianScene::default()
    }
}

fn clean(scene: GaussianScene) -> (GaussianScene, Option<Vec<u32>>, RepairReport) {
    let mut report = RepairReport::default();
    let (scene, kept) = clean_scene(scene, &mut report, Policy::Repair, Path::new("test")).unwrap();
    (scene, kept, report)
}

#[test]
fn a_clean_scene_is_unchanged() {
    let (out, kept, report) = clean(scene(3));
    assert_eq!(out, scene(3));
    assert!(kept.is_none() && report.findings.is_empty());
}

#[test]
fn rows_without_position_size_or_opacity_are_dropped_and_traceable() {
    let mut s = scene(6);
    s.coord[0][2] = f32::NEG_INFINITY;
    s.log_scale[2][1] = f32::NAN;
    s.log_scale[3][1] = f32::INFINITY;
    s.opacity_logit[5] = f32::NAN;
    let (out, kept, report) = clean(s);
    assert_eq!(kept.unwrap(), [1, 4]);
    assert_eq!(out.coord, [[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]);
    assert_eq!(report.dropped_rows, 4);
    assert_eq!(report.source_rows, 6);
    for (rule, row) in [
        (Rule::CoordNotFinite, 0),
        (Rule::ScaleNan, 2),
        (Rule::ScaleInfinite, 3),
        (Rule::OpacityNan, 5),
    ] {
        let finding = report.finding(rule).unwrap();
        assert_eq!((finding.count, finding.first_element), (1, row), "{rule:?}");
    }
    assert_eq!(report.finding(Rule::CoordNotFinite).unwrap().example, "-inf");
}

#[test]
fn infinities_that_mean_something_are_kept() {
    let mut s = scene(2);
    s.log_scale[0][2] = f32::NEG_INFINITY;
    s.opacity_logit = vec![f32::INFINITY, f32::NEG_INFINITY];
    let (out, kept, report) = clean(s.clone());
    assert_eq!(out, s);
    assert!(kept.is_none() && report.is_clean());
    assert_eq!(report.count(Rule::OpacityInfinite), 2);
    assert_eq!(report.count(Rule::ScaleZero), 1);
}

#[test]
fn quaternions_become_unit_with_w_not_negative() {
    let mut s = scene(8);
    s.quat = vec![
        [0.0; 4],
        [f32::NAN, 0.0, 0.0, 1.0],
        [0.0, 0.0, 3.0, 4.0],
        [-1.0, 0.0, 0.0, 0.0],
        [1e-30, 0.0, 1e-30, 0.0],
        [3e38, 3e38, 3e38, 3e38],
        [0.0, 0.0, -1.0, 0.0],
        [1.0, f32::INFINITY, 0.0, 0.0],
    ];
    let (out, _, report) = clean(s);
    let half = 0.5f32.sqrt();
    assert_eq!(
        out.quat,
        [
            [1.0, 0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.6, 0.8],
            [1.0, 0.0, 0.0, 0.0],
            [half, 0.0, half, 0.0],
            [0.5; 4],
            [0.0, 0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
        ]
    );
    assert_eq!(report.count(Rule::QuatZero), 1);
    assert_eq!(report.count(Rule::QuatNotFinite), 2);
    assert_eq!(report.count(Rule::QuatNotUnit), 3);
    assert_eq!(report.count(Rule::QuatHalfTurn), 2);
    let again = clean(out.clone()).0;
    assert_eq!(again, out, "cleaning twice is cleaning once");
}

#[test]
fn normalising_is_idempotent_for_any_direction() {
    let mut s = scene(20_000);
    let mut state = 1u32;
    for value in s.quat.iter_mut().flatten() {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *value = (state >> 8) as f32 / 8_388_608.0 - 1.0;
    }
    let once = clean(s).0;
    assert_eq!(clean(once.clone()).0.quat, once.quat);
    assert!(once.quat.iter().all(|q| q[0] >= 0.0));
}

#[test]
fn colors_and_coefficients_are_repaired_in_place() {
    let mut s = scene(2);
    s.sh_dc[1] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    s.sh_degree = 1;
    s.sh_rest = vec![1e-40; 18];
    s.sh_rest[10] = f32::NAN;
    s.sh_rest[11] = 3e38;
    let (out, kept, report) = clean(s);
    assert!(kept.is_none());
    assert_eq!(out.sh_dc[1][0], 0.0);
    assert_eq!(out.color_u8(1), [127, 255, 0]);
    assert_eq!(out.sh_rest[10], 0.0);
    assert_eq!(out.sh_rest[11], 3e38);
    assert_eq!(out.sh_rest[0], 1e-40);
    assert_eq!(report.count(Rule::RestNotFinite), 1);
    assert_eq!(report.finding(Rule::RestNotFinite).unwrap().first_element, 1);
    assert_eq!((report.count(Rule::ColorNan), report.count(Rule::ColorInfinite)), (1, 1));
}

#[test]
fn normals_are_unit_or_unknown() {
    let mut s = scene(3);
    s.normal = Some(vec![[0.0, 3.0, 4.0], [0.0; 3], [f32::NAN, 0.0, 1.0]]);
    let (out, _, report) = clean(s.clone());
    assert_eq!(out.normal.unwrap(), [[0.0, 0.6, 0.8], [0.0; 3], [0.0; 3]]);
    assert_eq!(report.count(Rule::NormalNotFinite), 1);
    s.normal = Some(vec![[0.0; 3]; 3]);
    let (out, _, report) = clean(s);
    assert!(out.normal.is_none() && report.is_clean());
}

#[test]
fn features_that_are_not_finite_are_masked_out() {
    use half::f16;
    let mut s = scene(2);
    let values = vec![f16::ONE, f16::ONE, f16::ONE, f16::NAN];
    s.lang_feat = Some(crate::LanguageFeatures { values, dim: 2 });
    s.valid_feat_mask = Some(vec![true; 2]);
    let (out, _, report) = clean(s);
    assert_eq!(out.valid_feat_mask.unwrap(), [true, false]);
    assert_eq!(out.lang_feat.unwrap().values, [f16::ONE, f16::ONE, f16::ZERO, f16::ZERO]);
    assert_eq!(report.count(Rule::FeatureNotFinite), 1);
}

#[test]
fn no_row_and_no_usable_row_are_errors() {
    let path = Path::new("some.ply");
    let mut report = RepairReport::default();
    let error = clean_scene(scene(0), &mut report, Policy::Repair, path).unwrap_err().to_string();
    assert!(error.contains("some.ply") && error.contains("no Gaussian at all"), "{error}");
    let mut s = scene(2);
    s.coord = vec![[f32::NAN; 3]; 2];
    let error = clean_scene(s, &mut report, Policy::Repair, path).unwrap_err().to_string();
    assert!(error.contains("some.ply") && error.contains("no Gaussian is usable"), "{error}");
}

#[test]
fn findings_of_many_tasks_name_the_first_row() {
    let rows = 3 * ROWS_PER_TASK;
    let mut s = scene(rows);
    for row in [ROWS_PER_TASK + 5, 2 * ROWS_PER_TASK + 1, rows - 1] {
        s.opacity_logit[row] = f32::NAN;
    }
    let (out, kept, report) = clean(s);
    assert_eq!(out.len(), rows - 3);
    assert_eq!(kept.unwrap().len(), rows - 3);
    let finding = report.finding(Rule::OpacityNan).unwrap();
    assert_eq!((finding.count, finding.first_element), (3, ROWS_PER_TASK + 5));
}

#[test]
fn scores_that_say_nothing_become_0() {
    let mut before = scene(4);
    before.segment_score = Some(vec![0.5, f32::NAN, f32::INFINITY, -1.0]);
    let mut report = RepairReport::default();
    let (after, kept) =
        clean_scene(before, &mut report, Policy::Repair, Path::new("a.ply")).unwrap();
    assert_eq!(after.segment_score, Some(vec![0.5, 0.0, f32::INFINITY, -1.0]));
    assert_eq!((report.count(Rule::ScoreNan), kept), (1, None));
    assert_eq!(report.finding(Rule::ScoreNan).unwrap().first_element, 1);
}
