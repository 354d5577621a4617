//! `scenesplat segment`

use super::answer::{self, certainty};
use super::labelled::{Labelled, Labelling};
use super::many::OneOrMany;
use super::objects::{OBJECT_FILES, summary, write_objects};
use crate::budget::{BudgetArgs, Job, within_budget};
use crate::flags::{PreviewArgs, Shared};
use crate::frame::frame;
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::objects::ObjectSettings;
use scenesplat::outputs::{ResultColumns, label_colors, legend, write_colored_ply};

/// Writes labels.npy, scores.npy, segmented.ply (class colors, label and score columns),
/// classes.json, preview.png and a receipt.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Which scenes.
    #[command(flatten)]
    pub input: OneOrMany,
    /// What labels it.
    #[command(flatten)]
    pub labelling: Labelling,
    /// Also writes instances.npy, objects.json and objects.csv: the objects that the labels make, with boxes.
    #[arg(long)]
    pub instances: bool,
    /// The picture.
    #[command(flatten)]
    pub preview: PreviewArgs,
    /// What the setting is chosen by.
    #[command(flatten)]
    pub budget: BudgetArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    label(args, line)?;
    if !args.shared.running.quiet {
        let lines = ["view SCENE", "objects SCENE", "query SCENE \"chair\""];
        print(&answer::next(&args.input.scene, &lines));
    }
    Ok(())
}

/// Labels a scene, and prints what came of it.
pub fn label(args: &Args, line: &str) -> Result<()> {
    let Labelling { vote_k, features, inference, .. } = &args.labelling;
    let job = Job {
        command: "segment",
        scene: &args.input.scene,
        inference,
        vote_k: *vote_k,
        features: features.as_deref(),
    };
    let (inference, vote_k, chosen) =
        within_budget(&args.budget, args.shared.running.threads, &job)?;
    let session = Session::start_network(&args.shared, &inference, chosen, line)?;
    let labelling = Labelling { inference, vote_k: Some(vote_k), ..args.labelling.clone() };
    session.outputs.reads(&args.input.scene)?;
    let wish = labelling.wish(&session)?;
    labelling.classes.check_model()?;
    labelling.classes.claim_inputs(&session.outputs)?;
    let names = ["labels.npy", "scores.npy", "classes.json", "segmented.ply", "preview.png"];
    let more: &[&str] = if args.instances { &OBJECT_FILES } else { &[] };
    session.outputs.open_folder(&[&names[..], more].concat())?;
    let labelled = labelling.run(&session, &args.input.scene, &wish)?;
    let Labelled { opened, labels, names, remark, .. } = &labelled;
    {
        let _stage = session.receipt.stage("write");
        session.write_rows("labels.npy", opened, labels, -1)?;
        let scores = labelled.scores.as_deref();
        session.write_rows("scores.npy", opened, scores.unwrap_or_default(), 0.0)?;
        session.write_text("classes.json", &serde_json::to_string_pretty(names)?)?;
        session.write("segmented.ply", |path| {
            let warnings = &session.doubts();
            let columns = ResultColumns { label: Some(labels), score: scores, warnings };
            write_colored_ply(opened, &label_colors(labels), &columns, path)
        })?;
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    {
        let _stage = session.receipt.stage("picture");
        let (scene, colors) = (&opened.loaded.scene, label_colors(labels));
        let name = args.input.name();
        let title = format!("{name}: labels{remark}");
        let up = session.up(opened, &labelling.inference);
        session.write_preview(scene, &colors, &legend(labels, names), title, up, args.preview)?;
    }
    if args.instances {
        let frame = frame(&session, opened, &labelling.inference);
        let found = labelled.objects(&session, &ObjectSettings::default(), false, frame)?;
        write_objects(&session, &labelled, &found)?;
        print(&summary(&found));
    }
    session.tell(answer::labels(&args.input.name(), labels, names));
    certainty(&session).iter().for_each(|text| session.tell(text));
    session.finish()
}
