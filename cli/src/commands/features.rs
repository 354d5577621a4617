//! `scenesplat features`

use super::WrongUse;
use super::many::Many;
use crate::budget::{BudgetArgs, Chosen, Job, within_budget};
use crate::effects::EffectArgs;
use crate::flags::{Inference, Shared};
use crate::session::Session;
use anyhow::Result;
use clap::ArgAction;
use scenesplat::outputs::{
    FeatureType, ResultColumns, write_colored_ply, write_features_npy, write_features_safetensors,
    write_scene_preview,
};
use scenesplat::principal::principal_colors;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat_lab::compensation::Consumer;
use std::path::PathBuf;

/// Writes features.npy ([N, D], one row per Gaussian of the file), features.ply and preview.png
/// (coloured by the features' three principal components) and a receipt; with the setting codes=K
/// features.npy is [N, K], and feature_axes.npy, [K, D], leads back: features · axes.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The scene, in any format; several get a folder in --out each.
    #[arg(num_args = 1.., action = ArgAction::Append, required = false, required_unless_present = "manifest")]
    pub scene: PathBuf,
    /// Which of many scenes.
    #[command(flatten)]
    pub many: Many,
    /// Number type of the features.
    #[arg(long, value_enum, default_value_t = Dtype::F32)]
    pub dtype: Dtype,
    /// File format of the features.
    #[arg(long, value_enum, default_value_t = Format::Npy)]
    pub format: Format,
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

impl Args {
    /// The setting that a budget chooses, if there is one, and the flags with it.
    fn chosen(&self) -> Result<(Self, Option<Chosen>)> {
        let job = Job {
            command: "features",
            scene: &self.scene,
            inference: &self.inference,
            vote_k: None,
            features: None,
        };
        let (inference, chosen) = within_budget(&self.budget, self.shared.threads, &job)?;
        Ok((Self { inference, ..self.clone() }, chosen))
    }

    /// With the parts of the setting among the flags.
    fn settled(&self) -> Result<Self> {
        if self.inference.setting.as_ref().is_some_and(|setting| setting.k.is_some()) {
            let text = "--setting k: features have no labels that neighbours could vote on";
            return Err(WrongUse(text.to_owned()).into());
        }
        Ok(Self { inference: self.inference.settled(None)?.0, ..self.clone() })
    }
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let (args, chosen) = args.chosen()?;
    let args = &args.settled()?;
    let session = Session::start_with(&args.shared, &args.inference.network, line)?;
    session.note_setting(&args.inference);
    session.note_budget(chosen);
    session.outputs.reads(&args.scene)?;
    let wish = args.effects.wish(&session, true, false)?;
    let features_file = match args.format {
        Format::Npy => "features.npy",
        Format::Safetensors => "features.safetensors",
    };
    let mut names = vec![features_file, "features.ply", "preview.png"];
    names.extend(args.inference.effective.codes.map(|_| AXES));
    session.make_out(&names)?;
    let network = session.network(&args.inference)?;
    let opened = session.open(&args.scene, &args.inference)?;
    let scene = &opened.loaded.scene;
    let consumer = Consumer { network: true, labels: false };
    let about = session.compensation(&wish, scene, &args.inference, consumer)?;
    let features = session.encode(scene, &network, &args.inference, &about)?;
    drop(network);
    {
        let _stage = session.receipt.stage("write");
        let (path, bytes) = match args.format {
            Format::Npy => {
                let path = session.out(features_file)?;
                let bytes = write_features_npy(&opened, &features, args.dtype.into(), &path)?;
                (path, bytes)
            }
            Format::Safetensors => {
                let path = session.out(features_file)?;
                let bytes =
                    write_features_safetensors(&opened, &features, args.dtype.into(), &path)?;
                (path, bytes)
            }
        };
        session.wrote(&path, bytes);
        if let Some(codes) = features.codes() {
            let path = session.out(AXES)?;
            write_npy(&path, &[codes.codes(), codes.width], &codes.axes)?;
            session.wrote(&path, std::fs::metadata(&path)?.len());
        }
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    session.check_stop()?;
    let _stage = session.receipt.stage("picture");
    let colors = principal_colors(&features)?;
    let path = session.out("features.ply")?;
    let bytes = write_colored_ply(&opened, &colors, &ResultColumns::default(), &path)?;
    session.wrote(&path, bytes);
    let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
    let title = format!("{name}: features (principal components as colours)");
    let up = session.up(&opened.loaded.scene, &args.inference);
    let path = session.out("preview.png")?;
    let bytes = write_scene_preview(&opened.loaded.scene, &colors, &[], &title, up, &path)?;
    session.wrote(&path, bytes);
    drop(_stage);
    session.finish()
}
