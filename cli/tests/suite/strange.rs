//! Scenes that look like nothing that the network inside the program was trained on.

use crate::support::*;
use scenesplat::scene::GaussianScene;

const GAUSSIANS: usize = 12_000;

fn plain_room() -> GaussianScene {
    GaussianScene { segment: None, instance: None, normal: None, ..room(GAUSSIANS, 779) }
}

/// The same Gaussians on spirals in a ball: neither floor nor walls nor things.
fn heap() -> GaussianScene {
    let mut scene = plain_room();
    for (i, p) in scene.coord.iter_mut().enumerate() {
        let t = i as f32;
        let (around, radius) = (2.399_963 * t, (t / GAUSSIANS as f32).cbrt());
        let z = (0.754_877 * t).fract() * 2.0 - 1.0;
        let flat = (1.0 - z * z).sqrt();
        *p = [radius * flat * around.cos(), radius * flat * around.sin(), radius * z];
    }
    scene
}

#[test]
fn a_strange_scene_is_said_to_be_one_and_stays_unknown_if_asked() {
    let folder = Folder::new();
    folder.scene("room.ply", &plain_room());
    folder.scene("heap.ply", &heap());
    let run = |command: &str, out: &str| {
        // Which way is up is not the question.
        let words = format!("{command} --up +z --unit m --out @{out}").replace('@', &folder.at(""));
        let said = told(&line(&words));
        let receipt = json(folder.path(&format!("{out}/receipt.json")));
        let warned = receipt["warnings"].to_string().matches("looks like nothing").count();
        let found: f64 = setting(&receipt, "known").unwrap().parse().unwrap();
        assert_eq!(said.contains("looks like nothing"), warned > 0, "{said}");
        (found, warned, said)
    };
    let labelled = |out: &str| {
        let all = labels(folder.path(&format!("{out}/labels.npy")));
        all.iter().filter(|l| **l >= 0).count()
    };
    let (usual, warned, _) = run("segment @room.ply --strange unknown", "room");
    assert!(warned == 0 && labelled("room") > 10_500, "{}", labelled("room"));
    let (strange, warned, _) = run("segment @heap.ply --strange label", "heap");
    assert!(usual > 0.95 && strange < 0.2, "{usual} {strange}");
    assert!(warned == 1 && labelled("heap") > 10_500, "{}", labelled("heap"));
    for (out, more) in [("left", "--strange unknown"), ("auto", "")] {
        let (again, warned, said) = run(&format!("segment @heap.ply {more}"), out);
        assert_eq!((again.to_bits(), warned, labelled(out)), (strange.to_bits(), 1, 0), "{said}");
        has(&said, &["labels are left out"]);
    }
    // Who opens a file reads it there.
    let said_in = |out: &str| {
        let file = bytes(folder.path(&format!("{out}/segmented.ply")));
        String::from_utf8_lossy(&file[..3000]).matches("warning: this looks like nothing").count()
    };
    assert_eq!(["room", "heap", "auto"].map(said_in), [0, 1, 1]);
    // What is asked of a strange scene is said to be a guess, too.
    let (again, _, said) = run("query @heap.ply chair", "asked");
    has(&said, &["what is found is a guess"]);
    assert_eq!(again.to_bits(), strange.to_bits());
}

#[test]
fn other_networks_have_no_strangeness() {
    let folder = Folder::new();
    let (scene, out) = (folder.scene("room.ply", &plain_room()), folder.at("out"));
    let segment = |more: &str| run!("segment {scene} --out {out} {more}");
    let tiny = segment("--config tiny --weights seeded:0 --strange unknown");
    refused(&tiny, 2, &["network inside the program"]);
    // Codes do not tell: said, and refused if it is asked for.
    done(&segment("--setting codes=16"));
    has(&text(folder.path("out/receipt.json")), &["not judged"]);
    refused(&segment("--setting codes=16 --strange unknown"), 2, &["do not tell"]);
}
