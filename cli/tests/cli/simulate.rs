//! `simulate`: what it writes, that nothing is the scene itself, and what it refuses.

use crate::{done, scenesplat, stderr};
use scenesplat::datasets::effects::simulate;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{ReadOptions, open_scene};
use std::path::Path;

fn read(path: &Path) -> scenesplat::scene::GaussianScene {
    let options = ReadOptions { sh_rest: true, ..ReadOptions::default() };
    open_scene(path, &options).unwrap().scene
}

#[test]
fn effects_are_those_of_the_library_and_none_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let room = folder.path().join("room.ply");
    let settings = SyntheticRoomSettings { room: 1, ..SyntheticRoomSettings::with_count(2000, 3) };
    write_inria_ply(&generate(&settings).unwrap().scene, &[], &room).unwrap();
    let run = |effect: &str, out: &str| {
        let out = folder.path().join(out);
        let words = ["--effect", effect, "--seed", "4", "--out", out.to_str().unwrap()];
        let output = scenesplat(&[&["simulate", room.to_str().unwrap()][..], &words].concat());
        done(&output);
        (out.clone(), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let (out, said) = run("floaters=5,holes=3,noise=2", "out");
    assert!(said.find("holes=3: ").unwrap() < said.find("floaters=5: ").unwrap(), "{said}");
    let want = simulate(&read(&room), &"holes=3,floaters=5,noise=2".parse().unwrap(), 4).unwrap();
    assert!(read(&out.join("simulated.ply")) == want.scene);
    let rows = NpyFile::open(&out.join("source_rows.npy")).unwrap().read_i64().unwrap();
    let source = want.source.iter().map(|row| row.map_or(-1, |row| row as i64));
    assert!(rows.into_iter().eq(source));
    let picture = std::fs::read(out.join("preview.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 5000);
    let receipt = std::fs::read_to_string(out.join("receipt.json")).unwrap();
    assert!(receipt.contains("holes=3,floaters=5,noise=2"), "{receipt}");
    let (out, said) = run("none", "none");
    assert!(said.contains("no effect"), "{said}");
    assert!(read(&out.join("simulated.ply")) == read(&room));
}

#[test]
fn wrong_effects_are_refused_by_name() {
    for (effect, part) in [
        ("hole=1", "holes, floaters, surface, blur, glass, light, noise"),
        ("holes=6", "0 to 5"),
        ("holes=1,holes=1", "twice"),
    ] {
        let output = scenesplat(&["simulate", "none.ply", "--effect", effect]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    }
}
