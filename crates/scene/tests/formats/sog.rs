//! Scenes as textures: files of other programs, and what is written comes back.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{SplitMix, random_scene, shared};
use half::f16;
use scenesplat_scene::formats::sog::{
    is_lod_meta_json, is_sog_archive, is_sog_folder, is_sog_meta_json, read_sog, read_sog_archive,
    write_sog, write_sog_folder,
};
use scenesplat_scene::{
    GaussianScene, LanguageCode, LanguageCodebook, LoadedScene, Policy, ReadOptions, SceneError,
    SceneFormat, WriteOptions, WriteReport, open_scene,
};
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::path::Path;

const PLAYBOT: &str = "real/objects/playbot_sog2_lod";

fn strict() -> ReadOptions {
    // Real files need no repair, so the strict policy must take them.
    ReadOptions { policy: Policy::Strict, ..ReadOptions::default() }
}

fn real(relative: &str) -> Option<LoadedScene> {
    Some(read_sog(&shared(relative)?, &strict()).unwrap())
}

fn archive_of(scene: &GaussianScene) -> (Vec<u8>, WriteReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.sog");
    let report = write_sog(scene, &path, &WriteOptions::default(), &mut |_| true).unwrap();
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(bytes.len() as u64, report.bytes);
    (bytes, report)
}

fn folder_of(scene: &GaussianScene, folder: &Path) -> Result<WriteReport, SceneError> {
    write_sog_folder(scene, &folder.join("meta.json"), &WriteOptions::default(), &mut |_| true)
}

fn read(bytes: &[u8]) -> GaussianScene {
    read_sog_archive(bytes, Path::new("a.sog"), &strict()).unwrap().scene
}

fn files_in(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        (path.file_name().unwrap().to_str().unwrap().to_owned(), std::fs::read(path).unwrap())
    });
    files.collect()
}

/// Writes, reads, writes again, compares; gives what was read.
fn fixed_point(scene: &GaussianScene, what: &str) -> GaussianScene {
    let (first, report) = archive_of(scene);
    let back = read(&first);
    assert_eq!(back.len(), scene.len(), "{what}");
    let (second, second_report) = archive_of(&back);
    assert!(first == second, "{what}: the second file differs");
    assert!(second_report.order.is_none() && second_report.limits.is_empty(), "{what}");
    if let Some(order) = report.order {
        let mut rows = order;
        rows.sort_unstable();
        assert!(rows.iter().enumerate().all(|(i, &row)| i == row as usize), "{what}");
    }
    back
}

#[test]
fn real_files_have_the_right_number_of_rows() {
    for (name, rows, degree) in [
        ("playbot_sog2_lod/0_0", 500_000, 2),
        ("playbot_sog2_lod/3_0/meta.json", 31_000, 2),
        ("playbot_sog2_lod/4_0", 8_406, 2),
        ("playbot_sog2_lod/5_0", 3_000, 2),
        ("playbot_sog2_lod/6_0", 1_873, 2),
        ("playcanvas_logo_sog1", 307_128, 0),
        ("playcanvas_logo_sog1/meta.json", 307_128, 0),
        ("monkey_0001.sog", 31_658, 0),
    ] {
        let Some(loaded) = real(&format!("real/objects/{name}")) else { continue };
        assert_eq!((loaded.scene.len(), loaded.scene.sh_degree), (rows, degree), "{name}");
        assert_eq!(loaded.kind, SceneFormat::Sog);
        for q in &loaded.scene.quat {
            let norm: f64 = q.iter().map(|&v| f64::from(v).powi(2)).sum();
            assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0, "{name} {q:?}");
        }
    }
}

#[test]
fn real_files_are_recognised_by_content() {
    let Some(folder) = shared("real/objects/playbot_sog2_lod") else { return };
    let meta = std::fs::read(folder.join("4_0/meta.json")).unwrap();
    let lod = std::fs::read(folder.join("lod-meta.json")).unwrap();
    assert!(is_sog_folder(&folder) && is_sog_folder(&folder.join("4_0")));
    assert!(!is_sog_folder(folder.parent().unwrap()) && !is_sog_folder(&folder.join("x")));
    assert!(is_sog_meta_json(&meta) && !is_sog_meta_json(&lod));
    assert!(is_lod_meta_json(&lod) && !is_lod_meta_json(&meta));
    assert!(!is_sog_archive(&meta) && !is_sog_meta_json(b"{\"a\": 1}") && !is_sog_meta_json(b""));
    let Some(logo) = shared("real/objects/playcanvas_logo_sog1/meta.json") else { return };
    assert!(is_sog_meta_json(&std::fs::read(logo).unwrap()), "version 1");
    let Some(monkey) = shared("real/objects/monkey_0001.sog") else { return };
    assert!(is_sog_archive(&std::fs::read(monkey).unwrap()));
}

#[test]
fn playbot_as_another_decoder_read_it() {
    let Some(sog) = real(&format!("{PLAYBOT}/4_0")) else { return };
    let sog = sog.scene;
    let close = |a: &[f32], b: &[f32], tolerance: f32| {
        assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(b) {
            assert!((a - b).abs() <= tolerance * a.abs().max(1.0), "{a} is not {b}");
        }
    };
    // The first row, decoded by hand in the description of the format.
    close(&sog.coord[0], &[-1.013_185, -0.023_974, -1.009_734], 1e-6);
    close(&sog.quat[0], &[0.955_186, -0.04714, 0.291_162, -0.024_957], 1e-6);
    close(&sog.log_scale[0], &[-5.277_591, -8.216_304, -4.877_026], 1e-6);
    close(&sog.sh_dc[0], &[-1.208_086, -1.253_035, -1.272_081], 1e-6);
    let Some(ply) = shared("real/parity/playbot_lod4.ply") else { return };
    let ply = open_scene(&ply, &ReadOptions::default()).unwrap().scene;
    assert_eq!((&sog.coord, &sog.log_scale), (&ply.coord, &ply.log_scale));
    assert_eq!((&sog.sh_dc, &sog.sh_rest), (&ply.sh_dc, &ply.sh_rest));
    close(sog.quat.as_flattened(), ply.quat.as_flattened(), 2e-7);
    close(&sog.opacity_logit, &ply.opacity_logit, 5e-7);
    assert!(sog.sh_rest.iter().any(|v| v.abs() > 0.5), "coefficients of all sizes were compared");
}

#[test]
fn higher_bands_are_left_out_on_request() {
    let Some(folder) = shared(&format!("{PLAYBOT}/6_0")) else { return };
    let options = ReadOptions { sh_rest: false, ..strict() };
    let scene = read_sog(&folder, &options).unwrap().scene;
    assert_eq!((scene.sh_degree, scene.sh_rest.len()), (0, 0));
    assert_eq!(scene.coord, read_sog(&folder, &strict()).unwrap().scene.coord);
}

#[test]
fn levels_of_a_streamed_scene() {
    let Some(folder) = shared(PLAYBOT) else { return };
    let level = |lod: usize| read_sog(&folder, &ReadOptions { lod, ..strict() });
    for (lod, rows) in [(0, 500_000), (3, 31_000), (4, 8_406), (5, 3_000), (6, 1_873)] {
        let loaded = level(lod).unwrap();
        assert_eq!(loaded.scene.len(), rows);
        if lod > 2 {
            let alone = read_sog(&folder.join(format!("{lod}_0")), &strict()).unwrap();
            assert_eq!(loaded.scene, alone.scene, "all runs of one chunk, in its order");
        }
    }
    for lod in [1, 2] {
        let error = level(lod).unwrap_err().to_string();
        assert!(error.contains(&format!("{lod}_0/meta.json")), "{error}");
        assert!(error.contains("0, 3, 4, 5, 6"), "{error}");
    }
    let error = level(7).unwrap_err().to_string();
    assert!(error.contains("has 7 levels") && error.contains("0 (finest) to 6"), "{error}");
    let by_file = ReadOptions { lod: 6, ..strict() };
    assert_eq!(read_sog(&folder.join("lod-meta.json"), &by_file).unwrap().scene.len(), 1_873);
}

#[test]
fn leaves_that_lack_a_level_give_the_nearest() {
    let dir = tempfile::tempdir().unwrap();
    // Chunks of degrees 0 and 1, one of them an archive.
    let (a, b) = (random_scene(40, 1, 1), random_scene(30, 0, 2));
    folder_of(&a, &dir.path().join("a")).unwrap();
    write_sog(&b, &dir.path().join("b.sog"), &WriteOptions::default(), &mut |_| true).unwrap();
    let a = read_sog(&dir.path().join("a"), &strict()).unwrap().scene;
    let b = read_sog(&dir.path().join("b.sog"), &strict()).unwrap().scene;
    let lod = r#"{"lodLevels": 4, "environment": "sky/meta.json",
        "filenames": ["a/meta.json", "b.sog"],
        "tree": {"children": [
            {"lods": {"0": {"file": 0, "offset": 30, "count": 10},
                      "2": {"file": 1, "offset": 5, "count": 3}}},
            {"children": [{"lods": {"3": {"file": 1, "offset": 20, "count": 10}}}]},
            {"lods": {"0": {"file": 0, "offset": 0, "count": 20},
                      "1": {"file": 1, "offset": 10, "count": 4}}}]}}"#;
    std::fs::write(dir.path().join("lod-meta.json"), lod).unwrap();
    let level = |lod: usize| {
        let loaded = read_sog(dir.path(), &ReadOptions { lod, ..strict() }).unwrap();
        let notes = loaded.report.notes.join("; ");
        (loaded.scene, notes)
    };
    let rows =
        |runs: &[std::ops::Range<usize>]| runs.iter().flat_map(Clone::clone).collect::<Vec<_>>();
    let (scene, notes) = level(0);
    assert_eq!((scene.len(), scene.sh_degree), (40, 1));
    assert!(notes.contains("1 of 3 leaves have no level 0") && notes.contains("sky"), "{notes}");
    let from_a = a.select_rows(&rows(&[0..20, 30..40])).unwrap();
    assert_eq!(
        (&scene.coord[..30], &scene.sh_rest[..270]),
        (&from_a.coord[..], &from_a.sh_rest[..])
    );
    assert_eq!(scene.quat[30..], b.quat[20..30]);
    assert!(scene.sh_rest[270..].iter().all(|&v| v == 0.0));
    // Level 1: the first leaf has only 2 as a coarser one; level 2: the last has only 1, finer.
    for lod in [1, 2] {
        let (scene, _) = level(lod);
        assert_eq!(scene.coord, b.select_rows(&rows(&[5..8, 10..14, 20..30])).unwrap().coord);
        assert_eq!(scene.sh_degree, 0);
    }
    for (from, to, expected) in [
        (r#""offset": 30"#, r#""offset": 31"#, "rows up to 41"),
        (r#""offset": 30"#, r#""offset": 19"#, "row 19 of file 0 in two leaves"),
        (r#""file": 0, "offset": 0"#, r#""file": 2, "offset": 0"#, "file 2 of 2"),
        (r#""a/meta.json""#, r#""../a/meta.json""#, "no file below"),
        (r#""count": 20"#, r#""count": -20"#, "line"),
        (r#""count": 20"#, r#""count": 18446744073709551615"#, "in two leaves"),
    ] {
        std::fs::write(dir.path().join("lod-meta.json"), lod.replace(from, to)).unwrap();
        let error = read_sog(dir.path(), &strict()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn an_archive_may_have_one_folder_and_packed_entries() {
    use std::io::Write;
    let (bytes, _) = archive_of(&random_scene(300, 1, 3));
    let scene = read(&bytes);
    let dir = tempfile::tempdir().unwrap();
    folder_of(&scene, &dir.path().join("f")).unwrap();
    let files = files_in(&dir.path().join("f"));
    let pack = |prefixes: &[&str]| {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Deflated);
        for prefix in prefixes {
            for (name, bytes) in &files {
                zip.start_file(format!("{prefix}{name}"), options).unwrap();
                zip.write_all(bytes).unwrap();
            }
        }
        zip.finish().unwrap().into_inner()
    };
    for prefixes in [&[""][..], &["room/"], &["", "room/"], &["room/", "__MACOSX/"]] {
        let bytes = pack(prefixes);
        assert!(is_sog_archive(&bytes));
        assert_eq!(read(&bytes), scene, "{prefixes:?}");
    }
    let two = read_sog_archive(&pack(&["a/", "b/"]), Path::new("x"), &strict()).unwrap_err();
    assert!(two.to_string().contains("several scenes"), "{two}");
    assert!(!is_sog_archive(&pack(&["a/b/"])));
}

/// Version 1 differs in its description only; made from version 2 with codebooks in equal steps.
#[test]
fn version_1_with_higher_bands() {
    let dir = tempfile::tempdir().unwrap();
    let mut scene = random_scene(100, 2, 5);
    // Every step of 256 occurs, so the codebook of version 2 is the ramp of version 1.
    let step = |i: usize| (i % 256) as f32;
    let flat = |v: &mut [[f32; 3]], value: &dyn Fn(usize) -> f32| {
        v.as_flattened_mut().iter_mut().enumerate().for_each(|(i, v)| *v = value(i));
    };
    flat(&mut scene.log_scale, &|i| -5.0 + step(i) / 255.0);
    flat(&mut scene.sh_dc, &|i| -1.0 + step(i) / 127.5);
    scene.sh_rest.iter_mut().enumerate().for_each(|(i, v)| *v = (step(i) - 128.0) / 128.0);
    folder_of(&scene, dir.path()).unwrap();
    let path = dir.path().join("meta.json");
    let v2 = read_sog(&path, &strict()).unwrap().scene;
    let mut meta: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let book = |key: &str| meta[key]["codebook"].as_array().unwrap().clone();
    let (scales, sh0, rest) = (book("scales"), book("sh0"), book("shN"));
    let ends = |book: &[serde_json::Value]| (book[0].clone(), book[255].clone());
    let set = |meta: &mut serde_json::Value, key: &str, (min, max)| {
        meta[key].as_object_mut().unwrap().remove("codebook");
        (meta[key]["mins"], meta[key]["maxs"]) = (min, max);
    };
    let list = |v: &serde_json::Value, n: usize| serde_json::Value::from(vec![v.clone(); n]);
    let (min, max) = ends(&scales);
    set(&mut meta, "scales", (list(&min, 3), list(&max, 3)));
    let (min, max) = ends(&sh0);
    let (mut mins, mut maxs) = (list(&min, 4), list(&max, 4));
    (mins[3], maxs[3]) = ((-6.0).into(), 6.0.into());
    set(&mut meta, "sh0", (mins, maxs));
    set(&mut meta, "shN", ends(&rest));
    for key in ["count", "version"] {
        meta.as_object_mut().unwrap().remove(key);
    }
    meta["means"]["shape"] = vec![100, 3].into();
    for key in ["count", "bands"] {
        meta["shN"].as_object_mut().unwrap().remove(key);
    }
    std::fs::write(&path, meta.to_string()).unwrap();
    let v1 = read_sog(dir.path(), &strict()).unwrap().scene;
    assert_eq!((v1.len(), v1.sh_degree, &v1.coord, &v1.quat), (100, 2, &v2.coord, &v2.quat));
    for (a, b) in [
        (v1.log_scale.as_flattened(), v2.log_scale.as_flattened()),
        (v1.sh_dc.as_flattened(), v2.sh_dc.as_flattened()),
        (&v1.sh_rest, &v2.sh_rest),
    ] {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6));
    }
    for (a, b) in v1.opacity_logit.iter().zip(&v2.opacity_logit) {
        let byte = (255.0 / (1.0 + (-f64::from(*b)).exp())).round();
        assert!((f64::from(*a) - (byte / 255.0 * 12.0 - 6.0)).abs() < 1e-5, "{a} {byte}");
    }
}

fn labelled(rows: usize) -> GaussianScene {
    let mut scene = random_scene(rows, 1, 8);
    scene.segment = Some((0..rows as i32).map(|i| i % 7 - 1).collect());
    scene.instance = Some((0..rows as i32).map(|i| i * 3).collect());
    scene.segment_score = Some((0..rows).map(|i| i as f32 * 0.25).collect());
    scene.lang_code = Some(LanguageCode {
        values: (0..rows * 2).map(|i| f16::from_f32(i as f32 * 0.5)).collect(),
        codebook: LanguageCodebook { mean: vec![0.5; 4], axes: vec![0.25; 8] },
    });
    scene
}

#[test]
fn labels_go_along_and_follow_the_order() {
    let scene = labelled(1500);
    let (bytes, report) = archive_of(&scene);
    let order: Vec<usize> =
        report.order.expect("a random scene is sorted").iter().map(|&r| r as usize).collect();
    let due = scene.select_rows(&order).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    let report = folder_of(&scene, &folder).unwrap();
    assert_eq!(report.files[0], folder.join("meta.json"));
    assert_eq!(report.files.len(), files_in(&folder).len());
    let from_folder = read_sog(&folder, &strict()).unwrap().scene;
    for back in [read(&bytes), from_folder] {
        assert_eq!((&back.segment, &back.instance), (&due.segment, &due.instance));
        assert_eq!((&back.segment_score, &back.lang_code), (&due.segment_score, &due.lang_code));
        for (a, b) in back.coord.as_flattened().iter().zip(due.coord.as_flattened()) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
        assert_eq!(archive_of(&back).0, bytes);
    }
}

#[test]
fn what_is_written_is_within_the_steps_of_the_format() {
    let Some(path) = shared("real/objects/hamburger.ply") else { return };
    let scene = open_scene(&path, &ReadOptions::default()).unwrap().scene;
    let (bytes, report) = archive_of(&scene);
    let order: Vec<usize> = match &report.order {
        Some(order) => order.iter().map(|&row| row as usize).collect(),
        None => (0..scene.len()).collect(),
    };
    let (a, b) = (scene.select_rows(&order).unwrap(), read(&bytes));
    let log = |p: f32| f64::from(p).abs().ln_1p().copysign(f64::from(p));
    for i in 0..3 {
        let values = || a.coord.iter().map(|p| log(p[i]));
        let range = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
        for (x, y) in values().zip(b.coord.iter().map(|p| log(p[i]))) {
            assert!((x - y).abs() <= range / 65_535.0 * 0.5 + 1e-7, "{x} {y}");
        }
    }
    for (x, y) in a.quat.iter().zip(&b.quat) {
        let dot: f64 = x.iter().zip(y).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum();
        // Three components off by half a step, the fourth by at most as much as all of them.
        let half = SQRT_2 / 255.0 / 2.0;
        assert!(dot.abs() >= 1.0 - 6.0 * half * half, "{x:?} {y:?}");
    }
    let rms = |x: &[f32], y: &[f32]| {
        let squared: f64 = x.iter().zip(y).map(|(x, y)| f64::from(x - y).powi(2)).sum();
        (squared / x.len() as f64).sqrt()
    };
    for (x, y) in [(&a.log_scale, &b.log_scale), (&a.sh_dc, &b.sh_dc)] {
        let (x, y) = (x.as_flattened(), y.as_flattened());
        let range =
            x.iter().copied().fold(f32::MIN, f32::max) - x.iter().copied().fold(f32::MAX, f32::min);
        let equal_steps = f64::from(range) / 255.0 / 12f64.sqrt();
        assert!(rms(x, y) < equal_steps, "{} {equal_steps}", rms(x, y));
    }
    let alpha = |logit: f32| 1.0 / (1.0 + (-f64::from(logit)).exp());
    for (x, y) in a.opacity_logit.iter().zip(&b.opacity_logit) {
        assert!((alpha(*x) - alpha(*y)).abs() <= 0.5 / 255.0 + 1e-6, "{x} {y}");
    }
}

/// Coefficients of a few materials with some variation, as trained scenes have them.
fn with_materials(mut scene: GaussianScene, seed: u64) -> GaussianScene {
    let width = scene.sh_rest_len() * 3;
    let mut rng = SplitMix(seed);
    let materials: Vec<f32> = (0..40 * width).map(|_| rng.float() * 0.3).collect();
    for row in scene.sh_rest.chunks_exact_mut(width) {
        let material = rng.below(40) * width;
        let strength = rng.float();
        for (v, m) in row.iter_mut().zip(&materials[material..]) {
            *v = m * strength + rng.float() * 0.01;
        }
    }
    scene
}

#[test]
fn a_palette_is_near_what_it_stands_for() {
    let scene = with_materials(random_scene(5000, 3, 4), 5);
    let (bytes, report) = archive_of(&scene);
    let order: Vec<usize> = report.order.unwrap().iter().map(|&row| row as usize).collect();
    let (a, b) = (scene.select_rows(&order).unwrap(), read(&bytes));
    let squared: f64 =
        a.sh_rest.iter().zip(&b.sh_rest).map(|(x, y)| f64::from(x - y).powi(2)).sum();
    // 4,096 entries for 5,000 rows; what is left is less than the variation of 0.01/√3.
    let error = (squared / a.sh_rest.len() as f64).sqrt();
    assert!(error < 0.006, "{error}");
    fixed_point(&scene, "materials");
}

#[test]
fn written_twice_is_the_same_bytes() {
    for rows in [1, 2, 3, 255, 256, 257, 1024, 2600] {
        for degree in 0..=4 {
            let scene = random_scene(rows, degree, rows as u64 + u64::from(degree));
            let back = fixed_point(&scene, &format!("{rows} rows of degree {degree}"));
            assert_eq!(back.sh_degree, degree.min(3));
        }
    }
    for name in ["3_0", "4_0"] {
        let Some(loaded) = real(&format!("{PLAYBOT}/{name}")) else { continue };
        // A file of another program keeps its order, and all its values have codes already.
        let back = fixed_point(&loaded.scene, name);
        assert!(archive_of(&loaded.scene).1.order.is_none(), "{name}");
        assert_eq!(back.log_scale, loaded.scene.log_scale);
        assert_eq!((&back.sh_dc, &back.sh_rest), (&loaded.scene.sh_dc, &loaded.scene.sh_rest));
        assert_eq!(back.opacity_logit, loaded.scene.opacity_logit);
    }
    for name in ["hamburger.ply", "biker.compressed.ply", "tmp_model_unnormalised.ply"] {
        let Some(path) = shared(&format!("real/objects/{name}")) else { continue };
        fixed_point(&open_scene(&path, &ReadOptions::default()).unwrap().scene, name);
    }
}

#[test]
fn hard_values_are_written_twice_the_same() {
    type Change = fn(&mut GaussianScene, &mut SplitMix);
    let changes: [(&str, Change); 10] = [
        ("equal rows", |s, _| *s = s.select_rows(&vec![0; s.len()]).unwrap()),
        ("tiny range", |s, r| {
            s.coord.iter_mut().flatten().for_each(|v| *v = 1000.0 + r.float() * 1e-3);
        }),
        ("tiny values", |s, r| s.coord.iter_mut().flatten().for_each(|v| *v = r.float() * 1e-38)),
        ("huge values", |s, r| {
            s.coord.iter_mut().flatten().for_each(|v| *v = r.float() * f32::MAX);
            s.sh_dc.iter_mut().flatten().for_each(|v| *v = r.float() * 1e38);
            s.sh_rest.iter_mut().for_each(|v| *v = r.float() * 1e38);
        }),
        ("one far off", |s, _| {
            s.coord[0] = [-1e30, 1e30, 0.0];
            s.log_scale[0] = [80.0; 3];
        }),
        ("zero scales", |s, r| {
            for v in s.log_scale.iter_mut().flatten() {
                *v = if r.below(3) == 0 { f32::NEG_INFINITY } else { *v * 10.0 };
            }
        }),
        ("only zero scales", |s, _| {
            s.log_scale.iter_mut().flatten().for_each(|v| *v = f32::NEG_INFINITY);
        }),
        ("infinite opacity", |s, r| {
            for v in &mut s.opacity_logit {
                *v = [f32::INFINITY, f32::NEG_INFINITY, *v, 0.0][r.below(4)];
            }
        }),
        ("equal components", |s, r| {
            let half = 0.5f32.sqrt();
            for q in &mut s.quat {
                *q = [
                    [0.5, 0.5, -0.5, 0.5],
                    [half, 0.0, half, 0.0],
                    [0.0, half, 0.0, -half],
                    [1.0, 0.0, 0.0, 0.0],
                    [0.0, 0.0, 0.0, 1.0],
                ][r.below(5)];
            }
        }),
        ("zeros of both signs", |s, r| {
            let zero = |r: &mut SplitMix| [0.0, -0.0][r.below(2)];
            s.coord.iter_mut().flatten().for_each(|v| *v = zero(r));
            s.log_scale.iter_mut().flatten().for_each(|v| *v = zero(r));
            s.sh_dc.iter_mut().flatten().for_each(|v| *v = zero(r));
            s.sh_rest.iter_mut().for_each(|v| *v = zero(r));
        }),
    ];
    for rows in [1, 2, 256, 1300] {
        for (what, change) in changes {
            let mut scene = random_scene(rows, 1, rows as u64);
            change(&mut scene, &mut SplitMix(rows as u64));
            fixed_point(&scene, &format!("{what}, {rows} rows"));
        }
    }
}

#[test]
fn folders_and_threads_give_the_same_bytes() {
    let scene = with_materials(random_scene(3000, 3, 6), 7);
    let dir = tempfile::tempdir().unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    folder_of(&scene, &one).unwrap();
    let back = read_sog(&one, &strict()).unwrap().scene;
    folder_of(&back, &two).unwrap();
    assert!(files_in(&one) == files_in(&two));
    let (bytes, _) = archive_of(&scene);
    assert_eq!(read(&bytes), back);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| archive_of(&scene).0) == bytes, "{threads} threads");
        assert_eq!(pool.install(|| read(&bytes)), back);
    }
}

#[test]
fn what_the_format_cannot_hold_is_reported() {
    let mut scene = random_scene(50, 4, 1);
    scene.log_scale[7][1] = f32::NEG_INFINITY;
    scene.opacity_logit.fill(6.0);
    scene.opacity_logit[3] = 9.0;
    scene.opacity_logit[5] = f32::INFINITY;
    scene.sh_rest[72 * 20..].fill(0.0);
    let report = archive_of(&scene).1;
    let found: Vec<(&str, usize, usize)> =
        report.limits.iter().map(|l| (l.field, l.rows, l.first_row)).collect();
    assert_eq!(found, [("log_scale", 1, 7), ("opacity_logit", 1, 3), ("sh_rest", 20, 0)]);
    let cut = (0..20).flat_map(|row| &scene.sh_rest[row * 72 + 45..(row + 1) * 72]);
    let largest = cut.fold(0f32, |a, v| a.max(v.abs()));
    assert_eq!(report.limits[2].largest_change, f64::from(largest));
    let one_place = GaussianScene { coord: vec![[1.0; 3]; 300_000], ..random_scene(300_000, 0, 1) };
    let dir = tempfile::tempdir().unwrap();
    let error = folder_of(&one_place, dir.path()).unwrap_err().to_string();
    assert!(error.contains("in one place"), "{error}");
    assert!(files_in(dir.path()).is_empty());
}

#[test]
fn replacing_a_folder_is_all_or_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let meta = dir.path().join("meta.json");
    let (old, new) = (labelled(60), random_scene(40, 0, 2));
    folder_of(&old, dir.path()).unwrap();
    std::fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    let before = files_in(dir.path());
    assert!(before.contains_key("shN_labels.webp") && before.contains_key("labels.safetensors"));

    let error = folder_of(&new, dir.path()).unwrap_err().to_string();
    assert!(error.contains("is there already"), "{error}");
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    let mut steps = 0;
    write_sog_folder(&new, &meta, &options, &mut |_| {
        steps += 1;
        true
    })
    .unwrap();
    folder_of(&old, dir.path()).unwrap_err();
    let after = files_in(dir.path());
    assert_eq!(after.len(), 7, "five textures, the description and a file of the user: {after:?}");
    assert_eq!(after["notes.txt"], b"mine");
    assert_eq!(read_sog(dir.path(), &strict()).unwrap().scene.len(), 40);

    for stop_at in 1..=steps {
        let mut calls = 0;
        let mut progress = |_| {
            calls += 1;
            calls < stop_at
        };
        let error = write_sog_folder(&old, &meta, &options, &mut progress).unwrap_err();
        assert!(matches!(error, SceneError::Stopped));
        assert!(files_in(dir.path()) == after, "stopped at {stop_at}");
    }
    let empty = tempfile::tempdir().unwrap();
    let path = empty.path().join("new/meta.json");
    write_sog_folder(&old, &path, &options, &mut |_| false).unwrap_err();
    write_sog(&old, &empty.path().join("a.sog"), &options, &mut |f| f < 0.5).unwrap_err();
    assert_eq!(std::fs::read_dir(empty.path()).unwrap().count(), 0, "nothing is left");
}
