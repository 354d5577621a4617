//! `pareto`: what it writes, that it goes on where it stopped, and what it refuses.

use crate::support::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use serde_json::Value;
#[cfg(unix)]
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Output;
#[cfg(unix)]
use std::process::Stdio;

const GRID: &str = "reference = \"voxel=0.1,k=8\"\npoints = [\"precision=bf16\"]\n\
    [axes]\nvoxel = [0.4, 0.1]\nk = [1, 8]\n\
    [neutral]\nthreads = [1, 2]\nmax_memory = [\"8GB\"]\nisa = [\"portable\"]\n";

/// A folder with two small rooms and a grid.
struct World {
    folder: Folder,
    scenes: Vec<String>,
}

impl World {
    fn new(grid: &str) -> Self {
        let folder = Folder::new();
        folder.write("grid.toml", grid);
        let scenes = [1, 2].map(|room| {
            let settings =
                SyntheticRoomSettings { room, ..SyntheticRoomSettings::with_count(1500, 3) };
            folder.scene(&format!("room{room}.ply"), &generate(&settings).unwrap().scene)
        });
        Self { folder, scenes: scenes.to_vec() }
    }

    /// The command on so many of the rooms; each setting is a process.
    fn line(&self, scenes: usize, more: &str) -> String {
        let (grid, out) = (self.folder.at("grid.toml"), self.folder.at("out"));
        let scenes = self.scenes[..scenes].join(" ");
        format!("pareto --grid {grid} --scenes {scenes} --repeats 2 --threads 2 --out {out} {more}")
    }

    fn run(&self, scenes: usize, more: &str) -> Output {
        process(&words(&self.line(scenes, more)))
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path("out").join(name)
    }

    fn records(&self) -> Vec<Value> {
        let lines = text(self.out("records.jsonl"));
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }
}

fn of<'a>(all: &'a [Value], kind: &str) -> Vec<&'a Value> {
    all.iter().filter(|r| r["kind"] == kind).collect()
}

fn are_whole(all: &[Value]) {
    let of = |kind: &str| of(all, kind);
    // Four of the product and one beside it, on two sets; some may be ruled out.
    assert!((6..=10).contains(&of("setting").len()), "{}", all.len());
    assert_eq!((of("oracle").len(), of("random").len()), (2, 2));
    assert_eq!(of("neutral").len(), 8);
    let fields = "setting changes_result prediction_hash weights_hash input_hash machine miou";
    for record in all {
        for field in fields.split(' ') {
            assert!(record.get(field).is_some(), "{field} of {record}");
        }
        for field in ["seconds_p50", "seconds_p95", "peak_bytes", "miou"] {
            assert!(record[field].as_f64().unwrap() > 0.0, "{field} of {record}");
        }
        assert!(record["f_miou"].as_f64().is_some(), "{record}");
        assert!(record["stage_coverage"].as_f64().unwrap() >= 0.97, "{record}");
    }
    for record in of("setting") {
        assert_eq!(record["changes_result"], true);
        let share: f64 =
            record["stages"].as_array().unwrap().iter().map(|s| s["share"].as_f64().unwrap()).sum();
        assert!((0.97..=1.0 + 1e-9).contains(&share), "{record}");
        assert!(record["agreement"].as_f64().unwrap() <= 1.0 && record["ece"].as_f64().is_some());
    }
    for record in of("neutral") {
        assert_eq!(
            (&record["changes_result"], &record["holds"]),
            (&Value::Bool(false), &Value::Bool(true))
        );
        if record["rule"] == "equal" {
            let own = of("setting")
                .into_iter()
                .find(|r| r["setting"] == record["setting"] && r["scenes"] == record["scenes"]);
            assert_eq!(own.unwrap()["prediction_hash"], record["prediction_hash"]);
        }
    }
    // Even the truth loses small objects to the vote of its neighbors, in rooms as sparse as these.
    let best =
        |kind: &str| of(kind).iter().map(|r| r["miou"].as_f64().unwrap()).fold(0.0, f64::max);
    assert!(best("oracle") > 0.5 && best("oracle") > best("setting") && best("random") < 0.2);
}

/// No point of a front is beaten.
fn is_a_front(front: &Value) {
    let points = front["points"].as_array().unwrap();
    let place = |p: &Value| (p["seconds_p50"].as_f64().unwrap(), p["f_miou"].as_f64().unwrap());
    for (i, a) in points.iter().map(place).enumerate() {
        for (j, b) in points.iter().map(place).enumerate() {
            assert!(i == j || !(a.0 <= b.0 && a.1 >= b.1), "{a:?} beats {b:?}");
        }
        let mut dominated = front["dominated"].as_array().unwrap().iter().map(place);
        assert!(dominated.all(|d| !(d.0 <= a.0 && d.1 > a.1)));
    }
    assert_eq!(front["classes"].as_array().unwrap().len(), 3);
    assert!(front["oracle"]["f_miou"].as_f64() > front["random_labels"]["f_miou"].as_f64());
}

#[test]
fn records_front_page_and_pictures_are_written() {
    let world = World::new(GRID);
    let printed = printed(&world.run(2, ""));
    let all = world.records();
    are_whole(&all);
    is_a_front(&json(world.out("front.json")));
    has(&printed, &["oracle", "random labels", "bought nothing", "threads=1", "99.9 %"]);
    let page = text(world.out("pareto.html"));
    assert!(page.contains("default-src 'none'") && !page.contains("@DATA@"));
    assert!(bytes(world.out("pareto.png")).starts_with(b"\x89PNG"));
    assert!(text(world.out("pareto.svg")).ends_with("</svg>\n"));

    // Again: nothing is measured twice, and a record that was cut comes back with the same labels.
    let file = world.out("records.jsonl");
    let before = text(&file);
    done(&world.run(2, "--quiet"));
    assert_eq!(text(&file), before);
    std::fs::write(&file, &before[..before.len() - 30]).unwrap();
    has(&told(&world.run(2, "")), &["cut by an interruption"]);
    let hashes =
        |all: &[Value]| all.iter().map(|r| r["prediction_hash"].clone()).collect::<Vec<_>>();
    assert_eq!(hashes(&world.records()), hashes(&all));

    // Of another machine, of other scenes.
    let fingerprint = all[0]["fingerprint"].as_str().unwrap();
    std::fs::write(&file, before.replace(fingerprint, "0123456789abcdef")).unwrap();
    refused(&world.run(2, ""), 1, &["another machine"]);
    std::fs::write(&file, before).unwrap();
    std::fs::copy(&world.scenes[1], &world.scenes[0]).unwrap();
    has(&stderr(&world.run(2, "")), &["another input"]);
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_goes_on_where_it_stopped() {
    let world = World::new(GRID);
    let mut child = program();
    let child = child.args(words(&world.line(1, ""))).stderr(Stdio::piped());
    let mut child = child.stdout(Stdio::piped()).spawn().unwrap();
    let file = world.out("records.jsonl");
    while std::fs::read_to_string(&file).map_or(0, |t| t.lines().count()) < 3 {
        assert!(child.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    // SAFETY: the process is a child that was not waited for.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
    refused(&child.wait_with_output().unwrap(), 1, &["goes on from there"]);
    assert!(!world.out("front.json").exists());
    let first = text(&file);
    done(&world.run(1, ""));
    let all = text(&file);
    assert!(all.starts_with(&first) && all.len() > first.len());
    let key = |r: &Value| format!("{} {} {}", r["kind"], r["setting"], r["neutral"]);
    let keys: BTreeSet<String> = world.records().iter().map(key).collect();
    assert_eq!(keys.len(), world.records().len(), "nothing is there twice");
}

#[test]
fn hostile_grids_are_refused_before_anything_is_measured() {
    let world = World::new(GRID);
    for (grid, part) in [
        ("reference = \"voxel=0.1,color=3\"", "color"),
        ("reference = \"voxel=0.1\"\n[axes]\nk = [1, 1]\n", "twice"),
        ("reference = \"voxel=0.1\"\nspeed = 3\n", "speed"),
        ("reference = \"voxel=0.1\"\npoints = [\"net=no-such-network\"]\n", "no-such-network"),
        ("reference = \"voxel=0.1\"\n[neutral]\nisa = [\"abacus\"]\n", "abacus"),
        ("reference = \"voxel=0.1\"\n[neutral]\nmax_memory = [\"much\"]\n", "max_memory"),
        ("not toml", "grid.toml"),
    ] {
        world.folder.write("grid.toml", grid);
        refused(&world.run(2, ""), 2, &[part]);
    }
    // Ten thousand settings: refused with the time that they would take.
    let list = |range: std::ops::RangeInclusive<usize>| {
        range.map(|k| k.to_string()).collect::<Vec<_>>().join(",")
    };
    let axes = format!("k = [{}]\npatch = [{}]\n", list(1..=100), list(17..=116));
    world.folder.write("grid.toml", format!("reference = \"voxel=0.1,k=8\"\n[axes]\n{axes}"));
    refused(&world.run(2, ""), 2, &["10001 settings", " h here"]);
    assert!(!world.out("front.json").exists());
    let cases = [
        ("--limit 0", 2, "above 0"),
        ("--limit '2 parsecs'", 2, "parsecs"),
        ("--repeats 0", 2, "repeats"),
    ];
    all_refused(cases, |more| world.run(2, more));
    let scenes = "pareto --scenes synthetic:x:1 --out";
    refused(&run!("{scenes} {}", world.folder.at("out")), 2, &["synthetic:COUNT:SEED"]);
}

#[test]
fn training_runs_are_shown_against_their_time() {
    let folder = Folder::new();
    let line = |step: usize, name: &str, value: f64| {
        format!("{{\"step\":{step},\"epoch\":0,\"name\":\"{name}\",\"value\":{value}}}\n")
    };
    let log = [
        line(10, "train/seconds_per_step", 2.0),
        line(10, "unseen/f-mIoU", 0.4),
        line(20, "train/seconds_per_step", 2.0),
        line(20, "unseen/f-mIoU", 0.5),
    ];
    folder.write("student/metrics.jsonl", log.concat());
    let pareto =
        |run: &str| run!("pareto --training {} --out {}", folder.at(run), folder.at("out"));
    has(&printed(&pareto("student")), &["student: unseen/f-mIoU of 50.00 %"]);
    let curve = &json(folder.path("out/front.json"))["training"][0];
    assert_eq!(curve["points"], serde_json::json!([[20.0, 0.4], [40.0, 0.5]]));
    has(&text(folder.path("out/pareto.html")), &["What training costs"]);
    refused(&pareto(""), 1, &["metrics.jsonl"]);
}

#[test]
fn an_earlier_run_is_compared_with() {
    let world = World::new("reference = \"voxel=0.1,k=8\"\npoints = [\"k=1\"]\n");
    done(&world.run(1, ""));
    let first = world.out("records.jsonl");
    // The same folder again: nothing is measured, and nothing differs.
    let said = printed(&world.run(1, &format!("--against {}", first.display())));
    has(&said, &["2 settings, 2 with the same labels", "1.00 to 1.00 times the time\n"]);

    // A time and a quality of before that were better, and a setting that is not there.
    let mut planted = world.records();
    planted.retain(|record| record["kind"] == "setting");
    let half = planted[0]["seconds_p50"].as_f64().unwrap() / 2.0;
    planted[0]["seconds_p50"] = half.into();
    let better = planted[1]["f_miou"].as_f64().unwrap() + 0.01;
    planted[1]["f_miou"] = better.into();
    let mut other = planted[0].clone();
    other["setting"] = "k=3".into();
    planted.push(other);
    let put = |records: &[Value]| {
        let lines: String = records.iter().map(|r| format!("{r}\n")).collect();
        world.run(1, &format!("--against {}", world.folder.write("before.jsonl", lines)))
    };
    let output = put(&planted);
    refused(&output, 1, &["2 settings became worse or slower"]);
    has(&stdout(&output), &["(2.00 times)", "f-mIoU", "k=3", "is not compared"]);
    // Times of another machine are told and not judged.
    planted[0]["fingerprint"] = "0123456789abcdef".into();
    planted[1]["f_miou"] = (better - 0.01).into();
    let said = printed(&put(&planted));
    has(&said, &["times are not judged", "(2.00 times)"]);
    // What was measured under other conditions is named, and neither its time nor its quality counts.
    planted[1]["conditions"] = "writes [Features]".into();
    planted[1]["f_miou"] = 0.99.into();
    let said = printed(&put(&planted));
    has(&said, &["other conditions", "writes [Features]", "1 settings, 1 with the same labels"]);
    // A file that is none is refused before anything else.
    refused(&world.run(1, "--against none.jsonl"), 1, &["none.jsonl"]);
}
