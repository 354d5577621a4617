//! `scenesplat query`

use super::WrongUse;
use super::segment::{Classes, slot_rows};
use crate::flags::{Inference, Shared};
use crate::session::{FeatureSource, Session};
use crate::terminal::print;
use anyhow::Result;
use scenesplat::metrics::{ZeroShotOptions, classify, vote};
use scenesplat::models::weights::read_single_tensor;
use scenesplat::outputs::{ResultColumns, write_colored_ply, write_scene_preview};
use scenesplat::preview::LegendEntry;
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::label_set::{find_name, nearest_names};
use scenesplat::scene::{LabelSet, TextTable};
use scenesplat::text::metric_table;
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
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// The texts with the query among them, and the query's row.
fn texts(args: &Args) -> Result<(TextTable, usize)> {
    if let (Some(vocabulary), None) = (args.classes.vocabulary()?, &args.embedding) {
        return from_vocabulary(&vocabulary, &args.query);
    }
    let table = match (&args.classes.text, &args.embedding) {
        (None, None) if args.inference.network.is_embedded() => {
            return from_vocabulary(&scenesplat::embedded::vocabulary()?, &args.query);
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
        let table = match table {
            Some(table) => table,
            None => return Err(WrongUse("--text is missing".to_owned()).into()),
        };
        return match find_name(&table.names, &args.query) {
            Ok(row) => Ok((table, row)),
            Err(_) => Err(WrongUse(format!(
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
    let (mut names, mut values) = table.map_or((Vec::new(), Vec::new()), |t| (t.names, t.values));
    // A row of the same name would be its own rival.
    if let Ok(row) = find_name(&names, &args.query) {
        names.remove(row);
        values.drain(row * vector.len()..(row + 1) * vector.len());
    }
    names.push(args.query.clone());
    values.extend_from_slice(&vector);
    let row = names.len() - 1;
    Ok((TextTable::from_rows(names, values, vector.len())?, row))
}

/// The query in the words of the network inside the program, with what it has to beat.
fn from_vocabulary(vocabulary: &Vocabulary, query: &str) -> Result<(TextTable, usize)> {
    let wrong = |error| WrongUse(format!("{error}"));
    let vector = vocabulary.embed(query).map_err(wrong)?;
    let mut table = vocabulary.rivals(query).map_err(wrong)?;
    table.names.push(query.to_owned());
    table.values.extend(vector);
    let row = table.names.len() - 1;
    Ok((table, row))
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
    let (text, row) = texts(args)?;
    session.make_out(&["scores.npy", "selection.npy", "query.ply", "preview.png"])?;
    args.classes.record(&session)?;
    if let Some(path) = &args.embedding {
        session.receipt.fingerprint("embedding", path)?;
    }
    let (opened, source) = session.open_with_source(&args.scene, &args.inference, |network| {
        if network.is_classifier() {
            let text = "a segmentation network cannot be queried; use --config language";
            return Err(WrongUse(text.to_owned()).into());
        }
        check_width(network.model().out_channels(), text.dim)
    })?;
    let scene = &opened.loaded.scene;
    if let (FeatureSource::Codes, Some(code)) = (&source, &scene.lang_code) {
        if args.classes.text.is_none() && args.embedding.is_none() {
            let text = "the scene carries language codes of its own: give --text or --embedding for \
                        them, or --weights embedded to use the network inside the program";
            return Err(WrongUse(text.to_owned()).into());
        }
        check_width(code.codebook.feature_width(), text.dim)?;
    }
    let features = session.features(scene, &source, &args.inference)?;

    let (scores, selected) = {
        let _stage = session.receipt.stage("query");
        let rows = slot_rows(&features)?;
        let own_text = TextTable::from_rows(
            vec![args.query.clone()],
            text.row(row).unwrap_or_default().to_vec(),
            text.dim,
        )?;
        let own = classify(&rows, &metric_table(&own_text)?, &ZeroShotOptions::default())?;
        let set = LabelSet::new(text.names.clone())?;
        let mut candidates =
            args.classes.options(&set)?.candidates.unwrap_or_else(|| vec![true; text.len()]);
        candidates[row] = false;
        // The best rival of each row, if there is any.
        let rivals = if candidates.contains(&true) {
            let options =
                ZeroShotOptions { candidates: Some(candidates), ..ZeroShotOptions::default() };
            Some(classify(&rows, &metric_table(&text)?, &options)?.scores)
        } else {
            None
        };
        let wins = |slot: usize| {
            let score = own.scores[slot];
            // A row without a direction has no class, not even the only one.
            own.labels[slot] >= 0
                && rivals.as_ref().is_none_or(|r| {
                    score > r[slot] && score - r[slot] >= args.classes.min_margin.unwrap_or(0.0)
                })
                && args.classes.min_score.is_none_or(|m| score >= m)
        };
        let slots: Vec<bool> = (0..features.num_slots()).map(wins).collect();
        let scores: Vec<f32> = features.inverse().iter().map(|s| own.scores[*s as usize]).collect();
        let selected: Vec<i32> =
            features.inverse().iter().map(|s| i32::from(slots[*s as usize])).collect();
        (scores, selected)
    };
    let selected = if args.vote_k > 1 {
        let _stage = session.receipt.stage("vote");
        session.receipt.setting("vote_k", args.vote_k, "neighbours that vote on the selection");
        vote(&scene.coord, &selected, None, &scene.coord, args.vote_k, 2)?
    } else {
        selected
    };
    session.check_stop()?;
    describe(&args.query, scene, &scores, &selected);

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
fn describe(
    query: &str,
    scene: &scenesplat::scene::GaussianScene,
    scores: &[f32],
    selected: &[i32],
) {
    let rows: Vec<usize> = (0..selected.len()).filter(|&i| selected[i] == 1).collect();
    let best = scores.iter().copied().filter(|s| s.is_finite()).fold(f32::NEG_INFINITY, f32::max);
    if rows.is_empty() {
        print(&format!("{query:?}: nothing selected; the best score is {best:.4}"));
        return;
    }
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    let mut mean = [0f64; 3];
    for &row in &rows {
        for axis in 0..3 {
            let v = scene.coord[row][axis];
            low[axis] = low[axis].min(v);
            high[axis] = high[axis].max(v);
            mean[axis] += f64::from(v) / rows.len() as f64;
        }
    }
    print(&format!(
        "{query:?}: {} of {} Gaussians, centre ({:.2}, {:.2}, {:.2}) m, box ({:.2}, {:.2}, {:.2}) \
         to ({:.2}, {:.2}, {:.2}) m, best score {best:.4}",
        rows.len(),
        selected.len(),
        mean[0],
        mean[1],
        mean[2],
        low[0],
        low[1],
        low[2],
        high[0],
        high[1],
        high[2]
    ));
}
