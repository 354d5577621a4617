//! What an adaptation in a folder is of: whether a command goes on with it.

use super::Args;
use crate::error::refuse;
use crate::receipt::sha256_of;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::adaptation::Folders;
use scenesplat::network::Weights;
use scenesplat::scene::AtomicFile;
use serde_json::{Value, json};
use std::path::Path;

/// What the training in the folder is of.
const STATE: &str = "adapt.json";

/// Notes what the training in the folder is of. One of the same is gone on with; one of something else is removed where the user
/// said so.
pub fn begin(args: &Args, session: &Session<'_>, folders: &Folders) -> Result<()> {
    let (path, run) = (folders.out().join(STATE), folders.run());
    let inputs = inputs(args)?;
    let before = std::fs::read(&path).ok().and_then(|text| serde_json::from_slice(&text).ok());
    if run.exists() && before.as_ref() != Some(&inputs) {
        if !args.anew {
            refuse!(
                "{}: holds an adaptation of {}; give another --out, or --anew to remove it",
                args.shared.out.display(),
                before.as_ref().and_then(|was| differing(was, &inputs)).unwrap_or("something else")
            );
        }
        session.warn(format!("{}: the training of something else is removed", run.display()));
        std::fs::remove_dir_all(&run).with_context(|| run.display().to_string())?;
    } else if run.exists() {
        session.progress.say("the training in the folder is gone on with");
    }
    AtomicFile::write(&path, serde_json::to_string_pretty(&inputs)?.as_bytes())?;
    Ok(())
}

/// Checksums and settings that decide the result.
fn inputs(args: &Args) -> Result<Value> {
    let hash = |path: &Path| sha256_of(path).map(|(hash, _)| hash);
    let of = |path: &Option<std::path::PathBuf>| path.as_deref().map(hash).transpose();
    let weights = match &args.weights {
        Weights::File(path) => hash(path)?,
        _ => scenesplat::embedded::sha256(),
    };
    Ok(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "scene": hash(&args.scene)?,
        "segment_name": args.source.segment_name,
        "labels": hash(&args.labels)?,
        "label_names": of(&args.label_names)?,
        "class_map": of(&args.class_map)?,
        "weights": weights,
        "settings": args.settings(),
        "up": args.up.map(|up| up.to_string()),
        "unit": args.unit,
    }))
}

/// What of an earlier adaptation was another.
fn differing(before: &Value, now: &Value) -> Option<&'static str> {
    const PARTS: [(&str, &str); 6] = [
        ("scene", "another scene"),
        ("labels", "other labels"),
        ("label_names", "other names of labels"),
        ("class_map", "other names of labels"),
        ("weights", "another network"),
        ("settings", "other settings"),
    ];
    PARTS.into_iter().find(|(part, _)| before[part] != now[part]).map(|(_, what)| what)
}
