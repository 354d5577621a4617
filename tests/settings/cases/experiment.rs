//! The experiment itself and its class texts.

use super::Effect::{Measured, Recorded, Refused, Weights};
use super::{Case, row};

pub const CASES: &[Case] = &[
    // The experiment itself.
    row("task", "language", "/task", "semantic_segmentation", Refused("targets")),
    row("precision", "language", "/precision", "bf16", Weights),
    row("model_seed", "language", "/model_seed", "4", Weights),
    row("init_from", "language", "/init_from", "DATA/init", Weights),
    row(
        "input.channels",
        "language",
        "/input/channels",
        r#"["quat", "color", "opacity", "scale"]"#,
        Weights,
    ),
    row("input.scale_clip", "language", "/input/scale_clip", "[0.0, 0.01]", Weights),
    row("input.orientation", "language", "/input/orientation", "drawn", Weights),
    row("mix", "language", "/mix", "main_first", Weights).with(&[("/train/1/weight", "2")]),
    row("targets", "table", "/targets", "features", Weights),
    // Class texts.
    row("teacher(network).type", "student", "/teacher/type", "features", Refused("unknown field")),
    row("teacher(network).weights", "student", "/teacher/weights", "seeded:4", Weights),
    row("teacher(network).config", "student", "/teacher/config", "DATA/teacher.json", Weights),
    row("teacher(network).precision", "student", "/teacher/precision", "bf16", Weights),
    row("teacher(network).view", "student", "/teacher/view", "augmented", Weights),
    row("teacher(network).cache.folder", "student", "/teacher/cache/folder", "DATA/own", Recorded),
    row("teacher(network).cache.max_gb", "student", "/teacher/cache/max_gb", "1.0", Recorded),
    row("teacher(features).type", "stored", "/teacher/type", "network", Refused("unknown field")),
    row("teacher(features).folder", "stored", "/teacher/folder", "DATA/other_features", Weights),
    row("text(vocabulary).type", "language", "/text/type", "table", Refused("path")),
    row("text(vocabulary).dim", "language", "/text/dim", "96", Refused("96")),
    row(
        "text(vocabulary).exclude",
        "language",
        "/text/exclude",
        r#"["wall", "floor", "bed", "cabinet", "chair", "table"]"#,
        Measured,
    ),
    row("text(table).type", "table", "/text/type", "vocabulary", Refused("unknown field")),
    row("text(table).path", "table", "/text/path", "DATA/turned.safetensors", Weights),
    row("text(table).names", "table", "/text/names", "DATA/reversed.txt", Refused("class 0")),
    row("text(table).rows", "table", "/text/rows", r#"["floor"]"#, Refused("1")),
    row(
        "text(table).exclude",
        "table",
        "/text/exclude",
        r#"["wall", "bed", "cabinet", "chair", "table"]"#,
        Measured,
    )
    .with(&[("/evaluate/1/text", "null")]),
    row("text(synthetic_classes).type", "rooms", "/text/type", "table", Refused("class")),
    row("text(synthetic_classes).path", "rooms", "/text/path", "DATA/turned.safetensors", Weights),
    row("text(synthetic_classes).names", "rooms", "/text/names", "DATA/reversed.txt", Weights),
    row(
        "text(synthetic_classes).exclude",
        "rooms",
        "/text/exclude",
        r#"["bed", "cabinet", "chair", "table"]"#,
        Measured,
    ),
];
