//! Experiments that together have every kind of table, and the scenes that they read.

use crate::runs;
use candle_core::{Device, Tensor};
use scenesplat::NetworkConfig;
use scenesplat::experiment::ExperimentConfig;
use scenesplat::rooms::vocabulary::Vocabulary;
use scenesplat::rooms::{CLASSES, SyntheticRoomSettings, generate};
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::{GaussianScene, LabelledPoints, LanguageFeatures};
use scenesplat_test_support::Network;
use serde_json::Value;
use std::path::Path;

/// Vocabulary, several sources, all terms of language pretraining.
const LANGUAGE: &str = r#"
task = "language_pretraining"
targets = "class_text"
model_seed = 3
text = { type = "vocabulary", dim = 64, exclude = ["wall"] }
loader = { workers = 0, mix_probability = 0.5 }
losses = [
    { type = "cosine", weight = 0.5 },
    { type = "l2", weight = 0.1 },
    { type = "aggregated_contrastive", weight = 0.5, min_points = 4 },
    { type = "text_classification" },
]
schedule = { type = "one_cycle", warmup = 0.7 }
early_stopping = { measurement = "unseen/mIoU", patience = 9 }
MODEL
projection = 64
[[train]]
source = { type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 500 } }
transforms = "language_pretraining"
[[train]]
source = { type = "generic", root = "DATA/halls" }
transforms = [{ type = "center_shift" }, { type = "grid_sample", grid_size = 0.3 }]
[optimizer]
lr = 0.01
groups = [{ keyword = "block", lr = 0.001 }]
weight_decay_schedule = { warmup = 0.5, warmup_from = 0.04, from = 0.1, to = 0.4 }
[trainer]
log_every = 1
max_left_out = 1.0
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 500 } }
"#;

/// Class texts in a file; targets in the scenes.
const TABLE: &str = r#"
task = "language_pretraining"
targets = "class_text"
text = { type = "table", path = "DATA/texts.safetensors", names = "DATA/names.txt" }
loader = { workers = 0 }
losses = [{ type = "cosine" }]
optimizer = { lr = 0.02, groups = [] }
trainer = { epochs = 12 }
MODEL
projection = 64
[[train]]
source = { type = "synthetic", count = 2, seed = 1, vocabulary = 64, room = { num_gaussians = 500 } }
transforms = "validation"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, vocabulary = 64, room = { num_gaussians = 500 } }
text = { type = "synthetic_classes", path = "DATA/texts.safetensors", names = "DATA/scannet.txt" }
[[evaluate]]
name = "again"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 500 } }
text = { type = "table", path = "DATA/texts.safetensors", names = "DATA/names.txt" }
[[evaluate]]
name = "words"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 500 } }
text = { type = "vocabulary", dim = 64 }
"#;

/// The first text of an experiment in the other form of file.
const CLASSES_OF_ROOMS: &str = r#"
task = "language_pretraining"
targets = "class_text"
text = { type = "synthetic_classes", path = "DATA/texts.safetensors", names = "DATA/scannet.txt" }
loader = { workers = 0 }
losses = [{ type = "cosine" }]
optimizer = { groups = [] }
MODEL
projection = 64
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 500 } }
transforms = "validation"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 500 } }
"#;

/// Folders of scenes, as a benchmark and as one's own, with features of their own.
const FOLDERS: &str = r#"
task = "language_pretraining"
text = { type = "vocabulary", dim = 64 }
loader = { workers = 0, batch_size = 1, shuffle = false, mix_probability = 0.0 }
losses = [{ type = "cosine" }]
optimizer = { groups = [] }
trainer = { max_left_out = 1.0 }
MODEL
projection = 64
[[train]]
source = { type = "replica", root = "DATA/replica", class_names = "DATA/names.txt" }
transforms = "validation"
[[train]]
source = { type = "generic", root = "DATA/halls" }
transforms = "validation"
[[evaluate]]
name = "replica"
source = { type = "replica", root = "DATA/replica", split = "validation", class_names = "DATA/names.txt" }
[[evaluate]]
name = "own"
source = { type = "generic", root = "DATA/halls" }
"#;

/// The other task.
const SEGMENTATION: &str = r#"
task = "semantic_segmentation"
loader = { workers = 0 }
losses = [{ type = "cross_entropy" }, { type = "lovasz_softmax" }]
optimizer = { lr = 0.01, groups = [] }
schedule = { type = "cosine", warmup = 0.5, warmup_from = 0.1, from = 1.0, to = 0.1 }
trainer = { epochs = 2, log_every = 1 }
limits = { train = 1.0 }
MODEL
num_classes = 41
[[train]]
source = { type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 500 } }
transforms = "semantic_segmentation"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 500 } }
"#;

const MODEL_V1: &str = r#"[model]
architecture = "point_transformer_v1"
grid_size = 0.3
stride = [1, 2]
enc_depths = [1, 1]
channels = [16, 32]
neighbors = [6, 8]
dec_depths = [1, 1]
num_classes = 41"#;

const MODEL_V2: &str = r#"[model]
architecture = "point_transformer_v2"
grid_size = 0.3
drop_path = 0.3
patch_embed_channels = 12
patch_embed_groups = 3
stride = [2]
enc_depths = [1]
enc_channels = [24]
enc_groups = [6]
enc_neighbors = [8]
dec_depths = [1]
dec_channels = [12]
dec_groups = [3]
dec_neighbors = [8]
num_classes = 41"#;

const MODEL_LITE: &str = r#"[model]
architecture = "litept"
grid_size = 0.3
drop_path = 0.3
stride = [2]
enc_depths = [1, 1]
enc_channels = [12, 24]
enc_blocks = ["convolution", "attention"]
enc_num_head = [1, 2]
enc_patch_size = [16, 16]
dec_depths = [1]
dec_channels = [12]
dec_blocks = ["attention"]
dec_num_head = [1]
dec_patch_size = [16]
num_classes = 41"#;

/// A short run of a network of points.
const POINTS: &str = r#"
task = "semantic_segmentation"
loader = { workers = 0, mix_probability = 0.0 }
losses = [{ type = "cross_entropy" }]
optimizer = { groups = [] }
MODEL
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 400 } }
transforms = "validation"
"#;

/// A student of a network.
const STUDENT: &str = r#"
task = "distillation"
text = { type = "vocabulary", dim = 64 }
loader = { workers = 0 }
losses = [{ type = "smooth_l1", beta = 0.1 }, { type = "text_distillation", temperature = 0.2 }]
optimizer = { groups = [] }
MODEL
projection = 64
[teacher]
type = "network"
weights = "seeded:3"
config = "tiny"
view = "scene"
cache = { folder = "DATA/rows", max_gb = 1e-9 }
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 500 } }
transforms = "language_pretraining"
"#;

/// A student of stored features.
const STORED: &str = r#"
task = "distillation"
teacher = { type = "features", folder = "DATA/features" }
loader = { workers = 0 }
losses = [{ type = "cosine" }]
optimizer = { groups = [] }
MODEL
projection = 64
[[train]]
source = { type = "generic", root = "DATA/halls" }
transforms = "validation"
"#;

/// Views of scenes, with every term.
const VIEWS: &str = r#"
task = "self_supervised"
loader = { workers = 0, mix_probability = 0.0 }
optimizer = { lr = 0.01, groups = [] }
trainer = { epochs = 3, log_every = 1 }
MODEL
mask_token = true
[[train]]
source = { type = "synthetic", count = 4, seed = 1, vocabulary = 64, room = { num_gaussians = 500 } }
transforms = [{ type = "center_shift" }, { type = "views", groups = [
    { kind = "global", views = [
        [{ type = "random_rotate", probability = 1.0 }, { type = "grid_sample", grid_size = 0.3 }],
        [{ type = "random_rotate", probability = 1.0 }, { type = "grid_sample", grid_size = 0.3 }],
    ] },
    { kind = "local", crop = { ratio = [0.2, 0.5], point_max = 400 }, views = [
        [{ type = "random_rotate", probability = 1.0 }, { type = "grid_sample", grid_size = 0.3 }],
    ] },
] }]
[self_supervised]
masking = { shape = { patches = 0.6 }, ratio = [0.2, 0.5], scenes = 1.0, weight = "per_patch" }
momentum = { warmup = 0.4, warmup_from = 0.6, from = 0.9, to = 1.0 }
mask_size = { warmup = 0.4, warmup_from = 0.4, from = 0.6, to = 0.8 }
mask_ratio = { warmup = 0.4, warmup_from = 0.3, from = 0.5, to = 0.6 }
terms = [
    { type = "masked_gaussians", distance = "fitted" },
    { type = "sim_dino", hidden = 8, out = 6 },
    { type = "dino", PROTOTYPES balance = { centering = 0.9 } } },
    { type = "ibot", hidden = 8, out = 6 },
    { type = "ibot_cross_entropy", PROTOTYPES balance = { centering = 0.9 } } },
    { type = "self_distillation", up_cast = 1, max_distance = 0.5, PROTOTYPES balance = { sinkhorn_knopp = 3 } } },
    { type = "language_alignment", hidden = 8, out = 64, masked_only = true },
    { type = "sim_dino_rows", hidden = 8, out = 6, up_cast = 1, max_distance = 0.5 },
]
"#;

/// Of a head with prototypes, but for how they are balanced.
const PROTOTYPES: &str = "prototypes = { count = 6, hidden = 8, out = 4, student_temperature = 0.2, \
    teacher_temperature = { warmup = 0.4, warmup_from = 0.1, from = 0.2, to = 0.3 },";

/// An autoencoder of language features.
const CODES: &str = r#"
task = "autoencoder"
text = { type = "vocabulary", dim = 64 }
model = { grid_size = 0.3 }
autoencoder = { widths = [64, 16, 8] }
loader = { workers = 0, mix_probability = 0.0 }
optimizer = { lr = 0.01, groups = [] }
[[train]]
source = { type = "synthetic", count = 4, seed = 1, vocabulary = 64, room = { num_gaussians = 500 } }
transforms = "validation"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, vocabulary = 64, room = { num_gaussians = 500 } }
"#;

/// The bases by name.
pub const ALL: [(&str, &str); 12] = [
    ("language", LANGUAGE),
    ("table", TABLE),
    ("rooms", CLASSES_OF_ROOMS),
    ("folders", FOLDERS),
    ("segmentation", SEGMENTATION),
    ("v1", POINTS),
    ("v2", POINTS),
    ("litept", POINTS),
    ("student", STUDENT),
    ("stored", STORED),
    ("views", VIEWS),
    ("codes", CODES),
];

/// A base as its file says it.
pub fn text(name: &str) -> String {
    let (_, text) = ALL.iter().find(|(base, _)| *base == name).unwrap();
    let network = Network { patch: 16, head: "drop_path = 0.3", ..Network::default() };
    let model = match name {
        "v1" => MODEL_V1.to_owned(),
        "v2" => MODEL_V2.to_owned(),
        "litept" => MODEL_LITE.to_owned(),
        _ => format!("[model]\n{network}"),
    };
    text.replace("MODEL", &model).replace("PROTOTYPES", PROTOTYPES)
}

/// Names of models that most rooms have a use for.
const FURNITURE: [&str; 9] = [
    "Armchair",
    "Bed",
    "Bedside table",
    "Bar table",
    "Bar stool",
    "Bath",
    "Bamboo",
    "Chair",
    "Desk",
];

/// What the bases read.
pub struct Data(tempfile::TempDir);

impl Data {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        for (place, seed) in [
            ("halls/one", 1),
            ("halls/two_a", 2),
            ("moved/one", 3),
            ("replica/train/a", 4),
            ("replica/train/b", 5),
            ("replica/val/c", 6),
            ("replica/test/d", 7),
        ] {
            let place = path.join(place);
            std::fs::create_dir_all(place.parent().unwrap()).unwrap();
            write_npy_folder(&room(seed), &place, false).unwrap();
            // Other labels of the same Gaussians.
            std::fs::copy(place.join("segment.npy"), place.join("other.npy")).unwrap();
            write_npy_folder(&other_labels(seed), &path.join("scratch"), true).unwrap();
            std::fs::copy(path.join("scratch/segment.npy"), place.join("other.npy")).unwrap();
        }
        for (id, seed) in [("one", 1), ("two_a", 2)] {
            let n = room(seed).len();
            for (features, factor) in [("features", 0.3_f32), ("other_features", 0.7)] {
                let values: Vec<f32> = (0..n * 64).map(|i| (i as f32 * factor).sin()).collect();
                let folder = path.join(features);
                std::fs::create_dir_all(&folder).unwrap();
                write_npy(&folder.join(format!("{id}.npy")), &[n, 64], &values).unwrap();
            }
        }
        let mut teacher = NetworkConfig::tiny();
        teacher.model.grid_size = 0.4;
        let json = serde_json::to_string(&teacher).unwrap();
        std::fs::write(path.join("teacher.json"), json).unwrap();
        let mut spoiled = room(8);
        spoiled.coord[3] = [f32::NAN; 3];
        spoiled.coord[5] = [f32::NAN; 3];
        std::fs::create_dir(path.join("spoiled")).unwrap();
        write_npy_folder(&spoiled, &path.join("spoiled/hall"), false).unwrap();
        let names: Vec<&str> = CLASSES.iter().map(|c| c.name).collect();
        std::fs::write(path.join("names.txt"), names.join("\n")).unwrap();
        std::fs::write(path.join("few.txt"), names[..7].join("\n")).unwrap();
        let scannet: Vec<&str> = CLASSES.iter().map(|c| c.scannet200_name).collect();
        std::fs::write(path.join("scannet.txt"), scannet.join("\n")).unwrap();
        let other: Vec<_> = scannet.iter().rev().copied().collect();
        std::fs::write(path.join("reversed.txt"), other.join("\n")).unwrap();
        let texts = Vocabulary::new(64).unwrap().class_table();
        write_texts(&texts.values, &path.join("texts.safetensors"));
        let mut turned = texts.values;
        turned.rotate_left(64);
        write_texts(&turned, &path.join("turned.safetensors"));
        write_furniture(&path.join("furniture"));
        Self(folder)
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// A value whose paths are in this folder.
    pub fn placed(&self, value: Value) -> Value {
        match value {
            Value::String(text) => Value::String(self.named(&text)),
            Value::Array(all) => all.into_iter().map(|v| self.placed(v)).collect(),
            Value::Object(all) => all.into_iter().map(|(name, v)| (name, self.placed(v))).collect(),
            other => other,
        }
    }

    fn named(&self, text: &str) -> String {
        text.replace("DATA", self.path().to_str().unwrap())
    }

    /// The experiment that a text says, with its paths in this folder.
    pub fn experiment(&self, text: &str) -> Result<ExperimentConfig, String> {
        runs::read(self.path(), &self.named(text))
    }
}

fn write_texts(values: &[f32], path: &Path) {
    let table = Tensor::from_slice(values, (values.len() / 64, 64), &Device::Cpu).unwrap();
    let tensors = std::collections::HashMap::from([("text_embeddings", table)]);
    candle_core::safetensors::save(&tensors, path).unwrap();
}

/// A catalog of boxes in many colors, ten of each of some usual names.
fn write_furniture(folder: &Path) {
    let models = folder.join("m");
    std::fs::create_dir_all(&models).unwrap();
    let mut properties = String::from("license=Free for all\n");
    for (kind, name) in FURNITURE.iter().enumerate() {
        for number in 0..10 {
            let (n, color) = (kind * 10 + number + 1, number as f32 / 9.0);
            let faces = "f 1 4 3 2\nf 1 2 6 5\nf 5 6 7 8\nf 2 3 7 6\nf 1 5 8 4\nf 4 8 7 3\n";
            let corners =
                "v 0 0 0\nv 2 0 0\nv 2 4 0\nv 0 4 0\nv 0 0 3\nv 2 0 3\nv 2 4 3\nv 0 4 3\n";
            let model = format!("mtllib {n}.mtl\n{corners}usemtl paint\n{faces}");
            std::fs::write(models.join(format!("{n}.obj")), model).unwrap();
            let paint = format!("newmtl paint\nKd {color} {} 0.5\n", 1.0 - color);
            std::fs::write(models.join(format!("{n}.mtl")), paint).unwrap();
            properties += &format!(
                "id#{n}=made#{name}{n}\nname#{n}={name}\nmodel#{n}=/m/{n}.obj\nwidth#{n}=60\ndepth#{n}={}\n\
                 height#{n}=80\ncreator#{n}=A | B\n",
                50 + number
            );
        }
    }
    std::fs::write(folder.join("PluginFurnitureCatalog.properties"), properties).unwrap();
}

/// A small room with labels, features and labeled points.
fn room(seed: u64) -> GaussianScene {
    let settings = SyntheticRoomSettings::with_count(500, seed);
    let mut scene = generate(&settings).unwrap().scene;
    let n = scene.len();
    let one = half::f16::from_f32(1.0);
    let mut values = vec![half::f16::ZERO; n * 64];
    (0..n).for_each(|row| values[row * 64 + (row + seed as usize) % 64] = one);
    scene.lang_feat = Some(LanguageFeatures { values, dim: 64 });
    scene.valid_feat_mask = Some((0..n).map(|row| row % 5 != 0).collect());
    let labels = scene.segment.clone().unwrap();
    // Points with labels that are not quite those of the Gaussians.
    let coord: Vec<[f32; 3]> = scene.coord.iter().step_by(3).copied().collect();
    let segment = labels.iter().step_by(3).map(|l| if *l == 0 { 1 } else { *l }).collect();
    scene.labelled_points = Some(LabelledPoints { coord, segment: Some(segment), instance: None });
    // Sizes and opacities at which the limits of the original's loader bite.
    scene.log_scale.iter_mut().step_by(3).for_each(|s| *s = [3.0_f32.ln(); 3]);
    scene.opacity_logit[1] = -12.0;
    scene
}

fn other_labels(seed: u64) -> GaussianScene {
    let mut scene = room(seed);
    scene.segment.as_mut().unwrap().iter_mut().for_each(|l| *l = (*l + 1) % 7);
    scene
}

/// A base as the program reads it, all settings in place.
pub fn read(data: &Data, name: &str) -> Value {
    serde_json::to_value(data.experiment(&text(name)).unwrap()).unwrap()
}
