//! `scenesplat demo`

use super::answer::next;
use super::segment;
use crate::outputs::withdraw;
use crate::progress::interrupted;
use crate::terminal::print;
use anyhow::{Context, Result, anyhow};
use clap::Parser;
use scenesplat::evaluation::background;
use scenesplat::metrics::{SceneTruth, Scores, VoteRule};
use scenesplat::outputs::{label_colors, legend, write_scene_preview};
use scenesplat::preview::PreviewSettings;
use scenesplat::rooms::{CLASSES, SyntheticRoomSettings, generate};
use scenesplat::scene::atomic_file::check_replaceable;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{FolderLock, LabelSet, Up};
use std::path::PathBuf;

/// Rooms of this seed are in no training configuration of the project.
const UNSEEN: u64 = 0x5EED;

/// Labels a furnished room that the network inside the program has never seen, and compares with the
/// truth. Needs no file. Writes room.ply, and what `segment` writes; truth.png is the picture of the
/// true classes, to be seen beside preview.png.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which room: any number.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub room: u64,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    pub out: PathBuf,
    /// Says nothing about the progress, and prints no receipt; results are still printed.
    #[arg(long)]
    pub quiet: bool,
}

/// A command line of `segment`, without the program's name.
#[derive(Debug, Parser)]
#[command(no_binary_name = true)]
struct Line {
    #[command(flatten)]
    args: segment::Args,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    // The labeling takes it again.
    drop(FolderLock::acquire(&args.out)?);
    for name in ["room.ply", "truth.png"] {
        check_replaceable(&args.out.join(name))?;
    }
    let settings =
        SyntheticRoomSettings { seed: UNSEEN, room: args.room, ..SyntheticRoomSettings::default() };
    let room = generate(&settings)?;
    let path = args.out.join("room.ply");
    // From here on the receipt of another room would be wrong.
    withdraw(&args.out.join("receipt.json"))?;
    write_inria_ply(&room.scene, &[], &path)?;

    let out = args.out.to_string_lossy();
    let mut words = vec![path.to_string_lossy().into_owned(), "--out".into(), out.clone().into()];
    if args.quiet {
        words.push("--quiet".into());
    }
    segment::label(&Line::try_parse_from(&words)?.args, line).map_err(|error| {
        if interrupted() { anyhow!("stopped; only {} was written", path.display()) } else { error }
    })?;

    let truth = room.scene.segment.as_deref().context("a room has labels")?;
    let labels = NpyFile::open(&args.out.join("labels.npy"))?.read_i64()?;
    let labels: Vec<i32> = labels.into_iter().map(|label| label as i32).collect();
    let names: Vec<String> = CLASSES.iter().map(|c| c.name.to_owned()).collect();
    let report = {
        let known = SceneTruth::new(&room.scene.coord, Some(truth), None, names.len())?;
        let known = known.context("a room has labels")?;
        let background = background(&LabelSet::new(names.clone())?);
        let mut scores = Scores::new(names.len(), &background)?;
        // The labels were voted on already.
        scores.add_labels(&known, labels, &VoteRule::of(1))?;
        scores.model.tester_report()
    };
    let picture = args.out.join("truth.png");
    let entries = legend(truth, &names);
    let title = "room.ply: truth".to_owned();
    let settings = PreviewSettings { title, up: Up::PLUS_Z, ..PreviewSettings::default() };
    write_scene_preview(&room.scene, &label_colors(truth), &entries, &settings, &picture)?;
    print(&format!(
        "{:?} with {} objects: {} of the labeled Gaussians right, f-mIoU {} on this room",
        room.kind,
        room.objects.len(),
        percent(report.all_accuracy),
        percent(report.foreground_mean_iou)
    ));
    print(&format!("look at {out}/preview.png beside {out}/truth.png"));
    print(&next(&path, &["query SCENE \"chair\"", "objects SCENE", "view SCENE"]));
    Ok(())
}

fn percent(share: Option<f64>) -> String {
    share.map_or("none".to_owned(), |s| format!("{:.1} %", 100.0 * s))
}
