//! `scenesplat reconstruct`

use super::render::parse_size;
use crate::error::refuse;
use crate::flags::{Shared, SourceArgs, parse_unit, parse_up};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::alignment::{Alignment, AlignmentSettings};
use scenesplat::preview::{Ceiling, Orbit, SceneRows, inside_views, write_png};
use scenesplat::reconstruction::{
    Reconstruction, ReconstructionPicture, ReconstructionPictures, ReconstructionRun,
};
use scenesplat::scene::{Camera, GaussianScene, LoadedScene, ReadOptions, Up};
use serde_json::json;
use std::path::PathBuf;

/// Size of each of the three pictures.
const SIZE: [u32; 2] = [640, 480];
/// Angle of view from inside, degrees.
const FOV: f64 = 75.0;

/// Masks parts of a scene as self-supervised training did, and draws what the network reconstructs: for
/// each camera NAME.png, the scene, what is left of it and the reconstruction from left to right; figures
/// in reconstruction.json.
///
/// The run has the term masked_gaussians. The network reads a Gaussian a voxel; all Gaussians of a masked
/// voxel get what is reconstructed for it, where they are. Colors do not depend on the direction.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The folder of the run, as `train --out` left it: heads are in its checkpoints, not in model/.
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Which patches are masked.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Number of cameras around the scene. [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=360))]
    pub orbit: Option<u16>,
    /// Number of cameras that look around from a free place inside the scene: for rooms.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=360))]
    pub inside: Option<u16>,
    /// Size of each of the three pictures. [default: 640x480]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Which way is up in the scene; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// What one unit of the scene is: m, cm, mm, km or a number of meters; judged by the scene if not
    /// given.
    #[arg(long, value_name = "UNIT|METRES", value_parser = parse_unit)]
    pub unit: Option<f64>,
    /// The network reads the scene as it is: neither turned nor scaled.
    #[arg(long, conflicts_with = "unit")]
    pub as_is: bool,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Cameras, and what would stand before them.
struct Look {
    cameras: Vec<Camera>,
    ceiling: Option<Ceiling>,
    near: Option<f64>,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    [&args.run, &args.scene].into_iter().try_for_each(|path| session.outputs.reads(path))?;
    session.outputs.open_folder(&["reconstruction.json"])?;
    let run = {
        let _stage = session.receipt.stage("weights");
        ReconstructionRun::open(&args.run)?
    };
    let receipt = &session.receipt;
    receipt.setting("checkpoint", &run.checkpoint, "of the run, whose student and head are used");
    receipt.setting("seed", args.seed, "which patches are masked");
    receipt.setting("masking", format!("{:?}", run.masking()), "as at that step");
    let options = ReadOptions { sh_rest: false, ..args.source.options() };
    let LoadedScene { scene, stated_up, .. } = session.open_with(&args.scene, &options)?.loaded;
    let settings = AlignmentSettings {
        up: args.up,
        stated_up,
        metres_per_unit: args.unit,
        as_is: args.as_is,
        ..AlignmentSettings::default()
    };
    let alignment = Alignment::of(&scene, &settings);
    session.tell_alignment(&alignment, args.as_is);
    let scene = alignment.apply(&scene);
    let made = {
        let _stage = session.receipt.stage("network");
        run.reconstruct(&scene, args.seed)?
    };
    session.check_stop()?;
    let up = if args.as_is { alignment.up.direction } else { Up::PLUS_Z };
    let look = look(&scene, up, args)?;
    let _stage = session.receipt.stage("render");
    let pictures = ReconstructionPictures::new(&scene, &made, look.ceiling, look.near)?;
    let mut drawn = Vec::new();
    for (k, camera) in look.cameras.iter().enumerate() {
        session.check_stop()?;
        session.progress.advance("render", k as f64 / look.cameras.len() as f64);
        let picture = pictures.draw(camera)?;
        session.write(&format!("{}.png", camera.name), |path| write_png(path, &picture.picture))?;
        drawn.push((camera.name.clone(), picture));
    }
    session.progress.finish();
    drop(_stage);
    tell(&run, &made, &drawn, &session)?;
    session.finish()
}

fn look(scene: &GaussianScene, up: Up, args: &Args) -> Result<Look> {
    let size = args.size.unwrap_or(SIZE);
    let color = vec![[0; 3]; scene.len()];
    let sizes = SceneRows::of(scene);
    let rows = sizes.rows(scene, &color);
    let mut all = Look { cameras: Vec::new(), ceiling: None, near: None };
    if let Some(count) = args.inside {
        if args.orbit.is_some() {
            refuse!(
                "--inside and --orbit: what is cut away for the one is seen by the other; \
                        give one of them"
            );
        }
        all.cameras = inside_views(&rows, up, count.into(), FOV, size);
        anyhow::ensure!(!all.cameras.is_empty(), "the scene has no Gaussian to stand among");
        return Ok(all);
    }
    let orbit = Orbit::around(&rows, up, args.orbit.unwrap_or(2).into(), size);
    Ok(Look { cameras: orbit.cameras, ceiling: orbit.ceiling, near: orbit.near })
}

fn tell(
    run: &ReconstructionRun,
    made: &Reconstruction,
    drawn: &[(String, ReconstructionPicture)],
    session: &Session<'_>,
) -> Result<()> {
    let [voxels, masked] = made.voxels;
    print(&format!("{}: {masked} of {voxels} voxels are masked", run.checkpoint));
    for (channel, error) in &made.errors {
        print(&format!("  {channel:?}: mean absolute difference {error:.4}"));
    }
    let db = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.2} dB"));
    for (name, picture) in drawn {
        print(&format!(
            "  {name}: {} masked pixels, reconstruction {}, holes {}",
            picture.masked_pixels,
            db(picture.psnr),
            db(picture.psnr_of_holes)
        ));
    }
    let errors: serde_json::Map<String, serde_json::Value> = made
        .errors
        .iter()
        .map(|(channel, error)| (format!("{channel:?}").to_lowercase(), json!(error)))
        .collect();
    let pictures: Vec<_> = drawn
        .iter()
        .map(|(name, p)| {
            json!({
                "name": name, "masked_pixels": p.masked_pixels, "psnr": p.psnr,
                "psnr_of_holes": p.psnr_of_holes
            })
        })
        .collect();
    let report = json!({
        "checkpoint": run.checkpoint, "step": run.step, "masking": run.masking(), "voxels": voxels,
        "masked_voxels": masked, "mean_absolute_difference": errors, "pictures": pictures
    });
    let text = serde_json::to_string_pretty(&report)? + "\n";
    session.write_text("reconstruction.json", &text)?;
    Ok(())
}
