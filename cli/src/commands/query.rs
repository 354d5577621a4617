//! `scenesplat query`

use super::WrongUse;
use super::segment::Classes;
use crate::flags::{Inference, Shared};
use crate::session::{FeatureSource, Session};
use crate::terminal::print;
use anyhow::Result;
use scenesplat::models::weights::read_single_tensor;
use scenesplat::outputs::{ResultColumns, write_colored_ply, write_scene_preview};
use scenesplat::preview::LegendEntry;
use scenesplat::query::{Query, QuerySettings, Selection, select};
use scenesplat::scene::LabelSet;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::label_set::nearest_names;
use std::path::{Path, PathBuf};

/// Writes scores.npy (cosine with the query), selection.npy (0 or 1), query.ply (a heat map with
/// score and label columns), preview.png and a receipt; prints where the object is.
///
/// The query is the name of a row of --text, or any text whose embedding is given by --embedding;
/// for the network inside the program, what its vocabulary knows ("red chair", "furniture").
/// A Gaussian is selected when the query scores best among all rows of --text (if there are
/// several), its score reaches --min-score, and most of its neighbours agree.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// What to find, such as "robot arm".
    pub query: String,
    /// Embedding of the query: .npy or .pt with D values.
    #[arg(long, value_name = "FILE")]
    pub embedding: Option<PathBuf>,
    /// Rivals of the query and thresholds.
    #[command(flatten)]
    pub classes: Classes,
    /// Neighbours that vote on the selection; 0 or 1 for no vote.
    #[arg(long, value_name = "K", default_value_t = 25)]
    pub vote_k: usize,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian, such as
    /// lang_feat.npy of lift-labels or features.npy.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// What is asked for, with its rivals.
fn query(args: &Args) -> Result<Query> {
    let wrong = |error: &dyn std::fmt::Display| WrongUse(error.to_string());
    if let (Some(vocabulary), None) = (args.classes.vocabulary()?, &args.embedding) {
        return Ok(Query::of_vocabulary(&vocabulary, &args.query).map_err(|e| wrong(&e))?);
    }
    let table = match (&args.classes.text, &args.embedding) {
        (None, None) if args.inference.network.is_embedded() && args.features.is_none() => {
            let vocabulary = scenesplat::embedded::vocabulary()?;
            return Ok(Query::of_vocabulary(&vocabulary, &args.query).map_err(|e| wrong(&e))?);
        }
        (None, None) => {
            return Err(WrongUse(
                "give --text (embeddings with names, the query being one of them) or --embedding \
                 (the query's own vector)"
                    .to_owned(),
            )
            .into());
        }
        (Some(_), _) => Some(args.classes.text_table(false)?),
        (None, Some(_)) => None,
    };
    let Some(path) = &args.embedding else {
        let Some(table) = table else {
            return Err(WrongUse("--text is missing".to_owned()).into());
        };
        return match Query::of_table(&table, &args.query)? {
            Some(query) => Ok(query),
            None => Err(WrongUse(format!(
                "{:?} is not among the {} names of --text; nearest: {}. For any other text give \
                 its embedding with --embedding FILE",
                args.query,
                table.names.len(),
                nearest_names(&table.names, &args.query, 3).join(", ")
            ))
            .into()),
        };
    };
    let vector = read_vector(path)?;
    if let Some(t) = &table
        && t.dim != vector.len()
    {
        return Err(WrongUse(format!(
            "--embedding has {} values, the rows of --text have {}",
            vector.len(),
            t.dim
        ))
        .into());
    }
    if table.is_none() && args.classes.min_score.is_none() {
        return Err(WrongUse(
            "without rivals every Gaussian would be selected: give --text (other classes) or \
             --min-score"
                .to_owned(),
        )
        .into());
    }
    Ok(Query::of_vector(&args.query, vector, table.as_ref())?)
}

fn read_vector(path: &Path) -> Result<Vec<f32>> {
    if path.extension().is_some_and(|e| e == "npy") {
        return Ok(NpyFile::open(path)?.read_f32()?);
    }
    Ok(read_single_tensor(path)?.flatten_all()?.to_vec1::<f32>()?)
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start_with(&args.shared, &args.inference.network, line)?;
    session.outputs.reads_any([Some(args.scene.as_path()), args.embedding.as_deref()])?;
    args.classes.claim_inputs(&session.outputs)?;
    let query = query(args)?;
    session.make_out(&["scores.npy", "selection.npy", "query.ply", "preview.png"])?;
    args.classes.record(&session)?;
    if let Some(path) = &args.embedding {
        session.receipt.fingerprint("embedding", path)?;
    }
    let (opened, source) = session.open_with_source(
        &args.scene,
        &args.inference,
        args.features.as_deref(),
        |network| {
            if network.is_classifier() {
                let text = "a segmentation network cannot be queried; use --config language";
                return Err(WrongUse(text.to_owned()).into());
            }
            check_width(network.model().out_channels(), query.width())
        },
    )?;
    let scene = &opened.loaded.scene;
    if let (FeatureSource::Codes, Some(code)) = (&source, &scene.lang_code) {
        if args.classes.text.is_none() && args.embedding.is_none() {
            let text = "the scene carries language codes of its own: give --text or --embedding for \
                        them, or --weights embedded to use the network inside the program";
            return Err(WrongUse(text.to_owned()).into());
        }
        check_width(code.codebook.feature_width(), query.width())?;
    }
    let features = session.features(&opened, &source, &args.inference)?;

    // A misspelt rival would go on to compete.
    if !args.classes.without.is_empty() {
        args.classes.options(&LabelSet::new(query.rivals.names.clone())?)?;
    }
    session.receipt.setting("vote_k", args.vote_k, "neighbours that vote on the selection");
    let found = {
        let _stage = session.receipt.stage("query");
        let settings = QuerySettings {
            without: args.classes.without.clone(),
            min_score: args.classes.min_score,
            min_margin: args.classes.min_margin,
            vote_k: args.vote_k,
        };
        select(&features, &query, &settings, &scene.coord)?
    };
    session.check_stop()?;
    describe(&args.query, &found, &scene.coord);
    let Selection { scores, selected } = found;

    let colors = heat(&scores, &selected);
    {
        let _stage = session.receipt.stage("write");
        let rows = opened.loaded.source_rows();
        let path = session.out("scores.npy")?;
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&scores, 0.0)?)?;
        session.wrote(&path, (rows * 4 + 128) as u64);
        let path = session.out("selection.npy")?;
        let bytes: Vec<u8> = selected.iter().map(|s| *s as u8).collect();
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&bytes, 0)?)?;
        session.wrote(&path, (rows + 128) as u64);
        let path = session.out("query.ply")?;
        let columns = ResultColumns { label: Some(&selected), score: Some(&scores) };
        let bytes = write_colored_ply(&opened, &colors, &columns, &path)?;
        session.wrote(&path, bytes);
        session.receipt.add_rows_out(rows);
    }
    {
        let _stage = session.receipt.stage("picture");
        let count = selected.iter().filter(|s| **s == 1).count() as u64;
        let entries = [
            LegendEntry { name: args.query.clone(), color: SELECTED, count },
            LegendEntry {
                name: "everything else".to_owned(),
                color: [110, 110, 118],
                count: selected.len() as u64 - count,
            },
        ];
        let path = session.out("preview.png")?;
        let title = format!("\"{}\"{}", args.query, source.remark());
        let up = session.up(scene, &args.inference);
        let bytes = write_scene_preview(scene, &colors, &entries, &title, up, &path)?;
        session.wrote(&path, bytes);
    }
    session.finish()
}

fn check_width(features: usize, texts: usize) -> Result<()> {
    if features == texts {
        return Ok(());
    }
    Err(WrongUse(format!(
        "the texts have {texts} values, the features {features}: give the texts of this network, or \
         with --weights the network of these texts"
    ))
    .into())
}

const SELECTED: [u8; 3] = [255, 140, 40];

/// Selected Gaussians orange, the others grey, brighter with their score.
fn heat(scores: &[f32], selected: &[i32]) -> Vec<[u8; 3]> {
    let mut sorted: Vec<f32> = scores.iter().copied().filter(|s| s.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let at = |q: f32| sorted.get(((sorted.len().max(1) - 1) as f32 * q) as usize).copied();
    let (low, high) = (at(0.02).unwrap_or(0.0), at(0.98).unwrap_or(0.0));
    scores
        .iter()
        .zip(selected)
        .map(|(&score, &selected)| {
            let t = if high > low { ((score - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
            match selected {
                1 => SELECTED,
                _ => {
                    let v = (60.0 + 100.0 * t) as u8;
                    [v, v, v.saturating_add(8)]
                }
            }
        })
        .collect()
}

/// Prints how much was found and where.
fn describe(query: &str, found: &Selection, coord: &[[f32; 3]]) {
    let best = found.best_score().unwrap_or(f32::NEG_INFINITY);
    let Some(place) = found.place(coord) else {
        print(&format!("{query:?}: nothing selected; the best score is {best:.4}"));
        return;
    };
    let [center, low, high] = [place.center, place.low.map(f64::from), place.high.map(f64::from)]
        .map(|[x, y, z]| format!("({x:.2}, {y:.2}, {z:.2})"));
    print(&format!(
        "{query:?}: {} of {} Gaussians, centre {center} m, box {low} to {high} m, best score \
         {best:.4}",
        place.count,
        found.selected.len(),
    ));
}
