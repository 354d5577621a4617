//! `scenesplat prepare frames`

use crate::error::refuse;
use crate::flags::Shared;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::datasets::prepare::frames::{
    FrameLayout, FrameRead, Frames, PosedFrame, SkipReason, open_frames,
};
use scenesplat::memory::Bytes;
use scenesplat::scene::Camera;
use scenesplat::scene::formats::cameras::write_cameras_json;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Makes a posed folder of the frames of a benchmark's scan: cameras.json, images and depth, which optimise, curate,
/// collect-labels and lift-labels read. Pictures are copied as they are, depths become PNG of 16 bits in millimeters, and
/// the world stays that of the scan.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scan: its folder; of scannet also a .sens file.
    pub scan: PathBuf,
    /// How its files are laid out: scannet, scannetpp, arkitscenes, matterport3d, 3rscan, hypersim, replica, or rgbd.
    #[arg(long, value_name = "LAYOUT", value_parser = parse_layout)]
    pub layout: FrameLayout,
    /// Takes every Nth frame.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub every: u32,
    /// Most frames, spread evenly over those of --every.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_frames: Option<u32>,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

fn parse_layout(text: &str) -> Result<FrameLayout, String> {
    FrameLayout::ALL.into_iter().find(|layout| layout.name() == text).ok_or_else(|| {
        let names: Vec<&str> = FrameLayout::ALL.iter().map(|layout| layout.name()).collect();
        format!("{text:?} is no layout; there are: {}", names.join(", "))
    })
}

/// What became of the frames.
#[derive(Default)]
struct Tally {
    cameras: Vec<Camera>,
    skipped: Vec<(String, SkipReason)>,
    with_depth: usize,
    resampled: usize,
    too_far: usize,
    bytes: u64,
}

/// Runs the command.
pub(super) fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    session.outputs.reads(&args.scan)?;
    args.check_folder()?;
    let stage = session.receipt.stage("list");
    let mut frames = open_frames(&args.scan, args.layout)?;
    drop(stage);
    frames.notes().iter().for_each(|note| session.warn(note));
    session.outputs.open_folder(&["cameras.json", "frames.json"])?;
    let chosen = args.chosen(frames.len());
    let tally = write(&session, &mut frames, &chosen)?;
    tell(&session, args, &tally, frames.len(), chosen.len())?;
    session.write("cameras.json", |path| write_cameras_json(&tally.cameras, path))?;
    let text = serde_json::to_string_pretty(&tally.report(args, &frames, chosen.len()))? + "\n";
    session.write_text("frames.json", &text)?;
    session.receipt.setting("layout", args.layout.name(), "of the scan");
    session.receipt.setting("frames", tally.cameras.len(), "with a picture and a pose");
    session.finish()?;
    print(&next_command(&args.shared.out, tally.with_depth > 0));
    Ok(())
}

impl Args {
    /// Refuses an output folder whose pictures are another's, such as the scan's own.
    fn check_folder(&self) -> Result<()> {
        let out = &self.shared.out;
        let taken = ["images", "depth"].map(|name| out.join(name)).into_iter().find(|p| p.exists());
        if let Some(taken) = taken.filter(|_| !out.join("frames.json").is_file()) {
            let (out, taken) = (out.display(), taken.display());
            refuse!("--out {out}: {taken} is there and not of this command; give another folder");
        }
        Ok(())
    }

    /// Which of so many frames are read.
    fn chosen(&self, count: usize) -> Vec<usize> {
        let all: Vec<usize> = (0..count).step_by(self.every as usize).collect();
        match self.max_frames.map(|most| most as usize).filter(|most| *most < all.len()) {
            Some(most) => (0..most).map(|i| all[i * all.len() / most]).collect(),
            None => all,
        }
    }
}

/// Reads frames one by one and writes their pictures and depths.
fn write(session: &Session<'_>, frames: &mut Frames, chosen: &[usize]) -> Result<Tally> {
    let _stage = session.receipt.stage("frames");
    let images = session.outputs.inner_folder("images")?;
    let mut tally = Tally::default();
    for (done, &index) in chosen.iter().enumerate() {
        session.check_stop()?;
        session.progress.advance("frames", done as f64 / chosen.len() as f64);
        let frame = match frames.read(index)? {
            FrameRead::Frame(frame) => *frame,
            FrameRead::Skipped { name, reason } => {
                tally.skipped.push((name, reason));
                continue;
            }
        };
        let PosedFrame { camera, picture, depth } = frame;
        tally.bytes += put(&images, &camera.name, &picture)?;
        if let Some(depth) = depth {
            let folder = session.outputs.inner_folder("depth")?;
            let name = Path::new(&camera.name).with_extension("png");
            tally.bytes += put(&folder, name, &depth.picture.encode_png()?)?;
            tally.with_depth += 1;
            tally.resampled += usize::from(depth.resampled);
            tally.too_far += depth.too_far;
        }
        tally.cameras.push(camera);
    }
    session.progress.finish();
    session.receipt.add_bytes_written(tally.bytes);
    Ok(tally)
}

/// Writes a file of a folder that waits for its place; its size.
fn put(folder: &Path, name: impl AsRef<Path>, bytes: &[u8]) -> Result<u64> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).with_context(|| path.display().to_string())?;
    Ok(bytes.len() as u64)
}

impl Tally {
    /// How many frames were skipped for each reason.
    fn reasons(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for (_, reason) in &self.skipped {
            *counts.entry(reason.text()).or_default() += 1;
        }
        counts
    }

    fn report(&self, args: &Args, frames: &Frames, chosen: usize) -> serde_json::Value {
        let skipped = self.skipped.iter();
        let skipped: Vec<_> =
            skipped.map(|(name, why)| json!({ "frame": name, "reason": why.text() })).collect();
        json!({
            "scan": args.scan.display().to_string(),
            "layout": args.layout.name(),
            "frames": frames.len(),
            "chosen": chosen,
            "written": self.cameras.len(),
            "skipped_by_reason": self.reasons(),
            "skipped": skipped,
            "with_depth": self.with_depth,
            "depth_resampled": self.resampled,
            "depth_values_too_far": self.too_far,
            "depth_scale": 1000,
            "notes": frames.notes(),
        })
    }
}

/// Says what was read and what was not.
fn tell(
    session: &Session<'_>,
    args: &Args,
    tally: &Tally,
    all: usize,
    chosen: usize,
) -> Result<()> {
    let reasons = tally.reasons().into_iter().map(|(reason, count)| format!("{count}: {reason}"));
    let reasons = reasons.collect::<Vec<_>>().join(", ");
    let written = tally.cameras.len();
    anyhow::ensure!(
        written > 0,
        "{}: none of {chosen} frames can be used ({reasons}); is it the right folder and --layout?",
        args.scan.display()
    );
    session
        .progress
        .say(format!("{written} frames ({}) of {chosen} chosen, {all} in all", Bytes(tally.bytes)));
    if !reasons.is_empty() {
        session.warn(format!("{} frames were skipped ({reasons})", tally.skipped.len()));
    }
    let without = written - tally.with_depth;
    if without > 0 {
        session.warn(format!("{without} of {written} frames have no depth"));
    }
    if tally.resampled > 0 {
        session.warn(format!(
            "{} depths have a lens of their own: they were brought into the pixels of their pictures, each the \
             nearest",
            tally.resampled
        ));
    }
    if tally.too_far > 0 {
        session.warn(format!(
            "{} depths are 65.5 m or more, which 16 bits of millimeters do not hold: written as unknown",
            tally.too_far
        ));
    }
    Ok(())
}

/// What to run with the folder.
fn next_command(out: &Path, has_depth: bool) -> String {
    let word = |path: &Path| {
        let text = path.display().to_string();
        let plain = |c: char| c.is_alphanumeric() || "/\\._-:+@".contains(c);
        if text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
    };
    let at = |name: &str| word(&out.join(name));
    let depth = if has_depth { format!(" --depth {}", at("depth")) } else { String::new() };
    // Without a slash at its end.
    let mut made = out.components().as_path().as_os_str().to_owned();
    made.push("-scene");
    format!(
        "next: scenesplat optimise --cameras {} --images {}{depth} --out {}",
        at("cameras.json"),
        at("images"),
        word(Path::new(&made))
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_and_commands_quoted() {
        let args = |every, max_frames| Args {
            scan: "scan".into(),
            layout: FrameLayout::Rgbd,
            every,
            max_frames,
            shared: Shared::into_folder(Path::new("out"), true),
        };
        assert_eq!(args(1, None).chosen(3), [0, 1, 2]);
        assert_eq!(args(2, None).chosen(5), [0, 2, 4]);
        assert_eq!(args(2, Some(3)).chosen(20), [0, 6, 12]);
        assert_eq!(args(4, Some(9)).chosen(3), [0]);
        let next = next_command(Path::new("my scan"), true);
        assert!(next.contains("--images 'my scan/images' --depth 'my scan/depth'"), "{next}");
        assert!(next.ends_with("--out 'my scan-scene'"), "{next}");
        assert!(!next_command(Path::new("a"), false).contains("--depth"));
    }
}
