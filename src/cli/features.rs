//! `scenesplat features`

use super::common::{Inference, Session, Shared};
use crate::outputs::{
    FeatureFormat, FeatureType, ResultColumns, write_colored_ply, write_features_npy,
    write_features_safetensors, write_scene_preview,
};
use crate::principal::principal_colors;
use anyhow::Result;
use std::path::PathBuf;

/// Writes features.npy ([N, D], one row per Gaussian of the file), features.ply and preview.png
/// (coloured by the features' three principal components) and a receipt.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A .ply file or a folder of .npy files.
    pub scene: PathBuf,
    /// Number type of the features.
    #[arg(long, value_enum, default_value_t = FeatureType::F32)]
    pub dtype: FeatureType,
    /// File format of the features.
    #[arg(long, value_enum, default_value_t = FeatureFormat::Npy)]
    pub format: FeatureFormat,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    session.make_out()?;
    let network = session.network(&args.inference)?;
    let opened = session.open(&args.scene, &args.inference)?;
    let features = session.encode(&opened.loaded.scene, &network, &args.inference)?;
    drop(network);
    {
        let _stage = session.receipt.stage("write");
        let (path, bytes) = match args.format {
            FeatureFormat::Npy => {
                let path = session.out("features.npy");
                let bytes = write_features_npy(&opened, &features, args.dtype, &path)?;
                (path, bytes)
            }
            FeatureFormat::Safetensors => {
                let path = session.out("features.safetensors");
                let bytes = write_features_safetensors(&opened, &features, args.dtype, &path)?;
                (path, bytes)
            }
        };
        session.wrote(&path, bytes);
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    session.check_stop()?;
    let _stage = session.receipt.stage("picture");
    let colors = principal_colors(&features)?;
    let path = session.out("features.ply");
    let bytes = write_colored_ply(&opened, &colors, &ResultColumns::default(), &path)?;
    session.wrote(&path, bytes);
    let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
    let title = format!("{name}: features (principal components as colours)");
    let up = session.up(&opened.loaded.scene, &args.inference);
    let path = session.out("preview.png");
    let bytes = write_scene_preview(&opened.loaded.scene, &colors, &[], &title, up, &path)?;
    session.wrote(&path, bytes);
    drop(_stage);
    session.finish()
}
