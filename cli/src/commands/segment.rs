//! `scenesplat segment`

use super::classes::Classes;
use super::labelled::{Labelled, Labelling, StrangeArgs, frame};
use super::many::Many;
use super::objects::{OBJECT_FILES, summary, write_objects};
use crate::budget::{BudgetArgs, Chosen, Job, within_budget};
use crate::effects::EffectArgs;
use crate::flags::{Inference, Shared};
use crate::session::Session;
use crate::surfaces::SurfaceArgs;
use crate::terminal::{print, write_text};
use anyhow::Result;
use clap::ArgAction;
use scenesplat::objects::ObjectSettings;
use scenesplat::outputs::{
    ResultColumns, label_colors, legend, write_colored_ply, write_scene_preview,
};
use std::path::PathBuf;

/// Writes labels.npy, scores.npy, segmented.ply (class colours, label and score columns),
/// classes.json, preview.png and a receipt.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The scene, in any format; several get a folder in --out each.
    #[arg(num_args = 1.., action = ArgAction::Append, required = false, required_unless_present = "manifest")]
    pub scene: PathBuf,
    /// Which of many scenes.
    #[command(flatten)]
    pub many: Many,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Neighbours that vote on each label; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian, such as
    /// lang_feat.npy of lift-labels or features.npy.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
    /// Also writes instances.npy, objects.json and objects.csv: the objects that the labels make, with boxes.
    #[arg(long)]
    pub instances: bool,
    /// Whether surfaces have one label.
    #[command(flatten)]
    pub surfaces: SurfaceArgs,
    /// What becomes of strange scenes.
    #[command(flatten)]
    pub strange: StrangeArgs,
    /// What the setting is chosen by.
    #[command(flatten)]
    pub budget: BudgetArgs,
    /// What is done about effects of the capture.
    #[command(flatten)]
    pub effects: EffectArgs,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

impl Args {
    /// The setting that a budget chooses, if there is one, and the flags with it.
    fn chosen(&self) -> Result<(Self, Option<Chosen>)> {
        let job = Job {
            command: "segment",
            scene: &self.scene,
            inference: &self.inference,
            vote_k: self.vote_k,
            features: self.features.as_deref(),
        };
        let (inference, chosen) = within_budget(&self.budget, self.shared.threads, &job)?;
        Ok((Self { inference, ..self.clone() }, chosen))
    }

    /// With the parts of the setting among the flags, and how many neighbours vote.
    fn settled(&self) -> Result<(Self, usize)> {
        let (inference, k) = self.inference.settled(self.vote_k)?;
        Ok((Self { inference, ..self.clone() }, k))
    }
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let (args, chosen) = args.chosen()?;
    let (args, vote_k) = &args.settled()?;
    let session = Session::start_with(&args.shared, &args.inference.network, line)?;
    session.note_setting(&args.inference);
    session.note_budget(chosen);
    session.outputs.reads(&args.scene)?;
    let wish = args.effects.wish(&session, args.features.is_none(), true)?;
    args.classes.claim_inputs(&session.outputs)?;
    let names = ["labels.npy", "scores.npy", "classes.json", "segmented.ply", "preview.png"];
    let more: &[&str] = if args.instances { &OBJECT_FILES } else { &[] };
    session.make_out(&[&names[..], more].concat())?;
    let labelling = Labelling {
        scene: &args.scene,
        classes: &args.classes,
        features: args.features.as_deref(),
        surfaces: args.surfaces,
        strange: args.strange,
        inference: &args.inference,
        vote_k: *vote_k,
    };
    let labelled = labelling.run(&session, &wish)?;
    let Labelled { opened, labels, names, remark, .. } = &labelled;
    let scene = &opened.loaded.scene;
    {
        let _stage = session.receipt.stage("write");
        session.write_rows("labels.npy", opened, labels, -1)?;
        let scores = labelled.scores.as_deref();
        session.write_rows("scores.npy", opened, scores.unwrap_or_default(), 0.0)?;
        let path = session.out("classes.json")?;
        let bytes = write_text(&path, &serde_json::to_string_pretty(names)?)?;
        session.wrote(&path, bytes);
        let path = session.out("segmented.ply")?;
        let columns = ResultColumns { label: Some(labels), score: scores };
        let bytes = write_colored_ply(opened, &label_colors(labels), &columns, &path)?;
        session.wrote(&path, bytes);
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    {
        let _stage = session.receipt.stage("picture");
        let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
        let path = session.out("preview.png")?;
        let bytes = write_scene_preview(
            scene,
            &label_colors(labels),
            &legend(labels, names),
            &format!("{name}: labels{remark}"),
            session.up(scene, &args.inference),
            &path,
        )?;
        session.wrote(&path, bytes);
    }
    if args.instances {
        let frame = frame(opened, &args.inference);
        let found = labelled.objects(&session, &ObjectSettings::default(), false, frame)?;
        write_objects(&session, &labelled, &found)?;
        print(&summary(&found));
    }
    session.finish()
}
