//! `scenesplat chunk`

use crate::{asset, done, scenesplat, stderr};
use scenesplat::scene::{ReadOptions, open_scene};
use std::path::Path;

fn chunk(root: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["chunk", root.to_str().unwrap(), "--out", out.to_str().unwrap()];
    args.extend(more);
    scenesplat(&args)
}

fn folders(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path).unwrap().map(|e| e.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|name| name.into_string().unwrap()).collect();
    names.retain(|name| !name.starts_with('.'));
    names.sort();
    names
}

#[test]
fn a_split_becomes_chunks_and_a_second_run_finds_them() {
    let dir = tempfile::tempdir().unwrap();
    let split = dir.path().join("data/train");
    std::fs::create_dir_all(&split).unwrap();
    std::fs::copy(asset("room.ply"), split.join("one.ply")).unwrap();
    std::fs::copy(asset("room.ply"), split.join("two.ply")).unwrap();
    std::fs::write(split.join("bad.ply"), "ply\n").unwrap();
    let (root, out) = (dir.path().join("data"), dir.path().join("out"));
    let more = ["--split", "train", "--range", "2", "2", "--stride", "1", "1", "--min", "100"];
    let first = chunk(&root, &out, &more);
    assert_eq!(first.status.code(), Some(1), "one scene is broken");
    assert!(stderr(&first).contains("bad.ply"), "{}", stderr(&first));
    let path = out.join("train_chunk2x2_stride1x1");
    let names = folders(&path);
    assert!(names.len() >= 4 && names.len().is_multiple_of(2), "{names:?}");
    assert!(names.contains(&"one_0".to_owned()) && names.contains(&"two_0".to_owned()));
    let scene = open_scene(&path.join("one_0"), &ReadOptions::default()).unwrap().scene;
    assert!(scene.len() >= 100 && scene.segment.is_some());
    std::fs::remove_file(split.join("bad.ply")).unwrap();
    let second = chunk(&root, &out, &more);
    done(&second);
    let text = String::from_utf8_lossy(&second.stdout).into_owned();
    assert!(text.contains(&format!("{} of them there already", names.len())), "{text}");
    // A subset, and a name that is no scene.
    let list = dir.path().join("list.txt");
    std::fs::write(&list, "two\n").unwrap();
    let listed = [&more[..], &["--grid", "0.05", "--scenes", list.to_str().unwrap()]].concat();
    done(&chunk(&root, &out, &listed));
    let names = folders(&out.join("train_grid5.0cm_chunk2x2_stride1x1"));
    assert!(!names.is_empty() && names.iter().all(|name| name.starts_with("two_")), "{names:?}");
    std::fs::write(&list, "three\n").unwrap();
    assert!(stderr(&chunk(&root, &out, &listed)).contains("three"));
}

#[test]
fn wrong_use_is_explained() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |more: &[&str], code: i32, text: &str| {
        let output = chunk(dir.path(), dir.path(), more);
        assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
        assert!(stderr(&output).contains(text), "{}", stderr(&output));
    };
    refused(&["--grid", "0"], 2, "grid_size");
    refused(&["--stride", "9", "9"], 2, "stride");
    refused(&["--range", "9"], 2, "range");
    refused(&["--split", "none"], 1, "none");
    refused(&[], 1, "no scene");
}
