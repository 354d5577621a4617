//! `scenesplat features`

use super::answer::certainty;
use super::many::OneOrMany;
use crate::budget::{BudgetArgs, Job, within_budget};
use crate::effects::{EffectArgs, Wish};
use crate::error::refuse;
use crate::flags::{Inference, PreviewArgs, Shared};
use crate::receipt::thousands;
use crate::session::Session;
use anyhow::Result;
use scenesplat::SceneFeatures;
use scenesplat::outputs::{
    FeatureType, OpenedScene, ResultColumns, write_colored_ply, write_features_npy,
    write_features_safetensors,
};
use scenesplat::principal::principal_colors;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat_lab::compensation::Consumer;
use std::path::Path;

/// Writes features.npy ([N, D], one row per Gaussian of the file), features.ply and preview.png
/// (colored by the features' three principal components) and a receipt; with the setting codes=K
/// features.npy is [N, K], and feature_axes.npy, [K, D], leads back: features · axes.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Which scenes.
    #[command(flatten)]
    pub input: OneOrMany,
    /// Number type of the features.
    #[arg(long, value_enum, default_value_t = Dtype::F32)]
    pub dtype: Dtype,
    /// File format of the features.
    #[arg(long, value_enum, default_value_t = Format::Npy)]
    pub format: Format,
    /// The picture.
    #[command(flatten)]
    pub preview: PreviewArgs,
    /// What the setting is chosen by.
    #[command(flatten)]
    pub budget: BudgetArgs,
    /// What is done about effects of the capture.
    #[command(flatten)]
    pub effects: EffectArgs,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Number type of written features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Dtype {
    /// 4 bytes a value.
    F32,
    /// 2 bytes a value, rounded to nearest.
    F16,
}

impl From<Dtype> for FeatureType {
    fn from(dtype: Dtype) -> Self {
        match dtype {
            Dtype::F32 => Self::F32,
            Dtype::F16 => Self::F16,
        }
    }
}

/// File format of written features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// `features.npy`, `[N, D]`.
    Npy,
    /// `features.safetensors` with the tensor `features`, `[N, D]`.
    Safetensors,
}

/// Where the directions are written that short features are coordinates along.
const AXES: &str = "feature_axes.npy";

/// Opens the scene and runs the network over it.
pub fn encode(
    session: &Session<'_>,
    scene: &Path,
    inference: &Inference,
    wish: &Wish,
) -> Result<(OpenedScene, SceneFeatures)> {
    let network = session.network(inference)?;
    let opened = session.open(scene, inference)?;
    let consumer = Consumer { network: true, labels: false };
    let about = session.compensation(wish, &opened, inference, consumer)?;
    let features = session.encode(&opened, &network, inference, &about)?;
    Ok((opened, features))
}

/// Refuses what features have no use for.
pub fn check(inference: &Inference) -> Result<()> {
    if inference.setting.as_ref().is_some_and(|setting| setting.k.is_some()) {
        refuse!("--setting k: features have no labels that neighbors could vote on");
    }
    Ok(())
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    check(&args.inference)?;
    let job = Job {
        command: "features",
        scene: &args.input.scene,
        inference: &args.inference,
        vote_k: None,
        features: None,
    };
    let (inference, _, chosen) = within_budget(&args.budget, args.shared.running.threads, &job)?;
    let session = Session::start_network(&args.shared, &inference, chosen, line)?;
    session.outputs.reads(&args.input.scene)?;
    let wish = args.effects.wish(&session, true, false)?;
    let features_file = match args.format {
        Format::Npy => "features.npy",
        Format::Safetensors => "features.safetensors",
    };
    let mut names = vec![features_file, "features.ply", "preview.png"];
    names.extend(inference.effective.codes.map(|_| AXES));
    session.outputs.open_folder(&names)?;
    let (opened, features) = encode(&session, &args.input.scene, &inference, &wish)?;
    let scene = &opened.loaded.scene;
    {
        let _stage = session.receipt.stage("write");
        let dtype = args.dtype.into();
        session.write(features_file, |path| match args.format {
            Format::Npy => write_features_npy(&opened, &features, dtype, path),
            Format::Safetensors => write_features_safetensors(&opened, &features, dtype, path),
        })?;
        if let Some(codes) = features.codes() {
            let shape = [codes.codes(), codes.width];
            session.write(AXES, |path| write_npy(path, &shape, &codes.axes))?;
        }
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    session.check_stop()?;
    let stage = session.receipt.stage("picture");
    let colors = principal_colors(&features)?;
    session.write("features.ply", |path| {
        let columns = ResultColumns { warnings: &session.doubts(), ..ResultColumns::default() };
        write_colored_ply(&opened, &colors, &columns, path)
    })?;
    let name = args.input.name();
    let title = format!("{name}: features (principal components as colors)");
    let up = session.up(&opened, &inference);
    session.write_preview(scene, &colors, &[], title, up, args.preview)?;
    drop(stage);
    let (rows, width) = (thousands(opened.loaded.source_rows() as u64), features.width());
    session.tell(format!("{name}: {rows} rows of {width} values in {features_file}"));
    certainty(&session).iter().for_each(|text| session.tell(text));
    session.finish()
}
