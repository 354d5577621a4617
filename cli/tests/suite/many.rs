//! Commands over many scenes, their parts, and `merge`. Each scene is a process.

use crate::support::*;
use serde_json::Value;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

/// Runs a command line as a process.
fn many(line: &str) -> Output {
    process(&words(line))
}

/// A folder with so many small scenes, `scenes/a.ply`, `scenes/b.ply`, ….
struct World(Folder);

impl World {
    fn new(count: u8) -> Self {
        let folder = Folder::new();
        std::fs::create_dir(folder.path("scenes")).unwrap();
        for i in 0..count {
            let name = format!("scenes/{}.ply", char::from(b'a' + i));
            folder.room(&name, 400, u64::from(i));
        }
        Self(folder)
    }

    /// The command over the scenes, with results in the folder `out`.
    fn run(&self, command: &str, out: &str, more: &str) -> Output {
        let (list, out) = (self.0.at("scenes"), self.0.at(out));
        let words = format!("{command} --manifest {list} {TINY} {SMALL_PICTURE} --out {out}");
        many(&format!("{words} {more}"))
    }

    /// Asserts that `features` succeeds, and parts of what it prints.
    #[track_caller]
    fn features(&self, out: &str, more: &str, parts: &[&str]) {
        has(&printed(&self.run("features", out, more)), parts);
    }

    fn merge(&self, out: &str) -> Output {
        many(&format!("merge {} --verify", self.0.at(out)))
    }

    fn record(&self, out: &str, name: &str) -> Value {
        json(self.0.path(&format!("{out}/records/{name}/record.json")))
    }

    /// Asserts that both folders have the same bytes in these files.
    fn same(&self, a: &str, b: &str, files: &[&str]) {
        for file in files {
            let [a, b] = [a, b].map(|out| bytes(self.0.path(out).join(file)));
            assert!(a == b, "{file}");
        }
    }
}

#[test]
fn parts_give_the_bytes_of_one_run() {
    let world = World::new(5);
    let all = "5 scenes, 5 done now, 0 done before, 0 failed";
    world.features("whole", "", &[all]);
    for part in ["0/3", "1/3", "2/3"] {
        assert!(!world.merge("parts").status.success(), "{part}: parts are missing");
        let own = if part == "2/3" { "1 scenes, 1 done" } else { "2 scenes, 2 done" };
        world.features("parts", &format!("--shard {part} --threads 2"), &[own]);
    }
    done(&world.merge("whole"));
    done(&world.merge("parts"));
    world.same("whole", "parts", &["merged.json", "merged.md"]);
    for scene in ["a", "b", "c", "d", "e"] {
        world.same("whole", "parts", &[&format!("{scene}/features.npy")]);
    }
    let merged = json(world.0.path("whole/merged.json"));
    assert_eq!(merged["scenes"].as_array().unwrap().len(), 5);
    assert!(merged["rows_in"].as_u64().unwrap() > 1500);
    let costs = json(world.0.path("whole/costs.json"));
    assert!(costs["stages"]["network"].as_f64().unwrap() > 0.0);
    // The same as the command on one scene, without all this.
    let (scene, out) = (world.0.at("scenes/c.ply"), world.0.at("alone"));
    done(&run!("features {scene} --out {out} {TINY}"));
    world.same("alone", "parts/c", &["features.npy"]);
}

#[test]
fn evaluations_of_parts_are_that_of_all() {
    // A file, and rooms that are made on the spot.
    let world = World::new(1);
    let scene = world.0.at("scenes/a.ply");
    let run = |out: &str, more: &str| {
        let out = world.0.at(out);
        let words = format!("evaluate {scene} synthetic:2:11 --features oracle");
        done(&many(&format!("{words} --out {out} {more}")));
    };
    let figures = |name: &str| json(world.0.path(name).join("evaluation.json"));
    run("whole", "");
    run("parts", "--shard 1/2");
    run("parts", "--shard 0/2");
    has(&printed(&world.merge("parts")), &["random labels"]);
    let merged = figures("parts");
    assert_eq!(figures("whole"), merged);
    // Nothing of a scene depends on when, or beside what, it was done.
    run("once", "--shard 0/1");
    done(&world.merge("once"));
    world.same("once", "parts", &["merged.json", "merged.md", "evaluation.json"]);
    assert_eq!(merged["scenes"], 3);
    let one = figures("parts/synthetic_1_11_1");
    assert_ne!(one["counts"]["random"], merged["counts"]["random"]);
}

#[test]
fn a_broken_scene_stops_no_other_and_is_told() {
    let world = World::new(3);
    let good = bytes(world.0.path("scenes/b.ply"));
    world.0.write("scenes/b.ply", &good[..good.len() / 2]);
    let output = world.run("features", "out", "--quiet");
    refused(&output, 3, &["1 of 3 scenes failed"]);
    let reason = world.record("out", "b")["reason"].as_str().unwrap().to_owned();
    has(&reason, &["b.ply"]);
    has(&stdout(&output), &["2 done now, 0 done before, 1 failed", &reason]);
    assert!(!world.0.path("out/b/features.npy").exists());
    refused(&world.merge("out"), 1, &["1 of 3 scenes are missing", &reason]);
    assert!(!world.0.path("out/merged.json").exists());
    // As broken as before it is tried again: what failed is not done.
    let again = world.run("features", "out", "--quiet");
    refused(&again, 3, &[]);
    has(&stdout(&again), &["0 done now, 2 done before, 1 failed"]);
    // Repaired, the one scene is done and nothing else.
    world.0.write("scenes/b.ply", &good);
    let time =
        || std::fs::metadata(world.0.path("out/a/features.npy")).unwrap().modified().unwrap();
    let before = time();
    world.features("out", "", &["1 done now, 2 done before, 0 failed"]);
    assert_eq!(before, time());
    done(&world.merge("out"));
}

#[test]
fn what_is_done_is_known_by_content_and_settings() {
    let world = World::new(2);
    let at = |name: &str| world.0.path(name);
    world.features("out", "", &[]);
    // Neither threads nor the path of a file change a result.
    world.features("out", "--threads 1", &[]);
    let other = world.run("features", "out", "--dtype f16");
    refused(&other, 2, &["--dtype left out, now f16", "--again"]);
    world.features("out", "--dtype f16 --again", &["2 done now"]);
    // A scene that is another now.
    world.0.room("scenes/a.ply", 300, 77);
    let output = world.run("features", "out", "--dtype f16");
    has(&stdout(&output), &["1 done now, 1 done before"]);
    has(&stderr(&output), &["a.ply has changed since"]);
    // A result that is gone, and one that was changed.
    let path = at("out/b/features.npy");
    std::fs::remove_file(&path).unwrap();
    has(&stderr(&world.merge("out")), &["features.npy is missing"]);
    world.features("out", "--dtype f16", &[]);
    done(&world.merge("out"));
    let mut changed = bytes(&path);
    *changed.last_mut().unwrap() ^= 1;
    std::fs::write(&path, changed).unwrap();
    has(&stderr(&world.merge("out")), &["features.npy was changed"]);
    // Another command needs another folder; a list may grow, but not shrink.
    has(&stderr(&world.run("segment", "out", "")), &["here are results of `features`"]);
    std::fs::rename(at("scenes/b.ply"), at("b.ply")).unwrap();
    has(&stderr(&world.run("features", "out", "--dtype f16")), &["b (", "is no part of"]);
    std::fs::rename(at("b.ply"), at("scenes/b.ply")).unwrap();
    std::fs::copy(at("scenes/b.ply"), at("scenes/c.ply")).unwrap();
    has(&stdout(&world.run("features", "out", "--dtype f16")), &["1 done now, 2 done before"]);
}

/// Runs a part and ends it without warning when a scene is done; gives whether it was still running.
fn killed(world: &World, out: &str, part: &str) -> bool {
    let (list, folder) = (world.0.at("scenes"), world.0.at(out));
    let line =
        format!("features --manifest {list} --shard {part} {TINY} {SMALL_PICTURE} --out {folder}");
    let mut child = program();
    let child = child.args(words(&line)).args(["--threads", "1"]);
    let mut child = child.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    let is_done = || {
        let records = std::fs::read_dir(world.0.path(out).join("records"));
        let mut folders = records.into_iter().flatten().flatten();
        folders.any(|folder| folder.path().join("record.json").exists())
    };
    while !is_done() && child.try_wait().unwrap().is_none() {
        assert!(began.elapsed() < Duration::from_secs(100), "nothing gets done");
        std::thread::sleep(Duration::from_millis(2));
    }
    let running = child.try_wait().unwrap().is_none();
    let _ = child.kill();
    child.wait().unwrap();
    running
}

/// Names in a folder; none of what is a file.
fn names(folder: &Path) -> BTreeSet<OsString> {
    let found = std::fs::read_dir(folder).into_iter().flatten().flatten();
    found.map(|entry| entry.file_name()).collect()
}

#[test]
fn a_part_that_was_killed_goes_on_and_two_on_one_part_agree() {
    let world = World::new(6);
    world.features("whole", "", &[]);
    assert!(killed(&world, "parts", "0/2"), "it was done too soon");
    has(&stderr(&world.merge("parts")), &["not done"]);
    // Two on the same part, at the same time.
    std::thread::scope(|scope| {
        let twice = ["0/2", "0/2", "1/2"].map(|part| {
            let world = &world;
            scope.spawn(move || world.features("parts", &format!("--shard {part}"), &[]))
        });
        twice.into_iter().for_each(|thread| thread.join().unwrap());
    });
    done(&world.merge("whole"));
    done(&world.merge("parts"));
    world.same("whole", "parts", &["merged.json"]);
    for name in names(&world.0.path("whole")) {
        // Nothing is left of the run that was killed.
        let [a, b] = ["whole", "parts"].map(|out| names(&world.0.path(out).join(&name)));
        assert_eq!(a, b, "{name:?}");
    }
}

#[test]
fn lists_give_scenes_flags_of_their_own() {
    let world = World::new(3);
    let (list, out) = (world.0.at("list.json"), world.0.at("out"));
    let run = |text: &str| {
        world.0.write("list.json", text);
        many(&format!("features --manifest {list} {TINY} --out {out}"))
    };
    let flags = r#"["scenes/a.ply", {"scene": "scenes/c.ply", "dtype": "f16", "exact": true}]"#;
    done(&run(flags));
    let size = |name: &str| bytes(world.0.path(&format!("out/{name}/features.npy"))).len() as f64;
    assert!((size("a") / size("c") - 2.0).abs() < 0.05, "f16 is half of f32");
    assert_eq!(world.record("out", "c")["job"]["settings"]["exact"], Value::Array(Vec::new()));
    assert!(!world.0.path("out/b").exists());
    for (text, problem) in [
        (r#"["scenes/a.ply", {"scene": "scenes/c.ply", "dtpye": "f16"}]"#, "\"dtpye\" is no flag"),
        (r#"[{"dtype": "f16"}]"#, "entry 0 of the list: \"scene\""),
        (r#"[{"scene": "a.ply", "exact": 3}]"#, "exact: 3; write true"),
        (r#"[{"scene": "a.ply", "json": "x.json"}]"#, "\"json\" is no flag"),
        (r#"["a.ply", 7]"#, "entry 1 of the list: 7 is neither"),
        (r#"["a.ply""#, "no JSON list of scenes"),
        ("[]", "there is no scene"),
        ("# nothing\n\n", "there is no scene"),
        ("scenes/a.ply\nscenes/a.ply\n", "given twice"),
    ] {
        let output = run(text);
        assert!(!output.status.success(), "{text}");
        has(&stderr(&output), &[problem]);
    }
    // Lines, and what is filled in for each scene.
    world.0.write("list.json", "# two\nscenes/b.ply\nscenes/c.ply\n");
    for name in ["b", "c"] {
        let classes: Vec<String> = (0..8).map(|i| format!("{name} {i}")).collect();
        world.0.write(&format!("{name}.txt"), classes.join("\n"));
    }
    let (names, second) = (world.0.at("{name}.txt"), world.0.at("second"));
    many(&format!("segment --manifest {list} {TINY} --out {second} --text-names {names}"));
    let texts = ["b", "c"]
        .map(|name| world.record("second", name)["job"]["settings"]["text-names"].clone());
    assert_ne!(texts[0], texts[1]);
    has(&texts[0].to_string(), &["sha256:"]);
}

#[test]
fn schedulers_say_the_part_and_wrong_use_is_told() {
    let world = World::new(3);
    let [a, b, out] = ["scenes/a.ply", "scenes/b.ply", "out"].map(|name| world.0.at(name));
    let run = |variables: &[(&str, &str)], more: &str| {
        let line = format!("features {a} {b} {TINY} --out {out} {more}");
        program().args(words(&line)).envs(variables.iter().copied()).output().unwrap()
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "3"),
        ("SLURM_ARRAY_TASK_MIN", "2"),
        ("SLURM_ARRAY_TASK_COUNT", "2"),
    ];
    has(&printed(&run(&slurm, "")), &["part 1/2 by SLURM_ARRAY_TASK_ID: 1 scenes"]);
    assert!(world.0.path("out/b/features.npy").exists() && !world.0.path("out/a").exists());
    let said = stdout(&run(&[("RANK", "0"), ("WORLD_SIZE", "2")], "--shard auto"));
    has(&said, &["part 0/2 by RANK: 1 scenes, 1 done now"]);
    // What is said by hand counts.
    let said = stdout(&run(&slurm, "--shard 0/1"));
    has(&said, &["--shard 0/1: 2 scenes, 0 done now, 2 done before"]);
    refused(&run(&[("RANK", "0")], ""), 2, &["WORLD_SIZE is missing"]);
    let cases = [
        ("--shard 2/2", 2, "0/2 to 1/2"),
        ("--shard half", 2, "write i/n"),
        ("--json x.json", 2, "unexpected argument"),
        ("--receipt x.json", 2, "--receipt names one file"),
        (&a, 2, "given twice"),
    ];
    all_refused(cases, |more| run(&[], more));
    refused(&run!("features --out {out}"), 2, &["required"]);
    refused(&run!("merge {}", world.0.at("scenes")), 2, &["no manifest.json"]);
    world.0.write("out/records/a/record.json", "{");
    has(&stderr(&world.merge("out")), &["no record of this program"]);
}
