//! `scenesplat evaluate`

use super::WrongUse;
use super::segment::Classes;
use crate::flags::{Inference, Shared};
use crate::session::Session;
use crate::terminal::{print, write_text};
use anyhow::{Context, Result};
use scenesplat::Network;
use scenesplat::datasets::{DataSource, SourceScene, SyntheticRooms};
use scenesplat::labels::{self, label_gaussians};
use scenesplat::metrics::{
    ConfusionMatrix, Fault, FeatureSlice, Metric, OracleCheck, OracleVote, TesterReport,
    UnknownRule, classify, keep_withheld, random_labels, vote,
};
use scenesplat::outputs::OpenedScene;
use scenesplat::rooms::{CLASSES, SyntheticClass, SyntheticRoomSettings};
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::label_set::{find_name, read_names};
use scenesplat::scene::{ClassMap, GaussianScene, LabelSet, LoadedScene, SceneFormat, TextTable};
use scenesplat::text::{class_list, text_rows};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Labels scenes and compares with their own labels; prints and writes evaluation.json.
///
/// Before anything is reported, the truth itself goes through the same chain (each point gets the
/// text of its own class as its feature). If that oracle falls short of its analytic value by a
/// single point, the evaluation is refused.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes with labels: .ply files, folders of .npy files, or synthetic:COUNT:SEED for rooms that
    /// are made on the spot.
    #[arg(required = true, value_name = "SCENE|synthetic:COUNT:SEED")]
    pub scenes: Vec<String>,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Names of the labels in the scenes, one a line or as JSON; if not given, labels are rows of
    /// --text.
    #[arg(long, value_name = "FILE")]
    pub label_names: Option<PathBuf>,
    /// Which class of --text each label name means (TOML or JSON); labels without one are ignored.
    #[arg(long, value_name = "FILE")]
    pub class_map: Option<PathBuf>,
    /// Classes left out of f-mIoU and f-mAcc, comma-separated.
    /// [default: those of wall, floor, ceiling that exist]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub exclude: Option<Vec<String>>,
    /// Lets only Gaussians vote that have a collected language feature (valid_feat_mask), as the
    /// original does; its numbers then depend on where labels were collected.
    #[arg(long)]
    pub vote_valid_only: bool,
    /// "oracle", or features made before (.npy, [N, D]; one scene only) instead of a network.
    #[arg(long, value_name = "oracle|FILE.npy")]
    pub features: Option<String>,
    /// Neighbours that vote on each label; 0 or 1 for no vote.
    #[arg(long, value_name = "K", default_value_t = 25)]
    pub vote_k: usize,
    /// Spoils this row of the oracle with the text of another class, to see the refusal.
    #[arg(long, value_name = "ROW")]
    pub break_oracle: Option<usize>,
    /// Also writes the figures as JSON here: f_miou, f_macc, miou, macc, per_class, oracle, seconds.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// The points that a scene is scored on.
struct Truth {
    /// Class of each Gaussian, −1 = none.
    gaussians: Vec<i32>,
    /// Other points to score, if the scene has some, with their classes.
    points: Option<(Vec<[f32; 3]>, Vec<i32>)>,
}

fn truth(
    scene: &GaussianScene,
    to_text: Option<&[i32]>,
    classes: usize,
    path: &std::path::Path,
) -> Result<Truth> {
    let map = |labels: &[i32]| -> Result<Vec<i32>> {
        labels
            .iter()
            .enumerate()
            .map(|(row, &l)| {
                let known = to_text.map_or(classes, <[i32]>::len);
                match usize::try_from(l) {
                    Err(_) => Ok(-1),
                    Ok(l) if l < known => Ok(to_text.map_or(l as i32, |m| m[l])),
                    Ok(l) => anyhow::bail!(
                        "{}: row {row} has label {l}, but there are only {known} names; give the \
                         names with --label-names",
                        path.display()
                    ),
                }
            })
            .collect()
    };
    let gaussians = match &scene.segment {
        Some(labels) => map(labels)?,
        None => vec![-1; scene.len()],
    };
    let points = match &scene.labelled_points {
        Some(p) => match &p.segment {
            Some(labels) => Some((p.coord.clone(), map(labels)?)),
            None => None,
        },
        None => None,
    };
    if points.is_none() && gaussians.iter().all(|l| *l < 0) {
        anyhow::bail!(
            "{}: no point has a label of a known class; nothing to evaluate (choose the labels with \
             --segment-name, the classes with --class-map)",
            path.display()
        );
    }
    Ok(Truth { gaussians, points })
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let began = Instant::now();
    let session = Session::start_with(&args.shared, &args.inference.network, line)?;
    args.scenes.iter().try_for_each(|scene| session.outputs.reads(Path::new(scene)))?;
    args.classes.claim_inputs(&session.outputs)?;
    let features = args.features.as_deref().map(Path::new);
    session.outputs.reads_any([
        args.label_names.as_deref(),
        args.class_map.as_deref(),
        features,
    ])?;
    session.outputs.claim_any("--json", args.json.as_ref())?;
    let inputs = inputs(&args.scenes)?;
    let from_file = args.features.as_deref().filter(|f| *f != "oracle").map(PathBuf::from);
    let oracle_only = args.features.as_deref() == Some("oracle");
    if from_file.is_some() && inputs.len() > 1 {
        return Err(
            WrongUse("--features FILE holds the features of one scene only".to_owned()).into()
        );
    }
    let network =
        if args.features.is_none() { Some(session.network(&args.inference)?) } else { None };
    let text = match &network {
        Some(network) if network.is_classifier() => classes_of(network, args)?,
        _ => args.classes.text_table(args.inference.network.is_embedded())?,
    };
    let set = LabelSet::new(text.names.clone())?;
    let excluded = match &args.exclude {
        Some(names) => class_list(&set, names)?,
        None => ["wall", "floor", "ceiling"].iter().filter_map(|n| set.index_of(n).ok()).collect(),
    };
    let options = args.classes.options(&set)?;
    // What a threshold withheld stays unknown; rows without a usable feature may be filled.
    let withholds = options.unknown != UnknownRule::default();
    let to_text = label_map(args, &text.names)?;
    let table = text_rows(&text)?;
    session.make_out(&["evaluation.json"])?;
    args.classes.record(&session)?;
    session.receipt.setting("vote_k", args.vote_k, "neighbours that vote on each label");
    let names: Vec<&str> = excluded.iter().map(|&c| text.names[c].as_str()).collect();
    session.receipt.setting("exclude", names.join(","), "left out of f-mIoU and f-mAcc");

    let classes = text.names.len();
    let matrix = || -> Result<ConfusionMatrix> {
        Ok(ConfusionMatrix::new(classes)?.with_excluded(&excluded)?)
    };
    let (mut oracle, mut random, mut model) = (matrix()?, matrix()?, matrix()?);
    for input in &inputs {
        let opened = input.open(&session, &args.inference)?;
        let (scene, path) = (&opened.loaded.scene, opened.loaded.path.as_path());
        let own = input.labels(&text.names)?;
        let to_text = to_text.as_deref().or(own.as_deref());
        let truth = truth(scene, to_text, classes, path)?;
        let query = truth.points.as_ref().map(|(c, l)| (c.as_slice(), l.as_slice()));
        let valid = match (&scene.valid_feat_mask, args.vote_valid_only) {
            (Some(mask), true) => Some(mask.as_slice()),
            (None, true) => {
                return Err(WrongUse(format!(
                    "--vote-valid-only: {} has no valid_feat_mask",
                    path.display()
                ))
                .into());
            }
            _ => None,
        };

        // What each class comes out as: itself, except for aliases.
        let mut answers: Vec<i32>;
        {
            let _stage = session.receipt.stage("oracle");
            let mut check = OracleCheck::new(&truth.gaussians, table)
                .with_class_names(&text.names)
                .with_excluded(&excluded)
                .with_options(options.clone());
            if args.vote_k > 1 || query.is_some() {
                check = check.with_vote(OracleVote {
                    coord: &scene.coord,
                    valid,
                    query,
                    k: args.vote_k.max(1),
                    keep_unknown: withholds,
                });
            }
            if let Some(row) = args.break_oracle {
                check = check.with_fault(fault(&truth.gaussians, row)?);
            }
            session.progress.say("oracle: the truth through the same chain");
            let report = check.run().with_context(|| {
                format!(
                    "{}: evaluation refused: the oracle falls short of its analytic value, so no \
                     number of this chain can be trusted",
                    path.display()
                )
            })?;
            for (class, becomes) in &report.aliases {
                let other = usize::try_from(*becomes).ok().and_then(|c| text.names.get(c));
                let text = format!(
                    "class {:?} rightly comes out as {:?} with these texts and options",
                    text.names[*class],
                    other.map_or("unknown", |n| n.as_str())
                );
                session.progress.say(&text);
                session.receipt.warning(text);
            }
            answers = (0..classes as i32).collect();
            for &(class, becomes) in &report.aliases {
                answers[class] = becomes;
            }
            print(&format!(
                "{}: oracle matches its analytic value on {} labelled Gaussians, {} scored points: {}",
                path.display(),
                report.num_labelled,
                report.num_scored,
                line_of(&report.metrics)
            ));
        }
        session.check_stop()?;

        // The oracle passed: its prediction is the truth through the vote.
        let scored = query.map_or(truth.gaussians.as_slice(), |(_, labels)| labels);
        let voted = |labels: &[i32]| -> Result<Vec<i32>> {
            if args.vote_k <= 1 && query.is_none() {
                return Ok(labels.to_vec());
            }
            let at = query.map_or(scene.coord.as_slice(), |(c, _)| c);
            let mut after = vote(&scene.coord, labels, valid, at, args.vote_k.max(1), classes)?;
            if withholds && query.is_none() {
                keep_withheld(labels, &mut after);
            }
            Ok(after)
        };
        let _stage = session.receipt.stage("score");
        let told: Vec<i32> = truth
            .gaussians
            .iter()
            .map(|&l| usize::try_from(l).map_or(-1, |l| answers[l]))
            .collect();
        oracle.update((&voted(&told)?, scored))?;
        random.update((&random_labels(scored.len(), classes, args.inference.seed)?, scored))?;
        drop(_stage);
        if oracle_only {
            continue;
        }
        let labels: Vec<i32> = match (&network, &from_file) {
            (Some(network), _) => {
                let features = session.encode(scene, network, &args.inference)?;
                let _stage = session.receipt.stage("labels");
                let classes = match network.is_classifier() {
                    true => labels::Classes::Probabilities(text.len()),
                    false => labels::Classes::Texts(&text),
                };
                label_gaussians(&features, classes, &options)?.labels
            }
            (None, Some(file)) => {
                let _stage = session.receipt.stage("labels");
                let array = NpyFile::open(file)?;
                if array.shape() != [opened.loaded.source_rows(), text.dim] {
                    anyhow::bail!(
                        "{}: expected [{}, {}], got {:?}",
                        file.display(),
                        opened.loaded.source_rows(),
                        text.dim,
                        array.shape()
                    );
                }
                let values = array.read_f32()?;
                let all = classify(&FeatureSlice::new(&values, text.dim)?, table, &options)?.labels;
                match &opened.loaded.kept_rows {
                    Some(kept) => kept.iter().map(|r| all[*r as usize]).collect(),
                    None => all,
                }
            }
            (None, None) => Vec::new(),
        };
        let _stage = session.receipt.stage("score");
        model.update((&voted(&labels)?, scored))?;
    }

    let rows: Vec<(&str, TesterReport)> = [("oracle", &oracle), ("random labels", &random)]
        .into_iter()
        .chain((!oracle_only).then_some(("features", &model)))
        .map(|(name, m)| (name, m.tester_report()))
        .collect();
    print(&format!(
        "{:14} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "", "mIoU", "mAcc", "allAcc", "f-mIoU", "f-mAcc"
    ));
    for (name, report) in &rows {
        print(&format!("{name:14} {}", columns(report)));
    }
    let meaningless = network.as_ref().is_some_and(scenesplat::Network::has_random_weights);
    if meaningless {
        print("the features come from seeded weights: their row means nothing");
    }
    let figures = |r: &TesterReport| {
        let per_class: Vec<_> = r
            .classes
            .iter()
            .zip(&text.names)
            .filter(|(c, _)| c.union > 0)
            .map(|(c, name)| {
                serde_json::json!({
                    "name": name, "iou": c.iou, "accuracy": c.accuracy,
                    "labelled": c.target, "excluded": c.excluded,
                })
            })
            .collect();
        serde_json::json!({
            "f_miou": r.foreground_mean_iou, "f_macc": r.foreground_mean_accuracy,
            "miou": r.mean_iou, "macc": r.mean_accuracy, "all_acc": r.all_accuracy,
            "per_class": per_class,
        })
    };
    let seconds = began.elapsed().as_secs_f64();
    let mut json = figures(&rows[rows.len() - 1].1);
    json["oracle"] = figures(&rows[0].1);
    json["random_labels"] = figures(&rows[1].1);
    json["features"] = serde_json::json!(if oracle_only { "oracle" } else { rows[2].0 });
    json["seconds"] = serde_json::json!(seconds);
    json["scenes"] = serde_json::json!(inputs.len());
    json["classes"] = serde_json::json!(text.names);
    json["excluded"] = serde_json::json!(excluded);
    json["vote_k"] = serde_json::json!(args.vote_k);
    json["meaningless"] = serde_json::json!(meaningless);
    if oracle_only {
        // Otherwise the last row would be that of random labels.
        for key in ["f_miou", "f_macc", "miou", "macc", "all_acc", "per_class"] {
            json[key] = json["oracle"][key].clone();
        }
    }
    let path = session.out("evaluation.json")?;
    let bytes = write_text(&path, &serde_json::to_string_pretty(&json)?)?;
    session.wrote(&path, bytes);
    if let Some(path) = &args.json {
        session.write_file(path, &serde_json::to_string_pretty(&json)?)?;
    }
    session.finish()
}

/// One scene to evaluate on.
enum Input {
    File(PathBuf),
    Room { rooms: Arc<SyntheticRooms>, index: usize },
}

/// The scenes that the arguments name.
fn inputs(scenes: &[String]) -> Result<Vec<Input>> {
    let mut all = Vec::new();
    for scene in scenes {
        let Some(rest) = scene.strip_prefix("synthetic:") else {
            all.push(Input::File(scene.into()));
            continue;
        };
        let numbers = rest.split_once(':').and_then(|(count, seed)| {
            Some((
                count.parse::<usize>().ok().filter(|c| (1..=1_000_000).contains(c))?,
                seed.parse().ok()?,
            ))
        });
        let Some((count, seed)) = numbers else {
            let text = format!("{scene:?}: write synthetic:COUNT:SEED, such as synthetic:20:7");
            return Err(WrongUse(text).into());
        };
        let rooms = Arc::new(SyntheticRooms::new(count, SyntheticRoomSettings::default(), seed)?);
        all.extend((0..count).map(|index| Input::Room { rooms: Arc::clone(&rooms), index }));
    }
    Ok(all)
}

impl Input {
    fn open(&self, session: &Session<'_>, inference: &Inference) -> Result<OpenedScene> {
        match self {
            Self::File(path) => session.open(path, inference),
            Self::Room { rooms, index } => {
                let id = &rooms.scene_ids()[*index];
                session.progress.say(format!("making {id}"));
                let SourceScene { scene, report } = rooms.load(id)?;
                session.receipt.add_rows_in(scene.len());
                let path = PathBuf::from(id);
                let kind = SceneFormat::Ply;
                let loaded = LoadedScene { scene, report, kept_rows: None, path, kind };
                Ok(OpenedScene { loaded, converted: false })
            }
        }
    }

    /// Which of the text's classes each label means, where the scene knows its labels' names.
    fn labels(&self, names: &[String]) -> Result<Option<Vec<i32>>> {
        let Self::Room { .. } = self else { return Ok(None) };
        let row = |class: &SyntheticClass| {
            let own = find_name(names, class.name);
            own.or_else(|_| find_name(names, class.scannet200_name)).map_or(-1, |row| row as i32)
        };
        Ok(Some(CLASSES.iter().map(row).collect()))
    }
}

/// Class of --text for each label of the scenes.
fn label_map(args: &Args, names: &[String]) -> Result<Option<Vec<i32>>> {
    let Some(path) = &args.label_names else {
        if args.class_map.is_some() {
            return Err(WrongUse("--class-map needs --label-names".to_owned()).into());
        }
        return Ok(None);
    };
    let labels = read_names(path)?;
    let map = match &args.class_map {
        Some(path) => ClassMap::read(path)?,
        // Without a map, labels mean the class of the same name.
        None => ClassMap::from_pairs(labels.iter().filter_map(|l| {
            let class = scenesplat::scene::label_set::find_name(names, l).ok()?;
            Some((l.clone(), names[class].clone()))
        })),
    };
    Ok(Some(map.indices(&labels, names)?))
}

/// The classes of a segmentation network as a table: each is its own direction.
fn classes_of(network: &Network, args: &Args) -> Result<TextTable> {
    let count = network.model().out_channels();
    let Some(path) = &args.classes.text_names else {
        let text = "--text-names is missing: the names of the network's classes, one a line";
        return Err(WrongUse(text.to_owned()).into());
    };
    let names = read_names(path)?;
    if names.len() != count || args.classes.text.is_some() {
        return Err(WrongUse(format!(
            "a segmentation network takes no --text, and --text-names with {count} names; got {}",
            names.len()
        ))
        .into());
    }
    let values = (0..count * count).map(|i| f32::from(u8::from(i % (count + 1) == 0))).collect();
    Ok(TextTable::from_rows(names, values, count)?)
}

/// A row with the text of another class.
fn fault(labels: &[i32], row: usize) -> Result<Fault> {
    let own = labels.get(row).copied().unwrap_or(-1);
    let other = labels.iter().copied().find(|l| *l >= 0 && *l != own);
    match (own >= 0, other) {
        (true, Some(other)) => Ok(Fault { row, class: other as usize }),
        _ => Err(WrongUse(format!(
            "--break-oracle {row}: choose a row with a label, in a scene with two classes"
        ))
        .into()),
    }
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{:.2} %", v * 100.0))
}

fn columns(r: &TesterReport) -> String {
    [r.mean_iou, r.mean_accuracy, r.all_accuracy, r.foreground_mean_iou, r.foreground_mean_accuracy]
        .map(|v| format!("{:>8}", percent(v)))
        .join(" ")
}

fn line_of(r: &TesterReport) -> String {
    format!("mIoU {}, allAcc {}", percent(r.mean_iou), percent(r.all_accuracy))
}
