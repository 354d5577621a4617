//! Scenes to train on, and the batches made of them.

use super::Effect::{Nothing, Refused, Weights};
use super::{Case, row};

pub const CASES: &[Case] = &[
    // Scenes to train on.
    row(
        "train[*].source(synthetic).type",
        "language",
        "/train/0/source/type",
        "generic",
        Refused("unknown field"),
    ),
    row("train[*].source(synthetic).count", "language", "/train/0/source/count", "6", Weights),
    row("train[*].source(synthetic).seed", "language", "/train/0/source/seed", "2", Weights),
    row(
        "train[*].source(synthetic).vocabulary",
        "table",
        "/train/0/source/vocabulary",
        "null",
        Refused("lang_feat"),
    )
    .with(&[("/targets", "features")]),
    row(
        "train[*].source(synthetic).texts",
        "language",
        "/train/0/source/texts",
        "DATA/texts.safetensors",
        Refused("does not name its classes"),
    ),
    row(
        "train[*].source(synthetic).effects",
        "language",
        "/train/0/source/effects",
        "holes=2,noise=1..3",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.seed",
        "language",
        "/train/0/source/room/seed",
        "1",
        Refused("room.seed"),
    ),
    row(
        "train[*].source(synthetic).room.room",
        "language",
        "/train/0/source/room/room",
        "7",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.num_gaussians",
        "language",
        "/train/0/source/room/num_gaussians",
        "400",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.gaussians_per_m2",
        "language",
        "/train/0/source/room/gaussians_per_m2",
        "6.0",
        Weights,
    )
    .with(&[
        ("/train/0/source/room/num_gaussians", "null"),
        ("/train/0/source/room/gaussians_per_m2", "4.0"),
    ]),
    row(
        "train[*].source(synthetic).room.kind",
        "language",
        "/train/0/source/room/kind",
        "bathroom",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.points_share",
        "language",
        "/train/0/source/room/points_share",
        "1.0",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.capture",
        "language",
        "/train/0/source/room/capture",
        "scan",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.seen_share",
        "language",
        "/train/0/source/room/seen_share",
        "1.0",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.density_variation",
        "language",
        "/train/0/source/room/density_variation",
        "1.0",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.flat_share",
        "language",
        "/train/0/source/room/flat_share",
        "1.0",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.furniture",
        "language",
        "/train/0/source/room/furniture",
        "DATA/furniture",
        Weights,
    ),
    row(
        "train[*].source(synthetic).room.furniture_share",
        "language",
        "/train/0/source/room/furniture_share",
        "0.0",
        Weights,
    )
    .with(&[("/train/0/source/room/furniture", "DATA/furniture")]),
    row(
        "train[*].source(synthetic).room.furniture_variation",
        "language",
        "/train/0/source/room/furniture_variation",
        "1.0",
        Weights,
    )
    .with(&[("/train/0/source/room/furniture", "DATA/furniture")]),
    row(
        "train[*].source(synthetic).room.furniture_split",
        "language",
        "/train/0/source/room/furniture_split",
        "held_out",
        Weights,
    )
    .with(&[("/train/0/source/room/furniture", "DATA/furniture")]),
    row(
        "train[*].source(generic).type",
        "folders",
        "/train/1/source/type",
        "replica",
        Refused("folder"),
    ),
    row("train[*].source(generic).root", "folders", "/train/1/source/root", "DATA/moved", Weights),
    row(
        "train[*].source(generic).split",
        "folders",
        "/train/1/source/split",
        "train",
        Refused("split"),
    ),
    row(
        "train[*].source(generic).folders",
        "folders",
        "/train/1/source/folders",
        r#"["train"]"#,
        Weights,
    )
    .with(&[("/train/1/source/root", "DATA/replica"), ("/train/1/source/folders", r#"["val"]"#)]),
    row(
        "train[*].source(generic).segment",
        "language",
        "/train/1/source/segment",
        "other",
        Weights,
    ),
    row("train[*].source(generic).exact", "language", "/train/1/source/exact", "true", Weights),
    row(
        "train[*].source(generic).lang_feat",
        "folders",
        "/train/1/source/lang_feat",
        "false",
        Refused("lang_feat"),
    ),
    row(
        "train[*].source(generic).labelled_points",
        "folders",
        "/train/1/source/labelled_points",
        "true",
        Refused("labelled_points"),
    ),
    row(
        "train[*].source(generic).excluded_scenes",
        "folders",
        "/train/1/source/excluded_scenes",
        r#"["two"]"#,
        Weights,
    ),
    row("train[*].source(generic).limit", "folders", "/train/1/source/limit", "1", Weights),
    row(
        "train[*].source(generic).class_names",
        "language",
        "/train/1/source/class_names",
        "DATA/few.txt",
        Refused("7 classes"),
    ),
    row(
        "train[*].source(generic).policy",
        "folders",
        "/train/1/source/policy",
        "strict",
        Refused("NaN"),
    )
    .with(&[("/train/1/source/root", "DATA/spoiled")]),
    row(
        "train[*].source(replica).type",
        "folders",
        "/train/0/source/type",
        "generic",
        Refused("holds no scene"),
    ),
    row(
        "train[*].source(replica).root",
        "folders",
        "/train/0/source/root",
        "DATA/halls",
        Refused("train"),
    ),
    row(
        "train[*].source(replica).split",
        "folders",
        "/train/0/source/split",
        "validation",
        Weights,
    ),
    row(
        "train[*].source(replica).folders",
        "folders",
        "/train/0/source/folders",
        r#"["test"]"#,
        Weights,
    ),
    row(
        "train[*].source(replica).segment",
        "language",
        "/train/0/source/segment",
        "other",
        Weights,
    )
    .with(&[(
        "/train/0/source",
        r#"{"type": "replica", "root": "DATA/replica", "class_names": "DATA/names.txt"}"#,
    )]),
    row("train[*].source(replica).exact", "folders", "/train/0/source/exact", "true", Weights),
    row(
        "train[*].source(replica).lang_feat",
        "folders",
        "/train/0/source/lang_feat",
        "false",
        Refused("lang_feat"),
    ),
    row(
        "train[*].source(replica).labelled_points",
        "folders",
        "/train/0/source/labelled_points",
        "true",
        Refused("labelled_points"),
    ),
    row(
        "train[*].source(replica).excluded_scenes",
        "folders",
        "/train/0/source/excluded_scenes",
        r#"["a"]"#,
        Weights,
    ),
    row("train[*].source(replica).limit", "folders", "/train/0/source/limit", "1", Weights),
    row(
        "train[*].source(replica).class_names",
        "language",
        "/train/0/source/class_names",
        "DATA/few.txt",
        Refused("7 classes"),
    )
    .with(&[(
        "/train/0/source",
        r#"{"type": "replica", "root": "DATA/replica", "class_names": "DATA/names.txt"}"#,
    )]),
    row(
        "train[*].source(replica).policy",
        "folders",
        "/train/0/source/policy",
        "strict",
        Refused("NaN"),
    )
    .with(&[("/train/0/source/root", "DATA/spoiled"), ("/train/0/source/folders", r#"["."]"#)]),
    row("train[*].transforms", "language", "/train/0/transforms", "validation", Weights),
    row(
        "train[*].labels",
        "segmentation",
        "/train/0/labels",
        r#"{"keep": {"share": 0.3}}"#,
        Weights,
    ),
    row("train[*].repeat", "language", "/train/0/repeat", "2", Weights),
    row("train[*].weight", "language", "/train/0/weight", "2", Weights),
    row("train[*].seed", "language", "/train/0/seed", "2", Weights),
    // Batches.
    row("loader.batch_size", "language", "/loader/batch_size", "1", Weights),
    row("loader.shuffle", "language", "/loader/shuffle", "false", Weights),
    row("loader.seed", "language", "/loader/seed", "5", Weights),
    row("loader.mix_probability", "language", "/loader/mix_probability", "1.0", Weights)
        .with(&[("/loader/mix_probability", "0.0")]),
    row("loader.mix_exact", "language", "/loader/mix_exact", "true", Weights)
        .with(&[("/loader/mix_probability", "1.0")]),
    row("loader.drop_last", "language", "/loader/drop_last", "false", Weights)
        .with(&[("/train/0/source/count", "5")]),
    row("loader.broken_scenes", "folders", "/loader/broken_scenes", "stop", Refused("NaN")).with(
        &[
            ("/loader/broken_scenes", "skip"),
            ("/train/1/source/root", "DATA/spoiled"),
            ("/train/1/source/policy", "strict"),
        ],
    ),
    row(
        "loader.workers",
        "language",
        "/loader/workers",
        "2",
        Nothing("batches depend neither on who makes them nor on when"),
    ),
    row(
        "loader.prefetch",
        "language",
        "/loader/prefetch",
        "2",
        Nothing("batches depend neither on who makes them nor on when"),
    ),
];
