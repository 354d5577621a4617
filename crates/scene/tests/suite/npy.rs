//! Arrays and preprocessed folders.

use crate::common::{labelled, npy_bytes, open, strict};
use half::f16;
use scenesplat_scene::formats::npy::{NpyFile, NpyType};
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::npy_writer::{NpyRowWriter, write_npy};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    GaussianScene, LabelledPoints, LanguageFeatures, ReadOptions, SceneError, SceneFormat,
    open_scene,
};
use std::path::Path;

fn parse(bytes: &[u8]) -> Result<NpyFile, SceneError> {
    NpyFile::from_bytes(bytes, Path::new("a.npy"))
}

fn dict(descr: &str, fortran: bool, shape: &str) -> String {
    let order = if fortran { "True" } else { "False" };
    format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}")
}

#[test]
fn every_type_and_byte_order() {
    macro_rules! check {
        ($($ty:ty, $kind:literal, $expected:expr, [$($v:expr),*];)*) => {$({
            let values: &[$ty] = &[$($v),*];
            let wide: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
            for (order, big) in [("<", false), (">", true)] {
                let bytes: Vec<u8> = values
                    .iter()
                    .flat_map(|v| if big { v.to_be_bytes() } else { v.to_le_bytes() })
                    .collect();
                let descr = format!("{order}{}", $kind);
                for version in 1..=3 {
                    let text = dict(&descr, false, &format!("({},)", values.len()));
                    let file = parse(&npy_bytes(version, &text, &bytes)).unwrap();
                    assert_eq!(file.ty(), $expected);
                    assert_eq!(file.read_f64().unwrap(), wide, "{descr}");
                    let f32s: Vec<f32> = wide.iter().map(|&v| v as f32).collect();
                    assert_eq!(file.read_f32().unwrap(), f32s, "{descr}");
                    let f16s: Vec<f16> = wide.iter().map(|&v| f16::from_f64(v)).collect();
                    assert_eq!(file.read_f16().unwrap(), f16s, "{descr}");
                }
            }
        })*};
    }
    check! {
        i8, "i1", NpyType::Int(1), [-128, 0, 127];
        u8, "u1", NpyType::UInt(1), [0, 128, 255];
        i16, "i2", NpyType::Int(2), [i16::MIN, -1, 300, i16::MAX];
        u16, "u2", NpyType::UInt(2), [0, 300, u16::MAX];
        i32, "i4", NpyType::Int(4), [i32::MIN, -1, 70_000, i32::MAX];
        u32, "u4", NpyType::UInt(4), [0, 70_000, u32::MAX];
        f16, "f2", NpyType::Float(2), [f16::from_f32(0.1), f16::MIN, f16::INFINITY];
        f32, "f4", NpyType::Float(4), [0.1, f32::MIN_POSITIVE, f32::NEG_INFINITY];
        f64, "f8", NpyType::Float(8), [0.1, 1e300, -2.0];
    }
    let bytes: Vec<u8> = [i64::MIN, -1, i64::MAX].iter().flat_map(|v| v.to_be_bytes()).collect();
    let file = parse(&npy_bytes(1, &dict(">i8", false, "(3L,)"), &bytes)).unwrap();
    assert_eq!(file.read_i64().unwrap(), [i64::MIN, -1, i64::MAX]);
    let file = parse(&npy_bytes(1, &dict("|b1", false, "(2, 1)"), &[0, 1])).unwrap();
    assert_eq!(file.read_u8().unwrap(), [0, 1]);
    let file = parse(&npy_bytes(1, &dict("<f4", false, "()"), &2.0f32.to_le_bytes())).unwrap();
    assert_eq!(file.read_i64().unwrap(), [2]);
    assert!(file.shape().is_empty());
}

#[test]
fn fortran_order_is_turned() {
    // Column by column: the matrix is [[0, 1, 2], [3, 4, 5]].
    let data = [0u8, 3, 1, 4, 2, 5];
    let file = parse(&npy_bytes(1, &dict("|u1", true, "(2, 3)"), &data));
    assert_eq!(file.unwrap().read_u8().unwrap(), [0, 1, 2, 3, 4, 5]);
    let file = parse(&npy_bytes(1, &dict("|u1", true, "(1, 2, 3)"), &data));
    assert!(file.err().unwrap().to_string().contains("Fortran"));
    for shape in ["(0, 3)", "(3, 0)"] {
        let file = parse(&npy_bytes(1, &dict("|u1", true, shape), &[])).unwrap();
        assert!(file.read_u8().unwrap().is_empty());
    }
}

#[test]
fn numbers_that_do_not_fit_are_errors() {
    let data: Vec<u8> = [1.0f32, 2.5].iter().flat_map(|v| v.to_le_bytes()).collect();
    let file = parse(&npy_bytes(1, &dict("<f4", false, "(2,)"), &data)).unwrap();
    assert!(file.read_i64().unwrap_err().to_string().contains("element 1"));
    let data = u64::MAX.to_le_bytes();
    let file = parse(&npy_bytes(1, &dict("<u8", false, "(1,)"), &data)).unwrap();
    assert!(file.read_i64().is_err());
    let file = parse(&npy_bytes(1, &dict("<i2", false, "(1,)"), &[0, 1])).unwrap();
    assert!(file.read_u8().unwrap_err().to_string().contains("256"));
}

#[test]
fn lying_headers_are_errors() {
    let good = dict("<f4", false, "(2, 3)");
    assert!(parse(&npy_bytes(1, &good, &[0; 24])).is_ok());
    for (text, bytes) in [
        (good.as_str(), 23),
        (&good, 25),
        (&good, 0),
        (&dict("<f4", false, "(1099511627776, 3)"), 24),
        (&dict("<f4", false, "(4294967296, 4294967296, 4294967296)"), 24),
        (&dict("<f4", false, "(18446744073709551615, 18446744073709551615)"), 24),
        (&dict("<f4", false, "(99999999999999999999,)"), 24),
        (&dict("<f4", false, "(0, 18446744073709551615)"), 24),
        (&dict("<f4", false, "(-2, -3)"), 24),
        (&dict("<f4", false, "(2, 3"), 24),
        (&dict("<f4", false, "(2,, 3)"), 24),
        (&dict("<f3", false, "(2, 3)"), 24),
        (&dict("|O", false, "(2, 3)"), 24),
        (&dict("<U4", false, "(2, 3)"), 24),
        (&dict("\u{e9}f4", false, "(2, 3)"), 24),
        ("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (6,), }", 24),
        ("{'descr': '<f4', 'shape': (6,), }", 24),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (6,), } x", 24),
        ("{", 24),
        ("", 24),
    ] {
        assert!(parse(&npy_bytes(1, text, &vec![0; bytes])).is_err(), "{text}");
    }
    let whole = npy_bytes(2, &good, &[0; 24]);
    let mut long = whole.clone();
    long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(parse(&long).is_err());
    let mut version = whole;
    version[6] = 4;
    assert!(parse(&version).is_err());
}

#[test]
fn arrays_survive_writing_and_reading() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    write_npy(&path, &[2, 3], &[1.0f32, -0.0, f32::MIN_POSITIVE, 4.0, 5.0, f32::INFINITY]).unwrap();
    let file = NpyFile::open(&path).unwrap();
    assert_eq!(file.shape(), [2, 3]);
    assert_eq!(file.read_f32().unwrap()[5], f32::INFINITY);
    write_npy(&path, &[3], &[i32::MIN, 0, i32::MAX]).unwrap();
    let expected = [i64::from(i32::MIN), 0, i64::from(i32::MAX)];
    assert_eq!(NpyFile::open(&path).unwrap().read_i64().unwrap(), expected);
    write_npy(&path, &[2, 1], &[f16::ONE, f16::MIN_POSITIVE_SUBNORMAL]).unwrap();
    let file = NpyFile::open(&path).unwrap();
    assert_eq!(file.ty(), NpyType::Float(2));
    assert_eq!(file.read_f16().unwrap(), [f16::ONE, f16::MIN_POSITIVE_SUBNORMAL]);
    write_npy(&path, &[0, 3], &[] as &[u8]).unwrap();
    assert_eq!(NpyFile::open(&path).unwrap().shape(), [0, 3]);
    write_npy(&path, &[], &[7u8]).unwrap();
    assert_eq!(NpyFile::open(&path).unwrap().read_u8().unwrap(), [7]);
    assert!(write_npy(&path, &[2, 3], &[0u8; 5]).is_err());
    assert!(write_npy(&path, &[2, 3], &[0u8; 9]).is_err());
    assert_eq!(NpyFile::open(&path).unwrap().read_u8().unwrap(), [7], "the old file stays");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn rows_may_come_in_any_order_from_any_thread() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let rows: Vec<[f32; 2]> = (0..1000).map(|i| [i as f32, -(i as f32)]).collect();
    let writer = NpyRowWriter::<f32>::create(&path, 1000, &[2]).unwrap();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (writer, rows) = (&writer, &rows);
            scope.spawn(move || {
                for part in (0..10).rev().filter(|part| part % 4 == thread) {
                    let rows = rows[part * 100..part * 100 + 100].as_flattened();
                    assert_eq!(writer.write_rows_at(part * 100, rows).unwrap(), 100);
                }
            });
        }
    });
    assert!(!path.exists(), "nothing is there before the end");
    writer.finish().unwrap();
    assert_eq!(NpyFile::open(&path).unwrap().read_f32().unwrap(), rows.as_flattened());

    let mut writer = NpyRowWriter::<f32>::create(&path, 3, &[2]).unwrap();
    writer.write_rows(&[1.0, 2.0]).unwrap();
    assert!(writer.write_rows(&[1.0]).is_err(), "half a row");
    assert!(writer.write_rows(&[0.0; 6]).is_err(), "too many rows");
    assert!(writer.write_rows_at(usize::MAX, &[0.0; 2]).is_err());
    writer.write_rows_at(2, &[5.0, 6.0]).unwrap();
    let error = writer.finish().unwrap_err().to_string();
    assert!(error.contains("row 1 of 3"), "{error}");
    let mut writer = NpyRowWriter::<f32>::create(&path, 3, &[2]).unwrap();
    writer.write_rows(&[1.0, 2.0]).unwrap();
    writer.finish_with_zeros().unwrap();
    assert_eq!(NpyFile::open(&path).unwrap().read_f32().unwrap(), [1.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
    assert!(NpyRowWriter::<f32>::create(&path, usize::MAX, &[2]).is_err());
    drop(NpyRowWriter::<f32>::create(&path, 3, &[2]).unwrap());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

fn full_scene() -> GaussianScene {
    let n = 200;
    let mut scene = labelled(n, 0);
    // Colors that are exactly a byte, every byte among them.
    for (row, dc) in scene.sh_dc.iter_mut().enumerate() {
        *dc = [row as u8, (row as u8).wrapping_add(56), 255 - row as u8]
            .map(scenesplat_scene::gaussian_scene::u8_to_dc);
    }
    scene.opacity_logit[0] = f32::INFINITY;
    scene.opacity_logit[1] = f32::NEG_INFINITY;
    scene.log_scale[2][0] = f32::NEG_INFINITY;
    scene.normal = Some(vec![[0.6, 0.0, -0.8]; n]);
    let mut values = vec![f16::from_f32(0.25); n * 8];
    values[..8].fill(f16::ZERO);
    scene.lang_feat = Some(LanguageFeatures { values, dim: 8 });
    scene.valid_feat_mask = Some((0..n).map(|i| i > 0).collect());
    scene.labelled_points = Some(LabelledPoints {
        coord: vec![[1.0, 2.0, 3.0]; 7],
        segment: Some((0..7).collect()),
        instance: Some(vec![-1; 7]),
    });
    scene
}

#[test]
fn a_folder_holds_the_whole_scene() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    let scene = full_scene();
    write_npy_folder(&scene, &folder, false).unwrap();
    let loaded = open_scene(&folder, &strict()).unwrap();
    assert_eq!(loaded.kind, SceneFormat::NpyFolder);
    let mut back = loaded.scene;
    for row in 0..scene.len() {
        // Activated and back in f32: a relative error of the probability or scale of a few ulp.
        assert!((back.opacity(row) - scene.opacity(row)).abs() < 1e-6);
        let (a, b) = (back.scale(row), scene.scale(row));
        assert!((0..3).all(|i| (a[i] - b[i]).abs() <= b[i] * 1e-6));
    }
    assert_eq!(back.opacity_logit[..2], [f32::INFINITY, f32::NEG_INFINITY]);
    assert_eq!(back.log_scale[2][0], f32::NEG_INFINITY);
    back.opacity_logit.clone_from(&scene.opacity_logit);
    back.log_scale.clone_from(&scene.log_scale);
    assert_eq!(back, scene);

    let types: Vec<_> = ["color", "lang_feat", "valid_feat_mask", "coord"]
        .iter()
        .map(|stem| NpyFile::open(&folder.join(format!("{stem}.npy"))).unwrap().ty())
        .collect();
    assert_eq!(types, [NpyType::UInt(1), NpyType::Float(2), NpyType::Int(8), NpyType::Float(4)]);

    let options = ReadOptions { lang_feat: false, ..ReadOptions::default() };
    let loaded = open_scene(&folder, &options).unwrap();
    assert!(loaded.scene.lang_feat.is_none() && loaded.scene.valid_feat_mask.is_some());
}

#[test]
fn labels_may_be_chosen_and_have_several_columns() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    write_npy(&folder.join("coord.npy"), &[2, 3], &[0.5f32; 6]).unwrap();
    write_npy(&folder.join("segment20.npy"), &[2], &[3i16, -100]).unwrap();
    let open = |segment: Option<&str>| {
        let options = ReadOptions { segment: segment.map(str::to_owned), ..ReadOptions::default() };
        open_scene(folder, &options)
    };
    let loaded = open(None).unwrap();
    assert_eq!(loaded.scene.segment.unwrap(), [3, -1], "the only labels are taken");
    assert_eq!(loaded.report.count(Rule::SegmentNone), 1);
    write_npy(&folder.join("segment200.npy"), &[2], &[30i64, 40]).unwrap();
    let loaded = open(None).unwrap();
    assert!(loaded.scene.segment.is_none());
    assert!(loaded.report.to_string().contains("segment20, segment200"), "{}", loaded.report);
    assert_eq!(open(Some("segment200")).unwrap().scene.segment.unwrap(), [30, 40]);
    let error = open(Some("segment_nyu_160")).unwrap_err().to_string();
    assert!(
        error.contains("segment_nyu_160.npy") && error.contains("segment20, segment200"),
        "{error}"
    );
    write_npy(&folder.join("segment.npy"), &[2, 3], &[7i32, 8, 9, 10, 11, 12]).unwrap();
    assert_eq!(open(None).unwrap().scene.segment.unwrap(), [7, 10]);
    write_npy(
        &folder.join("pc_coord.npy"),
        &[3, 3],
        &[0.0f32, 0.0, 0.0, f32::NAN, 0.0, 0.0, 1.0, 1.0, 1.0],
    )
    .unwrap();
    write_npy(&folder.join("pc_segment200.npy"), &[3], &[1i32, 2, 3]).unwrap();
    let loaded = open(Some("segment200")).unwrap();
    let points = loaded.scene.labelled_points.unwrap();
    assert_eq!(points.segment.unwrap(), [1, 3]);
    assert_eq!(points.coord.len(), 2);
    assert_eq!(loaded.report.count(Rule::PointNotFinite), 1);
}

#[test]
fn values_of_folders_follow_the_table() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    write_npy(&folder.join("coord.npy"), &[6, 3], &(0..18).map(|v| v as f32).collect::<Vec<_>>())
        .unwrap();
    write_npy(&folder.join("opacity.npy"), &[6, 1], &[0.0f32, 1.0, 1.5, -0.5, f32::NAN, 0.5])
        .unwrap();
    let mut scale = [0.1f32; 18];
    scale[3] = -1.0;
    scale[0] = 0.0;
    write_npy(&folder.join("scale.npy"), &[6, 3], &scale).unwrap();
    let loaded = open(folder);
    assert_eq!(loaded.kept_rows.as_deref(), Some(&[0, 2, 3, 5][..]));
    let alpha: Vec<f32> = (0..4).map(|row| loaded.scene.opacity(row)).collect();
    assert_eq!(alpha, [0.0, 1.0, 0.0, 0.5]);
    assert_eq!(loaded.report.count(Rule::OpacityOutside), 2);
    assert_eq!(loaded.report.count(Rule::OpacityNan), 1);
    assert_eq!(loaded.report.count(Rule::ScaleNan), 1);
    assert_eq!(loaded.report.count(Rule::ScaleZero), 1);
    assert_eq!(loaded.report.count(Rule::QuatMissing), 6);
    assert_eq!(loaded.report.count(Rule::ColorMissing), 6);
    assert_eq!(loaded.scene.color_u8(0), [128; 3]);

    for (stem, shape) in
        [("scale", [5, 3]), ("quat", [6, 3]), ("color", [6, 4]), ("normal", [7, 3])]
    {
        let path = folder.join(format!("{stem}.npy"));
        let old = std::fs::read(&path).ok();
        write_npy(&path, &shape, &vec![0.5f32; shape[0] * shape[1]]).unwrap();
        let error = open_scene(folder, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains(stem) && error.contains("(6, "), "{error}");
        std::fs::remove_file(&path).unwrap();
        if let Some(old) = old {
            std::fs::write(&path, old).unwrap();
        }
    }
    assert!(open_scene(folder, &ReadOptions::default()).is_ok());
    std::fs::remove_file(folder.join("coord.npy")).unwrap();
    assert!(
        open_scene(folder, &ReadOptions::default()).unwrap_err().to_string().contains("coord.npy")
    );
}
