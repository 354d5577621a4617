//! Scenes in plain PLY files: reading, defaults, writing.

use crate::common::ply::{Encoding, inria_columns, ply_bytes};
use crate::common::{check_unit, labelled, random_scene, strict};
use scenesplat_scene::formats::inria_ply::write_inria_ply;
use scenesplat_scene::formats::ply::{ColumnValues, PlyColumn, PlyFile};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    LoadedScene, ReadOptions, SceneError, SceneFormat, open_scene, open_scene_bytes,
};
use std::path::Path;

fn open(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    open_with(bytes, &ReadOptions::default())
}

fn open_with(bytes: &[u8], options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    open_scene_bytes(bytes, Path::new("scene.ply"), options)
}

fn columns(rows: usize) -> Vec<(String, Vec<f32>)> {
    inria_columns(&random_scene(rows, 1, 9))
}

fn without(prefix: &str) -> Vec<(String, Vec<f32>)> {
    columns(4).into_iter().filter(|(name, _)| !name.starts_with(prefix)).collect()
}

fn le(columns: &[(String, Vec<f32>)]) -> Vec<u8> {
    ply_bytes(columns, Encoding::Little, "\n")
}

#[test]
fn every_degree_survives_writing_and_reading() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    for degree in 0..=4 {
        let mut scene = labelled(300, degree);
        scene.opacity_logit[0] = f32::INFINITY;
        scene.log_scale[1][2] = f32::NEG_INFINITY;
        scene.normal = Some(vec![[0.0, 0.6, 0.8]; 300]);
        let score = vec![0.25; 300];
        let extra = [PlyColumn { name: "extra", values: ColumnValues::F32(&score) }];
        write_inria_ply(&scene, &extra, &path).unwrap();
        let loaded = open_scene(&path, &strict()).unwrap();
        assert_eq!(loaded.scene, scene, "degree {degree}");
        assert_eq!(loaded.kind, SceneFormat::Ply);
        assert!(loaded.kept_rows.is_none());
        let file = PlyFile::open(&path).unwrap();
        assert_eq!(file.column_f32("vertex", "extra").unwrap(), score);
        let names: Vec<_> =
            file.element("vertex").unwrap().properties.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names[..9], ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
        let end = "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 segment score instance \
                   lang_code_0 lang_code_1 lang_code_2 extra";
        let end: Vec<&str> = end.split(' ').collect();
        assert!(names.ends_with(&end), "{names:?}");
        assert_eq!(names.len(), 9 + scene.sh_rest_len() * 3 + end.len());
    }
}

#[test]
fn coefficients_are_planar_in_the_file_and_interleaved_in_memory() {
    // Degree 1: f_rest_0..2 are red, 3..5 green, 6..8 blue.
    let mut columns = columns(1);
    for (name, values) in &mut columns {
        if let Some(i) = name.strip_prefix("f_rest_") {
            values[0] = i.parse().unwrap();
        }
    }
    let scene = open(&le(&columns)).unwrap().scene;
    assert_eq!(scene.sh_rest, [0.0, 3.0, 6.0, 1.0, 4.0, 7.0, 2.0, 5.0, 8.0]);
}

#[test]
fn encodings_and_property_orders_give_the_same_scene() {
    let scene = random_scene(50, 2, 3);
    let mut columns = inria_columns(&scene);
    for turn in 0..columns.len() {
        columns.rotate_left(turn % 7 + 1);
        let i = turn % (columns.len() - 1);
        columns.swap(i, i + 1);
        let encoding = [Encoding::Ascii, Encoding::Little, Encoding::Big][turn % 3];
        let loaded = open(&ply_bytes(&columns, encoding, "\r\n")).unwrap();
        assert_eq!(loaded.scene, scene, "{encoding:?}, turn {turn}");
    }
}

#[test]
fn each_missing_group_has_its_default_and_is_reported() {
    let check = |prefix: &str, rule: Rule, test: &dyn Fn(&LoadedScene) -> bool| {
        let bytes = le(&without(prefix));
        let loaded = open(&bytes).unwrap();
        assert_eq!(loaded.report.count(rule), 4, "{prefix}");
        assert!(test(&loaded), "{prefix}: {:?}", loaded.scene);
        let error = open_with(&bytes, &strict()).unwrap_err().to_string();
        assert!(error.contains(rule.about().field), "{error}");
    };
    check("opacity", Rule::OpacityMissing, &|l| (0..4).all(|r| l.scene.opacity(r) == 1.0));
    check("rot_", Rule::QuatMissing, &|l| l.scene.quat.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0]));
    check("f_dc", Rule::ColorMissing, &|l| (0..4).all(|r| l.scene.color_u8(r) == [128; 3]));
    check("scale_2", Rule::ScaleTwo, &|l| (l.scene.scale(1)[2] / 1e-7 - 1.0).abs() < 1e-5);
    check("scale_", Rule::ScaleMissing, &|l| (l.scene.scale(1)[2] - 0.01).abs() < 1e-8);
    let one: Vec<_> = without("scale_1").into_iter().filter(|c| c.0 != "scale_2").collect();
    let loaded = open(&le(&one)).unwrap();
    assert_eq!(loaded.report.count(Rule::ScaleOne), 4);
    assert!(loaded.scene.log_scale.iter().all(|s| s[0] == s[1] && s[1] == s[2] && s[0] < -2.0));
}

#[test]
fn groups_in_part_and_odd_counts_are_refused() {
    for name in ["x", "scale_0", "rot_2", "f_dc_1", "f_rest_4"] {
        let error = open(&le(&without(name))).unwrap_err().to_string();
        assert!(error.contains("lack") || error.contains("f_rest"), "{name}: {error}");
    }
    let mut gap = columns(4);
    gap.iter_mut().find(|c| c.0 == "f_rest_3").unwrap().0 = "f_rest_9".into();
    assert!(open(&le(&gap)).unwrap_err().to_string().contains("f_rest_3"));
    let all: Vec<_> =
        columns(4).into_iter().filter(|c| !["x", "y", "z"].contains(&&*c.0)).collect();
    assert!(open(&le(&all)).unwrap_err().to_string().contains("x, y or z missing"));
}

#[test]
fn bytes_of_color_are_kept_exactly() {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 256\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n".to_vec();
    for i in 0..=255u8 {
        [0.0f32; 3].iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        bytes.extend_from_slice(&[i, 255 - i, i.wrapping_mul(7)]);
    }
    let loaded = open(&bytes).unwrap();
    for i in 0..=255u8 {
        assert_eq!(loaded.scene.color_u8(usize::from(i)), [i, 255 - i, i.wrapping_mul(7)]);
    }
    assert_eq!(loaded.report.count(Rule::ColorFromBytes), 256);
}

#[test]
fn one_bad_value_in_each_column_is_handled_by_the_table() {
    let names: Vec<String> = columns(5).into_iter().map(|c| c.0).collect();
    for name in names {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-42, 3e38, -3e38] {
            let mut columns = columns(5);
            columns.iter_mut().find(|c| c.0 == name).unwrap().1[3] = bad;
            let loaded = open(&le(&columns)).unwrap();
            let finite = bad.is_finite();
            let dropped = match &*name {
                "x" | "y" | "z" => !finite,
                "opacity" => bad.is_nan(),
                n if n.starts_with("scale") => bad.is_nan() || bad == f32::INFINITY,
                _ => false,
            };
            let case = format!("{name} = {bad}");
            assert_eq!(loaded.kept_rows, dropped.then(|| vec![0, 1, 2, 4]), "{case}");
            assert_eq!(loaded.report.dropped_rows, usize::from(dropped), "{case}");
            let legal = finite
                || name == "opacity" && !bad.is_nan()
                || name.starts_with("scale") && bad == f32::NEG_INFINITY;
            assert_eq!(loaded.report.is_clean(), legal, "{case}: {}", loaded.report);
            if !legal {
                let finding = loaded.report.findings.iter().find(|f| f.first_element == 3).unwrap();
                assert_eq!(finding.count, 1, "{case}");
            }
            assert_eq!(open_with(&le(&columns), &strict()).is_ok(), legal, "{case}");
            let all_rows = loaded.to_source_rows(&vec![1; loaded.scene.len()], -1).unwrap();
            assert_eq!(all_rows, if dropped { [1, 1, 1, -1, 1] } else { [1; 5] }, "{case}");
            check_unit(&loaded.scene);
            let (dc, rest) = (loaded.scene.sh_dc.as_flattened(), &loaded.scene.sh_rest);
            assert!(dc.iter().chain(rest).all(|v| v.is_finite()), "{case}");
        }
    }
}

#[test]
fn half_turns_and_no_rotation() {
    let mut columns = columns(3);
    for (i, values) in [[0.0, 0.0, 2.0], [0.0, -2.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        .into_iter()
        .enumerate()
    {
        columns.iter_mut().find(|c| c.0 == format!("rot_{i}")).unwrap().1 = values.to_vec();
    }
    let loaded = open(&le(&columns)).unwrap();
    assert_eq!(
        loaded.scene.quat,
        [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    );
    assert_eq!(loaded.report.count(Rule::QuatZero), 1);
    assert_eq!(loaded.report.count(Rule::QuatHalfTurn), 1);
}

#[test]
fn labels_of_any_type_and_name() {
    let mut columns = columns(3);
    columns.push(("label".into(), vec![2.0, -1.0, 1.5]));
    columns.push(("segment20".into(), vec![7.0, 8.0, 9.0]));
    let loaded = open(&le(&columns)).unwrap();
    assert_eq!(loaded.scene.segment.unwrap(), [2, -1, -1]);
    assert_eq!(loaded.report.count(Rule::SegmentInvalid), 1);
    let options = ReadOptions { segment: Some("segment20".into()), ..ReadOptions::default() };
    assert_eq!(open_with(&le(&columns), &options).unwrap().scene.segment.unwrap(), [7, 8, 9]);
    let options = ReadOptions { segment: Some("segment200".into()), ..ReadOptions::default() };
    assert!(open_with(&le(&columns), &options).unwrap_err().to_string().contains("segment200"));
}

#[test]
fn zero_normals_are_no_normals() {
    let mut columns = columns(2);
    for name in ["nx", "ny", "nz"] {
        columns.push((name.into(), vec![0.0, 0.0]));
    }
    assert!(open(&le(&columns)).unwrap().scene.normal.is_none());
    columns.last_mut().unwrap().1[1] = 2.0;
    assert_eq!(open(&le(&columns)).unwrap().scene.normal.unwrap(), [[0.0; 3], [0.0, 0.0, 1.0]]);
}

#[test]
fn one_gaussian_is_a_scene_and_none_is_not() {
    assert_eq!(open(&le(&columns(1))).unwrap().scene.len(), 1);
    let error = open(&le(&columns(0))).unwrap_err().to_string();
    assert!(error.contains("no Gaussian at all") && error.contains("export"), "{error}");
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    assert!(write_inria_ply(&random_scene(0, 0, 0), &[], &path).is_err());
    let mut ragged = random_scene(2, 1, 0);
    ragged.sh_rest.pop();
    assert!(write_inria_ply(&ragged, &[], &path).is_err());
    let taken = [PlyColumn { name: "opacity", values: ColumnValues::F32(&[0.0; 2]) }];
    assert!(write_inria_ply(&random_scene(2, 0, 0), &taken, &path).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn rows_the_header_does_not_count_are_reported() {
    let mut bytes = le(&columns(3));
    bytes.extend_from_slice(&[1; 17]);
    let loaded = open(&bytes).unwrap();
    assert_eq!(loaded.scene.len(), 3);
    assert_eq!(loaded.report.finding(Rule::FileTrailing).unwrap().example, "17 bytes");
    assert!(open_with(&bytes, &strict()).is_err());
}
