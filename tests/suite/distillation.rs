//! Distillation from files: the teacher is the network that the experiment names; what happens to it is recorded or
//! refused, and neither workers nor caches change a bit.

use crate::runs::{exported, read, record, run_until};
use scenesplat::alignment::AlignmentSettings;
use scenesplat::datasets::{Sample, TeacherRows};
use scenesplat::experiment::teacher::Teacher;
use scenesplat::experiment::{ExperimentConfig, data};
use scenesplat::models::{ModelConfig, PointTransformerV3Config};
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::trainers::callbacks::read_json_lines;
use scenesplat::{Network, NetworkConfig, SceneEncoder, WeightOptions, Weights};
use serde_json::Value;
use std::path::Path;
use std::sync::LazyLock;

/// A student of a teacher with other voxels and other inputs.
const TEXT: &str = r#"
task = "distillation"
text = { type = "vocabulary", dim = 64 }
[teacher]
type = "network"
weights = "seeded:3"
config = "teacher.json"
[model]
NETWORK
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 700 } }
transforms = [
  { type = "center_shift" },
  { type = "random_flip" },
  { type = "grid_sample", grid_size = 0.3 },
  { type = "sphere_crop", point_max = 200 },
]
repeat = 2
[loader]
workers = 1
batch_size = 1
mix_probability = 0.0
[[losses]]
type = "cosine"
[[losses]]
type = "smooth_l1"
beta = 0.05
[optimizer]
lr = 0.01
groups = []
[trainer]
epochs = 1
log_every = 1
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 700 } }
vote_k = 3
"#;

static EXPERIMENT: LazyLock<String> = LazyLock::new(|| {
    let network =
        scenesplat_test_support::Network { head: "projection = 64", ..Default::default() };
    TEXT.replace("NETWORK", &network.to_string())
});

const CACHED: &str = "view = \"scene\"\ncache = { folder = \"rows\", max_gb = 1.0 }\n[model]";

/// What the teacher is: 64 features of color and height, at its own voxels.
fn teacher_config() -> NetworkConfig {
    let mut config = NetworkConfig::tiny();
    config.model.grid_size = 0.2;
    config.input.channels = serde_json::from_str(r#"["height", "color"]"#).unwrap();
    let json =
        serde_json::to_string(&config).unwrap().replace("\"in_channels\":11", "\"in_channels\":4");
    serde_json::from_str(&json).unwrap()
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let json = serde_json::to_string(&teacher_config()).unwrap();
    std::fs::write(folder.path().join("teacher.json"), json).unwrap();
    folder
}

fn start(
    folder: &Path,
    text: &str,
    name: &str,
    resume: bool,
    stop: bool,
) -> Result<Vec<String>, String> {
    let report = run_until(&read(folder, text)?, &folder.join(name), resume, stop)?;
    Ok(report.remarks)
}

/// The weights that a run ends with.
fn weights(folder: &Path, text: &str, name: &str) -> Vec<u8> {
    start(folder, text, name, false, false).unwrap_or_else(|e| panic!("{name}: {e}"));
    exported(&folder.join(name))
}

/// What the record of a run says of the teacher.
fn said(folder: &Path, name: &str) -> Value {
    record(&folder.join(name))["teacher"].clone()
}

fn first_scene(config: &ExperimentConfig) -> Sample {
    let source = config.train[0].source.build().unwrap();
    let id = &source.scene_ids()[0];
    Sample::from_scene(id, source.load(id).unwrap().scene)
}

fn rows(taught: &TeacherRows, gaussians: usize) -> Vec<f32> {
    (0..gaussians).flat_map(|i| taught.row(i).unwrap().iter().map(|v| v.to_f32())).collect()
}

/// Through another part of the library: the teacher as whole scenes are read by it.
#[test]
fn the_teacher_is_the_network_in_evaluation_mode_at_its_own_voxels() {
    let folder = folder();
    // Heights count from the ground of what is read, which differs between a scene and its voxels.
    let mut own = teacher_config();
    own.input = scenesplat::datasets::InputFeatures::default();
    own.model =
        ModelConfig { grid_size: 0.2, ..ModelConfig::new(PointTransformerV3Config::tiny()) };
    let json = serde_json::to_string(&own).unwrap();
    std::fs::write(folder.path().join("teacher.json"), json).unwrap();
    let text = EXPERIMENT.replacen("[model]", "view = \"scene\"\n[model]", 1);
    let config = read(folder.path(), &text).unwrap();
    let teacher = Teacher::open(&config).unwrap().unwrap();
    let scene = first_scene(&config);
    let before = teacher.train.teach(scene.clone()).unwrap();

    let network = Network::load(own, &Weights::Seeded(3), WeightOptions::default()).unwrap();
    let source = config.train[0].source.build().unwrap();
    let loaded = source.load(&scene.id).unwrap().scene;
    let alignment = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
    let encoder = SceneEncoder { alignment, ..SceneEncoder::new(&network) };
    let encoded = encoder.encode(&loaded, &mut |_| Ok(())).unwrap();
    let want = encoded.gaussian_rows(0..loaded.len()).unwrap();
    let got = rows(&before, scene.len());
    assert_eq!(got.len(), want.len());
    for (i, (g, w)) in got.iter().zip(&want).enumerate() {
        // Rounded to f16 once.
        assert!((g - w).abs() <= 0.0006 * w.abs().max(1e-3), "{i}: {g}, in inference {w}");
    }
    // Training a student moves nothing of it: no gradient, no batch statistic.
    start(folder.path(), &text, "run", false, false).unwrap();
    let mut loader = data::loader(&config, Some(&teacher)).unwrap();
    let batches: Vec<_> = loader.epoch(0, 0).map(|batch| batch.unwrap()).collect();
    assert_eq!(batches.len(), 4);
    assert_eq!(teacher.train.teach(scene).unwrap(), before);
}

#[test]
fn neither_workers_nor_interruptions_change_a_bit() {
    let folder = folder();
    let plain = weights(folder.path(), &EXPERIMENT, "plain");
    for workers in [0, 3] {
        let text = EXPERIMENT.replace("workers = 1", &format!("workers = {workers}"));
        assert!(plain == weights(folder.path(), &text, &format!("workers{workers}")));
    }
    start(folder.path(), &EXPERIMENT, "stopped", false, true).unwrap();
    start(folder.path(), &EXPERIMENT, "stopped", true, false).unwrap();
    assert!(plain == exported(&folder.path().join("stopped")), "resumed");
    // A checkpoint holds no teacher.
    for entry in std::fs::read_dir(folder.path().join("plain/checkpoints")).unwrap() {
        let dir = entry.unwrap().path();
        let files: Vec<_> = std::fs::read_dir(&dir).into_iter().flatten().flatten().collect();
        assert!(files.iter().all(|f| !f.file_name().to_string_lossy().contains("teacher")));
    }
}

#[test]
fn caches_change_no_bit() {
    let folder = folder();
    let cached = EXPERIMENT.replacen("[model]", CACHED, 1);
    let uncached = EXPERIMENT.replacen("[model]", "view = \"scene\"\n[model]", 1);
    let plain = weights(folder.path(), &uncached, "uncached");
    assert!(plain == weights(folder.path(), &cached, "first"));
    assert!(plain == weights(folder.path(), &cached, "second"));
    let (first, second) = (said(folder.path(), "first"), said(folder.path(), "second"));
    // Two scenes to train on, each twice, and one to evaluate.
    assert_eq!((&first["taught"], &first["cache"]["kept"]), (&3.into(), &3.into()), "{first}");
    assert_eq!((&second["taught"], &second["cache"]["read"]), (&0.into(), &5.into()), "{second}");
    let files = || -> Vec<_> {
        let entries = std::fs::read_dir(folder.path().join("rows")).unwrap().flatten();
        entries.map(|entry| entry.path()).collect()
    };
    assert_eq!(files().len(), 3);
    // A damaged file is told and made again.
    let damaged = &files()[0];
    let mut bytes = std::fs::read(damaged).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(damaged, &bytes).unwrap();
    let remarks = start(folder.path(), &cached, "third", false, false).unwrap();
    assert!(plain == exported(&folder.path().join("third")));
    assert!(remarks.iter().any(|r| r.contains("made again")), "{remarks:?}");
    assert_eq!(said(folder.path(), "third")["cache"]["remade"], 1);
    bytes[middle] ^= 4;
    assert!(std::fs::read(damaged).unwrap() == bytes, "the bits it had");
    // Another teacher finds nothing of its own there.
    let other = cached.replace("seeded:3", "seeded:4");
    assert!(plain != weights(folder.path(), &other, "other"));
    assert_eq!(said(folder.path(), "other")["cache"]["kept"], 3);
    assert_eq!(files().len(), 6);
    // A cache that is full keeps nothing more, and says so.
    let full = cached.replace("seeded:3", "seeded:5").replace("max_gb = 1.0", "max_gb = 1e-6");
    let remarks = start(folder.path(), &full, "full", false, false).unwrap();
    assert!(remarks.iter().any(|r| r.contains("max_gb")), "{remarks:?}");
    assert_eq!(files().len(), 6);
    // With what is augmented, rows of evaluations alone are kept: here those that are there already, as
    // an evaluation shows the scene itself, and then anew.
    let augmented = cached.replace("view = \"scene\"", "view = \"augmented\"");
    weights(folder.path(), &augmented, "augmented");
    let did = said(folder.path(), "augmented");
    assert_eq!((&did["cache"]["read"], &did["taught"]), (&1.into(), &4.into()), "{did}");
    weights(folder.path(), &augmented.replace("\"rows\"", "\"more rows\""), "elsewhere");
    let did = said(folder.path(), "elsewhere");
    assert_eq!((&did["cache"]["kept"], &did["taught"]), (&1.into(), &5.into()), "{did}");
}

#[test]
fn a_run_goes_on_with_its_own_teacher_only() {
    let folder = folder();
    start(folder.path(), &EXPERIMENT, "run", false, false).unwrap();
    let resumed = |text: &str| start(folder.path(), text, "run", true, false);
    let error = resumed(&EXPERIMENT.replace("seeded:3", "seeded:4")).unwrap_err();
    assert!(error.contains("teacher.content was \"sha256"), "{error}");
    let error =
        resumed(&EXPERIMENT.replacen("[model]", "view = \"scene\"\n[model]", 1)).unwrap_err();
    assert!(error.contains("teacher.view was \"augmented\" and is \"scene\""), "{error}");
    let error =
        resumed(&EXPERIMENT.replacen("[model]", "precision = \"bf16\"\n[model]", 1)).unwrap_err();
    assert!(error.contains("teacher.precision"), "{error}");
    // The same teacher by another name, and a cache.
    std::fs::rename(folder.path().join("teacher.json"), folder.path().join("moved.json")).unwrap();
    let moved = EXPERIMENT.replace("teacher.json", "moved.json").replacen(
        "[model]",
        "cache = { folder = \"rows\" }\n[model]",
        1,
    );
    resumed(&moved).unwrap();
    // The same name, another network.
    let mut other = teacher_config();
    other.model.grid_size = 0.25;
    let json = serde_json::to_string(&other).unwrap();
    std::fs::write(folder.path().join("teacher.json"), json).unwrap();
    let error = resumed(&EXPERIMENT).unwrap_err();
    assert!(error.contains("teacher.content"), "{error}");
}

/// The experiment with features in files for its teacher.
fn stored() -> String {
    EXPERIMENT.replace(
        "type = \"network\"\nweights = \"seeded:3\"\nconfig = \"teacher.json\"",
        "type = \"features\"\nfolder = \"stored\"",
    )
}

#[test]
fn a_teacher_can_be_stored_features() {
    let (folder, stored) = (folder(), stored());
    let error = start(folder.path(), &stored, "none", false, false).unwrap_err();
    assert!(error.contains("room-000000") && error.contains("features.npy"), "{error}");
    let write = |id: &str, rows: usize, width: usize, factor: f32| {
        let values: Vec<f32> =
            (0..rows * width).map(|i| (i as f32 * 0.37).sin() * factor).collect();
        let scene = folder.path().join("stored").join(id);
        std::fs::create_dir_all(&scene).unwrap();
        write_npy(&scene.join("features.npy"), &[rows, width], &values).unwrap();
    };
    // Rooms of the sources have the same names; their sizes are those of the settings.
    let sizes: Vec<usize> = {
        let config = read(folder.path(), &stored).unwrap();
        let source = config.train[0].source.build().unwrap();
        let of = |id: &String| source.load(id).unwrap().scene.len();
        source.scene_ids().iter().map(of).collect()
    };
    assert!(sizes.iter().all(|n| *n == sizes[0]), "{sizes:?}");
    for id in ["room-000000", "room-000001"] {
        write(id, sizes[0], 32, 1.0);
    }
    let error = start(folder.path(), &stored, "narrow", false, false).unwrap_err();
    assert!(error.contains("set it to 32") && error.contains("model.projection"), "{error}");
    for id in ["room-000000", "room-000001"] {
        write(id, sizes[0], 64, 1.0);
    }
    let plain = weights(folder.path(), &stored, "stored_run");
    assert_eq!(said(folder.path(), "stored_run")["taught"], 5);
    // Directions count, lengths do not; other features are another teacher.
    write("room-000001", sizes[0], 64, -1.0);
    let error = start(folder.path(), &stored, "stored_run", true, false).unwrap_err();
    assert!(error.contains("teacher.content"), "{error}");
    assert!(plain != weights(folder.path(), &stored, "turned"));
    write("room-000001", sizes[0] - 1, 64, 1.0);
    let error = start(folder.path(), &stored, "short", false, false).unwrap_err();
    assert!(error.contains("room-000001") && error.contains("one for each Gaussian"), "{error}");
    write("room-000001", sizes[0], 64, f32::INFINITY);
    let error = start(folder.path(), &stored, "infinite", false, false).unwrap_err();
    assert!(error.contains("room-000001") && error.contains("in f16"), "{error}");
}

#[test]
fn a_teacher_can_be_the_features_of_the_scenes() {
    let folder = folder();
    let own = stored().replace("folder = \"stored\"\n", "");
    let error = start(folder.path(), &own, "own", false, false).unwrap_err();
    assert!(error.contains("lang_feat"), "{error}");
    let own = own.replace("seed = 1, ", "seed = 1, vocabulary = 64, ");
    let own = own.replace("seed = 9, ", "seed = 9, vocabulary = 64, ");
    weights(folder.path(), &own, "words");
    let log = read_json_lines(&folder.path().join("words/metrics.jsonl")).unwrap();
    let value = |name: &str| log.iter().find(|m| m.name == name).unwrap().value;
    // Words of the rooms are the truth, but for floaters, which have none.
    let (teacher, oracle) = (value("unseen/teacher/allAcc"), value("unseen/oracle/allAcc"));
    assert!((teacher - oracle).abs() < 0.05 && teacher > 0.7, "{teacher}, oracle {oracle}");
    for name in ["unseen/f-mIoU", "unseen/agreement/cosine", "unseen/agreement/top1"] {
        assert!(value(name).is_finite(), "{name}");
    }
}

#[test]
fn experiments_that_do_not_fit_are_refused_before_the_first_step() {
    let folder = folder();
    let refused = |from: &str, to: &str, parts: &[&str]| {
        assert!(EXPERIMENT.contains(from), "{from}");
        let text = EXPERIMENT.replacen(from, to, 1);
        let error = start(folder.path(), &text, "run", false, false).unwrap_err();
        assert!(parts.iter().all(|part| error.contains(part)), "{to}: {error}");
        assert!(!folder.path().join("run/checkpoints").exists(), "{to}");
    };
    let teacher =
        "[teacher]\ntype = \"network\"\nweights = \"seeded:3\"\nconfig = \"teacher.json\"";
    refused(teacher, "", &["teacher", "distillation needs one"]);
    refused("\"distillation\"", "\"language_pretraining\"", &["teacher", "only task"]);
    refused("text =", "targets = \"class_text\"\ntext =", &["targets"]);
    refused("projection = 64", "num_classes = 41", &["model.num_classes"]);
    refused("projection = 64", "projection = 48", &["model.projection", "set it to 64"]);
    refused("dim = 64 }", "dim = 96 }", &["text", "96 wide"]);
    refused("\"teacher.json\"", "\"semseg\"", &["weights", "gives classes"]);
    refused("seeded:3", "seeded:x", &["teacher.weights", "no seed"]);
    refused("seeded:3", "nowhere.safetensors", &["nowhere.safetensors"]);
    refused("seeded:3", "embedded", &["config", "leave it out"]);
    refused("[model]", "precision = \"f8\"\n[model]", &["teacher.precision"]);
    refused("task =", "precision = \"int8\"\ntask =", &["precision", "int8 is for inference"]);
    refused("[model]", "views = \"scene\"\n[model]", &["views"]);
    refused("[model]", "cache = { folder = \"c\", max_gb = 0.0 }\n[model]", &["max_gb"]);
    refused("[model]", "cache = { folder = \"c\", size = 1 }\n[model]", &["size"]);
    refused("type = \"network\"", "type = \"networks\"", &["networks"]);
    refused("beta = 0.05", "beta = 0.0", &["smooth_l1", "beta"]);
    let late = "point_max = 200 },\n  { type = \"random_flip\" },";
    refused("point_max = 200 },", late, &["train[0]", "before it"]);
    let losses = "[[losses]]\ntype = \"cosine\"\n[[losses]]\ntype = \"smooth_l1\"\nbeta = 0.05";
    let labels = "[[losses]]\ntype = \"text_classification\"";
    refused(losses, labels, &["losses", "none compares with the teacher"]);
}
