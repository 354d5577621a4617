//! `scenesplat query`

mod args;
mod asked;
mod guess;
pub(super) mod place;
mod write;

use crate::budget::{Job, within_budget};
use crate::effects::Wish;
use crate::error::{WrongUse, refuse};
use crate::session::{FeatureSource, Session};
use anyhow::Result;
pub use args::Args;
pub use asked::{Meant, meant};
use scenesplat::SceneFeatures;
use scenesplat::outputs::OpenedScene;
use scenesplat::phrases::shortened;
use scenesplat::query::{Query, QuerySettings, Selection, select};
use scenesplat::recognition::{KNOWN, LEAST_SHARE};
use scenesplat::scene::LabelSet;
use scenesplat_lab::compensation::Consumer;
use write::{describe, write};

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let job = Job {
        command: "query",
        scene: &args.scene,
        inference: &args.inference,
        vote_k: args.vote_k,
        features: args.features.as_deref(),
    };
    let (inference, vote_k, chosen) =
        within_budget(&args.budget, args.shared.running.threads, &job)?;
    let session = Session::start_network(&args.shared, &inference, chosen, line)?;
    let args = &Args { inference, ..args.clone() };
    session.outputs.reads_any([Some(args.scene.as_path()), args.embedding.as_deref()])?;
    let wish = args.effects.wish(&session, args.features.is_none(), true)?;
    args.classes.claim_inputs(&session.outputs)?;
    let meant = meant(args, &session)?;
    session.outputs.open_folder(&["scores.npy", "selection.npy", "query.ply", "preview.png"])?;
    args.classes.record(&session)?;
    if let Some(path) = &args.embedding {
        session.receipt.fingerprint("embedding", path)?;
    }
    let found = find(args, &session, &meant, &wish, vote_k)?;
    session.check_stop()?;
    let Found { opened, remark, selection } = &found;
    describe(&args.query, selection, &opened.loaded.scene.coord);
    write(args, &session, opened, remark, selection)?;
    session.finish()
}

/// What a query found, where.
pub struct Found {
    /// The scene.
    pub opened: OpenedScene,
    /// What to add to a title where the result means nothing.
    pub remark: &'static str,
    /// The Gaussians that are meant.
    pub selection: Selection,
}

/// Opens the scene and selects what is asked for.
pub fn find(
    args: &Args,
    session: &Session<'_>,
    meant: &Meant,
    wish: &Wish,
    vote_k: usize,
) -> Result<Found> {
    let (query, near) = match meant {
        Meant::Query { query, near } => (query, near),
        Meant::Place => return place::find(args, session, vote_k),
    };
    let (opened, source) = open(args, session, query)?;
    let scene = &opened.loaded.scene;
    let consumer = Consumer { network: source.is_network(), labels: true };
    let about = session.compensation(wish, &opened, &args.inference, consumer)?;
    let features = session.features(&opened, &source, &args.inference, &about)?;
    if source.is_network() && args.inference.network.is_embedded() {
        let known = session.recognize(&opened, &args.inference, &features, None)?;
        if let Some(known) = known.filter(|known| known.share(KNOWN) < LEAST_SHARE) {
            session.warn_strange(1.0 - known.share(KNOWN), "what is found is a guess");
        }
    }

    let rows = (&features, &scene.coord[..]);
    let mut found = selected(args, session, (query, near), rows, vote_k)?;
    session.note_withheld(found.withhold(about.withheld()), "selected Gaussians");
    Ok(Found { opened, remark: source.remark(), selection: found })
}

/// The Gaussians that features select; where there are none, those of what the phrase may mean as well.
pub fn selected(
    args: &Args,
    session: &Session<'_>,
    (query, near): (&Query, &[(String, Query)]),
    (features, coord): (&SceneFeatures, &[[f32; 3]]),
    vote_k: usize,
) -> Result<Selection> {
    session.receipt.setting("vote_k", vote_k, "neighbors that vote on the selection");
    let _stage = session.receipt.stage("query");
    let settings = QuerySettings {
        without: args.classes.without.clone(),
        min_score: args.classes.min_score,
        min_margin: args.classes.min_margin,
        vote_k,
    };
    let found = select(features, query, &settings, coord)?;
    if !found.is_empty() {
        return Ok(found);
    }
    for (text, other) in near {
        let other = select(features, other, &settings, coord)?;
        if !other.is_empty() {
            let how = "as near as what the phrase is taken for, which is not there";
            session.receipt.setting("taken_for", text, how);
            let phrase = shortened(&args.query);
            session.warn_loudly(format!("{phrase:?} is taken for {text:?}: {how}"));
            return Ok(other);
        }
    }
    Ok(found)
}

/// The scene and the source of its features, which fit the query.
fn open(args: &Args, session: &Session<'_>, query: &Query) -> Result<(OpenedScene, FeatureSource)> {
    let (opened, source) = session.open_with_source(
        &args.scene,
        &args.inference,
        args.features.as_deref(),
        |network| {
            if network.is_classifier() {
                refuse!("a segmentation network cannot be queried; use --config language");
            }
            check_width(network.model().out_channels(), query.width())
        },
    )?;
    // Before the network runs, which may take minutes.
    check_rivals(args, query)?;
    if let (FeatureSource::Codes, Some(code)) = (&source, &opened.loaded.scene.lang_code) {
        if args.classes.text.is_none() && args.embedding.is_none() {
            refuse!(
                "the scene carries language codes of its own: give --text or --embedding for \
                        them, or --weights embedded to use the network inside the program"
            );
        }
        check_width(code.codebook.feature_width(), query.width())?;
    }
    Ok((opened, source))
}

/// Refuses a misspelt rival, which would go on to compete.
pub fn check_rivals(args: &Args, query: &Query) -> Result<()> {
    if !args.classes.without.is_empty() {
        args.classes.options(&LabelSet::new(query.rivals.names.clone())?)?;
    }
    Ok(())
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
