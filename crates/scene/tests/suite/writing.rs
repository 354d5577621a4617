//! Writing scenes: all or nothing, in every format, and the report.

use crate::common::{self, contents, labelled, random_scene, strict, write_as};
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::{
    GaussianScene, SceneError, SceneFormat, WriteOptions, WriteReport, open_scene, write_scene,
};
use std::path::{Path, PathBuf};

const FORMATS: [(SceneFormat, &str); 11] = [
    (SceneFormat::Ply, "a.ply"),
    (SceneFormat::CompressedPly, "a.compressed.ply"),
    (SceneFormat::Spz, "a.spz"),
    (SceneFormat::Splat, "a.splat"),
    (SceneFormat::Sog, "a.sog"),
    (SceneFormat::SogFolder, "sog/meta.json"),
    (SceneFormat::NpyFolder, "deeper/npy"),
    (SceneFormat::Glb, "a.glb"),
    (SceneFormat::SogStreamed, "lod/lod-meta.json"),
    (SceneFormat::Usda, "a.usda"),
    (SceneFormat::Usdz, "a.usdz"),
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
    write_as(scene, path, format, &options)
}

fn open(path: &Path) -> GaussianScene {
    common::open(path).scene
}

fn without_labels(scene: &GaussianScene) -> GaussianScene {
    GaussianScene {
        segment: None,
        segment_score: None,
        instance: None,
        lang_code: None,
        ..scene.clone()
    }
}

fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".labels.safetensors");
    name.into()
}

#[test]
fn stopping_at_any_time_changes_nothing() {
    let scene = labelled(3000, 0);
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
    let many = random_scene(600_000, 0, 4);
    let scene = many.select_rows(&(0..70_000).collect::<Vec<_>>()).unwrap();
    for (format, name) in FORMATS.into_iter().filter(|(_, name)| !name.contains("meta.json")) {
        let path = folder.path().join(name);
        let options = WriteOptions::default();
        let large = matches!(format, SceneFormat::Ply | SceneFormat::NpyFolder | SceneFormat::Glb);
        let scene = if large { &many } else { &scene };
        let mut seen = Vec::new();
        let result = write_scene(scene, &path, format, &options, &mut |done| {
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
    let scene = labelled(20, 0);
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
fn reports_name_every_file_and_its_size() {
    for (format, name) in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let report = write(&labelled(5000, 0), &folder.path().join(name), format, false).unwrap();
        let mut files = report.files.clone();
        files.sort();
        let due = contents(folder.path()).into_iter().filter(|file| file.1.is_some());
        assert_eq!(files, due.map(|file| file.0).collect::<Vec<_>>(), "{name}");
        let sizes = files.iter().map(|path| std::fs::metadata(path).unwrap().len());
        assert_eq!(report.bytes, sizes.sum::<u64>(), "{name}");
    }
}

#[test]
fn labels_of_an_earlier_scene_do_not_come_back() {
    for (format, name) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let scene = labelled(30, 0);
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
        let scene = labelled(30, 0);
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
        let error = write(&labelled(20, 0), &path, format, true).unwrap_err();
        assert!(matches!(error, SceneError::Io { .. }), "{error}");
        assert!(contents(folder.path()) == before, "{ending}");

        let path = folder.path().join(format!("a.{ending}"));
        write(&random_scene(10, 0, 1), &path, format, false).unwrap();
        std::fs::create_dir(beside(&path)).unwrap();
        let before = contents(folder.path());
        let error = write(&labelled(20, 0), &path, format, true).unwrap_err().to_string();
        assert!(error.contains("is not a file"), "{error}");
        assert!(contents(folder.path()) == before, "{ending}");
    }
}

#[test]
fn damaged_labels_do_not_hide_the_scene() {
    for (format, name) in BESIDE {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let scene = labelled(30, 0);
        write(&scene, &path, format, false).unwrap();
        let labels = std::fs::read(beside(&path)).unwrap();
        // Of the same length, so that only the codebook is missing.
        let mut without_mean = labels.clone();
        let at = labels.windows(18).position(|w| w == b"lang_codebook_mean").unwrap();
        without_mean[at] = b'L';
        for bytes in [&labels[..labels.len() - 3], b"no labels at all", b"", &without_mean] {
            std::fs::write(beside(&path), bytes).unwrap();
            let loaded = common::open(&path);
            assert_eq!((loaded.scene.len(), &loaded.scene.segment), (30, &None), "{name}");
            let text = loaded.report.to_string();
            assert!(text.contains("is damaged and was not read"), "{text}");
            let error = open_scene(&path, &strict()).unwrap_err().to_string();
            assert!(error.contains("labels.safetensors"), "{error}");
        }
        // Those of the scene before somebody changed it.
        std::fs::write(beside(&path), labels).unwrap();
        let other = folder.path().join("other");
        write(&random_scene(30, 0, 9), &other, format, false).unwrap();
        std::fs::rename(other, &path).unwrap();
        let loaded = open_scene(&path, &strict()).unwrap();
        assert_eq!(loaded.scene.segment, None);
        let notes = &loaded.report.notes;
        assert!(notes.iter().any(|note| note.contains("another version")), "{}", loaded.report);
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
