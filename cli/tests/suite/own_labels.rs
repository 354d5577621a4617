//! Labels that scenes carry, and the names that their ids stand for.

use crate::support::{Folder, done, has, json, process, refused, room, run, stderr, words};
use scenesplat::scene::GaussianScene;

/// A room whose labels went through `change`.
fn relabelled(folder: &Folder, name: &str, change: impl Fn(usize, i32) -> i32) -> String {
    let mut scene: GaussianScene = room(4000, 7);
    let labels = scene.segment.as_mut().unwrap();
    labels.iter_mut().enumerate().for_each(|(row, label)| *label = change(row, *label));
    folder.scene(name, &scene)
}

#[test]
fn ids_that_count_from_one_are_shifted_on_request() {
    let folder = Folder::new();
    let (names, out) = (folder.names(), folder.at("out"));
    let zero = relabelled(&folder, "zero.ply", |_, label| label);
    let one = relabelled(&folder, "one.ply", |_, label| label + 1);
    let evaluate = |scene: &str, more: &str| {
        run!("evaluate {scene} --label-names {names} --vote-k 0 --out {out} {more}")
    };
    let figures = || json(folder.path("out/evaluation.json"));
    done(&evaluate(&zero, "--label-base 0"));
    let right = figures();
    done(&evaluate(&one, "--label-base 1"));
    assert_eq!(figures(), right);
    // The network is no part of the list: what it finds tells that every label is one off.
    let output = evaluate(&one, "--label-base 0");
    done(&output);
    has(&stderr(&output), &["one.ply", "would if every id", "--label-base 1"]);
    let output = evaluate(&one, "--features oracle");
    done(&output);
    has(&stderr(&output), &["***", "least label is 1", "--label-base 1", "--label-base 0"]);
    let objects = run!("objects {one} --label-names {names} --label-base 1 --out {out}");
    done(&objects);
    assert!(!stderr(&objects).contains("may count from 1"));
    let objects = run!("objects {one} --label-names {names} --out {out}");
    has(&stderr(&objects), &["may count from 1", "--label-base 1"]);
}

#[test]
fn ids_that_have_names_only_from_one_are_asked_about() {
    let folder = Folder::new();
    let (names, out) = (folder.names(), folder.at("out"));
    let scene = relabelled(&folder, "one.ply", |row, _| row as i32 % 41 + 1);
    let base = format!("--label-names {names} --out {out}");
    for command in ["evaluate --features oracle", "objects"] {
        let parts = ["one.ply", "1 to 41", "--label-base 1", "--label-base 0"];
        refused(&run!("{command} {scene} {base}"), 1, &parts);
    }
    refused(&run!("objects {scene} --label-base 1 --out {out}"), 2, &["--label-names"]);
    refused(&run!("objects {scene} {base} --label-base 2"), 2, &["0 or 1"]);
}

#[test]
fn ids_without_a_name_are_counted_as_unlabelled() {
    let folder = Folder::new();
    let (names, out) = (folder.names(), folder.at("out"));
    let stray = relabelled(&folder, "stray.ply", |row, label| if row < 3 { 99 } else { label });
    let none = relabelled(&folder, "none.ply", |row, label| if row < 5 { 255 } else { label });
    let evaluate = |scene: &str, more: &str| {
        run!("evaluate {scene} --features oracle --vote-k 0 --label-base 0 --out {out} {more}")
    };
    let output = evaluate(&stray, &format!("--label-names {names}"));
    done(&output);
    has(&stderr(&output), &["stray.ply", "3 labels", "99: 3", "unlabeled"]);
    let output = evaluate(&none, &format!("--label-names {names}"));
    done(&output);
    has(&stderr(&output), &["none.ply", "5 labels are 255"]);
    let grid = folder.at("grid.toml");
    folder.write("grid.toml", "reference = \"voxel=0.4,k=1\"\n");
    let line = format!("pareto --grid {grid} --scenes {stray} --label-names {names} --repeats 1");
    let output = process(&words(&format!("{line} --out {}", folder.at("pareto"))));
    done(&output);
    has(&stderr(&output), &["stray.ply", "99: 3", "unlabeled"]);
    // Without names they are of another list.
    let output = evaluate(&stray, "");
    refused(&output, 1, &["99: 3", "give the names with --label-names"]);
}
