//! `scenesplat evaluate`

mod args;
mod report;
mod scenes;

use crate::effects::Wish;
use crate::error::WrongUse;
use crate::session::{FeatureSource, Session};
use crate::surfaces::Asked;
use anyhow::{Result, anyhow};
pub use args::Args;
pub use report::{EVALUATION, Written, tell as tell_report};
pub use scenes::{KINDS, one_by_one};
use scenesplat::evaluation::{Evaluation, EvaluationError, Restraint, other_ids};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::{LoadedScene, label_names};
use scenesplat_lab::compensation::Consumer;
use serde_json::Value;
use std::time::Instant;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let began = Instant::now();
    let (args, vote_k) = &args.settled()?;
    let session = Session::start_network(&args.shared, &args.inference, None, line)?;
    args.claim_inputs(&session.outputs)?;
    let json = figures(args, &session, *vote_k, || session.outputs.open_folder(&[EVALUATION]))?;
    report::write(&session, json, began, args.json.as_deref())?;
    session.finish()
}

/// Scores the scenes; gives the figures, and says them. `begin` is called once all that is asked for fits together.
pub fn figures(
    args: &Args,
    session: &Session<'_>,
    vote_k: usize,
    begin: impl FnOnce() -> Result<()>,
) -> Result<Value> {
    let inputs = scenes::inputs(&args.scenes)?;
    let wish = args.wish(session, inputs.len())?;
    let source = args.source(session, inputs.len())?;
    let text = args.text_table(source.as_ref())?;
    let settings = args.settings(&text, vote_k)?;
    let excluded = settings.excluded.clone();
    let class_of = args.classes_of_labels(&text.names)?;
    let names_of_labels = class_of.as_ref().map(Vec::len);
    let mut evaluation = Evaluation::new(&text, settings)?;
    begin()?;
    args.classes.record(session)?;
    session.receipt.setting("vote_k", vote_k, "neighbors that vote on each label");
    let names: Vec<&str> = excluded.iter().map(|&c| text.names[c].as_str()).collect();
    session.receipt.setting("exclude", names.join(","), "left out of f-mIoU and f-mAcc");

    for input in &inputs {
        let mut opened = input.open(session, &args.inference)?;
        if input.is_file() {
            args.number_labels(session, &mut opened, names_of_labels.unwrap_or(text.names.len()))?;
        }
        let own = input.classes_of_labels(&text.names);
        let class_of = class_of.as_deref().or(own.as_deref());
        let source = source.as_ref().map(|source| (source, &wish));
        score(args, session, &mut evaluation, &opened, class_of, source)?;
    }
    let meaningless = source.as_ref().is_some_and(FeatureSource::has_random_weights);
    let mut json = report::tell(&evaluation.report(), &text.names, meaningless);
    json["scenes"] = serde_json::json!(inputs.len());
    json["excluded"] = serde_json::json!(excluded);
    json["vote_k"] = serde_json::json!(vote_k);
    Ok(json)
}

/// Adds a scene: its truth, which has to come through the chain, and the labels by its features and by what is done
/// about the effects of its capture.
fn score(
    args: &Args,
    session: &Session<'_>,
    evaluation: &mut Evaluation<'_>,
    opened: &OpenedScene,
    class_of: Option<&[i32]>,
    source: Option<(&FeatureSource, &Wish)>,
) -> Result<()> {
    let (scene, path) = (&opened.loaded.scene, opened.loaded.path.as_path());
    let explained = |error| explain(error, &opened.loaded);
    let truth = evaluation.truth(scene, class_of).map_err(explained)?;
    let checked = {
        let _stage = session.receipt.stage("oracle");
        session.progress.detail("oracle: the truth through the same chain");
        evaluation.check(&truth, args.break_oracle).map_err(explained)?
    };
    report::tell_oracle(session, evaluation.names(), &checked, path);
    session.check_stop()?;
    {
        let _stage = session.receipt.stage("score");
        evaluation.add_truth(&truth, &checked)?;
    }
    let Some((source, wish)) = source else { return Ok(()) };
    let consumer = Consumer { network: source.is_network(), labels: true };
    let about = session.compensation(wish, opened, &args.inference, consumer)?;
    let features = session.features(opened, source, &args.inference, &about)?;
    let is_classifier = source.classifier().is_some();
    let is_vocabulary = !is_classifier && args.has_vocabulary(source)?;
    let is_network = source.is_network();
    let asked = Asked { names: evaluation.names(), is_vocabulary, is_network, is_classifier };
    let agreeing = args.surfaces.find(session, opened, &args.inference, asked)?;
    let labels = {
        let _stage = session.receipt.stage("labels");
        let agreement = agreeing.agreement(scene, evaluation.names());
        evaluation.label_agreeing(&features, is_classifier, &agreement)?
    };
    let _stage = session.receipt.stage("score");
    let withheld = about.withheld_at(truth.places());
    let about = Restraint { voters: features.voters(), withheld: &withheld };
    let found = evaluation.add_some_labels(&truth, labels, about)?;
    if let Some(other) = other_ids(scene, &found, class_of) {
        report::tell_other_ids(session, &other, path);
    }
    Ok(())
}

/// An error with the scene, and with the flags that help.
fn explain(error: EvaluationError, loaded: &LoadedScene) -> anyhow::Error {
    let scene = loaded.path.display();
    match error {
        EvaluationError::NoLabels => match label_names(&loaded.unread) {
            Some(names) => anyhow!("{scene}: {error} (choose with --segment-name {names})"),
            None => anyhow!(
                "{scene}: {error} (choose the labels with --segment-name, the classes with --class-map)"
            ),
        },
        EvaluationError::NoVoters => {
            WrongUse(format!("--vote-valid-only: {scene} has no valid_feat_mask")).into()
        }
        EvaluationError::Fault { row } => WrongUse(format!(
            "--break-oracle {row}: choose a row with a label, in a scene with two classes"
        ))
        .into(),
        other => anyhow::Error::from(other).context(scene.to_string()),
    }
}
