//! `scenesplat train`, and the network inside the program.

use crate::support::*;
use scenesplat_test_support::Network;
use serde_json::Value;

#[test]
fn a_run_leaves_what_it_promises_and_its_weights_work() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let out = folder.at("run");
    // Progress is of the library, and not of the command.
    has(&told(&process(&["train", &config, "--out", &out])), &["step 8/8"]);
    for name in ["config.toml", "run.json", "curves.png", "curves.html", "model/config.json"] {
        assert!(folder.path("run").join(name).is_file(), "{name}");
    }
    let log = text(folder.path("run/metrics.jsonl"));
    let count = |name: &str| log.lines().filter(|l| l.contains(name)).count();
    assert_eq!((count("train/lovasz_softmax"), count("unseen/mIoU")), (8, 2));
    // A run is not overwritten by another one, neither is a resumed one another one.
    let again = |more: &str| run!("train {config} --out {out} --quiet {more}");
    refused(&again(""), 1, &["--resume"]);
    done(&again("--resume"));
    has(&stderr(&again("--resume --seed 5")), &["seed was 0 and is 5"]);
    let (names, labels) = (folder.names(), folder.at("labels"));
    let words = format!("--weights {out}/model --text-names {names} --out {labels}");
    done(&run!("evaluate synthetic:1:3 {words}"));
}

#[test]
fn settings_are_changed_from_the_command_line() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let text = small_segmentation();
    let checked = |config: &str, more: &str| printed(&run!("train {config} --check {more}"));
    // As in a file that says so.
    let edited = text.replace("epochs = 2", "epochs = 3");
    assert_ne!(edited, text);
    let by_file = checked(&folder.write("edited.toml", &edited), "");
    assert_eq!(checked(&config, "--set trainer.epochs=3"), by_file);
    let several = "--set trainer.epochs=9 --set trainer.epochs=3 --set precision=bf16";
    has(&checked(&config, several), &["epochs = 3", "precision = \"bf16\""]);
    has(&checked(&config, "--set train.0.repeat=5 --set optimizer.groups=[]"), &["repeat = 5"]);
    has(&checked(&config, "--set trainer.checkpoint.keep=7"), &["keep = 7"]);
    for (change, part) in [
        ("trainer.epoch=3", "unknown field `epoch`"),
        ("trainer.epochs=many", "epochs = \"many\""),
        ("trainer.epochs", "KEY=VALUE"),
        ("trainer..epochs=3", "no path of a setting"),
        ("train.7.repeat=5", "train is a list of 1"),
        ("train.repeat=5", "train is a list of 1"),
        ("train=5", "train is a list of 1"),
        ("task.name=5", "holds no settings"),
    ] {
        refused(&run!("train {config} --check --set {change}"), 1, &[part]);
    }
    let misspelt = run!("train {config} --epochs 3");
    refused(&misspelt, 2, &["--epochs", "--set trainer.epochs=3"]);
}

#[test]
fn a_run_goes_on_from_its_folder_alone() {
    let folder = Folder::new();
    let config = folder.write("sub/experiment.toml", small_segmentation());
    let run = folder.at("run");
    let often = "--set trainer.checkpoint.every_steps=3 --set trainer.checkpoint.keep=9";
    done(&run!("train {config} --quiet --out {run} {often}"));
    let weights = || bytes(folder.path("run/model/model.safetensors"));
    let whole = weights();
    // As if it had been killed after its sixth step.
    let mut steps: Vec<_> = std::fs::read_dir(folder.path("run/checkpoints"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .collect();
    steps.sort();
    assert!(steps.len() >= 3, "{steps:?}");
    std::fs::remove_dir_all(steps.pop().unwrap()).unwrap();
    std::fs::remove_dir_all(folder.path("run/model")).unwrap();
    refused(&run!("train {run} --quiet"), 2, &["--resume"]);
    refused(&run!("train {run} --resume --out {run}2"), 2, &["--out"]);
    let other = run!("train {run} --resume --quiet --set loader.seed=7");
    refused(&other, 1, &["seed was 0 and is 7"]);
    // Progress is of the library, and not of the command.
    let said = told(&process(&["train", &run, "--resume"]));
    assert!(said.contains("step 8/8") && !said.contains("step 1/8"), "{said}");
    assert!(weights() == whole, "other bits after a resume from the folder");
    refused(
        &run!("train {} --resume", folder.at("nowhere")),
        2,
        &["nowhere", "--resume the folder"],
    );
}

#[test]
fn a_sweep_trains_each_combination_and_compares_them() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let (out, alone) = (folder.at("sweep"), folder.at("alone"));
    let values = "--sweep optimizer.lr=[0.003,1e30]";
    for (wrong, part) in [
        ("--sweep optimizer.lr=1", "KEY=[VALUE"),
        ("--sweep model_seed=[1,2] --seed 3", "leave out one"),
        ("--sweep model_seed=[1,2] --sweep model_seed=[3]", "swept twice"),
    ] {
        refused(&run!("train {config} --out {out} {wrong}"), 2, &[part]);
    }
    // All are read before the first begins.
    refused(&run!("train {config} --out {out} --sweep trainer.epochs=[1,true]"), 1, &["true"]);
    assert!(!folder.path("sweep").exists());
    // With such steps numbers become infinite: that training fails, and the other one does not.
    let swept = run!("train {config} --quiet --out {out} {values}");
    refused(&swept, 1, &["1 of 2 trainings failed"]);
    has(&stdout(&swept), &["* ", "optimizer.lr=0.003", "failed"]);
    done(&run!("train {config} --quiet --out {alone} --set optimizer.lr=0.003"));
    let weights = |run: &str| bytes(folder.path(run).join("model/model.safetensors"));
    assert!(weights("sweep/001-lr=0.003") == weights("alone"), "other bits than alone");
    let table = text(folder.path("sweep/sweep.csv"));
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 3, "{table}");
    assert!(rows[1].starts_with("1,\"001-lr=0.003\",\"optimizer.lr=0.003\",8,"), "{table}");
    assert!(rows[2].starts_with("2,") && rows[2].contains(",failed,,"), "{table}");
}

/// A tiny student of the network inside the program.
fn distillation() -> String {
    let network = Network { grid_size: 0.2, head: "projection = 96", ..Network::default() };
    format!(
        r#"
task = "distillation"
[teacher]
type = "network"
weights = "embedded"
cache = {{ folder = "rows" }}
[model]
{network}
[text]
type = "vocabulary"
dim = 96
[[train]]
source = {{ type = "synthetic", count = 4, seed = 1, room = {{ num_gaussians = 1500 }} }}
transforms = "language_pretraining"
[loader]
mix_probability = 0.5
[[losses]]
type = "cosine"
[[losses]]
type = "l2"
weight = 0.5
[optimizer]
lr = 0.01
groups = []
[trainer]
epochs = 6
log_every = 1
[[evaluate]]
name = "unseen"
source = {{ type = "synthetic", count = 1, seed = 9, room = {{ num_gaussians = 1500 }} }}
"#
    )
}

#[test]
fn a_student_learns_from_a_teacher() {
    let folder = Folder::new();
    let config = folder.write("student.toml", distillation());
    for (out, threads) in [("one", 1), ("two", 2)] {
        let out = folder.at(out);
        done(&run!("train {config} --out {out} --threads {threads} --quiet"));
    }
    let weights = |out: &str| bytes(folder.path(out).join("model/model.safetensors"));
    assert!(weights("one") == weights("two"), "other bits with other threads");
    let log = text(folder.path("one/metrics.jsonl"));
    let log: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let values = |name: &str| -> Vec<f64> {
        let of = log.iter().filter(|m| m["name"] == name);
        of.map(|m| m["value"].as_f64().unwrap()).collect()
    };
    let losses = values("train/cosine");
    assert_eq!(losses.len(), 12);
    assert!(losses[11] < 0.9 * losses[0], "{losses:?}");
    let (agreement, teacher) = (values("unseen/agreement/cosine"), values("unseen/teacher/allAcc"));
    assert!(agreement[5] > agreement[0], "{agreement:?}");
    // The same teacher on the same room, epoch after epoch; it knows rooms, though few Gaussians are far
    // from what it was trained on: five times better than one of 41 classes by chance.
    let is_good = |v: &f64| *v == teacher[0] && *v > 5.0 / 41.0;
    assert!(teacher.len() == 6 && teacher.iter().all(is_good), "{teacher:?}");
    assert_eq!(values("unseen/oracle/f-mIoU").len(), 6);
    // Its rows of the room were computed once and read ever after.
    let [first, second] = ["one", "two"].map(|out| json(folder.path(out).join("run.json")));
    assert_eq!(first["teacher"]["cache"]["kept"], 1, "{first}");
    assert_eq!(first["teacher"]["cache"]["read"], 5);
    assert_eq!(second["teacher"]["cache"]["read"], 6);
    has(first["teacher"]["content"].as_str().unwrap(), &["sha256"]);
    // A student is a network like any other.
    let (model, out) = (folder.at("one/model"), folder.at("labels"));
    let room = folder.room("room.ply", 900, 3);
    done(&run!("segment {room} --weights {model} --text vocabulary --out {out}"));
}

#[test]
fn wrong_experiments_are_said() {
    let folder = Folder::new();
    let (config, out) = (folder.at("experiment.toml"), folder.at("run"));
    for (from, to, said) in [
        ("epochs = 2", "epoch = 2", "epoch"),
        ("\"lovasz_softmax\"", "\"lovas\"", "lovas"),
        ("num_classes = 41\n", "", "num_classes"),
        ("grid_size = 0.15", "in_channels = 14", "in_channels is 14"),
        ("\"semantic_segmentation\"\nrepeat", "\"fancy\"\nrepeat", "fancy"),
    ] {
        assert!(small_segmentation().contains(from));
        folder.write("experiment.toml", small_segmentation().replace(from, to));
        refused(&run!("train {config} --out {out}"), 1, &[said]);
    }
    assert!(!folder.path("run/checkpoints").exists());
    folder.write("experiment.toml", small_segmentation());
    has(&printed(&run!("train {config} --out {out} --check")), &["lovasz_softmax"]);
}

#[test]
fn the_network_inside_the_program_answers_without_any_file() {
    let folder = Folder::new();
    let demo = folder.at("demo");
    has(&printed(&run!("demo --out {demo} --quiet")), &["f-mIoU"]);
    for name in ["room.ply", "segmented.ply", "labels.npy", "preview.png", "truth.png"] {
        assert!(folder.path("demo").join(name).is_file(), "{name}");
    }
    let query = |text: &str| run!("query {demo}/room.ply {text} --out {}", folder.at("query"));
    done(&query("furniture"));
    refused(&query("spaceship"), 2, &["spaceship"]);

    let evaluate = |more: &str| {
        let (file, out) = (folder.at("figures.json"), folder.at("evaluation"));
        done(&run!("evaluate synthetic:1:7 --json {file} --out {out} {more}"));
        json(file)
    };
    let figures = evaluate("");
    for key in ["f_miou", "f_macc", "miou", "macc", "seconds"] {
        assert!(figures[key].as_f64().is_some_and(f64::is_finite), "{key}");
    }
    assert!(figures["oracle"]["miou"].as_f64() > figures["miou"].as_f64());
    assert!(figures["per_class"].as_array().is_some_and(|c| c.len() > 10));
    // A network trained with the same words is named by `--text vocabulary`.
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/embedded");
    let same = evaluate(&format!("--weights {model} --text vocabulary"));
    assert_eq!(same["per_class"], figures["per_class"]);
}
