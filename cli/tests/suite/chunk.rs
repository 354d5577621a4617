//! `scenesplat chunk`

use crate::support::*;

#[test]
fn a_split_becomes_chunks_and_a_second_run_finds_them() {
    let folder = Folder::new();
    let room = bytes(asset("room.ply"));
    folder.write("data/train/one.ply", &room);
    folder.write("data/train/two.ply", &room);
    let bad = folder.write("data/train/bad.ply", "ply\n");
    let (root, out) = (folder.at("data"), folder.at("out"));
    let chunk = |more: &str| {
        run!("chunk {root} --out {out} --split train --range 2 2 --stride 1 1 --min 100 {more}")
    };
    let names = |name: &str| {
        let entries = std::fs::read_dir(folder.path("out").join(name)).unwrap();
        let names = entries.map(|e| e.unwrap().file_name().into_string().unwrap());
        names.filter(|name| !name.starts_with('.')).collect::<Vec<_>>()
    };
    refused(&chunk(""), 1, &["bad.ply"]);
    let made = names("train_chunk2x2_stride1x1");
    assert!(made.len() >= 4 && made.len().is_multiple_of(2), "{made:?}");
    assert!(made.contains(&"one_0".to_owned()) && made.contains(&"two_0".to_owned()));
    let scene = read(folder.path("out/train_chunk2x2_stride1x1/one_0"));
    assert!(scene.len() >= 100 && scene.segment.is_some());
    std::fs::remove_file(bad).unwrap();
    has(&printed(&chunk("")), &[&format!("{} of them there already", made.len())]);
    // A subset, and a name that is no scene.
    let list = folder.write("list.txt", "two\n");
    done(&chunk(&format!("--grid 0.05 --scenes {list}")));
    let made = names("train_grid5.0cm_chunk2x2_stride1x1");
    assert!(!made.is_empty() && made.iter().all(|name| name.starts_with("two_")), "{made:?}");
    folder.write("list.txt", "three\n");
    has(&stderr(&chunk(&format!("--scenes {list}"))), &["three"]);
}

#[test]
fn wrong_use_is_explained() {
    let folder = Folder::new();
    let cases = [
        ("--grid 0", 2, "meters above 0"),
        ("--stride 9 9", 2, "stride"),
        ("--range 9", 2, "range"),
        ("--split none", 1, "none"),
        ("", 1, "no scene"),
    ];
    let root = folder.at("");
    all_refused(cases, |more| run!("chunk {root} --out {root} {more}"));
}
