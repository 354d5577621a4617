//! A room that lies on its side, or is in millimeters, gets the labels of the upright one, in every
//! command that runs a network.

use crate::support::*;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Samples, read_picture};
use scenesplat::scene::{Camera, Similarity, Up};
use std::path::{Path, PathBuf};

struct World(Folder);

impl World {
    /// With the upright room in it.
    fn new() -> Self {
        let world = Self(Folder::new());
        world.lying("upright", Up::PLUS_Z, 1.0);
        world
    }

    /// Writes the room with another direction up, and another unit.
    fn lying(&self, name: &str, up: Up, scale: f64) {
        let m = up.upright();
        let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
        let mut scene = room(20_000, 0x5EED);
        scene.transform(&Similarity { rotation, scale, translation: [0.0; 3] });
        self.0.scene(&format!("{name}.ply"), &scene);
    }

    /// Runs a command on a scene with results in the folder `out`.
    fn run(&self, command: &str, scene: &str, out: &str, more: &str) -> String {
        let scene = self.0.at(&format!("{scene}.ply"));
        told(&run!("{command} '{scene}' {more} --out '{}'", self.0.at(out)))
    }

    fn floats(&self, name: &str) -> Vec<f32> {
        floats(self.0.path(name))
    }
}

/// Share of the rows that are the same within `within`.
fn alike(a: &[f32], b: &[f32], within: f32) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() <= within).count() as f64 / a.len() as f64
}

#[test]
fn segment_labels_a_lying_room_as_the_upright_one() {
    let world = World::new();
    let said = world.run("segment", "upright", "upright", "");
    assert!(!said.contains("turned") && !said.contains("UNCLEAR"), "{said}");
    let due = world.floats("upright/labels.npy");
    let same = |out: &str| alike(&world.floats(&format!("{out}/labels.npy")), &due, 0.0);
    for (up, scale) in [
        (Up::MINUS_Y, 1.0),
        (Up::PLUS_Y, 1.0),
        (Up::PLUS_X, 1.0),
        (Up::MINUS_X, 1.0),
        (Up::MINUS_Y, 1000.0),
    ] {
        let name = format!("{up}-{scale}");
        world.lying(&name, up, scale);
        let said = world.run("segment", &name, &name, "");
        has(&said, &[&format!("up is {up}"), "turned to +z"]);
        let alike = same(&name);
        assert!(alike > 0.995, "{name}: {alike} of the labels are those of the upright room");
        let receipt = text(world.0.path(&name).join("receipt.json"));
        has(&receipt, &["\"turned\""]);
        assert_eq!(receipt.contains("\"unit\""), scale != 1.0, "{receipt}");
    }
    // Surfaces, on which labels agree, lie along the walls, too, however the room does.
    world.lying("aslant", Up::new([0.3, -0.8, 0.5]).unwrap(), 1.0);
    world.run("segment", "aslant", "aslant", "");
    assert!(same("aslant") > 0.98, "{}", same("aslant"));
    // What the step is for: without it most labels are lost.
    world.run("segment", "-y-1", "as_is", "--as-is");
    assert!(same("as_is") < 0.7, "{}", same("as_is"));
    // And the user's word counts.
    let said = world.run("segment", "-y-1", "given", "--up -y --unit m");
    has(&said, &["up is -y:"]);
    assert!(same("given") > 0.995);
}

#[test]
fn features_queries_and_scores_are_those_of_the_upright_room() {
    let world = World::new();
    world.lying("lying", Up::MINUS_Y, 1.0);
    let both = |command: &str, more: &str, file: &str| {
        ["upright", "lying"].map(|scene| {
            world.run(command, scene, scene, more);
            world.0.path(scene).join(file)
        })
    };
    for (command, more, file) in
        [("features", "", "features.npy"), ("query", "floor", "scores.npy")]
    {
        let [a, b] = both(command, more, file).map(floats);
        let same = alike(&a, &b, 0.02);
        assert!(same > 0.99, "{same} of {file}");
    }
    let more = format!("--label-names {}", world.0.names());
    let right = |path: PathBuf| json(path)["all_acc"].as_f64().unwrap();
    let [due, got] = both("evaluate", &more, "evaluation.json").map(right);
    assert!(due > 0.6 && (due - got).abs() < 0.005, "{got} right, {due} upright");
}

#[test]
fn what_cannot_be_told_is_warned_of() {
    let world = World(Folder::new());
    // A sphere: no side differs from another.
    let n = 3000;
    let point = |i: usize| {
        let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
        let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
        [r * phi.cos(), r * phi.sin(), z]
    };
    let ball = world.0.scene("ball.ply", &balls((0..n).map(point).collect(), 0.018, 2.0));
    let said = world.run("segment", "ball", "out", "--vote-k 1");
    has(&said, &["UP IS UNCLEAR", "--up"]);
    has(&text(world.0.path("out/receipt.json")), &["UP IS UNCLEAR"]);
    let said = stdout(&run!("inspect {ball} --no-sheet"));
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    has(&said, &["up is unclear", "--up AXIS"]);
    let said = world.run("segment", "ball", "out", "--vote-k 1 --up +z");
    assert!(!said.contains("UNCLEAR"), "{said}");
    for unit in ["furlong", "-1", "nan"] {
        refused(&run!("segment {ball} --unit {unit}"), 2, &[]);
    }
}

/// Mean difference of two pictures, of 255.
fn apart(a: &Path, b: &Path) -> f64 {
    let read = |path: &Path| -> Vec<u8> {
        match read_picture(path).unwrap().into_samples() {
            Samples::Eight(values) => values,
            Samples::Sixteen(_) => panic!("{}: 8 bits are expected", path.display()),
        }
    };
    let (a, b) = (read(a), read(b));
    assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / a.len() as f64
}

#[test]
fn every_direction_is_found_and_drawn_upright() {
    let world = World::new();
    // Names with spaces are names like others.
    let orbit = |scene: &str, out: &str, more: &str| {
        world.run("render", scene, out, &format!("--orbit 2 --size 96x72 {more}"));
        world.0.path(out).join("orbit_001.png")
    };
    let due = orbit("upright", "upright", "");
    let file = world.0.at("as seen.json");
    for up in [Up::MINUS_Z, Up::PLUS_Y, Up::MINUS_Y, Up::PLUS_X, Up::MINUS_X] {
        let name = &up.to_string();
        let lying = format!("lying {name}");
        world.lying(&lying, up, 1.0);
        let scene = world.0.at(&format!("{lying}.ply"));
        done(&run!("inspect '{scene}' --no-sheet --json '{file}'"));
        assert_eq!(json(&file)["up"]["axis"], **name);
        let got = apart(&orbit(&lying, &format!("orbit {name}"), ""), &due);
        assert!(got < 2.0, "{name}: {got}");
    }
    // It takes the turn: as it lies, the picture is another.
    assert!(apart(&orbit("lying -y", "as it lies", "--up +z"), &due) > 8.0);
}

#[test]
fn lifted_labels_are_drawn_upright() {
    let world = World::new();
    let (width, height) = (64, 48);
    std::fs::create_dir(world.0.path("segments")).unwrap();
    let ids: Vec<i32> = (0..width * height).map(|i| i32::from(i % width >= 32)).collect();
    let shape = [height as usize, width as usize];
    write_npy(&world.0.path("segments/a_s.npy"), &shape, &ids).unwrap();
    let table = world.0.path("segments/a_f.npy");
    write_npy(&table, &[2, 2], &[1.0f32, 0.0, 0.0, 1.0]).unwrap();
    let preview = |scene: &str, up: Up, more: &str| {
        // Looks down into the room from above, wherever that is.
        let m = up.upright();
        let down = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
        let rotation = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..3).map(|k| down[i][k] * m[k][j]).sum())
        });
        let at = camera("a.png", [width, height], [-2.0, 2.0, 8.0]);
        let cameras = [Camera { fx: 30.0, fy: 30.0, rotation, ..at }];
        let cameras = world.0.cameras("cameras.json", &cameras);
        let words = format!("--cameras {cameras} --segments {}", world.0.at("segments"));
        let out = format!("{scene}{}", more.len());
        world.run(
            "lift-labels",
            scene,
            &out,
            &format!("{words} --depth off --preview-size=720 {more}"),
        );
        world.0.path(&out).join("preview.png")
    };
    world.lying("lying", Up::MINUS_Y, 1.0);
    let due = preview("upright", Up::PLUS_Z, "");
    let far = |more: &str| apart(&preview("lying", Up::MINUS_Y, more), &due);
    assert!(far("") < 2.0, "{}", far(""));
    assert!(far("--up +z") > 5.0, "{}", far("--up +z"));
}
