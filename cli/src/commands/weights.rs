//! `scenesplat weights`

use crate::flags::{BranchArg, ConvLayoutArg, Shared};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::models::convert::{Renamed, rename};
use scenesplat::models::weights::{Shapes, WeightFile, resolve, summarize};
use scenesplat::models::{Compute, LoadPolicy, ModelConfig};
use scenesplat::network::{
    Network, NetworkChoice, NetworkConfig, WeightOptions, Weights as Source, config_beside,
    network_of,
};
use std::path::PathBuf;

/// Values of the largest network that is built without a sign that it fits.
const LARGE: usize = 100_000_000;

/// Prints the files with their SHA-256, their entries, and which network they fit.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A .safetensors, .pth or .pt file, or a model folder.
    pub checkpoint: PathBuf,
    /// Lists every entry.
    #[arg(long)]
    pub list: bool,
    /// Writes the findings as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Half of a self-supervised checkpoint.
    #[arg(long, value_enum, default_value_t = BranchArg::Teacher)]
    pub branch: BranchArg,
    /// Layout of sparse convolutions in the checkpoint.
    #[arg(long, value_enum, default_value_t = ConvLayoutArg::Spconv2)]
    pub conv_layout: ConvLayoutArg,
    /// Which language head, of a checkpoint with several (projection.NAME.weight).
    #[arg(long, value_name = "NAME")]
    pub head: Option<String>,
    /// Asks about this network only: language, semseg, ssl, tiny, litept-s (-s-decoder, -b, -l) or a .toml file.
    #[arg(long, value_name = "NAME|FILE")]
    pub config: Option<NetworkChoice>,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    session.outputs.reads(&args.checkpoint)?;
    session.outputs.claim_any("--json", args.json.as_ref())?;
    let folder = resolve(&args.checkpoint)?;
    let files = folder.files.iter().map(|file| describe(&session, file, args));
    let files = files.collect::<Result<Vec<_>>>()?;
    let options = WeightOptions {
        policy: LoadPolicy::Partial,
        branch: args.branch.into(),
        conv_layout: args.conv_layout.into(),
        head: args.head.clone(),
    };
    let is_network = |shapes: &Shapes| ModelConfig::recognize(shapes).is_some();
    let shapes = options.clone().source(folder.files, is_network)?.shapes();

    let candidates: Vec<(String, NetworkConfig)> = match &args.config {
        Some(choice) => {
            let own = network_of(&Source::File(args.checkpoint.clone()), Some(choice), &options)?;
            vec![(choice.to_string(), own)]
        }
        None => match config_beside(&args.checkpoint)? {
            Some(own) => vec![("the folder's own".to_owned(), own)],
            None => NetworkChoice::NAMED
                .into_iter()
                .map(|(name, choice)| {
                    // Inputs of an unknown kind are no network of ours: the plain one says why.
                    let adapted = choice.resolve_for(&shapes).or_else(|_| choice.resolve())?;
                    Ok((name.to_owned(), adapted))
                })
                // Encoders of a gigabyte are not built to say that they do not fit.
                .filter(|candidate: &Result<(String, NetworkConfig)>| {
                    let Ok((_, config)) = candidate else { return true };
                    config.model.num_values() < LARGE || config.model.fits(&shapes)
                })
                .collect::<Result<_>>()?,
        },
    };
    let mut fits = Vec::new();
    for (name, mut config) in candidates {
        // Nothing is computed with it.
        let compute = config.model.backbone.get().compute();
        config.model = config.model.with_compute(Compute { fold: false, ..compute });
        match Network::load(config, &Source::File(args.checkpoint.clone()), options.clone()) {
            Ok(network) => {
                let report = network.report();
                let verdict = if report.is_complete() { "fits" } else { "does not fit" };
                print(&format!("{name}: {verdict}: {report}"));
                fits.push(serde_json::json!({ "network": name, "fits": report.is_complete(), "report": report }));
            }
            Err(e) => {
                print(&format!("{name}: does not fit: {e}"));
                fits.push(serde_json::json!({ "network": name, "fits": false }));
            }
        }
    }
    if let Some(path) = &args.json {
        let text =
            serde_json::to_string_pretty(&serde_json::json!({ "files": files, "networks": fits }))?;
        session.write_file(path, &text)?;
    }
    session.finish_quietly()
}

/// Prints what is in a file of weights, and gives it as JSON.
fn describe(session: &Session<'_>, file: &WeightFile, args: &Args) -> Result<serde_json::Value> {
    // Shapes in a pickle are only claims.
    let values = |shape: &[usize]| shape.iter().fold(1usize, |n, d| n.saturating_mul(*d));
    let values = file.entries().values().map(|e| values(&e.shape));
    let values = values.fold(0usize, usize::saturating_add);
    let sha256 = file.sha256()?;
    let bytes = std::fs::metadata(file.path()).map_or(0, |m| m.len());
    session.receipt.fingerprint_known("weights", file.path(), bytes, &sha256);
    print(&format!(
        "{}\n  sha256 {sha256}\n  {} tensors, {values} values, {} other entries",
        file.path().display(),
        file.entries().len(),
        file.skipped().len()
    ));
    if let Ok(top) = summarize(file.path()) {
        for (key, value) in top.iter().take(12) {
            print(&format!("  {key}: {}", serde_json::to_string(value)?));
        }
        if top.len() > 12 {
            print(&format!("  … {} more", top.len() - 12));
        }
    }
    if args.list {
        for (name, entry) in file.entries() {
            let ours = match rename(name, args.branch.into()) {
                Renamed::Weight(ours) if ours == *name => String::new(),
                Renamed::Weight(ours) => format!(" → {ours}"),
                Renamed::Ignored(origin) => format!(" (ignored: {origin})"),
            };
            print(&format!("  {name} {:?} {}{ours}", entry.shape, entry.dtype));
        }
    }
    Ok(serde_json::json!({
        "path": file.path(), "sha256": sha256, "entries": file.entries(),
        "skipped": file.skipped(), "values": values,
    }))
}
