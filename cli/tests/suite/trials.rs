//! `train` on less data, and the search for a learning rate.

use crate::support::*;
use serde_json::Value;

/// What a run logged under a name, with the steps.
fn logged(folder: &Folder, run: &str, name: &str) -> Vec<(u64, f64)> {
    let log = text(folder.path(run).join("metrics.jsonl"));
    let lines = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let of_name = lines.filter(|value| value["name"] == name);
    of_name.map(|v| (v["step"].as_u64().unwrap(), v["value"].as_f64().unwrap())).collect()
}

#[test]
fn a_trial_uses_every_part_and_writes_nothing() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let tried = |more: &str| {
        let mut program = program();
        let line = format!("train {config} {more}");
        program.args(words(&line)).current_dir(folder.root());
        program.output().unwrap()
    };
    let one = tried("--fast-dev-run");
    has(
        &printed(&one),
        &["1 batches in 1 steps, 1 scenes at most of unseen", "nothing was written"],
    );
    has(&stderr(&one), &["step 1/1", "unseen: "]);
    assert!(!stderr(&one).contains("saved"), "{}", stderr(&one));
    // A step takes two batches: so do three.
    let three = tried("--fast-dev-run=3 --set trainer.accumulate=2 --quiet");
    has(&printed(&three), &["4 batches in 2 steps, 3 scenes"]);
    assert_eq!(folder.count(), 1, "only the experiment");
    // What would end a run at its first evaluation ends a trial, too.
    let misspelt = run!("train {config} --fast-dev-run --set trainer.checkpoint.best=unseen/mIou");
    refused(&misspelt, 1, &["unseen/mIou"]);
    for flag in ["--resume", "--out x", "--check", "--lr-find", "--overfit 1", "--limit-batches 1"]
    {
        refused(&run!("train {config} --fast-dev-run {flag}"), 2, &["--fast-dev-run"]);
    }
    refused(&run!("train {config} --fast-dev-run=0"), 2, &["0"]);
}

#[test]
fn epochs_and_evaluations_are_cut_short() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let out = folder.at("run");
    // Of four batches, half; of two scenes, one.
    let few = "--limit-batches 0.5 --limit-evaluation 1";
    done(&run!("train {config} --quiet --out {out} {few}"));
    let steps: Vec<u64> = logged(&folder, "run", "train/loss").iter().map(|row| row.0).collect();
    assert_eq!(steps, [1, 2, 3, 4], "two epochs of two batches");
    has(&text(folder.path("run/config.toml")), &["[limits]", "train = 0.5", "evaluate = 1"]);
    // The log as a table.
    let table = text(folder.path("run/metrics.csv"));
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = names.iter().position(|name| *name == "train/loss").unwrap();
    assert_eq!((names[0], names[1], lines.clone().count()), ("step", "epoch", 4));
    let losses: Vec<f64> =
        lines.map(|l| l.split(',').nth(column).unwrap().parse().unwrap()).collect();
    let expected: Vec<f64> = logged(&folder, "run", "train/loss").iter().map(|row| row.1).collect();
    assert_eq!(losses, expected);
    // A run goes on with the limits that it began with, and no others.
    done(&run!("train {out} --resume --quiet"));
    refused(&run!("train {config} --resume --quiet --out {out}"), 1, &["limits"]);
    for (more, code, part) in [
        ("--limit-batches 0", 2, "share above 0"),
        ("--limit-batches 1.5", 2, "share above 0"),
        ("--limit-batches 2 --overfit 1", 2, "--overfit"),
        ("--set limits.train=2 --set limits.overfit=1", 1, "leave one out"),
        (
            "--limit-evaluation 1 --set evaluate=[] --set trainer.checkpoint={}",
            1,
            "limits.evaluate",
        ),
        ("--set limits.overfit=0", 1, "limits.overfit"),
    ] {
        refused(&run!("train {config} --check {more}"), code, &[part]);
    }
}

#[test]
fn the_same_batches_come_again_and_are_learned_by_heart() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let over =
        "--overfit 1 --set trainer.epochs=12 --set optimizer.lr=0.02 --set optimizer.groups=[]";
    for out in ["one", "two"] {
        let out = folder.at(out);
        done(&run!("train {config} --quiet --out {out} {over} --threads 2"));
    }
    let weights = |out: &str| bytes(folder.path(out).join("model/model.safetensors"));
    assert!(weights("one") == weights("two"), "other bits with the same seed");
    let losses = logged(&folder, "one", "train/loss");
    assert_eq!(losses.len(), 12);
    assert!(losses[11].1 < 0.5 * losses[0].1, "{losses:?}");
    // Every epoch has the same rows, which augmentation would change.
    let rows = logged(&folder, "one", "train/counted_rows");
    assert!(rows.iter().all(|row| row.1 == rows[0].1), "{rows:?}");
    // The evaluation is on the scene of this batch: once more with another seed of the rooms to evaluate on.
    let other = small_segmentation().replace("seed = 9", "seed = 10");
    let config = folder.write("other.toml", other);
    done(&run!("train {config} --quiet --out {} {over}", folder.at("three")));
    let of = |run: &str| logged(&folder, run, "unseen/allAcc");
    assert_eq!(of("one"), of("three"));
    assert!(of("one")[11].1 > of("one")[0].1, "{:?}", of("one"));
}

#[test]
fn a_learning_rate_is_found_and_nothing_else_changes() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let out = folder.at("run");
    done(&run!("train {config} --quiet --out {out}"));
    let names = ["model/model.safetensors", "metrics.jsonl", "run.json", "config.toml"];
    let files = || names.map(|name| bytes(folder.path("run").join(name)));
    let before = files();
    let said = printed(&run!("train {config} --out {out} --lr-find=20"));
    has(&said, &["learning rate: ", "lr_find.png"]);
    assert!(files() == before, "the run was changed");
    let table = text(folder.path("run/lr_find.csv"));
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|value| value.parse().unwrap()).collect())
        .collect();
    assert!((10..=20).contains(&rows.len()), "{table}");
    assert_eq!(rows[0][0], 1e-7);
    // Twenty rates from 1e-7 to 1, each so many times the one before.
    let factor = 1e7_f64.powf(1.0 / 19.0);
    assert!(rows.windows(2).all(|two| (two[1][0] / two[0][0] / factor - 1.0).abs() < 1e-9));
    // The first loss is that of the run: the same seed, the same batch.
    assert!((rows[0][1] - logged(&folder, "run", "train/loss")[0].1).abs() < 1e-12);
    assert_eq!(printed(&run!("train {config} --out {out} --lr-find=20")), said);
    refused(&run!("train {config} --lr-find=2"), 2, &["3.."]);
    refused(&run!("train {config} --lr-find --resume"), 2, &["--resume"]);
}

#[test]
fn a_training_reports_as_json() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let output = run!("train {config} --out {} --log-format json", folder.at("run"));
    done(&output);
    let said = stderr(&output);
    let all: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let steps: Vec<&Value> =
        all.iter().filter(|v| v["measurements"]["train/loss"].is_number()).collect();
    assert_eq!(steps.len(), 8);
    assert_eq!(
        (&steps[2]["stage"], &steps[2]["done"], &steps[2]["total"]),
        (&"train".into(), &3.into(), &8.into())
    );
    assert!(all.iter().any(|v| v["measurements"]["unseen/mIoU"].is_number()));
    assert!(all.iter().all(|v| v["level"].is_string() && v["message"].is_string()));
}
