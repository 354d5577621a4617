//! `scenesplat prepare scan`

use super::splits::{self, SplitList};
use crate::error::{WrongUse, refuse};
use crate::flags::{Shared, SourceArgs, parse_positive};
use crate::session::Session;
use anyhow::{Context, Result};
use half::f16;
use scenesplat::datasets::prepare::{
    LabelTables, PrepareReport, PrepareSettings, ScanLayout, prepare, read_scan,
};
use scenesplat::models::weights::read_single_tensor;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{GaussianScene, LanguageFeatures, ReadOptions};
use std::path::{Path, PathBuf};

/// Makes a folder of .npy files that training reads: Gaussians inside the scan's box, each with the label, instance and
/// normal of the nearest point of the scan, and the labeled points themselves.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene of Gaussians, in any format, in the frame of the scan.
    pub scene: PathBuf,
    /// The scan: its folder; of matterport3d a regionN.ply; of points a .ply.
    #[arg(long, value_name = "PATH")]
    pub scan: PathBuf,
    /// How its files are laid out: scannet, scannetpp, matterport3d, replica, 3rscan, arkitscenes, hypersim, interiorgs, or
    /// points.
    #[arg(long, value_name = "LAYOUT", value_parser = parse_layout)]
    pub layout: ScanLayout,
    /// The benchmark's table of names: scannetv2-labels.combined.tsv, category_mapping.tsv, map_benchmark.csv.
    #[arg(long, value_name = "FILE")]
    pub label_table: Option<PathBuf>,
    /// Names of classes, one a line, in the order of their numbers, in place of the layout's own.
    #[arg(long, value_name = "FILE")]
    pub classes: Option<PathBuf>,
    /// Language features of the scene's rows: langfeat.pth, lang_feat.npy.
    #[arg(long, value_name = "FILE")]
    pub lang_feat: Option<PathBuf>,
    /// Leaves the language features out if fewer of the Gaussians that are kept have one (ScanNet++ of the original:
    /// 0.5).
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, requires = "lang_feat")]
    pub min_valid: f64,
    /// A Gaussian farther than this from any point has no label, meters; 0 = however far, as the original.
    #[arg(long, value_name = "M", default_value_t = 0.25)]
    pub max_distance: f64,
    /// How much longer the sides of the box are than the scan's, meters.
    #[arg(long, value_name = "M", default_value = "0.5", value_parser = parse_positive, conflicts_with = "keep_all")]
    pub margin: f64,
    /// Keeps Gaussians outside of the box too.
    #[arg(long)]
    pub keep_all: bool,
    /// Name of the scene; that of the scan's folder if not given.
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Lists of the splits, train=FILE,val=FILE: the scene goes into DIR/SPLIT/NAME, DIR/test/NAME if no list has it.
    #[arg(long, value_name = "SPLIT=FILE", value_delimiter = ',', value_parser = splits::parse)]
    pub splits: Vec<SplitList>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

fn parse_layout(text: &str) -> Result<ScanLayout, String> {
    ScanLayout::ALL.into_iter().find(|layout| layout.name() == text).ok_or_else(|| {
        let names: Vec<&str> = ScanLayout::ALL.iter().map(|layout| layout.name()).collect();
        format!("{text:?} is no layout; there are: {}", names.join(", "))
    })
}

/// Runs the command.
pub(super) fn run(args: &Args, line: &str) -> Result<()> {
    args.check()?;
    let session = Session::start(&args.shared, line)?;
    let files = [&args.label_table, &args.classes, &args.lang_feat];
    session.outputs.reads_any([Some(args.scan.as_path())])?;
    session.outputs.reads_any(files.map(Option::as_deref))?;
    let tables =
        LabelTables { table: args.label_table.as_deref(), classes: args.classes.as_deref() };
    let tables = tables.of(args.layout)?;
    let name = args.scene_name()?;
    let folder = match splits::of(&name, &args.splits)? {
        Some(split) => args.shared.out.join(split).join(&name),
        None => args.shared.out.join(&name),
    };
    let stage = session.receipt.stage("scan");
    let scan = read_scan(&args.scan, args.layout)?;
    drop(stage);
    session.outputs.open_folder(&[])?;
    let options = ReadOptions { sh_rest: false, ..args.source.options() };
    let opened = session.open_with(&args.scene, &options)?;
    let rows = opened.loaded.source_rows();
    let kept = opened.loaded.kept_rows.clone();
    let mut scene = opened.loaded.scene;
    // Scans are read as f32, in the coordinates of their files.
    scene.move_origin([0.0; 3]);
    if let Some(path) = &args.lang_feat {
        add_features(&mut scene, path, rows, kept.as_deref())?;
        session.receipt.fingerprint("language features", path)?;
    }
    let settings = PrepareSettings {
        max_distance: (args.max_distance > 0.0).then_some(args.max_distance),
        margin: (!args.keep_all).then_some(args.margin),
        points: true,
    };
    let stage = session.receipt.stage("labels");
    let (mut prepared, report) = prepare(&scene, &scan, &tables, &settings)?;
    drop(stage);
    args.limit_features(&session, &mut prepared.scene);
    tell(&session, &report, scan.coord.len());
    let stage = session.receipt.stage("write");
    prepared.write(&folder)?;
    note_files(&session, &folder)?;
    drop(stage);
    session.receipt.add_rows_out(prepared.scene.len());
    session.receipt.setting("layout", args.layout.name(), "of the scan");
    session.receipt.setting("folder", folder.display(), "what training reads");
    session.progress.say(format!("wrote {}", folder.display()));
    session.finish()
}

impl Args {
    fn check(&self) -> Result<()> {
        let wrong = |text: String| -> Result<()> { Err(WrongUse(text).into()) };
        if !(self.max_distance >= 0.0 && self.max_distance.is_finite()) {
            return wrong(format!("--max-distance {}: meters, at least 0", self.max_distance));
        }
        if !(0.0..=1.0).contains(&self.min_valid) {
            return wrong(format!("--min-valid {}: a share from 0 to 1", self.min_valid));
        }
        Ok(())
    }

    /// What the scene is called; a part of a path.
    fn scene_name(&self) -> Result<String> {
        let name = match &self.name {
            Some(name) => name.clone(),
            None => {
                let full = self.scan.canonicalize().unwrap_or_else(|_| self.scan.clone());
                full.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
            }
        };
        let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\']);
        if !plain {
            refuse!("--name {name:?}: no name of a folder");
        }
        Ok(name)
    }

    /// Leaves features out where too few Gaussians have one.
    fn limit_features(&self, session: &Session<'_>, scene: &mut GaussianScene) {
        let Some(mask) = &scene.valid_feat_mask else { return };
        let share = mask.iter().filter(|v| **v).count() as f64 / mask.len().max(1) as f64;
        let text = format!("{:.1} % of the Gaussians have a language feature", 100.0 * share);
        session.progress.say(&text);
        if share < self.min_valid {
            let text = format!("{text}, fewer than --min-valid {}: left out", self.min_valid);
            session.warn(text);
            (scene.lang_feat, scene.valid_feat_mask) = (None, None);
        }
    }
}

/// The files of a scene's folder, in the receipt.
fn note_files(session: &Session<'_>, folder: &Path) -> Result<()> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        let about = entry.metadata()?;
        if about.is_file() {
            files.push((entry.path(), about.len()));
        }
    }
    files.sort();
    files.iter().for_each(|(path, bytes)| session.wrote(path, *bytes));
    Ok(())
}

/// Puts features beside the rows that are left of a file of `rows`.
fn add_features(
    scene: &mut GaussianScene,
    path: &Path,
    rows: usize,
    kept: Option<&[u32]>,
) -> Result<()> {
    let (shape, values): (Vec<usize>, Vec<f16>) = if path.extension().is_some_and(|e| e == "npy") {
        let file = NpyFile::open(path)?;
        (file.shape().to_vec(), file.read_f16()?)
    } else {
        let tensor = read_single_tensor(path)?;
        let flat = tensor.flatten_all()?.to_vec1::<f32>()?;
        (tensor.dims().to_vec(), flat.into_iter().map(f16::from_f32).collect())
    };
    let &[got, dim] = shape.as_slice() else {
        anyhow::bail!("{}: is {shape:?}, features are [rows, width]", path.display());
    };
    anyhow::ensure!(
        got == rows && dim > 0,
        "{}: has {got} rows of {dim} values, the scene {rows} rows (both have to be of one scene, before anything \
         was dropped)",
        path.display()
    );
    let row = |i: usize| &values[i * dim..(i + 1) * dim];
    let bad = values.iter().position(|v| !v.is_finite());
    if let Some(at) = bad {
        anyhow::bail!("{}: row {}, column {}: {}", path.display(), at / dim, at % dim, values[at]);
    }
    let values: Vec<f16> = match kept {
        Some(kept) => kept.iter().flat_map(|&i| row(i as usize).iter().copied()).collect(),
        None => values,
    };
    let is_valid = |row: &[f16]| row.iter().any(|v| *v != f16::ZERO);
    scene.valid_feat_mask = Some(values.chunks_exact(dim).map(is_valid).collect());
    scene.lang_feat = Some(LanguageFeatures { values, dim });
    scene.check_rows().with_context(|| path.display().to_string())
}

/// Says and notes what came of it.
fn tell(session: &Session<'_>, report: &PrepareReport, points: usize) {
    let kept = report.gaussians - report.outside;
    session.progress.say(format!(
        "{points} points; {kept} of {} Gaussians are inside the scan's box, {} of them too far from any point",
        report.gaussians, report.too_far
    ));
    session.receipt.setting("outside", report.outside, "Gaussians outside of the scan's box");
    session.receipt.setting(
        "too_far",
        report.too_far,
        "Gaussians too far from any point for a label",
    );
    for (stem, labelled) in &report.labelled {
        let share = 100.0 * *labelled as f64 / kept.max(1) as f64;
        session.progress.say(format!("{stem}: {labelled} Gaussians ({share:.1} %) have a label"));
        session.receipt.setting(stem, labelled, "Gaussians with a label");
    }
    if !report.unknown.is_empty() {
        let shown: Vec<String> =
            report.unknown.iter().take(8).map(|(name, n)| format!("{name} ({n})")).collect();
        session.warn(format!(
            "{} names are no class and label nothing: {}{}",
            report.unknown.len(),
            shown.join(", "),
            if report.unknown.len() > 8 { ", …" } else { "" }
        ));
    }
}
