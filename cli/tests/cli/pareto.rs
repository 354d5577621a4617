//! `pareto`: what it writes, that it goes on where it stopped, and what it refuses.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

const GRID: &str = "reference = \"voxel=0.1,k=8\"\npoints = [\"precision=bf16\"]\n\
    [axes]\nvoxel = [0.4, 0.1]\nk = [1, 8]\n\
    [neutral]\nthreads = [1, 2]\nmax_memory = [\"8GB\"]\nisa = [\"portable\"]\n";

/// A folder with two small rooms and a grid.
fn inputs() -> (tempfile::TempDir, Vec<PathBuf>, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scenes: Vec<PathBuf> = [1, 2]
        .map(|room| {
            let path = folder.path().join(format!("room{room}.ply"));
            let settings =
                SyntheticRoomSettings { room, ..SyntheticRoomSettings::with_count(1500, 3) };
            write_inria_ply(&generate(&settings).unwrap().scene, &[], &path).unwrap();
            path
        })
        .to_vec();
    let grid = folder.path().join("grid.toml");
    std::fs::write(&grid, GRID).unwrap();
    (folder, scenes, grid)
}

fn words<'a>(grid: &'a Path, scenes: &'a [PathBuf], out: &'a Path) -> Vec<&'a str> {
    let mut words = vec!["pareto", "--grid", grid.to_str().unwrap(), "--scenes"];
    words.extend(scenes.iter().map(|s| s.to_str().unwrap()));
    words.extend(["--repeats", "2", "--threads", "2", "--out", out.to_str().unwrap()]);
    words
}

fn pareto(grid: &Path, scenes: &[PathBuf], out: &Path, more: &[&str]) -> Output {
    let mut words = words(grid, scenes, out);
    words.extend(more);
    scenesplat(&words)
}

fn records(out: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(out.join("records.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn records_front_page_and_pictures_are_written() {
    let (folder, scenes, grid) = inputs();
    let out = folder.path().join("out");
    let output = pareto(&grid, &scenes, &out, &[]);
    done(&output);
    let all = records(&out);
    let of = |kind: &str| all.iter().filter(|r| r["kind"] == kind).collect::<Vec<_>>();
    // Four of the product and one beside it, on two sets; some may be ruled out.
    assert!((6..=10).contains(&of("setting").len()), "{}", all.len());
    assert_eq!((of("oracle").len(), of("random").len()), (2, 2));
    assert_eq!(of("neutral").len(), 8);
    for record in &all {
        for field in [
            "setting",
            "changes_result",
            "prediction_hash",
            "weights_hash",
            "input_hash",
            "machine",
            "miou",
        ] {
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
    // Even the truth loses small objects to the vote of its neighbours, in rooms as sparse as these.
    let best =
        |kind: &str| of(kind).iter().map(|r| r["miou"].as_f64().unwrap()).fold(0.0, f64::max);
    assert!(best("oracle") > 0.5 && best("oracle") > best("setting") && best("random") < 0.2);

    let front = json(&out.join("front.json"));
    let points = front["points"].as_array().unwrap();
    let place = |p: &Value| (p["seconds_p50"].as_f64().unwrap(), p["f_miou"].as_f64().unwrap());
    for (i, a) in points.iter().map(place).enumerate() {
        for (j, b) in points.iter().map(place).enumerate() {
            assert!(i == j || !(a.0 <= b.0 && a.1 >= b.1), "{a:?} beats {b:?}");
        }
        assert!(
            front["dominated"]
                .as_array()
                .unwrap()
                .iter()
                .map(place)
                .all(|d| !(d.0 <= a.0 && d.1 > a.1))
        );
    }
    assert_eq!(front["classes"].as_array().unwrap().len(), 3);
    assert!(front["oracle"]["f_miou"].as_f64() > front["random_labels"]["f_miou"].as_f64());
    let printed = String::from_utf8_lossy(&output.stdout);
    for text in ["oracle", "random labels", "bought nothing", "threads=1", "99.9 %"] {
        assert!(printed.contains(text), "{text} in\n{printed}");
    }
    let page = std::fs::read_to_string(out.join("pareto.html")).unwrap();
    assert!(page.contains("default-src 'none'") && !page.contains("@DATA@"));
    assert!(std::fs::read(out.join("pareto.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(std::fs::read_to_string(out.join("pareto.svg")).unwrap().ends_with("</svg>\n"));

    // Again: nothing is measured twice, and a record that was cut comes back with the same labels.
    let before = std::fs::read(out.join("records.jsonl")).unwrap();
    done(&pareto(&grid, &scenes, &out, &["--quiet"]));
    assert_eq!(std::fs::read(out.join("records.jsonl")).unwrap(), before);
    std::fs::write(out.join("records.jsonl"), &before[..before.len() - 30]).unwrap();
    let output = pareto(&grid, &scenes, &out, &[]);
    done(&output);
    assert!(stderr(&output).contains("cut by an interruption"), "{}", stderr(&output));
    let hashes =
        |all: &[Value]| all.iter().map(|r| r["prediction_hash"].clone()).collect::<Vec<_>>();
    assert_eq!(hashes(&records(&out)), hashes(&all));

    // Of another machine, of other scenes.
    let text = String::from_utf8(before).unwrap();
    let fingerprint = all[0]["fingerprint"].as_str().unwrap();
    std::fs::write(out.join("records.jsonl"), text.replace(fingerprint, "0123456789abcdef"))
        .unwrap();
    let output = pareto(&grid, &scenes, &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("another machine"), "{}", stderr(&output));
    std::fs::write(out.join("records.jsonl"), text).unwrap();
    std::fs::copy(&scenes[1], &scenes[0]).unwrap();
    let output = pareto(&grid, &scenes, &out, &[]);
    assert!(stderr(&output).contains("another input"), "{}", stderr(&output));
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_goes_on_where_it_stopped() {
    let (folder, scenes, grid) = inputs();
    let out = folder.path().join("out");
    let mut child = Command::new(env!("CARGO_BIN_EXE_scenesplat"))
        .args(words(&grid, &scenes[..1], &out))
        .stderr(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines =
        || std::fs::read_to_string(out.join("records.jsonl")).map_or(0, |t| t.lines().count());
    while lines() < 3 {
        assert!(child.try_wait().unwrap().is_none(), "ended too early");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    // SAFETY: the process is a child that was not waited for.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("goes on from there"), "{}", stderr(&output));
    assert!(!out.join("front.json").exists());
    let first = std::fs::read_to_string(out.join("records.jsonl")).unwrap();
    done(&pareto(&grid, &scenes[..1], &out, &[]));
    let all = std::fs::read_to_string(out.join("records.jsonl")).unwrap();
    assert!(all.starts_with(&first) && all.len() > first.len());
    let mut keys: Vec<String> = records(&out)
        .iter()
        .map(|r| format!("{} {} {}", r["kind"], r["setting"], r["neutral"]))
        .collect();
    let count = keys.len();
    keys.sort();
    keys.dedup();
    assert_eq!(keys.len(), count, "nothing is there twice");
}

#[test]
fn hostile_grids_are_refused_before_anything_is_measured() {
    let (folder, scenes, grid) = inputs();
    let out = folder.path().join("out");
    for (text, part) in [
        ("reference = \"voxel=0.1,color=3\"", "color"),
        ("reference = \"voxel=0.1\"\n[axes]\nk = [1, 1]\n", "twice"),
        ("reference = \"voxel=0.1\"\nspeed = 3\n", "speed"),
        ("reference = \"voxel=0.1\"\npoints = [\"net=no-such-network\"]\n", "no-such-network"),
        ("reference = \"voxel=0.1\"\n[neutral]\nisa = [\"abacus\"]\n", "abacus"),
        ("reference = \"voxel=0.1\"\n[neutral]\nmax_memory = [\"much\"]\n", "max_memory"),
        ("not toml", "grid.toml"),
    ] {
        std::fs::write(&grid, text).unwrap();
        let output = pareto(&grid, &scenes, &out, &[]);
        assert_eq!(output.status.code(), Some(2), "{text}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{text}: {}", stderr(&output));
    }
    // Ten thousand settings: refused with the time that they would take.
    let list = |range: std::ops::RangeInclusive<usize>| {
        range.map(|k| k.to_string()).collect::<Vec<_>>().join(",")
    };
    let text = format!(
        "reference = \"voxel=0.1,k=8\"\n[axes]\nk = [{}]\npatch = [{}]\n",
        list(1..=100),
        list(17..=116)
    );
    std::fs::write(&grid, text).unwrap();
    let output = pareto(&grid, &scenes, &out, &[]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(said.contains("10001 settings") && said.contains(" h here"), "{said}");
    assert!(!out.join("front.json").exists());
    for (more, part) in [
        (["--limit", "0"], "above 0"),
        (["--limit", "2 parsecs"], "parsecs"),
        (["--repeats", "0"], "repeats"),
    ] {
        let output = pareto(&grid, &scenes, &out, &more);
        assert_eq!(output.status.code(), Some(2), "{more:?}");
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    }
    let output =
        scenesplat(&["pareto", "--scenes", "synthetic:x:1", "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("synthetic:COUNT:SEED"), "{}", stderr(&output));
}

#[test]
fn training_runs_are_shown_against_their_time() {
    let folder = tempfile::tempdir().unwrap();
    let (run, out) = (folder.path().join("student"), folder.path().join("out"));
    std::fs::create_dir(&run).unwrap();
    let line = |step: usize, name: &str, value: f64| {
        format!("{{\"step\":{step},\"epoch\":0,\"name\":\"{name}\",\"value\":{value}}}\n")
    };
    let log = [
        line(10, "train/seconds_per_step", 2.0),
        line(10, "unseen/f-mIoU", 0.4),
        line(20, "train/seconds_per_step", 2.0),
        line(20, "unseen/f-mIoU", 0.5),
    ];
    std::fs::write(run.join("metrics.jsonl"), log.concat()).unwrap();
    let words = ["pareto", "--training", run.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let output = scenesplat(&words);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("student: unseen/f-mIoU of 50.00 %"), "{said}");
    let curve = &json(&out.join("front.json"))["training"][0];
    assert_eq!(curve["points"], serde_json::json!([[20.0, 0.4], [40.0, 0.5]]));
    assert!(
        std::fs::read_to_string(out.join("pareto.html")).unwrap().contains("What training costs")
    );
    let none = folder.path().to_str().unwrap();
    let output = scenesplat(&["pareto", "--training", none, "--out", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("metrics.jsonl"), "{}", stderr(&output));
}

#[test]
fn an_earlier_run_is_compared_with() {
    let (folder, scenes, grid) = inputs();
    std::fs::write(&grid, "reference = \"voxel=0.1,k=8\"\npoints = [\"k=1\"]\n").unwrap();
    let out = folder.path().join("out");
    done(&pareto(&grid, &scenes[..1], &out, &[]));
    let first = out.join("records.jsonl");
    // The same folder again: nothing is measured, and nothing differs.
    let again = pareto(&grid, &scenes[..1], &out, &["--against", first.to_str().unwrap()]);
    done(&again);
    let said = String::from_utf8_lossy(&again.stdout).into_owned();
    assert!(said.contains("2 settings, 2 with the same labels"), "{said}");
    assert!(said.contains("1.00 to 1.00 times the time\n"), "{said}");

    // A time and a quality of before that were better, and a setting that is not there.
    let text = std::fs::read_to_string(&first).unwrap();
    let mut planted: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    planted.retain(|record| record["kind"] == "setting");
    let half = planted[0]["seconds_p50"].as_f64().unwrap() / 2.0;
    planted[0]["seconds_p50"] = half.into();
    let better = planted[1]["f_miou"].as_f64().unwrap() + 0.01;
    planted[1]["f_miou"] = better.into();
    let mut other = planted[0].clone();
    other["setting"] = "k=3".into();
    planted.push(other);
    let file = folder.path().join("before.jsonl");
    let put = |records: &[Value]| {
        let lines: String = records.iter().map(|r| format!("{r}\n")).collect();
        std::fs::write(&file, lines).unwrap();
        pareto(&grid, &scenes[..1], &out, &["--against", file.to_str().unwrap()])
    };
    let output = put(&planted);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("(2.00 times)") && said.contains("f-mIoU"), "{said}");
    assert!(said.contains("k=3") && said.contains("is not compared"), "{said}");
    assert!(stderr(&output).contains("2 settings became worse or slower"), "{}", stderr(&output));
    // Times of another machine are told and not judged.
    planted[0]["fingerprint"] = "0123456789abcdef".into();
    planted[1]["f_miou"] = (better - 0.01).into();
    let output = put(&planted);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("times are not judged") && said.contains("(2.00 times)"), "{said}");
    // What was measured under other conditions is named, and neither its time nor its quality counts.
    planted[1]["conditions"] = "writes [Features]".into();
    planted[1]["f_miou"] = 0.99.into();
    let output = put(&planted);
    done(&output);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("other conditions") && said.contains("writes [Features]"), "{said}");
    assert!(said.contains("1 settings, 1 with the same labels"), "{said}");
    // A file that is none is refused before anything else.
    let missing = folder.path().join("none.jsonl");
    let output = pareto(&grid, &scenes[..1], &out, &["--against", missing.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("none.jsonl"), "{}", stderr(&output));
}
