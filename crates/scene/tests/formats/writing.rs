//! Writing scenes: all or nothing, in every format, and what is said about it.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{language_code, random_scene};
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::{
    GaussianScene, Policy, ReadOptions, SceneError, SceneFormat, WriteOptions, WriteReport,
    open_scene, write_scene,
};
use std::path::{Path, PathBuf};

const FORMATS: [(SceneFormat, &str); 9] = [
    (SceneFormat::Ply, "a.ply"),
    (SceneFormat::CompressedPly, "a.compressed.ply"),
    (SceneFormat::Spz, "a.spz"),
    (SceneFormat::Splat, "a.splat"),
    (SceneFormat::Sog, "a.sog"),
    (SceneFormat::SogFolder, "sog/meta.json"),
    (SceneFormat::NpyFolder, "deeper/npy"),
    (SceneFormat::Glb, "a.glb"),
    (SceneFormat::SogStreamed, "lod/lod-meta.json"),
];
/// Those with a file of labels beside the scene.
const BESIDE: [(SceneFormat, &str); 3] = [FORMATS[1], FORMATS[3], FORMATS[7]];

fn write(
    scene: &GaussianScene,
    path: &Path,
    format: SceneFormat,
    overwrite: bool,
) -> Result<WriteReport, SceneError> {
    let options = WriteOptions { overwrite, ..WriteOptions::default() };
    write_scene(scene, path, format, &options, &mut |_| true)
}

fn open(path: &Path) -> GaussianScene {
    open_scene(path, &ReadOptions::default()).unwrap().scene
}

fn labelled(rows: usize) -> GaussianScene {
    let mut scene = random_scene(rows, 0, 4);
    scene.segment = Some((0..rows as i32).map(|i| i % 21 - 1).collect());
    scene.lang_code = Some(language_code(rows, 3, 8));
    scene
}

fn without_labels(scene: &GaussianScene) -> GaussianScene {
    GaussianScene { segment: None, lang_code: None, ..scene.clone() }
}

fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".labels.safetensors");
    name.into()
}

/// Every file and folder below `folder` with its bytes.
fn contents(folder: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        all.push((path.clone(), std::fs::read(&path).ok()));
        if path.is_dir() {
            all.extend(contents(&path));
        }
    }
    all.sort();
    all
}

#[test]
fn stopping_at_any_time_changes_nothing() {
    let scene = labelled(3000);
    for (format, name) in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        for overwrite in [false, true] {
            let before = contents(folder.path());
            let options = WriteOptions { overwrite, ..WriteOptions::default() };
            let mut calls = 0;
            loop {
                let (mut left, mut last) = (calls, 0.0);
                let result = write_scene(&scene, &path, format, &options, &mut |done| {
                    assert!(done >= last || done == 0.0, "{name}: {last} and then {done}");
                    assert!((0.0..=1.0).contains(&done), "{name}: {done}");
                    last = done;
                    left -= 1;
                    left >= 0
                });
                if result.is_ok() {
                    break;
                }
                assert!(matches!(result, Err(SceneError::Stopped)), "{name}: {result:?}");
                assert!(contents(folder.path()) == before, "{name}: after {calls} calls");
                calls += 1;
            }
            // At the start, when all is written, and once more when it is in place.
            assert!(calls >= 2, "{name}: {calls}");
            assert_eq!(open(&path).len(), 3000, "{name}");
        }
    }
}

#[test]
fn large_scenes_can_be_stopped_on_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let rows = 600_000;
    let scene = GaussianScene {
        coord: vec![[1.0; 3]; rows],
        log_scale: vec![[-4.0; 3]; rows],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; rows],
        opacity_logit: vec![0.0; rows],
        sh_dc: vec![[0.0; 3]; rows],
        ..GaussianScene::default()
    };
    for (format, name) in [FORMATS[0], FORMATS[6]] {
        let path = folder.path().join(name);
        let options = WriteOptions::default();
        let result = write_scene(&scene, &path, format, &options, &mut |done| done == 0.0);
        assert!(matches!(result, Err(SceneError::Stopped)), "{name}");
        let mut seen = Vec::new();
        let result = write_scene(&scene, &path, format, &options, &mut |done| {
            seen.push(done);
            done < 0.5
        });
        assert!(matches!(result, Err(SceneError::Stopped)), "{name}");
        let on_the_way = seen.iter().filter(|done| (0.01..0.99).contains(*done)).count();
        assert!(on_the_way >= 1, "{name}: {seen:?}");
    }
    assert!(contents(folder.path()).is_empty());
}

#[test]
fn what_would_not_come_back_is_not_written() {
    type Break = fn(&mut GaussianScene);
    let cases: [(&str, Break); 6] = [
        ("coord", |scene| scene.coord[2][1] = f32::INFINITY),
        ("log_scale", |scene| scene.log_scale[2][1] = f32::INFINITY),
        ("quat", |scene| scene.quat[2] = [0.0; 4]),
        ("opacity_logit", |scene| scene.opacity_logit[2] = f32::NAN),
        ("sh_dc", |scene| scene.sh_dc[2][1] = f32::NEG_INFINITY),
        ("coord", |scene| scene.coord[2][0] = f32::NAN),
    ];
    for (format, name) in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        for (field, change) in cases {
            let mut scene = random_scene(5, 0, 3);
            change(&mut scene);
            let error = write(&scene, &path, format, false).unwrap_err().to_string();
            assert!(error.contains("element 2") && error.contains(field), "{name}: {error}");
            assert!(contents(folder.path()).is_empty(), "{name}, {field}");
        }
        // These have a meaning.
        let mut scene = random_scene(5, 0, 3);
        scene.log_scale[0][1] = f32::NEG_INFINITY;
        (scene.opacity_logit[1], scene.opacity_logit[2]) = (f32::INFINITY, f32::NEG_INFINITY);
        write(&scene, &path, format, false).unwrap();
        assert_eq!(open(&path).len(), 5, "{name}");
    }
}

#[test]
fn leftovers_of_a_killed_run_stay_out_of_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    let mut leftovers = vec![dir.path().join(format!(".scene.{}.part", std::process::id()))];
    for serial in 0..100 {
        leftovers.push(folder.join(format!(".npy.{}-{serial}.part", std::process::id())));
    }
    for left in &leftovers {
        std::fs::create_dir_all(left).unwrap();
        write_npy(&left.join("segment.npy"), &[3], &[7i32; 3]).unwrap();
    }
    let scene = random_scene(3, 0, 1);
    write(&scene, &folder, SceneFormat::NpyFolder, false).unwrap();
    assert_eq!(open(&folder).segment, None);
    assert!(!folder.join("segment.npy").exists());
    assert!(leftovers.iter().all(|left| left.join("segment.npy").exists()), "they are not ours");

    let path = dir.path().join("a.ply");
    for serial in 0..600 {
        let left = format!(".a.ply.{}-{serial}.part", std::process::id());
        std::fs::write(dir.path().join(left), "left").unwrap();
    }
    write(&scene, &path, SceneFormat::Ply, false).unwrap();
    assert_eq!(open(&path).coord, scene.coord);
}

#[test]
fn other_labels_of_a_folder_are_neither_deleted_nor_mixed_in() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    let scene = labelled(20);
    write(&scene, &folder, SceneFormat::NpyFolder, false).unwrap();
    for (name, values) in [("segment200", [3i32; 20]), ("pc_segment20", [4; 20])] {
        write_npy(&folder.join(format!("{name}.npy")), &[20], &values).unwrap();
    }
    let before = contents(dir.path());
    let few = random_scene(3, 0, 1);
    for other in [&few, &open(&folder)] {
        let error = write(other, &folder, SceneFormat::NpyFolder, true).unwrap_err().to_string();
        assert!(error.contains("pc_segment20.npy, segment200.npy"), "{error}");
        assert!(error.contains("move them away"), "{error}");
        assert!(contents(dir.path()) == before);
    }
    std::fs::remove_file(folder.join("segment200.npy")).unwrap();
    std::fs::remove_file(folder.join("pc_segment20.npy")).unwrap();
    write(&few, &folder, SceneFormat::NpyFolder, true).unwrap();
    let back = open(&folder);
    assert_eq!((back.len(), back.segment, back.lang_code), (3, None, None));
    let names = std::fs::read_dir(&folder).unwrap().count();
    assert_eq!(names, 5, "nothing else is left in the folder");
}

#[test]
fn a_folder_says_what_it_could_not_hold() {
    let dir = tempfile::tempdir().unwrap();
    let [folder, second] = ["a", "b"].map(|name| dir.path().join(name));
    let mut scene = labelled(5000);
    scene.sh_dc = vec![[0.5; 3]; 5000];
    scene.opacity_logit = vec![0.0; 5000];
    scene.log_scale[11] = [0.0, 90.0, f32::MAX];
    scene.log_scale[4500][0] = 88.722_84;
    scene.log_scale[12][1] = -200.0;
    scene.log_scale[13][1] = f32::NEG_INFINITY;
    scene.sh_dc[4096] = [0.0, 2.0, -3.0];
    scene.sh_dc[4097] = [1.775, 0.0, 0.0];
    (scene.opacity_logit[3], scene.opacity_logit[5]) = (-200.0, 40.0);
    scene.opacity_logit[6] = f32::INFINITY;
    let report = write(&scene, &folder, SceneFormat::NpyFolder, false).unwrap();
    let find = |field: &str, word: &str| {
        let mut found = report.limits.iter().filter(|l| l.field == field && l.limit.contains(word));
        let limit = found.next().unwrap_or_else(|| panic!("{field}: {report}"));
        (limit.rows, limit.first_row, limit.largest_change)
    };
    assert_eq!(find("log_scale", "larger").0, 1);
    assert_eq!(find("log_scale", "larger").1, 11);
    assert_eq!(find("log_scale", "becomes 0"), (1, 12, f64::INFINITY));
    let color = find("sh_dc", "clipped");
    assert_eq!((color.0, color.1), (1, 4096));
    assert!((color.2 - (3.0 - 1.772_454)).abs() < 1e-5, "{color:?}");
    assert_eq!((find("opacity_logit", "0 or 1").0, find("opacity_logit", "0 or 1").1), (2, 3));
    assert_eq!(report.limits.len(), 4, "{report}");

    let names: Vec<_> =
        report.files.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
    assert_eq!(names[0], "coord.npy");
    assert_eq!(names.len(), std::fs::read_dir(&folder).unwrap().count());
    let sizes = report.files.iter().map(|path| std::fs::metadata(path).unwrap().len());
    assert_eq!(report.bytes, sizes.sum::<u64>());

    let back = open(&folder);
    assert_eq!(back.len(), 5000, "no row is lost");
    assert!(back.log_scale[11].iter().all(|v| v.is_finite()));
    let again = write(&back, &second, SceneFormat::NpyFolder, false).unwrap();
    assert!(again.limits.is_empty(), "nothing is lost a second time: {again}");
    for (a, b) in report.files.iter().zip(&again.files) {
        assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap(), "{}", a.display());
    }
}

#[test]
fn labels_of_an_earlier_scene_do_not_come_back() {
    for (format, name) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let scene = labelled(30);
        write(&scene, &path, format, false).unwrap();
        let geometry = std::fs::read(&path).unwrap();
        assert!(open(&path).segment.is_some());
        write(&without_labels(&scene), &path, format, true).unwrap();
        assert!(geometry == std::fs::read(&path).unwrap(), "{name}: the checksum would match");
        assert_eq!((open(&path).segment, beside(&path).exists()), (None, false), "{name}");

        // Half of one of ours goes too; a file of someone else stays.
        write(&scene, &path, format, true).unwrap();
        let labels = std::fs::read(beside(&path)).unwrap();
        for (bytes, stays) in [(&labels[..labels.len() / 2], false), (b"someone else's", true)] {
            std::fs::write(beside(&path), bytes).unwrap();
            write(&without_labels(&scene), &path, format, true).unwrap();
            assert_eq!(beside(&path).exists(), stays, "{name}");
        }
    }
}

#[test]
fn labels_in_the_way_are_there_already() {
    for (format, name) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let scene = labelled(30);
        write(&scene, &path, format, false).unwrap();
        std::fs::remove_file(&path).unwrap();
        let before = contents(folder.path());
        for scene in [&scene, &without_labels(&scene)] {
            let error = write(scene, &path, format, false).unwrap_err().to_string();
            assert!(error.contains("labels.safetensors: is there already"), "{error}");
            assert!(contents(folder.path()) == before, "{name}");
        }
        write(&scene, &path, format, true).unwrap();
        assert_eq!(open(&path).segment.unwrap().len(), 30);
    }
}

#[test]
fn a_scene_whose_labels_cannot_be_written_is_not_replaced() {
    for (format, _) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let ending = match format {
            SceneFormat::Splat => "splat",
            SceneFormat::Glb => "glb",
            _ => "compressed.ply",
        };
        // The name of the labels is longer than file systems allow, that of the scene is not.
        let path =
            folder.path().join(format!("{:a<length$}.{ending}", "", length = 239 - ending.len()));
        write(&random_scene(10, 0, 1), &path, format, false).unwrap();
        let before = contents(folder.path());
        let error = write(&labelled(20), &path, format, true).unwrap_err();
        assert!(matches!(error, SceneError::Io { .. }), "{error}");
        assert!(contents(folder.path()) == before, "{ending}");

        let path = folder.path().join(format!("a.{ending}"));
        write(&random_scene(10, 0, 1), &path, format, false).unwrap();
        std::fs::create_dir(beside(&path)).unwrap();
        let before = contents(folder.path());
        let error = write(&labelled(20), &path, format, true).unwrap_err().to_string();
        assert!(error.contains("is not a file"), "{error}");
        assert!(contents(folder.path()) == before, "{ending}");
    }
}

#[test]
fn damaged_labels_do_not_hide_the_scene() {
    for (format, name) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let scene = labelled(30);
        write(&scene, &path, format, false).unwrap();
        let labels = std::fs::read(beside(&path)).unwrap();
        for bytes in [&labels[..labels.len() - 3], b"no labels at all", b""] {
            std::fs::write(beside(&path), bytes).unwrap();
            let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
            assert_eq!((loaded.scene.len(), &loaded.scene.segment), (30, &None), "{name}");
            let text = loaded.report.to_string();
            assert!(text.contains("is damaged and was not read"), "{text}");
            let strict = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
            let error = open_scene(&path, &strict).unwrap_err().to_string();
            assert!(error.contains("labels.safetensors"), "{error}");
        }
    }
}

#[cfg(unix)]
#[test]
fn links_are_written_through() {
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("there");
    std::fs::create_dir(&there).unwrap();
    for (format, name) in [FORMATS[0], FORMATS[2], FORMATS[3], FORMATS[4]] {
        let (path, real) = (folder.path().join(name), there.join(name));
        write(&random_scene(3, 0, 1), &real, format, false).unwrap();
        std::os::unix::fs::symlink(&real, &path).unwrap();
        write(&random_scene(9, 0, 1), &path, format, true).unwrap();
        assert!(path.is_symlink(), "{name}");
        assert_eq!((open(&path).len(), open(&real).len()), (9, 9), "{name}");
    }
}
