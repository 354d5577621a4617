//! One row for each setting: its value, and what the run must show.

use Effect::{Files, Logged, Measured, Nothing, Recorded, Refused, Weights};

/// What a changed setting changes.
#[derive(Debug, Clone, Copy)]
pub enum Effect {
    /// The parameters at the end.
    Weights,
    /// Evaluations, with the same parameters.
    Measured,
    /// Other lines of the log, with the same parameters.
    Logged,
    /// Which checkpoints there are.
    Files,
    /// The record of data, alarms and the teacher.
    Recorded,
    /// The run is refused with an error that contains this.
    Refused(&'static str),
    /// No number at all, for this reason.
    #[expect(dead_code, reason = "read by people")]
    Nothing(&'static str),
}

/// A field of a table (a JSON pointer), its value (JSON, or plain words), and the effect.
pub type Row = (&'static str, &'static str, Effect);

/// Settings of one table of a base.
pub struct Table {
    /// Which experiment.
    pub base: &'static str,
    /// JSON pointer of the table.
    pub at: &'static str,
    /// Other values that are set, in the base and in the changed run.
    pub with: &'static [(&'static str, &'static str)],
    /// Its settings.
    pub rows: &'static [Row],
}

const fn table(base: &'static str, at: &'static str) -> Table {
    Table { base, at, with: &[], rows: &[] }
}

impl Table {
    const fn with(self, with: &'static [(&'static str, &'static str)]) -> Self {
        Self { with, ..self }
    }

    const fn rows(self, rows: &'static [Row]) -> Self {
        Self { rows, ..self }
    }
}

/// Heads with prototypes.
const PROTOTYPES: &[Row] = &[
    ("count", "5", Weights),
    ("hidden", "7", Weights),
    ("out", "3", Weights),
    ("student_temperature", "0.4", Weights),
    ("teacher_temperature/warmup", "0.9", Weights),
    ("teacher_temperature/warmup_from", "0.6", Weights),
    ("teacher_temperature/from", "0.7", Weights),
    ("teacher_temperature/to", "0.9", Weights),
];

/// Steps with larger voxels.
const COARSE: &str =
    r#"[{"type": "center_shift"}, {"type": "grid_sample", "grid_size": 0.6, "keep_full": true}]"#;

/// For the 41 classes of rooms.
const CLASS_WEIGHTS: &str = "[0.1, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, \
    1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, \
    1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]";

/// All settings, in the order of an experiment's file.
pub const TABLES: &[Table] = &[
    // The experiment, its teacher and class texts.
    table("language", "").rows(&[
        ("task", "semantic_segmentation", Refused("targets")),
        ("precision", "bf16", Weights),
        ("model_seed", "4", Weights),
        ("init_from", "DATA/init", Weights),
    ]),
    table("language", "/input").rows(&[
        ("channels", r#"["quat", "color", "opacity", "scale"]"#, Weights),
        ("scale_clip", "[0.0, 0.01]", Weights),
        ("orientation", "drawn", Weights),
    ]),
    table("language", "").with(&[("/train/1/weight", "2")]).rows(&[("mix", "main_first", Weights)]),
    table("table", "").rows(&[("targets", "features", Weights)]),
    table("student", "/teacher").rows(&[
        ("type", "features", Refused("unknown field")),
        ("weights", "seeded:4", Weights),
        ("config", "DATA/teacher.json", Weights),
        ("precision", "bf16", Weights),
        ("view", "augmented", Weights),
        ("cache/folder", "DATA/own", Recorded),
        ("cache/max_gb", "1.0", Recorded),
    ]),
    table("stored", "/teacher").rows(&[
        ("type", "network", Refused("unknown field")),
        ("folder", "DATA/other_features", Weights),
    ]),
    table("language", "/text").rows(&[
        ("type", "table", Refused("path")),
        ("dim", "96", Refused("96")),
        ("exclude", r#"["wall", "floor", "bed", "cabinet", "chair", "table"]"#, Measured),
    ]),
    table("table", "/text").rows(&[
        ("type", "vocabulary", Refused("unknown field")),
        ("path", "DATA/turned.safetensors", Weights),
        ("names", "DATA/reversed.txt", Refused("class 0")),
        ("rows", r#"["floor"]"#, Refused("1")),
    ]),
    table("table", "/text").with(&[("/evaluate/1/text", "null")]).rows(&[(
        "exclude",
        r#"["wall", "bed", "cabinet", "chair", "table"]"#,
        Measured,
    )]),
    table("rooms", "/text").rows(&[
        ("type", "table", Refused("class")),
        ("path", "DATA/turned.safetensors", Weights),
        ("names", "DATA/reversed.txt", Weights),
        ("exclude", r#"["bed", "cabinet", "chair", "table"]"#, Measured),
    ]),
    // The network.
    table("language", "/model").rows(&[
        ("order", r#"["hilbert", "z"]"#, Weights),
        ("stride", "[4]", Weights),
        ("enc_depths", "[1, 2]", Weights),
        ("enc_channels", "[16, 16]", Weights),
        ("enc_num_head", "[2, 2]", Weights),
        ("enc_patch_size", "[32, 16]", Weights),
        ("dec_depths", "[2]", Weights),
        ("dec_channels", "[32]", Weights),
        ("dec_num_head", "[4]", Weights),
        ("dec_patch_size", "[32]", Weights),
        ("mlp_ratio", "2", Weights),
        ("drop_path", "0.6", Weights),
        ("pooling", "max", Weights),
        ("version", "m2", Weights),
        ("grid_size", "0.2", Weights),
        ("in_channels", "12", Refused("in_channels is 12")),
        ("mask_token", "true", Refused("mask_token")),
        ("projection", "32", Refused("32")),
    ]),
    table("segmentation", "/model").rows(&[
        ("architecture", "point_transformer_v2", Refused("unknown field")),
        ("num_classes", "40", Refused("num_classes")),
    ]),
    table("language", "/model")
        .with(&[
            ("/model/order", r#"["hilbert"]"#),
            ("/loader/mix_probability", "0.0"),
            ("/model/grid_size", "0.1"),
        ])
        .rows(&[("batch_rule", "shared_depth", Weights)]),
    table("v1", "/model").rows(&[
        ("stride", "[1, 4]", Weights),
        ("enc_depths", "[1, 2]", Weights),
        ("channels", "[16, 16]", Weights),
        ("neighbors", "[4, 8]", Weights),
        ("dec_depths", "[1, 2]", Weights),
        ("share_channels", "4", Weights),
        ("grid_size", "0.2", Weights),
        ("architecture", "point_transformer_v3", Refused("channels")),
        ("in_channels", "12", Refused("in_channels is 12")),
        ("num_classes", "40", Refused("num_classes")),
        ("projection", "32", Refused("projection")),
    ]),
    table("v2", "/model").rows(&[
        ("patch_embed_depth", "2", Weights),
        ("patch_embed_channels", "24", Weights),
        ("patch_embed_groups", "6", Weights),
        ("patch_embed_neighbors", "4", Weights),
        ("stride", "[4]", Weights),
        ("enc_depths", "[2]", Weights),
        ("enc_channels", "[36]", Weights),
        ("enc_groups", "[3]", Weights),
        ("enc_neighbors", "[4]", Weights),
        ("dec_depths", "[2]", Weights),
        ("dec_channels", "[24]", Weights),
        ("dec_groups", "[6]", Weights),
        ("dec_neighbors", "[4]", Weights),
        ("position_multiplier", "true", Weights),
        ("grid_size", "0.2", Weights),
        ("architecture", "point_transformer_v1", Refused("unknown field")),
        ("in_channels", "12", Refused("in_channels is 12")),
        ("num_classes", "40", Refused("num_classes")),
        ("projection", "32", Refused("projection")),
    ]),
    table("v2", "/model").with(&[("/model/enc_depths", "[3]")]).rows(&[(
        "drop_path",
        "0.7",
        Weights,
    )]),
    table("litept", "/model").rows(&[
        ("order", r#"["hilbert", "z"]"#, Weights),
        ("stride", "[4]", Weights),
        ("enc_depths", "[1, 2]", Weights),
        ("enc_channels", "[12, 48]", Weights),
        ("enc_blocks", r#"["convolution", "convolution"]"#, Weights),
        ("enc_num_head", "[1, 4]", Weights),
        ("enc_patch_size", "[16, 32]", Weights),
        ("dec_depths", "[2]", Weights),
        ("dec_channels", "[24]", Weights),
        ("dec_blocks", r#"["convolution"]"#, Weights),
        ("dec_num_head", "[2]", Weights),
        ("dec_patch_size", "[32]", Weights),
        ("mlp_ratio", "2", Weights),
        ("rope_base", "10.0", Weights),
        ("grid_size", "0.2", Weights),
        ("architecture", "point_transformer_v2", Refused("unknown field")),
        ("in_channels", "12", Refused("in_channels is 12")),
        ("num_classes", "40", Refused("num_classes")),
        ("projection", "32", Refused("projection")),
    ]),
    table("litept", "/model").with(&[("/model/enc_depths", "[2, 2]")]).rows(&[(
        "drop_path",
        "0.7",
        Weights,
    )]),
    // Scenes to train on, and batches.
    table("language", "/train/0/source").rows(&[
        ("type", "generic", Refused("unknown field")),
        ("count", "6", Weights),
        ("seed", "2", Weights),
        ("texts", "DATA/texts.safetensors", Refused("does not name its classes")),
        ("effects", "holes=2,noise=1..3", Weights),
    ]),
    table("table", "/train/0/source").with(&[("/targets", "features")]).rows(&[(
        "vocabulary",
        "null",
        Refused("lang_feat"),
    )]),
    table("language", "/train/0/source/room").rows(&[
        ("seed", "1", Refused("room.seed")),
        ("room", "7", Weights),
        ("num_gaussians", "400", Weights),
        ("kind", "bathroom", Weights),
        ("points_share", "1.0", Weights),
        ("capture", "scan", Weights),
        ("seen_share", "1.0", Weights),
        ("density_variation", "1.0", Weights),
        ("flat_share", "1.0", Weights),
        ("public_share", "1.0", Weights),
        ("furniture", "DATA/furniture", Weights),
    ]),
    table("language", "/train/0/source/room")
        .with(&[
            ("/train/0/source/room/num_gaussians", "null"),
            ("/train/0/source/room/gaussians_per_m2", "4.0"),
        ])
        .rows(&[("gaussians_per_m2", "6.0", Weights)]),
    table("language", "/train/0/source/room")
        .with(&[("/train/0/source/room/furniture", "DATA/furniture")])
        .rows(&[
            ("furniture_share", "0.0", Weights),
            ("furniture_variation", "1.0", Weights),
            ("furniture_split", "held_out", Weights),
        ]),
    table("folders", "/train/1/source").rows(&[
        ("type", "replica", Refused("folder")),
        ("root", "DATA/moved", Weights),
        ("split", "train", Refused("split")),
        ("lang_feat", "false", Refused("lang_feat")),
        ("labelled_points", "true", Refused("labelled_points")),
        ("excluded_scenes", r#"["two"]"#, Weights),
        ("limit", "1", Weights),
    ]),
    table("folders", "/train/1/source")
        .with(&[
            ("/train/1/source/root", "DATA/replica"),
            ("/train/1/source/folders", r#"["val"]"#),
        ])
        .rows(&[("folders", r#"["train"]"#, Weights)]),
    table("language", "/train/1/source").rows(&[
        ("segment", "other", Weights),
        ("exact", "true", Weights),
        ("class_names", "DATA/few.txt", Refused("7 classes")),
        ("label_base", "1", Refused("label_base")),
    ]),
    table("folders", "/train/1/source")
        .with(&[("/train/1/source/root", "DATA/spoiled")])
        .rows(&[("policy", "strict", Refused("NaN"))]),
    table("folders", "/train/0/source").rows(&[
        ("type", "generic", Refused("holds no scene")),
        ("root", "DATA/halls", Refused("train")),
        ("split", "validation", Weights),
        ("folders", r#"["test"]"#, Weights),
        ("exact", "true", Weights),
        ("lang_feat", "false", Refused("lang_feat")),
        ("labelled_points", "true", Refused("labelled_points")),
        ("excluded_scenes", r#"["a"]"#, Weights),
        ("limit", "1", Weights),
    ]),
    table("language", "/train/0/source")
        .with(&[(
            "/train/0/source",
            r#"{"type": "replica", "root": "DATA/replica", "class_names": "DATA/names.txt"}"#,
        )])
        .rows(&[
            ("segment", "other", Weights),
            ("class_names", "DATA/few.txt", Refused("7 classes")),
            ("label_base", "1", Weights),
        ]),
    table("folders", "/train/0/source")
        .with(&[("/train/0/source/root", "DATA/spoiled"), ("/train/0/source/folders", r#"["."]"#)])
        .rows(&[("policy", "strict", Refused("NaN"))]),
    table("language", "/train/0").rows(&[
        ("transforms", "validation", Weights),
        ("repeat", "2", Weights),
        ("weight", "2", Weights),
        ("seed", "2", Weights),
    ]),
    table("segmentation", "/train/0").rows(&[("labels", r#"{"keep": {"share": 0.3}}"#, Weights)]),
    table("language", "/loader").rows(&[
        ("batch_size", "1", Weights),
        ("shuffle", "false", Weights),
        ("seed", "5", Weights),
        ("workers", "2", Nothing("batches depend neither on who makes them nor on when")),
        ("prefetch", "2", Nothing("batches depend neither on who makes them nor on when")),
    ]),
    table("language", "/loader").with(&[("/loader/mix_probability", "0.0")]).rows(&[(
        "mix_probability",
        "1.0",
        Weights,
    )]),
    table("language", "/loader").with(&[("/loader/mix_probability", "1.0")]).rows(&[(
        "mix_exact",
        "true",
        Weights,
    )]),
    table("language", "/loader").with(&[("/train/0/source/count", "5")]).rows(&[(
        "drop_last",
        "false",
        Weights,
    )]),
    table("folders", "/loader")
        .with(&[
            ("/loader/broken_scenes", "skip"),
            ("/train/1/source/root", "DATA/spoiled"),
            ("/train/1/source/policy", "strict"),
        ])
        .rows(&[("broken_scenes", "stop", Refused("NaN"))]),
    // The loss.
    table("language", "/losses/0").rows(&[
        ("type", "cross_entropy", Refused("unknown field")),
        ("weight", "0.9", Weights),
        ("reduction", "sum", Weights),
    ]),
    table("language", "/losses/1").rows(&[
        ("type", "cross_entropy", Refused("unknown field")),
        ("weight", "0.9", Weights),
        ("reduction", "sum", Weights),
    ]),
    table("student", "/losses/0").rows(&[
        ("type", "l2", Refused("beta")),
        ("weight", "0.3", Weights),
        ("beta", "0.5", Weights),
        ("reduction", "sum", Weights),
    ]),
    table("student", "/losses/1").rows(&[
        ("type", "cosine", Refused("temperature")),
        ("weight", "0.3", Weights),
        ("temperature", "0.6", Weights),
        ("reduction", "sum", Weights),
    ]),
    table("language", "/losses/2").rows(&[
        ("type", "cosine", Refused("unknown field")),
        ("weight", "0.9", Weights),
        ("temperature", "0.3", Weights),
        ("schedule", "skip", Weights),
        ("min_points", "9", Weights),
        ("classes", "off", Weights),
        ("reduction", "sum", Weights),
    ]),
    table("language", "/losses/3").rows(&[
        ("type", "cosine", Refused("unknown field")),
        ("weight", "0.9", Weights),
        ("temperature", "0.3", Weights),
        ("lovasz", "0.3", Weights),
        ("label_smoothing", "0.2", Weights),
    ]),
    table("segmentation", "/losses/0").rows(&[
        ("type", "cosine", Refused("unknown field")),
        ("weight", "0.5", Weights),
        ("label_smoothing", "0.2", Weights),
        ("class_weights", CLASS_WEIGHTS, Weights),
    ]),
    table("segmentation", "/losses/1")
        .rows(&[("type", "cross_entropy", Weights), ("weight", "0.5", Weights)]),
    // Self-supervised training and autoencoders.
    table("codes", "/autoencoder").rows(&[
        ("widths", "[64, 12, 8]", Weights),
        ("l2", "0.1", Weights),
        ("cosine", "9.0", Weights),
    ]),
    table("views", "/self_supervised").rows(&[
        ("compat", "original", Weights),
        ("export", "teacher", Weights),
        ("momentum/warmup", "0.9", Weights),
        ("momentum/warmup_from", "0.1", Weights),
        ("momentum/from", "0.2", Weights),
        ("momentum/to", "0.3", Weights),
        ("masking/shape", "gaussians", Refused("mask_size")),
        ("masking/ratio", "[0.9, 0.1]", Refused("ratio")),
        ("masking/scenes", "0.5", Weights),
        ("masking/weight", "per_gaussian", Weights),
        ("mask_size/warmup", "0.9", Weights),
        ("mask_size/warmup_from", "0.9", Weights),
        ("mask_size/from", "1.2", Weights),
        ("mask_size/to", "1.9", Weights),
        ("mask_ratio/warmup", "0.9", Weights),
        ("mask_ratio/warmup_from", "0.9", Weights),
        ("mask_ratio/from", "0.9", Weights),
        ("mask_ratio/to", "0.1", Weights),
    ]),
    table("views", "/self_supervised/terms/0").rows(&[
        ("type", "ibot", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("distance", "mean_square", Weights),
        ("heads", "per_attribute", Weights),
    ]),
    table("views", "/self_supervised/terms/1").rows(&[
        ("type", "dino", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("hidden", "7", Weights),
        ("out", "5", Weights),
        ("coefficient", "0.9", Weights),
        ("epsilon", "0.5", Weights),
        ("expansion", "student", Weights),
    ]),
    table("views", "/self_supervised/terms/2")
        .rows(&[("type", "ibot", Refused("unknown field")), ("weight", "3.0", Weights)]),
    table("views", "/self_supervised/terms/2/prototypes").rows(PROTOTYPES),
    table("views", "/self_supervised/terms/2/prototypes").rows(&[(
        "balance",
        r#"{"centering": 0.1}"#,
        Weights,
    )]),
    table("views", "/self_supervised/terms/3").rows(&[
        ("type", "dino", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("hidden", "7", Weights),
        ("out", "5", Weights),
    ]),
    table("views", "/self_supervised/terms/4")
        .rows(&[("type", "ibot", Refused("unknown field")), ("weight", "3.0", Weights)]),
    table("views", "/self_supervised/terms/4/prototypes").rows(PROTOTYPES),
    table("views", "/self_supervised/terms/4/prototypes").rows(&[(
        "balance",
        r#"{"centering": 0.1}"#,
        Weights,
    )]),
    table("views", "/self_supervised/terms/5").rows(&[
        ("type", "ibot", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("up_cast", "0", Weights),
        ("max_distance", "0.05", Weights),
        ("shares", "[0.5, 0.25, 0.25]", Weights),
    ]),
    table("views", "/self_supervised/terms/5/prototypes").rows(PROTOTYPES),
    table("views", "/self_supervised/terms/5/prototypes").rows(&[(
        "balance",
        r#"{"sinkhorn_knopp": 1}"#,
        Weights,
    )]),
    table("views", "/self_supervised/terms/6").rows(&[
        ("type", "ibot", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("hidden", "7", Weights),
        ("masked_only", "false", Weights),
        ("out", "16", Refused("64 wide")),
    ]),
    table("views", "/self_supervised/terms/7").rows(&[
        ("type", "ibot", Refused("unknown field")),
        ("weight", "3.0", Weights),
        ("hidden", "5", Weights),
        ("out", "3", Weights),
        ("coefficient", "0.3", Weights),
        ("epsilon", "0.7", Weights),
        ("expansion", "student", Weights),
        ("max_rows", "9", Weights),
        ("up_cast", "0", Weights),
        ("max_distance", "0.05", Weights),
        ("shares", "[0.5, 0.25, 0.25]", Weights),
    ]),
    // Optimizer, schedules and the loop.
    table("language", "/optimizer").rows(&[
        ("lr", "0.02", Weights),
        ("groups/0/keyword", "norm", Weights),
        ("groups/0/lr", "0.005", Weights),
        ("weight_decay_schedule/warmup", "0.9", Weights),
        ("weight_decay_schedule/warmup_from", "0.9", Weights),
        ("weight_decay_schedule/from", "0.9", Weights),
        ("weight_decay_schedule/to", "0.9", Weights),
    ]),
    table("segmentation", "/optimizer").rows(&[
        ("weight_decay", "0.5", Weights),
        ("adamw/beta1", "0.5", Weights),
        ("adamw/beta2", "0.9", Weights),
        ("adamw/eps", "0.001", Weights),
    ]),
    table("language", "/schedule").rows(&[
        ("type", "cosine", Refused("unknown field")),
        ("warmup", "0.2", Weights),
        ("div_factor", "3.0", Weights),
        ("final_div_factor", "2.0", Weights),
        ("min_beta1", "0.5", Weights),
        ("max_beta1", "0.99", Weights),
    ]),
    table("segmentation", "/schedule").rows(&[
        ("type", "one_cycle", Refused("unknown field")),
        ("warmup", "0.9", Weights),
        ("warmup_from", "0.5", Weights),
        ("from", "0.5", Weights),
        ("to", "0.6", Weights),
    ]),
    table("language", "/trainer").rows(&[
        ("seed", "5", Weights),
        ("epochs", "2", Weights),
        ("max_steps", "1", Weights),
        ("accumulate", "2", Weights),
        ("clip_norm", "0.01", Weights),
        ("ema", "0.05", Weights),
        ("freeze", r#"["embedding"]"#, Weights),
        ("log_every", "2", Logged),
        ("recompute", "true", Nothing("memory only")),
    ]),
    table("language", "/trainer").with(&[("/trainer/accumulate", "2")]).rows(&[(
        "sync_batch_norm",
        "true",
        Refused("accumulate = 1"),
    )]),
    table("language", "/trainer").with(&[("/trainer/epochs", "2")]).rows(&[(
        "eval_every",
        "2",
        Measured,
    )]),
    table("language", "/trainer")
        .with(&[("/trainer/idle", r#"["mask_token"]"#), ("/model/mask_token", "true")])
        .rows(&[("idle", "[]", Refused("mask_token"))]),
    table("folders", "/trainer")
        .with(&[("/trainer/max_left_out", "1.0"), ("/train/1/source/root", "DATA/spoiled")])
        .rows(&[("max_left_out", "0.001", Refused("left out"))]),
    table("language", "/trainer/checkpoint").rows(&[(
        "dir",
        "DATA/elsewhere",
        Refused("checkpoint.dir"),
    )]),
    table("language", "/trainer/checkpoint")
        .with(&[("/trainer/checkpoint/keep", "9"), ("/trainer/epochs", "4")])
        .rows(&[("every_steps", "5", Files)]),
    table("language", "/trainer/checkpoint")
        .with(&[("/trainer/epochs", "4")])
        .rows(&[("keep", "2", Files), ("best", "unseen/mIoU", Weights)]),
    table("language", "/trainer/checkpoint")
        .with(&[("/trainer/checkpoint/best", "unseen/mIoU"), ("/trainer/epochs", "4")])
        .rows(&[("smaller_is_better", "true", Weights)]),
    table("language", "/trainer/health").rows(&[
        ("every_steps", "1", Logged),
        ("min_effective_rank", "1000.0", Recorded),
        ("max_centred_cosine", "-2.0", Recorded),
        ("min_running_var", "1e9", Recorded),
        ("max_running_var", "1e-30", Recorded),
    ]),
    table("language", "/trainer/health")
        .with(&[
            ("/trainer/health/every_steps", "1"),
            ("/trainer/health/min_effective_rank", "1000.0"),
        ])
        .rows(&[("stop_after", "1", Refused("have collapsed"))]),
    // Evaluation, and when training ends.
    table("language", "/evaluate/0").rows(&[
        ("name", "other", Refused("unseen/mIoU")),
        ("transforms", COARSE, Measured),
        ("vote_k", "1", Measured),
    ]),
    table("segmentation", "/evaluate/0").rows(&[("vote_k", "5", Measured)]),
    table("segmentation", "/evaluate/0/text")
        .with(&[("/evaluate/0/text", r#"{ "type": "vocabulary", "dim": 64 }"#)])
        .rows(&[("exclude", "[]", Measured)]),
    table("language", "/evaluate/0/source").rows(&[
        ("type", "generic", Refused("unknown field")),
        ("count", "2", Measured),
        ("seed", "10", Measured),
        ("vocabulary", "64", Nothing("only floaters have no feature, and no vote turns on them")),
        ("texts", "DATA/texts.safetensors", Refused("does not name its classes")),
        ("effects", "holes=5", Measured),
    ]),
    table("language", "/evaluate/0/source/room").rows(&[
        ("seed", "1", Refused("room.seed")),
        ("room", "7", Measured),
        ("num_gaussians", "400", Measured),
        ("kind", "bathroom", Measured),
        ("points_share", "0.0", Measured),
        ("capture", "scan", Measured),
        ("seen_share", "1.0", Measured),
        ("density_variation", "1.0", Measured),
        ("flat_share", "1.0", Measured),
        ("public_share", "1.0", Measured),
        ("furniture", "DATA/furniture", Measured),
    ]),
    table("language", "/evaluate/0/source/room")
        .with(&[
            ("/evaluate/0/source/room/num_gaussians", "null"),
            ("/evaluate/0/source/room/gaussians_per_m2", "4.0"),
        ])
        .rows(&[("gaussians_per_m2", "8.0", Measured)]),
    table("language", "/evaluate/0/source/room")
        .with(&[("/evaluate/0/source/room/furniture", "DATA/furniture")])
        .rows(&[
            ("furniture_share", "0.0", Measured),
            ("furniture_variation", "1.0", Measured),
            ("furniture_split", "held_out", Measured),
        ]),
    table("folders", "/evaluate/1/source").rows(&[
        ("type", "replica", Refused("classes of replica")),
        ("root", "DATA/moved", Measured),
        ("split", "train", Refused("split")),
        ("segment", "other", Measured),
        ("lang_feat", "false", Nothing("votes look at the mask of features alone")),
        ("labelled_points", "false", Measured),
        ("excluded_scenes", r#"["two"]"#, Measured),
        ("limit", "1", Measured),
        ("class_names", "DATA/few.txt", Refused("7 classes")),
        ("label_base", "1", Refused("label_base")),
    ]),
    table("folders", "/evaluate/1/source")
        .with(&[
            ("/evaluate/1/source/root", "DATA/replica"),
            ("/evaluate/1/source/folders", r#"["val"]"#),
        ])
        .rows(&[("folders", r#"["train"]"#, Measured)]),
    table("folders", "/evaluate/1/source")
        .with(&[("/input/scale_clip", "none")])
        .rows(&[("exact", "true", Measured)]),
    table("folders", "/evaluate/1/source")
        .with(&[("/evaluate/1/source/root", "DATA/spoiled")])
        .rows(&[("policy", "strict", Refused("NaN"))]),
    table("folders", "/evaluate/0/source").rows(&[
        ("type", "generic", Refused("split")),
        ("root", "DATA/halls", Refused("val")),
        ("split", "train", Measured),
        ("folders", r#"["test"]"#, Measured),
        ("segment", "other", Measured),
        ("lang_feat", "false", Nothing("votes look at the mask of features alone")),
        ("labelled_points", "false", Measured),
        ("class_names", "DATA/few.txt", Refused("7 classes")),
        ("label_base", "1", Measured),
    ]),
    table("folders", "/evaluate/0/source")
        .with(&[
            ("/input/scale_clip", "none"),
            ("/evaluate/0/source/root", "DATA/halls"),
            ("/evaluate/0/source/folders", r#"["."]"#),
        ])
        .rows(&[("exact", "true", Measured)]),
    table("folders", "/evaluate/0/source")
        .with(&[("/evaluate/0/source/split", "train")])
        .rows(&[("excluded_scenes", r#"["a"]"#, Measured), ("limit", "1", Measured)]),
    table("folders", "/evaluate/0/source")
        .with(&[
            ("/evaluate/0/source/root", "DATA/spoiled"),
            ("/evaluate/0/source/folders", r#"["."]"#),
        ])
        .rows(&[("policy", "strict", Refused("NaN"))]),
    table("table", "/evaluate/0/text").rows(&[
        ("type", "table", Refused("class")),
        ("path", "DATA/turned.safetensors", Measured),
        ("names", "DATA/reversed.txt", Measured),
        ("exclude", r#"["bed", "cabinet", "chair", "table"]"#, Measured),
    ]),
    table("table", "/evaluate/1/text").rows(&[
        ("type", "vocabulary", Refused("unknown field")),
        ("path", "DATA/turned.safetensors", Measured),
        ("names", "DATA/reversed.txt", Refused("class 0")),
        ("rows", r#"["floor"]"#, Refused("1")),
        ("exclude", r#"["bed", "cabinet", "chair", "table"]"#, Measured),
    ]),
    table("table", "/evaluate/2/text").rows(&[
        ("type", "table", Refused("path")),
        ("dim", "96", Refused("96")),
        ("exclude", r#"["bed", "cabinet", "chair", "table"]"#, Measured),
    ]),
    table("language", "/early_stopping").rows(&[(
        "measurement",
        "unseen/nothing",
        Refused("early_stopping.measurement"),
    )]),
    table("language", "/early_stopping")
        .with(&[("/early_stopping/measurement", "unseen/oracle/mIoU"), ("/trainer/epochs", "4")])
        .rows(&[("patience", "1", Weights)]),
    table("language", "/early_stopping")
        .with(&[("/trainer/epochs", "4"), ("/early_stopping/patience", "1")])
        .rows(&[("smaller_is_better", "true", Weights)]),
    table("language", "/early_stopping")
        .with(&[("/trainer/epochs", "4"), ("/early_stopping/patience", "1")])
        .rows(&[("min_delta", "1.0", Weights)]),
    table("segmentation", "/limits")
        .rows(&[("train", "1", Weights), ("evaluate", "1.5", Refused("limits.evaluate"))]),
    table("segmentation", "/limits")
        .with(&[("/limits/train", "null")])
        .rows(&[("overfit", "1", Weights)]),
];
