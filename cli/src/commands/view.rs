//! `scenesplat view`

use super::WrongUse;
use super::labelled::{LabelArgs, Labelled, frame};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::embedded;
use scenesplat::memory::Bytes;
use scenesplat::page::{PageInput, PageSettings, write_page};
use std::path::{Path, PathBuf};

/// Writes one HTML file to look at a scene and to query it: it opens from disk in any browser with WebGL 2, without a
/// server, and loads nothing from anywhere.
///
/// Labels, objects and language codes are those of segment and objects, or with --label-names the scene's own labels;
/// typed phrases are answered in the page (docs/view.md).
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Where labels come from.
    #[command(flatten)]
    pub labels: LabelArgs,
    /// The page.
    #[arg(long, value_name = "FILE.html", default_value = "scene.html")]
    pub out: PathBuf,
    /// Shows the Gaussians alone: no labels, no network.
    #[arg(long, conflicts_with_all = ["label_names", "features"])]
    pub plain: bool,
    /// Numbers of a language code of a Gaussian, 1 to 32.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u8).range(1..=32))]
    pub codes: u8,
    /// Keeps so many Gaussians, those that are seen most.
    #[arg(long, value_name = "N")]
    pub max_splats: Option<usize>,
    /// Threads; all cores by default. Results do not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Also writes what was done and what it cost as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub receipt: Option<PathBuf>,
    /// Says nothing about the progress, and prints no receipt; results are still printed.
    #[arg(long)]
    pub quiet: bool,
}

/// From this size on browsers take long to open a page.
const LARGE: u64 = 150 << 20;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let (labels, vote_k) = &args.labels.settled()?;
    let shared = args.shared();
    let session = Session::start_with(&shared, &labels.inference.network, line)?;
    session.note_setting(&labels.inference);
    labels.claim_inputs(&session)?;
    session.outputs.claim("--out", &args.out)?;
    let name = labels.scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let settings = PageSettings { codes: usize::from(args.codes), max_splats: args.max_splats };
    if settings.max_splats == Some(0) {
        return Err(WrongUse("--max-splats: give a number above 0".to_owned()).into());
    }
    let labelled = if args.plain {
        plain(labels, &session)?
    } else {
        labels.label(&session, *vote_k, false)?
    };
    let frame = frame(&labelled.opened, &labels.inference);
    let found = match args.plain {
        true => None,
        false => Some(labelled.objects(&session, &labels.settings(), labels.pieces, frame)?),
    };
    session.check_stop()?;
    // Of the width of the texts, which --text vocabulary:D sets.
    let vocabulary = match labelled.is_vocabulary {
        true => Some(labels.classes.vocabulary()?.map_or_else(embedded::vocabulary, Ok)?),
        false => None,
    };
    let remarks = remarks(args, &labelled);
    let _stage = session.receipt.stage("page");
    let input = PageInput {
        title: &name,
        scene: &labelled.opened.loaded.scene,
        labels: (!args.plain).then_some(&labelled.labels[..]),
        scores: labelled.scores.as_deref(),
        names: &labelled.names,
        catalogue: found.as_ref(),
        features: labelled.features.as_ref().map(|(features, text)| (features, text)),
        vocabulary: vocabulary.as_ref(),
        up: frame.0,
        metres_per_unit: frame.1,
        remarks: &remarks,
    };
    let waiting = session.outputs.file_path(&args.out)?;
    let report = write_page(&waiting, &input, &settings)?;
    session.wrote(&waiting, report.bytes);
    session.receipt.add_rows_out(report.gaussians);
    let codes = report.code_cosine.map_or(String::new(), |c| {
        format!(", {} code numbers a Gaussian (mean cosine {c:.4})", args.codes)
    });
    let left_out = match report.left_out {
        0 => String::new(),
        n => format!(", {n} Gaussians left out"),
    };
    print(&format!(
        "{}: {} Gaussians, {}{codes}{left_out}; positions to {:.1e} units; opens from disk",
        args.out.display(),
        report.gaussians,
        Bytes(report.bytes),
        report.position_step / 2.0
    ));
    if report.bytes > LARGE {
        let text =
            "the page is large for a browser: --max-splats N or fewer --codes make it smaller";
        session.progress.say(text);
        session.receipt.warning(text);
    }
    drop(_stage);
    session.finish_quietly()
}

/// The Gaussians without labels.
fn plain(labels: &LabelArgs, session: &Session<'_>) -> Result<Labelled> {
    if let Some(flag) =
        labels.inference.network_flag().filter(|f| !["--unit", "--as-is"].contains(f))
    {
        return Err(WrongUse(format!("{flag} is about a network, which --plain leaves out")).into());
    }
    if labels.inference.network.weights.is_some() || labels.inference.network.config.is_some() {
        return Err(WrongUse(
            "--plain runs no network: leave out --weights and --config".to_owned(),
        )
        .into());
    }
    let opened = session.open_with(&labels.scene, &labels.inference.source.options())?;
    Ok(Labelled {
        opened,
        labels: Vec::new(),
        scores: None,
        names: Vec::new(),
        features: None,
        is_vocabulary: false,
        is_own: false,
        remark: "",
    })
}

/// What a reader of the page has to know.
fn remarks(args: &Args, labelled: &Labelled) -> Vec<String> {
    let mut out = Vec::new();
    if !labelled.remark.is_empty() {
        out.push("Seeded weights: labels, scores and answers mean nothing.".to_owned());
    }
    if !args.plain {
        let from = match (&args.labels.label_names, labelled.is_own) {
            (Some(_), _) => "Labels: those that the scene carries.",
            (None, true) => {
                "Labels: a small network trained on synthetic rooms; it knows a closed set of classes (assets/embedded/README.md)."
            }
            (None, false) => "Labels: the network or features that were given.",
        };
        out.push(from.to_owned());
    }
    out.push("Colors are those of the zeroth harmonic, seen from every side alike.".to_owned());
    out
}

impl Args {
    fn shared(&self) -> crate::flags::Shared {
        let folder =
            self.out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        crate::flags::Shared {
            threads: self.threads,
            out: folder.to_owned(),
            receipt: self.receipt.clone(),
            quiet: self.quiet,
        }
    }
}
