//! What `convert` reads: one scene of all that it is given.

use super::Args;
use super::checks::check_source_frame;
use crate::error::refuse;
use crate::progress::{Progress, interrupted};
use anyhow::{Context, Result};
use scenesplat::input::{open_input, read_feature_rows};
use scenesplat::language_codes::compress_features;
use scenesplat::scene::edit::merge;
use scenesplat::scene::{GaussianScene, ReadOptions, SceneFormat, StatedUp};
use serde_json::json;

/// What is converted.
pub struct Source {
    /// The scene.
    pub scene: GaussianScene,
    /// What the first file says about up.
    pub stated_up: StatedUp,
    /// Whether all files say so themselves, unlike the conventions of their formats.
    pub says_up: bool,
    /// Rows of all files.
    pub source_rows: usize,
    /// Rows that cannot be used.
    pub dropped: usize,
    /// What was read, for --json.
    pub about: serde_json::Value,
}

/// Reads all scenes, makes one of them, and computes its language codes.
pub fn read(args: &Args, format: SceneFormat, progress: &Progress) -> Result<Source> {
    let options = ReadOptions {
        extra: true,
        lang_feat: args.language_code.is_some() || format == SceneFormat::NpyFolder,
        sh_rest: args.sh != Some(0),
        ..args.source.options()
    };
    let (mut scenes, mut about) = (Vec::new(), Vec::new());
    let (mut source_rows, mut dropped, mut kept) = (0, 0, None);
    let mut stated_up = None;
    let mut says_up = true;
    for (number, path) in args.from.iter().enumerate() {
        progress.advance("reading", number as f64 / args.from.len() as f64);
        let (opened, remark) = open_input(path, &options)?;
        progress.finish();
        let loaded = opened.loaded;
        if let Some(text) = remark {
            progress.say(text);
        }
        if !loaded.report.is_clean() || !loaded.report.notes.is_empty() {
            progress.say(format!("{}: {}", path.display(), loaded.report));
        }
        check_source_frame(args, path, loaded.kind)?;
        source_rows += loaded.source_rows();
        dropped += loaded.report.dropped_rows;
        about.push(json!({
            "path": path.display().to_string(),
            "format": if opened.converted { "points" } else { loaded.kind.name() },
            "gaussians": loaded.source_rows(),
            "read": loaded.report,
            "left_behind": loaded.unread,
        }));
        for left in &loaded.unread {
            progress.say(format!("{}: left behind: {} ({})", path.display(), left.name, left.kind));
        }
        let first = *stated_up.get_or_insert(loaded.stated_up);
        says_up &= first.source == StatedUp::COMMENT && loaded.stated_up == first;
        kept = loaded.kept_rows;
        scenes.push(loaded.scene);
    }
    let (mut scene, merged) = merge(scenes)?;
    for note in &merged.notes {
        progress.say(format!("merged: {note}"));
    }
    if let Some(k) = args.language_code {
        add_codes(args, k, source_rows, kept.as_deref(), &mut scene, progress)?;
    }
    let about = match about.len() {
        1 => about.remove(0),
        _ => json!({ "scenes": about, "gaussians": source_rows, "notes": merged.notes }),
    };
    let stated_up = stated_up.unwrap_or_default();
    Ok(Source { scene, stated_up, says_up, source_rows, dropped, about })
}

/// Makes codes from the features of the scene or of a file.
fn add_codes(
    args: &Args,
    k: usize,
    source_rows: usize,
    kept: Option<&[u32]>,
    scene: &mut GaussianScene,
    progress: &Progress,
) -> Result<()> {
    if let Some(path) = &args.features {
        if args.from.len() > 1 {
            refuse!("--features: has the rows of one scene; make the codes of each, then merge");
        }
        scene.lang_feat = Some(read_feature_rows(path, source_rows, kept)?);
        scene.valid_feat_mask = None;
    }
    let Some(features) = &scene.lang_feat else {
        refuse!("--language-code: the scene has no language features; give --features FILE.npy");
    };
    let valid = scene.valid_feat_mask.as_deref();
    let done = compress_features(features, valid, k, args.seed, &mut |done| {
        progress.advance("language codes", done);
        !interrupted()
    });
    progress.finish();
    let done = done.context("--language-code")?;
    if done.not_finite > 0 {
        progress
            .say(format!("{} features hold NaN or infinity and count as missing", done.not_finite));
    }
    progress.say(format!(
        "language codes of {k} numbers keep a mean cosine of {:.4} (lowest {:.4}) to {} features",
        done.mean_cosine, done.lowest_cosine, done.valid
    ));
    scene.lang_code = Some(done.code);
    Ok(())
}
