//! `scenesplat codes`

use crate::error::refuse;
use crate::flags::Shared;
use crate::progress::interrupted;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::feature_codes::{CodeDirection, FeatureCodeReport, TrainedAutoencoder};
use scenesplat::scene::printable;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Turns the language features of scenes into codes by a trained autoencoder, or back with --decode:
/// writes a folder of .npy files for each scene, with all its arrays and lang_feat.npy in the other form,
/// and a receipt.
///
/// Training reads codes as any other language features: the term language_alignment learns them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The autoencoder: a model folder as `train` leaves one (autoencoder.json and weights).
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Scenes: folders of .npy files with lang_feat.npy. Each gets a folder of its name in --out.
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    /// Features from codes.
    #[arg(long)]
    pub decode: bool,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    let names = names(&args.scenes)?;
    let all = args.scenes.iter().chain([&args.model]);
    all.clone().try_for_each(|path| session.outputs.reads(path))?;
    session.outputs.open_folder(&[])?;
    let model = TrainedAutoencoder::read(&args.model)?;
    for path in model.files() {
        session.receipt.fingerprint("autoencoder", path)?;
    }
    let direction = if args.decode { CodeDirection::Decode } else { CodeDirection::Encode };
    let [from, to] = model.widths(direction);
    let what = if args.decode { "codes back to features" } else { "features to codes" };
    session.receipt.setting("widths", format!("{from} to {to}"), what);
    let _stage = session.receipt.stage("codes");
    for (scene, name) in args.scenes.iter().zip(&names) {
        let folder = session.outputs.inner_folder(name)?;
        let done = model.recode_scene(direction, scene, &folder, &mut |part| {
            session.progress.advance(name, part);
            !interrupted()
        });
        session.progress.finish();
        let report = done?;
        session.receipt.add_rows_in(report.rows);
        session.receipt.add_rows_out(report.rows);
        session.receipt.fingerprint("input", &scene.join("lang_feat.npy"))?;
        tell(&session, name, &report);
        note_files(&session, &folder)?;
    }
    drop(_stage);
    session.finish()
}

/// Names of the folders to write.
fn names(scenes: &[PathBuf]) -> Result<Vec<String>> {
    let (mut names, mut seen) = (Vec::new(), BTreeSet::new());
    for scene in scenes {
        // Also of `..` and of `scene/.`.
        let whole = scene.canonicalize().with_context(|| scene.display().to_string())?;
        let Some(name) = whole.file_name().and_then(|name| name.to_str()) else {
            refuse!("{}: its name is no text to call a folder by", scene.display());
        };
        if !seen.insert(name.to_owned()) {
            refuse!("{name}: two scenes have this name, and so would their folders");
        }
        names.push(name.to_owned());
    }
    Ok(names)
}

fn tell(session: &Session<'_>, name: &str, report: &FeatureCodeReport) {
    let name = printable(name);
    let mut text = format!("{name}: {} of {} rows", report.with_feature, report.rows);
    if let (Some(mean), Some(lowest)) = (report.mean_cosine, report.lowest_cosine) {
        text += &format!(
            "; cosine of a feature with what comes back: mean {mean:.4}, lowest {lowest:.4}"
        );
    }
    print(&text);
    let warn = |count: usize, what: &str| {
        if count > 0 {
            session.warn(format!(
                "{name}: {count} rows are marked as features and hold {what}; they have none now"
            ));
        }
    };
    warn(report.not_finite, "NaN or infinity");
    warn(report.zero, "zeros");
    if !report.left_out.is_empty() {
        let list: Vec<String> =
            report.left_out.iter().map(|name| printable(name).to_string()).collect();
        session.progress.say(format!("{name}: not copied, as no arrays: {}", list.join(", ")));
    }
}

fn note_files(session: &Session<'_>, folder: &Path) -> Result<()> {
    let listed = || format!("{}: cannot list the folder", folder.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(listed)? {
        let entry = entry.with_context(listed)?;
        files.push((entry.path(), entry.metadata().with_context(listed)?.len()));
    }
    files.sort();
    files.iter().for_each(|(path, bytes)| session.wrote(path, *bytes));
    Ok(())
}
