//! Optimizer, schedules and the loop.

use super::Effect::{Files, Logged, Measured, Nothing, Recorded, Refused, Weights};
use super::{Case, row};

pub const CASES: &[Case] = &[
    // Optimizer and schedules.
    row("optimizer.lr", "language", "/optimizer/lr", "0.02", Weights),
    row("optimizer.weight_decay", "segmentation", "/optimizer/weight_decay", "0.5", Weights),
    row("optimizer.groups[*].keyword", "language", "/optimizer/groups/0/keyword", "norm", Weights),
    row("optimizer.groups[*].lr", "language", "/optimizer/groups/0/lr", "0.005", Weights),
    row(
        "optimizer.weight_decay_schedule.warmup",
        "language",
        "/optimizer/weight_decay_schedule/warmup",
        "0.9",
        Weights,
    ),
    row(
        "optimizer.weight_decay_schedule.warmup_from",
        "language",
        "/optimizer/weight_decay_schedule/warmup_from",
        "0.9",
        Weights,
    ),
    row(
        "optimizer.weight_decay_schedule.from",
        "language",
        "/optimizer/weight_decay_schedule/from",
        "0.9",
        Weights,
    ),
    row(
        "optimizer.weight_decay_schedule.to",
        "language",
        "/optimizer/weight_decay_schedule/to",
        "0.9",
        Weights,
    ),
    row("optimizer.adamw.beta1", "segmentation", "/optimizer/adamw/beta1", "0.5", Weights),
    row("optimizer.adamw.beta2", "segmentation", "/optimizer/adamw/beta2", "0.9", Weights),
    row("optimizer.adamw.eps", "segmentation", "/optimizer/adamw/eps", "0.001", Weights),
    row(
        "schedule(one_cycle).type",
        "language",
        "/schedule/type",
        "cosine",
        Refused("unknown field"),
    ),
    row("schedule(one_cycle).warmup", "language", "/schedule/warmup", "0.2", Weights),
    row("schedule(one_cycle).div_factor", "language", "/schedule/div_factor", "3.0", Weights),
    row(
        "schedule(one_cycle).final_div_factor",
        "language",
        "/schedule/final_div_factor",
        "2.0",
        Weights,
    ),
    row("schedule(one_cycle).min_beta1", "language", "/schedule/min_beta1", "0.5", Weights),
    row("schedule(one_cycle).max_beta1", "language", "/schedule/max_beta1", "0.99", Weights),
    row(
        "schedule(cosine).type",
        "segmentation",
        "/schedule/type",
        "one_cycle",
        Refused("unknown field"),
    ),
    row("schedule(cosine).warmup", "segmentation", "/schedule/warmup", "0.9", Weights),
    row("schedule(cosine).warmup_from", "segmentation", "/schedule/warmup_from", "0.5", Weights),
    row("schedule(cosine).from", "segmentation", "/schedule/from", "0.5", Weights),
    row("schedule(cosine).to", "segmentation", "/schedule/to", "0.6", Weights),
    // The loop.
    row("trainer.seed", "language", "/trainer/seed", "5", Weights),
    row("trainer.epochs", "language", "/trainer/epochs", "2", Weights),
    row("trainer.accumulate", "language", "/trainer/accumulate", "2", Weights),
    row(
        "trainer.sync_batch_norm",
        "language",
        "/trainer/sync_batch_norm",
        "true",
        Refused("accumulate = 1"),
    )
    .with(&[("/trainer/accumulate", "2")]),
    row("trainer.clip_norm", "language", "/trainer/clip_norm", "0.01", Weights),
    row("trainer.ema", "language", "/trainer/ema", "0.05", Weights),
    row("trainer.freeze", "language", "/trainer/freeze", r#"["embedding"]"#, Weights),
    row("trainer.log_every", "language", "/trainer/log_every", "2", Logged),
    row("trainer.eval_every", "language", "/trainer/eval_every", "2", Measured)
        .with(&[("/trainer/epochs", "2")]),
    row("trainer.recompute", "language", "/trainer/recompute", "true", Nothing("memory only")),
    row("trainer.idle", "language", "/trainer/idle", "[]", Refused("mask_token"))
        .with(&[("/trainer/idle", r#"["mask_token"]"#), ("/model/mask_token", "true")]),
    row("trainer.max_left_out", "folders", "/trainer/max_left_out", "0.001", Refused("left out"))
        .with(&[("/trainer/max_left_out", "1.0"), ("/train/1/source/root", "DATA/spoiled")]),
    row(
        "trainer.checkpoint.dir",
        "language",
        "/trainer/checkpoint/dir",
        "DATA/elsewhere",
        Refused("checkpoint.dir"),
    ),
    row(
        "trainer.checkpoint.every_steps",
        "language",
        "/trainer/checkpoint/every_steps",
        "5",
        Files,
    )
    .with(&[("/trainer/checkpoint/keep", "9"), ("/trainer/epochs", "4")]),
    row("trainer.checkpoint.keep", "language", "/trainer/checkpoint/keep", "2", Files)
        .with(&[("/trainer/epochs", "4")]),
    row("trainer.checkpoint.best", "language", "/trainer/checkpoint/best", "unseen/mIoU", Weights)
        .with(&[("/trainer/epochs", "4")]),
    row(
        "trainer.checkpoint.smaller_is_better",
        "language",
        "/trainer/checkpoint/smaller_is_better",
        "true",
        Weights,
    )
    .with(&[("/trainer/checkpoint/best", "unseen/mIoU"), ("/trainer/epochs", "4")]),
    row("trainer.health.every_steps", "language", "/trainer/health/every_steps", "1", Logged),
    row(
        "trainer.health.stop_after",
        "language",
        "/trainer/health/stop_after",
        "1",
        Refused("have collapsed"),
    )
    .with(&[
        ("/trainer/health/every_steps", "1"),
        ("/trainer/health/min_effective_rank", "1000.0"),
    ]),
    row(
        "trainer.health.min_effective_rank",
        "language",
        "/trainer/health/min_effective_rank",
        "1000.0",
        Recorded,
    ),
    row(
        "trainer.health.max_centred_cosine",
        "language",
        "/trainer/health/max_centred_cosine",
        "-2.0",
        Recorded,
    ),
    row(
        "trainer.health.min_running_var",
        "language",
        "/trainer/health/min_running_var",
        "1e9",
        Recorded,
    ),
    row(
        "trainer.health.max_running_var",
        "language",
        "/trainer/health/max_running_var",
        "1e-30",
        Recorded,
    ),
];
