//! `scenesplat simulate`

use crate::flags::{PreviewArgs, Shared, SourceArgs, parse_up};
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Result, bail};
use scenesplat::datasets::effects::{EffectSet, simulate_upright};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::{ReadOptions, Up, guess_up};
use std::path::PathBuf;

/// Does to a scene what a bad capture would have done: writes simulated.ply, source_rows.npy (the row
/// of the file that each Gaussian comes from, −1 for added ones), preview.png and a receipt.
///
/// Lengths are meters. Language features have no place in a PLY file; codes go along.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// What, and how strong from 0 to 5: holes, floaters, surface, blur, glass, light,
    /// noise; or none.
    #[arg(long, value_name = "NAME=SEVERITY,…")]
    pub effect: EffectSet,
    /// Which of the possible damages.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Which way is up: for glass, and in the picture. [default: what inspect finds]
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// The picture.
    #[command(flatten)]
    pub preview: PreviewArgs,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    session.outputs.reads(&args.scene)?;
    session.outputs.open_folder(&["simulated.ply", "source_rows.npy", "preview.png"])?;
    let options = ReadOptions { sh_rest: true, ..args.source.options() };
    let opened = session.open_with(&args.scene, &options)?;
    let scene = &opened.loaded.scene;
    let found = {
        let _stage = session.receipt.stage("simulate");
        session.receipt.setting("effect", args.effect, "what is done to the scene");
        session.receipt.setting("seed", args.seed, "which of the possible damages");
        simulate_upright(scene, &args.effect, args.seed, args.up)?
    };
    for done in &found.done {
        let text = format!("{}={}: {}", done.effect.name(), done.severity, done.text);
        print(&text);
        session.receipt.setting(done.effect.name(), done.severity, &done.text);
    }
    if found.done.is_empty() {
        print("no effect: the scene is written as it was read");
    }
    if found.scene.is_empty() {
        bail!("{}: nothing is left of the scene", args.scene.display());
    }
    if scene.lang_feat.is_some() {
        session.warn("language features are left out: a PLY file has no place for them");
    }
    session.check_stop()?;
    {
        let _stage = session.receipt.stage("write");
        session.write("simulated.ply", |path| write_inria_ply(&found.scene, &[], path))?;
        let kept = opened.loaded.kept_rows.as_deref();
        let in_file = |row: &usize| kept.map_or(*row as i64, |kept| i64::from(kept[*row]));
        let rows: Vec<i64> =
            found.source.iter().map(|row| row.as_ref().map_or(-1, in_file)).collect();
        session.write("source_rows.npy", |path| write_npy(path, &[rows.len()], &rows))?;
        session.receipt.add_rows_out(found.scene.len());
    }
    {
        let _stage = session.receipt.stage("picture");
        let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
        let colors: Vec<[u8; 3]> =
            (0..found.scene.len()).map(|row| found.scene.color_u8(row)).collect();
        let up = args.up.unwrap_or_else(|| guess_up(scene, opened.loaded.stated_up).direction);
        let title = format!("{name}: {}", args.effect);
        session.write_preview(&found.scene, &colors, &[], title, up, args.preview)?;
    }
    session.finish()
}
