//! `simulate`: what it writes, that nothing is the scene itself, and what it refuses.

use crate::support::*;
use scenesplat::datasets::effects::simulate;
use scenesplat::scene::{GaussianScene, ReadOptions, open_scene};

#[test]
fn effects_are_those_of_the_library_and_none_changes_nothing() {
    let folder = Folder::new();
    let room = folder.room("room.ply", 2000, 3);
    let read = |name: &str| -> GaussianScene {
        let options = ReadOptions { sh_rest: true, ..ReadOptions::default() };
        open_scene(&folder.path(name), &options).unwrap().scene
    };
    let run = |effect: &str, out: &str| {
        printed(&run!("simulate {room} --effect {effect} --seed 4 --out {}", folder.at(out)))
    };
    let said = run("floaters=5,holes=3,noise=2", "out");
    assert!(said.find("holes=3: ").unwrap() < said.find("floaters=5: ").unwrap(), "{said}");
    let effects = "holes=3,floaters=5,noise=2";
    let want = simulate(&read("room.ply"), &effects.parse().unwrap(), 4).unwrap();
    assert!(read("out/simulated.ply") == want.scene);
    let source = want.source.iter().map(|row| row.map_or(-1, |row| row as i64));
    assert!(labels(folder.path("out/source_rows.npy")).into_iter().eq(source));
    let picture = bytes(folder.path("out/preview.png"));
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 5000);
    has(&text(folder.path("out/receipt.json")), &[effects]);
    has(&run("none", "none"), &["no effect"]);
    assert!(read("none/simulated.ply") == read("room.ply"));
}

#[test]
fn wrong_effects_are_refused_by_name() {
    let cases = [
        ("hole=1", 2, "holes, floaters, surface, blur, glass, light, noise"),
        ("holes=6", 2, "0 to 5"),
        ("holes=1,holes=1", 2, "twice"),
    ];
    all_refused(cases, |effect| run!("simulate none.ply --effect {effect}"));
}
