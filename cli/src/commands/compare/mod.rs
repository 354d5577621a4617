//! `scenesplat compare`

mod evaluations;
mod measure;
mod pictures;
mod scatter;
mod table;

use crate::error::refuse;
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::terminal::{check_warnings, print, write_text};
use anyhow::{Context, Result};
use clap::ValueEnum;
use evaluations::Comparison;
use measure::{Measured, Summary, measure};
use scenesplat::models::Lpips;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Compares two pictures, PNG or JPEG, or those of two folders by their names without ending. The
/// first is the render, the second the truth. 16-bit gray pictures are depth, all others color.
///
/// Two evaluations (`evaluation.json`, or the output folders of `evaluate`) are compared by class and by scene.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A PNG or JPEG file, or a folder of such; or an evaluation.json, or a folder with one.
    pub a: PathBuf,
    /// What it should be.
    pub b: PathBuf,
    /// What to measure; all by default.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAME,…")]
    pub metrics: Vec<MetricArg>,
    /// Weights of LPIPS, AlexNet or VGG16, as one safetensors file; without them it is left out.
    #[arg(long, value_name = "FILE")]
    pub lpips_weights: Option<PathBuf>,
    /// Steps per unit in 16-bit pictures of depth: 1000 for millimeters.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0)]
    pub depth_scale: f64,
    /// Also writes all numbers as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Of two evaluations: draws each class and scene here, the first to the right, the second upward.
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Says nothing about the progress.
    #[arg(long)]
    pub quiet: bool,
}

/// A metric of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MetricArg {
    /// Peak signal-to-noise ratio.
    Psnr,
    /// Structural similarity, with each treatment of the border.
    Ssim,
    /// Perceptual distance.
    Lpips,
    /// Mean absolute error of depth.
    Depth,
}

impl Args {
    /// Whether a metric is asked for.
    fn wants(&self, metric: MetricArg) -> bool {
        self.metrics.is_empty() || self.metrics.contains(&metric)
    }
}

/// What is said where the distance cannot be computed.
const NO_LPIPS: &str = "LPIPS skipped: weights not found (give them with --lpips-weights)";

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    if !(args.depth_scale.is_finite() && args.depth_scale > 0.0) {
        refuse!("--depth-scale {}: must be above 0", args.depth_scale);
    }
    let outputs = Outputs::new(Path::new(""));
    outputs.reads_any([Some(args.a.as_path()), Some(&args.b), args.lpips_weights.as_deref()])?;
    outputs.claim_any("--json", args.json.as_ref())?;
    outputs.claim_any("--picture", args.picture.as_ref())?;
    if let Some(comparison) = evaluations::find(&args.a, &args.b)? {
        return tell(args, &comparison, &outputs);
    }
    if args.picture.is_some() {
        refuse!("--picture is for two evaluations; {} is none", args.a.display());
    }
    let progress = Progress::new(args.quiet);
    let pairs = pictures::pairs(&args.a, &args.b)?;
    let lpips = match &args.lpips_weights {
        Some(path) if args.wants(MetricArg::Lpips) => {
            Some(Lpips::load(path).context("LPIPS: the weights cannot be used")?)
        }
        _ => None,
    };
    let mut measured = Vec::new();
    for (k, pair) in pairs.iter().enumerate() {
        if interrupted() {
            return Err(scenesplat::inference::EncodeError::Stopped.into());
        }
        progress.advance("compare", k as f64 / pairs.len() as f64);
        measured.push(measure(args, pair, lpips.as_ref())?);
    }
    progress.finish();
    let summary = Summary::of(&measured);
    let no_lpips = args.wants(MetricArg::Lpips) && lpips.is_none();
    print(&table::table(&measured, &summary));
    if no_lpips {
        print(NO_LPIPS);
    }
    if let Some(path) = &args.json {
        let net = lpips.as_ref().map(|l| l.net().name());
        let note = no_lpips.then_some(NO_LPIPS);
        write_text(path, &report(&measured, &summary, net, note)?)?;
    }
    Ok(())
}

/// Prints and writes what two evaluations say.
fn tell(args: &Args, comparison: &Comparison, outputs: &Outputs) -> Result<()> {
    if !args.metrics.is_empty() || args.lpips_weights.is_some() {
        refuse!("--metrics and --lpips-weights are for pictures, not for evaluations");
    }
    print(&comparison.table());
    let progress = Progress::new(args.quiet);
    for remark in &comparison.remarks {
        progress.warn(remark);
    }
    if let Some(path) = &args.picture {
        outputs.file(path, &scatter::scatter(comparison).to_picture().encode_png()?)?;
    }
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&comparison.json())? + "\n";
        outputs.file(path, text.as_bytes())?;
    }
    check_warnings()?;
    outputs.commit(None)
}

fn report(
    measured: &[Measured],
    summary: &Summary,
    net: Option<&str>,
    note: Option<&str>,
) -> Result<String> {
    let report = json!({
        "images": measured,
        "mean": summary,
        "lpips_net": net,
        "lpips_note": note,
    });
    Ok(serde_json::to_string_pretty(&report)? + "\n")
}
