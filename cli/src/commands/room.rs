//! `scenesplat room`

use super::{Cli, adapt};
use crate::error::refuse;
use crate::flags::Shared;
use crate::receipt::sha256_of;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use clap::Parser;
use scenesplat::datasets::prepare::frames::{FrameLayout, open_frames};
use scenesplat::scene::atomic_file::AtomicFile;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// What the stages were made of; written after each.
const STATE: &str = "room.json";
/// What is left in the output folder, and from which stage.
const RESULTS: [(&str, &str); 3] =
    [("scene.ply", "scene"), ("labels.npy", "labels"), ("objects.json", "objects")];
const PAGE: &str = "room.html";

/// From the frames of a room to a room that one can ask: a scene of Gaussians, a label for each, objects and a page. Runs
/// prepare frames, optimise, with --detector also collect-labels, then segment, objects and view, each in a folder of its own
/// below --out, and leaves scene.ply, labels.npy, objects.json and room.html.
///
/// A run that was stopped goes on with the stage at which it was; a stage is made anew if what it is made of has changed.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The frames: a scan in one of the layouts of prepare frames, or a folder with cameras.json, images and, where there is
    /// depth, depth.
    pub frames: PathBuf,
    /// The layout of a scan, as in prepare frames; found by its files if not given.
    #[arg(long, value_name = "LAYOUT")]
    pub layout: Option<String>,
    /// Most frames, spread evenly.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_frames: Option<u32>,
    /// Steps of optimise. More make better pictures and rougher surfaces, on which labels are worse (docs/room.md).
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    pub steps: u32,
    /// Gaussians of the scene, at first and at most.
    #[arg(long, value_name = "N", default_value_t = 200_000, value_parser = clap::value_parser!(u32).range(1..))]
    pub gaussians: u32,
    /// A detector, as in collect-labels: what it finds in the photos overrules the network. Without it the network alone
    /// labels the scene.
    #[arg(long, value_name = "FILE.json")]
    pub detector: Option<PathBuf>,
    /// The network learns what the detector found, as adapt teaches it, before it labels the scene.
    #[arg(long, requires = "detector")]
    pub adapt: bool,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// One command of the program.
struct Stage {
    /// Its folder below --out.
    name: &'static str,
    words: Vec<String>,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    session.outputs.reads(&args.frames)?;
    let inputs = args.inputs()?;
    let mut stages = args.frames_stage()?.into_iter().collect::<Vec<_>>();
    let posed =
        if stages.is_empty() { args.frames.clone() } else { args.shared.out.join("frames") };
    let labels_from = stages.len() + args.scene_stages(&posed).len();
    let count = labels_from + 3;
    session.outputs.open_folder(&[&RESULTS.map(|(name, _)| name)[..], &[PAGE]].concat())?;
    // Stages lie beside the results, where the next run finds them.
    let out = &args.shared.out;
    let before = read_state(&out.join(STATE), &inputs);
    let mut done: Vec<Value> = Vec::new();
    let mut anew = false;
    for number in 0..count {
        session.check_stop()?;
        if number == stages.len() {
            // Whether frames have depth is known when they are there, and how the scene lies when the network learned it.
            let further = match number < labels_from {
                true => args.scene_stages(&posed),
                false => args.label_stages()?,
            };
            stages.extend(further);
        }
        let stage = &stages[number];
        let folder = out.join(stage.name);
        let known = before.get(number).filter(|known| known["command"] == json!(stage.words));
        anew |= known.is_none() || !folder.join("receipt.json").is_file();
        if let (false, Some(known)) = (anew, known) {
            session.progress.say(format!(
                "{} of {}: {}, done before",
                number + 1,
                count,
                stage.name
            ));
            done.push(known.clone());
            continue;
        }
        session.progress.say(format!("{} of {}: {}", number + 1, count, stage.name));
        let began = std::time::Instant::now();
        {
            let _stage = session.receipt.stage(stage.name);
            // `view` writes a file into a folder that is there.
            std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            let words = std::iter::once("scenesplat".to_owned()).chain(stage.words.iter().cloned());
            let command = Cli::try_parse_from(words).context("a stage of room")?.command;
            command
                .run(&stage.words.join(" "))
                .with_context(|| format!("room, stage {}", stage.name))?;
        }
        done.push(json!({ "stage": stage.name, "command": stage.words, "seconds": began.elapsed().as_secs_f64() }));
        let state = json!({ "inputs": inputs, "stages": done });
        AtomicFile::write(&out.join(STATE), serde_json::to_string_pretty(&state)?.as_bytes())?;
    }
    for (name, stage) in RESULTS {
        let from = out.join(stage).join(name);
        session.write(name, |path| std::fs::copy(&from, path).map(drop))?;
    }
    session.write(PAGE, |path| std::fs::copy(out.join("page").join(PAGE), path).map(drop))?;
    for stage in &done {
        let name = format!("stage/{}", stage["stage"].as_str().unwrap_or_default());
        session.receipt.setting(
            &name,
            format!("{:.1} s", stage["seconds"].as_f64().unwrap_or(0.0)),
            &words(stage),
        );
    }
    session.finish()?;
    print(&format!("open {} in a browser; then ask:", out.join(PAGE).display()));
    let mut words = vec![text(&out.join("scene.ply"))];
    words.extend(args.labelling()?);
    print(&format!("  scenesplat objects {} --find \"chair\"", words.join(" ")));
    Ok(())
}

/// The command of a stage as one line.
fn words(stage: &Value) -> String {
    let words = stage["command"].as_array().into_iter().flatten().filter_map(Value::as_str);
    words.collect::<Vec<_>>().join(" ")
}

/// The stages of an earlier run, if it was made of the same.
fn read_state(path: &Path, inputs: &Value) -> Vec<Value> {
    let state =
        std::fs::read(path).ok().and_then(|text| serde_json::from_slice::<Value>(&text).ok());
    let same = state.filter(|state| state["inputs"] == *inputs);
    same.and_then(|state| state["stages"].as_array().cloned()).unwrap_or_default()
}

impl Args {
    /// Checksums of what the stages are made of.
    fn inputs(&self) -> Result<Value> {
        let hash = |path: &Path| sha256_of(path).map(|(hash, _)| hash);
        let detector = self.detector.as_deref().map(hash).transpose()?;
        Ok(json!({
            "version": env!("CARGO_PKG_VERSION"),
            "frames": hash(&self.frames)?,
            "detector": detector,
        }))
    }

    /// Whether the frames are posed pictures already.
    fn is_posed(&self) -> bool {
        self.frames.join("cameras.json").is_file() && self.frames.join("images").is_dir()
    }

    /// The layout of the scan.
    fn layout(&self) -> Result<String> {
        if let Some(layout) = &self.layout {
            return Ok(layout.clone());
        }
        let fits = |layout: &FrameLayout| open_frames(&self.frames, *layout).is_ok();
        let fitting: Vec<&str> =
            FrameLayout::ALL.into_iter().filter(fits).map(|layout| layout.name()).collect();
        match &*fitting {
            [one] => Ok((*one).to_owned()),
            [] => {
                let names: Vec<&str> =
                    FrameLayout::ALL.iter().map(|layout| layout.name()).collect();
                refuse!(
                    "{}: is no scan in a layout that is read ({}), and no folder with cameras.json and images; --layout says \
                     which it should be, and prepare frames what it lacks",
                    self.frames.display(),
                    names.join(", ")
                )
            }
            several => refuse!(
                "{}: may be {}; say which with --layout",
                self.frames.display(),
                several.join(" or ")
            ),
        }
    }

    /// What makes posed pictures of a scan; none if they are that already.
    fn frames_stage(&self) -> Result<Option<Stage>> {
        if self.is_posed() {
            if self.layout.is_some() || self.max_frames.is_some() {
                let frames = self.frames.display();
                refuse!("--layout and --max-frames are about scans; {frames} has cameras.json");
            }
            return Ok(None);
        }
        let mut words: Vec<String> = ["prepare", "frames"].map(str::to_owned).into();
        words.extend([text(&self.frames), "--layout".into(), self.layout()?]);
        if let Some(most) = self.max_frames {
            words.extend(["--max-frames".into(), most.to_string()]);
        }
        words.extend(["--out".into(), self.inner("frames")]);
        Ok(Some(Stage { name: "frames", words: self.with_running(words) }))
    }

    /// What makes a scene of the frames, which are in the folder `posed`, and what is learned of it.
    fn scene_stages(&self, posed: &Path) -> Vec<Stage> {
        let flag = |flag: &str, path: &Path| [flag.to_owned(), text(path)];
        let mut pictures = flag("--cameras", &posed.join("cameras.json")).to_vec();
        pictures.extend(flag("--images", &posed.join("images")));
        if posed.join("depth").is_dir() {
            pictures.extend(flag("--depth", &posed.join("depth")));
        }
        let mut words = vec!["optimise".to_owned()];
        words.extend(pictures.clone());
        for (flag, value) in
            [("--initial", self.gaussians), ("--cap", self.gaussians), ("--steps", self.steps)]
        {
            words.extend([flag.to_owned(), value.to_string()]);
        }
        if posed.join("depth").is_dir() {
            words.extend(["--init", "depth"].map(str::to_owned));
        }
        words.extend(["--out".to_owned(), self.inner("scene")]);
        let mut stages = vec![Stage { name: "scene", words: self.with_running(words) }];
        let Some(detector) = &self.detector else { return stages };
        let mut words = vec!["collect-labels".to_owned(), self.inner("scene/scene.ply")];
        words.extend(pictures);
        words.extend(["--teacher".to_owned(), "detector".to_owned()]);
        words.extend(flag("--detector", detector));
        words.extend(["--out".to_owned(), self.inner("taught")]);
        stages.push(Stage { name: "taught", words: self.with_running(words) });
        if self.adapt {
            let mut words = vec!["adapt".to_owned(), self.inner("scene/scene.ply")];
            words.extend(["--labels".to_owned(), self.inner("taught")]);
            // What lies there of other frames is of no use.
            words.extend(["--anew".to_owned(), "--out".to_owned(), self.inner("adapted")]);
            stages.push(Stage { name: "adapted", words: self.with_running(words) });
        }
        stages
    }

    /// What comes of the scene.
    fn label_stages(&self) -> Result<Vec<Stage>> {
        let (scene, labelling) = (self.inner("scene/scene.ply"), self.labelling()?);
        let stage = |name: &'static str, command: &str, out: &str, more: &[String]| {
            let mut words = vec![command.to_owned(), scene.clone()];
            words.extend(labelling.clone());
            words.extend(["--out".to_owned(), self.inner(out)]);
            words.extend_from_slice(more);
            Stage { name, words: self.with_running(words) }
        };
        let receipt = ["--receipt".to_owned(), self.inner("page/receipt.json")];
        Ok(vec![
            stage("labels", "segment", "labels", &[]),
            stage("objects", "objects", "objects", &[]),
            stage("page", "view", &format!("page/{PAGE}"), &receipt),
        ])
    }

    /// Flags of what labels the scene.
    fn labelling(&self) -> Result<Vec<String>> {
        let mut words = Vec::new();
        if self.detector.is_some() {
            words.extend(["--taught".to_owned(), self.inner("taught")]);
        }
        if self.adapt {
            words.extend(["--weights".to_owned(), self.inner("adapted")]);
            words.extend(["--text".to_owned(), "vocabulary".to_owned()]);
            words.extend(adapt::flags(&self.shared.out.join("adapted"))?);
        }
        Ok(words)
    }

    /// A file or folder below --out.
    fn inner(&self, name: &str) -> String {
        text(&self.shared.out.join(name))
    }

    /// With the flags of all commands.
    fn with_running(&self, mut words: Vec<String>) -> Vec<String> {
        if self.shared.running.quiet {
            words.push("--quiet".to_owned());
        }
        if let Some(threads) = self.shared.running.threads {
            words.extend(["--threads".to_owned(), threads.to_string()]);
        }
        words
    }
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
