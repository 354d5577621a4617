//! Scenes as textures: files of other programs, and what is written comes back.

use crate::common::{
    SplitMix, close, flat, labelled, open, order_of, random_scene, shared, strict, write, write_as,
};
use scenesplat_scene::formats::sog::{
    is_lod_meta_json, is_sog_archive, is_sog_folder, is_sog_meta_json, read_sog, read_sog_archive,
};
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat, WriteOptions, WriteReport,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::path::Path;

const PLAYBOT: &str = "real/objects/playbot_sog2_lod";

fn real(relative: &str) -> Option<LoadedScene> {
    Some(read_sog(&shared(relative)?, &strict()).unwrap())
}

fn archive_of(scene: &GaussianScene) -> (Vec<u8>, WriteReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.sog");
    let report = write(scene, &path, SceneFormat::Sog);
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(bytes.len() as u64, report.bytes);
    (bytes, report)
}

fn folder_of(scene: &GaussianScene, folder: &Path) -> Result<WriteReport, SceneError> {
    let path = folder.join("meta.json");
    write_as(scene, &path, SceneFormat::SogFolder, &WriteOptions::default())
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

#[test]
fn real_files_are_recognized_by_content() {
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
    // The first row, decoded by hand in the description of the format.
    close(&sog.coord[0], &[-1.013_185, -0.023_974, -1.009_734], 1e-6);
    close(&sog.quat[0], &[0.955_186, -0.04714, 0.291_162, -0.024_957], 1e-6);
    close(&sog.log_scale[0], &[-5.277_591, -8.216_304, -4.877_026], 8e-6);
    close(&sog.sh_dc[0], &[-1.208_086, -1.253_035, -1.272_081], 1e-6);
    let Some(ply) = shared("real/parity/playbot_lod4.ply") else { return };
    let ply = open(&ply).scene;
    assert_eq!((&sog.coord, &sog.log_scale), (&ply.coord, &ply.log_scale));
    assert_eq!((&sog.sh_dc, &sog.sh_rest), (&ply.sh_dc, &ply.sh_rest));
    close(flat(&sog.quat), flat(&ply.quat), 2e-7);
    for (a, b) in sog.opacity_logit.iter().zip(&ply.opacity_logit) {
        assert!((a - b).abs() <= 5e-7 * a.abs().max(1.0), "{a} is not {b}");
    }
    assert!(sog.sh_rest.iter().any(|v| v.abs() > 0.5), "coefficients of all sizes were compared");
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
    write(&b, &dir.path().join("b.sog"), SceneFormat::Sog);
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
    let mut meta: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let book = |key: &str| meta[key]["codebook"].as_array().unwrap().clone();
    let (scales, sh0, rest) = (book("scales"), book("sh0"), book("shN"));
    let ends = |book: &[Value]| (book[0].clone(), book[255].clone());
    let set = |meta: &mut Value, key: &str, (min, max)| {
        meta[key].as_object_mut().unwrap().remove("codebook");
        (meta[key]["mins"], meta[key]["maxs"]) = (min, max);
    };
    let list = |v: &Value, n: usize| Value::from(vec![v.clone(); n]);
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

#[test]
fn what_is_written_is_within_the_steps_of_the_format() {
    let Some(path) = shared("real/objects/hamburger.ply") else { return };
    let scene = open(&path).scene;
    let (bytes, report) = archive_of(&scene);
    let (a, b) = (scene.select_rows(&order_of(&report)).unwrap(), read(&bytes));
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
    let (a, b) = (scene.select_rows(&order_of(&report)).unwrap(), read(&bytes));
    let squared: f64 =
        a.sh_rest.iter().zip(&b.sh_rest).map(|(x, y)| f64::from(x - y).powi(2)).sum();
    // 4,096 entries for 5,000 rows; what is left is less than the variation of 0.01/√3.
    let error = (squared / a.sh_rest.len() as f64).sqrt();
    assert!(error < 0.006, "{error}");
}

#[test]
fn too_many_gaussians_in_one_place_are_refused() {
    let one_place = GaussianScene { coord: vec![[1.0; 3]; 300_000], ..random_scene(300_000, 0, 1) };
    let dir = tempfile::tempdir().unwrap();
    let error = folder_of(&one_place, dir.path()).unwrap_err().to_string();
    assert!(error.contains("in one place"), "{error}");
    assert!(files_in(dir.path()).is_empty());
}

#[test]
fn files_of_the_old_scene_go_and_others_stay() {
    let dir = tempfile::tempdir().unwrap();
    let meta = dir.path().join("meta.json");
    let (old, new) = (labelled(60, 1), random_scene(40, 0, 2));
    folder_of(&old, dir.path()).unwrap();
    std::fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    let before = files_in(dir.path());
    assert!(before.contains_key("shN_labels.webp") && before.contains_key("labels.safetensors"));

    let error = folder_of(&new, dir.path()).unwrap_err().to_string();
    assert!(error.contains("is there already"), "{error}");
    write(&new, &meta, SceneFormat::SogFolder);
    let after = files_in(dir.path());
    assert_eq!(after.len(), 7, "five textures, the description and a file of the user: {after:?}");
    assert_eq!(after["notes.txt"], b"mine");
    assert_eq!(read_sog(dir.path(), &strict()).unwrap().scene.len(), 40);
}

/// A folder of 50 Gaussians of degree 1, and its description.
fn small_folder(folder: &Path) -> Value {
    let meta = folder.join("meta.json");
    write(&random_scene(50, 1, 3), &meta, SceneFormat::SogFolder);
    serde_json::from_slice(&std::fs::read(meta).unwrap()).unwrap()
}

fn error_of(folder: &Path, meta: &Value) -> String {
    std::fs::write(folder.join("meta.json"), meta.to_string()).unwrap();
    read_sog(&folder.join("meta.json"), &ReadOptions::default()).unwrap_err().to_string()
}

#[test]
fn descriptions_with_wrong_values() {
    let dir = tempfile::tempdir().unwrap();
    let good = small_folder(dir.path());
    let long = vec![0.5; 257];
    for (at, value, expected) in [
        ("/count", json!(-5), "count is -5, not a whole number"),
        ("/count", json!(50.5), "count is 50.5"),
        ("/count", json!("50"), "count is \"50\""),
        ("/count", json!(null), "no field count"),
        ("/count", json!(65), "8×8 texels for 65 Gaussians"),
        ("/count", json!(0), "no Gaussian"),
        ("/count", json!(1u64 << 40), "only"),
        ("/count", json!(u64::MAX), "only"),
        ("/count", json!(1e300), "count is 1e+300"),
        ("/version", json!(3), "version 3"),
        ("/version", json!("2"), "version is \"2\""),
        ("/version", json!(1), "scales"),
        ("/means/mins", json!([0.0, 1.0]), "means.mins has 2 entries, not 3"),
        ("/means/mins/1", json!("x"), "means.mins[1] is \"x\", not a number"),
        ("/means/maxs", json!(1.0), "means.maxs is 1.0, not a list"),
        ("/means/files", json!(["means_l.webp"]), "means.files has 1 entries"),
        ("/means/files/0", json!(7), "means.files[0] is 7, not a text"),
        ("/means/files/0", json!("../means_l.webp"), "not a file of this folder"),
        ("/means/files/0", json!("/etc/passwd"), "not a file of this folder"),
        ("/means/files/0", json!("no.webp"), "names the file no.webp, which is not there"),
        ("/means/files/0", json!("meta.json"), "is no WebP image"),
        ("/means/files/0", json!("."), "not a file of this folder"),
        ("/scales/codebook", json!(long), "scales.codebook has 257 entries, not 256"),
        ("/scales/codebook/3", json!(null), "scales.codebook[3] is null"),
        ("/scales/codebook/3", json!({}), "scales.codebook[3] is {}"),
        ("/sh0", json!([]), "no field codebook in sh0"),
        ("/shN/bands", json!(4), "shN.bands is 4"),
        ("/shN/bands", json!(2), "192 texels wide, not 512 for 2 bands"),
        ("/shN/count", json!(1 << 20), "texels high for 1048576 centroids"),
        ("/shN/count", json!(10), "of 10 centroids"),
        ("/shN/files/0", json!("means_l.webp"), "8 texels wide"),
        ("/shN/files/1", json!("shN_centroids.webp"), "of 50 centroids"),
        ("/scenesplat/labels", json!("no"), "names the file no, which"),
        ("/scenesplat/labels", json!("means_l.webp"), "block of labels"),
    ] {
        let mut meta = good.clone();
        meta["scenesplat"] =
            if at.starts_with("/scenesplat") { json!({"labels": 0}) } else { json!(null) };
        if at == "/version" && value == json!(1) {
            meta["scales"] = json!({"files": ["scales.webp"]});
        }
        *meta.pointer_mut(at).unwrap() = value.clone();
        let error = error_of(dir.path(), &meta);
        assert!(error.contains(expected), "{at} = {value}: {error}");
    }
    for text in ["", "{", "[]", "null", "{}", "\u{feff}{}", &"[".repeat(100_000)] {
        std::fs::write(dir.path().join("meta.json"), text).unwrap();
        assert!(read_sog(dir.path(), &ReadOptions::default()).is_err());
        assert!(read_sog(&dir.path().join("meta.json"), &ReadOptions::default()).is_err());
        assert!(!is_sog_meta_json(text.as_bytes()) && !is_lod_meta_json(text.as_bytes()));
    }
    std::fs::write(dir.path().join("lod-meta.json"), "{\"lodLevels\": 1}").unwrap();
    assert!(read_sog(&dir.path().join("lod-meta.json"), &ReadOptions::default()).is_err());
    assert!(read_sog(&dir.path().join("nowhere"), &ReadOptions::default()).is_err());
}
