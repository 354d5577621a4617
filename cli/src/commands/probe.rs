//! `scenesplat probe`

use crate::error::refuse;
use crate::flags::{Running, SourceArgs};
use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::{Context, Result};
use scenesplat::datasets::{DataError, DataSource, SourceScene, SyntheticRooms};
use scenesplat::network::{WeightOptions, Weights, network_of};
use scenesplat::probe::{
    LabelRegime, ObjectSet, ProbeKind, ProbeReport, ProbeResult, ProbeScenes, ProbeSettings, probe,
    read_file,
};
use scenesplat::rooms::SyntheticRoomSettings;
use scenesplat::scene::ReadOptions;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Asks what a network has learned: trains a small classifier on its rows, which stay as they are.
///
/// Reads all scales of the encoder at every voxel of the first scenes, learns their classes, and scores
/// the labels of the last ones, every Gaussian by its voxel. Beside it the same for the same network
/// with values that nobody trained, and for what it reads (with the height above the ground): a network
/// that learned something beats both.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The network: a model folder as `train` leaves one, or weights that are known by their shapes.
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Scenes with labels, two or more: files, folders of .npy files, or synthetic:COUNT:SEED for rooms
    /// that are made on the spot. Or objects:FOLDER alone: single objects, one label a file, in CLASS/train/FILE and
    /// CLASS/test/FILE or train/CLASS/FILE and test/CLASS/FILE.
    #[arg(required = true, value_name = "SCENE|synthetic:COUNT:SEED|objects:FOLDER")]
    pub scenes: Vec<String>,
    /// What stands on the rows.
    #[arg(long, value_enum, default_value_t = Kind::Linear)]
    pub kind: Kind,
    /// Labels to learn from: all, a part such as 1% or 10% of those of each scene, or so many of each.
    #[arg(long, value_name = "all|PERCENT%|COUNT", default_value = "all", value_parser = regime)]
    pub labels: LabelRegime,
    /// How many of the last scenes are scored; the others are learned from. [default: a quarter]
    #[arg(long, value_name = "N")]
    pub test: Option<usize>,
    /// Steps of AdamW.
    #[arg(long, value_name = "N", default_value_t = 500)]
    pub steps: u64,
    /// Largest learning rate.
    #[arg(long, value_name = "RATE", default_value_t = 0.005)]
    pub lr: f64,
    /// Weight decay.
    #[arg(long, value_name = "DECAY", default_value_t = 0.02)]
    pub weight_decay: f64,
    /// Seed of the probe, of the labels it learns from and of the untrained network.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Leaves out the probe on objects (mean rows of instances).
    #[arg(long)]
    pub no_objects: bool,
    /// Also writes the figures as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// How scenes are read.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

/// What stands on the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// One linear layer.
    Linear,
    /// Three linear layers.
    Mlp3,
    /// A decoder as networks have one, over the frozen encoder; what is read is probed by three linear
    /// layers then.
    Decoder,
}

impl From<Kind> for ProbeKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Linear => Self::Linear,
            Kind::Mlp3 => Self::Mlp3,
            Kind::Decoder => Self::Decoder,
        }
    }
}

fn regime(text: &str) -> Result<LabelRegime, String> {
    let wrong = || format!("{text:?}: write all, a part such as 10%, or a count such as 20");
    if text == "all" {
        return Ok(LabelRegime::All);
    }
    match text.strip_suffix('%') {
        Some(percent) => {
            let percent: f64 = percent.parse().map_err(|_| wrong())?;
            Ok(LabelRegime::Share(percent / 100.0))
        }
        None => text.parse().map(LabelRegime::PerScene).map_err(|_| wrong()),
    }
}

/// The scenes of the command line, one after the other.
struct Given {
    ids: Vec<String>,
    places: Vec<Place>,
    options: ReadOptions,
}

enum Place {
    File(PathBuf),
    Room(Arc<SyntheticRooms>, String),
}

impl Given {
    fn new(scenes: &[String], options: ReadOptions) -> Result<Self> {
        let (mut ids, mut places) = (Vec::new(), Vec::new());
        for scene in scenes {
            let Some(rest) = scene.strip_prefix("synthetic:") else {
                ids.push(scene.clone());
                places.push(Place::File(scene.into()));
                continue;
            };
            let numbers = rest.split_once(':').and_then(|(count, seed)| {
                let count = count.parse::<usize>().ok().filter(|c| (1..=10_000).contains(c))?;
                Some((count, seed.parse().ok()?))
            });
            let Some((count, seed)) = numbers else {
                refuse!("{scene:?}: write synthetic:COUNT:SEED, such as synthetic:20:7");
            };
            let rooms = SyntheticRooms::new(count, SyntheticRoomSettings::default(), seed)?;
            let rooms = Arc::new(rooms);
            for id in rooms.scene_ids() {
                ids.push(format!("{scene}/{id}"));
                places.push(Place::Room(Arc::clone(&rooms), id.clone()));
            }
        }
        for (i, id) in ids.iter().enumerate() {
            if ids[..i].contains(id) {
                refuse!("{id}: is there twice");
            }
        }
        Ok(Self { ids, places, options })
    }
}

impl DataSource for Given {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let unknown = || DataError::UnknownScene { id: id.to_owned(), known: self.ids.len() };
        let index = self.ids.iter().position(|known| known == id).ok_or_else(unknown)?;
        match &self.places[index] {
            Place::Room(rooms, id) => rooms.load(id),
            Place::File(path) => read_file(id, path, &self.options),
        }
    }
}

/// The folder of a set of objects, if that is what is probed.
fn object_folder(args: &Args) -> Result<Option<&Path>> {
    let mut folders = args.scenes.iter().filter_map(|scene| scene.strip_prefix("objects:"));
    let Some(folder) = folders.next() else { return Ok(None) };
    if args.scenes.len() > 1 {
        refuse!("objects:{folder}: a set of objects is probed alone");
    }
    if args.test.is_some() {
        refuse!("--test: a set of objects has its own, in the folders named test");
    }
    if args.no_objects {
        refuse!("--no-objects: nothing would be left to say about objects:{folder}");
    }
    Ok(Some(Path::new(folder)))
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let progress = Progress::start(&args.running)?;
    let weights = Weights::File(args.model.clone());
    let config = network_of(&weights, None, &WeightOptions::default())?;
    let (given, test): (Arc<dyn DataSource>, _) = match object_folder(args)? {
        Some(folder) => {
            let objects = ObjectSet::open(folder, args.source.options())?;
            progress.say(format!("classes: {}", objects.classes().join(", ")));
            let test = objects.test();
            (Arc::new(objects), Some(test))
        }
        None => (Arc::new(Given::new(&args.scenes, args.source.options())?), args.test),
    };
    let scenes = ProbeScenes::new(given, config.model.grid_size, test)?;
    let settings = ProbeSettings {
        kind: args.kind.into(),
        labels: args.labels,
        steps: args.steps,
        lr: args.lr,
        weight_decay: args.weight_decay,
        seed: args.seed,
        objects: !args.no_objects,
    };
    let report = probe(&args.model, &scenes, &settings, &mut |text| {
        progress.say(text);
        !interrupted()
    })?;
    tell(&report);
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&report)?;
        write_text(path, &text).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// Prints the table.
fn tell(report: &ProbeReport) {
    print(&format!(
        "{} classes; learned from {} of {} labeled voxels of {} scenes, scored on {} scenes",
        report.classes,
        report.learned_rows,
        report.labelled_rows,
        report.train_scenes.len(),
        report.test_scenes.len()
    ));
    print(&format!(
        "{:12} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "", "width", "mIoU", "mAcc", "allAcc", "objects", "seconds"
    ));
    let percent =
        |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{:.2}", v * 100.0));
    let line = |name: &str, r: &ProbeResult| {
        print(&format!(
            "{name:12} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8.1}",
            r.width,
            percent(r.miou),
            percent(r.macc),
            percent(r.all_acc),
            percent(r.objects.and_then(|o| o.mean_accuracy)),
            r.seconds
        ));
    };
    line("backbone", &report.backbone);
    line("random", &report.random);
    line("raw inputs", &report.raw_inputs);
}
