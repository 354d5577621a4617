//! `scenesplat segment`

use super::WrongUse;
use super::classes::Classes;
use super::labelled::{Labelled, frame};
use super::objects::{OBJECT_FILES, summary, write_objects};
use crate::budget::{BudgetArgs, Chosen, Job, within_budget};
use crate::effects::EffectArgs;
use crate::flags::{Inference, Shared};
use crate::session::{FeatureSource, Session};
use crate::terminal::{print, write_text};
use anyhow::Result;
use scenesplat::Network;
use scenesplat::compensation::Consumer;
use scenesplat::labels::{self, label_with_vote};
use scenesplat::objects::ObjectSettings;
use scenesplat::outputs::{
    ResultColumns, label_colors, legend, write_colored_ply, write_scene_preview,
};
use scenesplat::scene::LabelSet;
use scenesplat::scene::label_set::read_names;
use std::path::PathBuf;

/// Writes labels.npy, scores.npy, segmented.ply (class colours, label and score columns),
/// classes.json, preview.png and a receipt.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
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
    // A bad table is better found before the scene is read.
    let table = match &args.classes.text {
        Some(_) => Some(args.classes.text_table(false)?),
        None => None,
    };
    let embedded = args.inference.network.is_embedded();
    let (opened, source) = session.open_with_source(
        &args.scene,
        &args.inference,
        args.features.as_deref(),
        |network| {
            let needed = !network.is_classifier() && table.is_none();
            if needed { args.classes.text_table(embedded).map(drop) } else { Ok(()) }
        },
    )?;
    let (labels_of, text) = if let Some(network) = source.classifier() {
        (own_classes(&args.classes, network)?, None)
    } else {
        let own = embedded && matches!(source, FeatureSource::Network(_));
        let text = table.map_or_else(|| args.classes.text_table(own), Ok)?;
        (LabelSet::new(text.names.clone())?, Some(text))
    };
    let options = args.classes.options(&labels_of)?;
    args.classes.record(&session)?;
    let scene = &opened.loaded.scene;
    let consumer = Consumer { network: source.is_network(), labels: true };
    let about = session.compensation(&wish, scene, &args.inference, consumer)?;
    let features = session.features(&opened, &source, &args.inference, &about)?;

    let classes = match &text {
        Some(text) => labels::Classes::Texts(text),
        None => labels::Classes::Probabilities(labels_of.len()),
    };
    let mut found = {
        let _stage = session.receipt.stage("labels");
        session.receipt.setting("vote_k", vote_k, "neighbours that vote on each label");
        label_with_vote(&features, classes, &options, &scene.coord, *vote_k)?
    };
    if found.num_withheld + found.num_unusable > 0 {
        session.progress.say(format!(
            "{} voxels unknown by the thresholds, {} without a usable feature",
            found.num_withheld, found.num_unusable
        ));
    }
    session.note_withheld(found.withhold(about.withheld()), "labels");
    let (labels, scores) = (found.labels, found.scores);
    session.check_stop()?;
    {
        let _stage = session.receipt.stage("write");
        session.write_rows("labels.npy", &opened, &labels, -1)?;
        session.write_rows("scores.npy", &opened, &scores, 0.0)?;
        let path = session.out("classes.json")?;
        let bytes = write_text(&path, &serde_json::to_string_pretty(&labels_of.names)?)?;
        session.wrote(&path, bytes);
        let path = session.out("segmented.ply")?;
        let columns = ResultColumns { label: Some(&labels), score: Some(&scores) };
        let bytes = write_colored_ply(&opened, &label_colors(&labels), &columns, &path)?;
        session.wrote(&path, bytes);
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    {
        let _stage = session.receipt.stage("picture");
        let name = args.scene.file_name().unwrap_or_default().to_string_lossy();
        let path = session.out("preview.png")?;
        let bytes = write_scene_preview(
            scene,
            &label_colors(&labels),
            &legend(&labels, &labels_of.names),
            &format!("{name}: labels{}", source.remark()),
            session.up(scene, &args.inference),
            &path,
        )?;
        session.wrote(&path, bytes);
    }
    if args.instances {
        let text = text.map(|text| (features, text));
        let (up, metres_per_unit) = frame(&opened, &args.inference);
        let is_vocabulary = false;
        let labelled = Labelled {
            opened,
            labels,
            scores: Some(scores),
            names: labels_of.names,
            features: text,
            is_vocabulary,
            remark: source.remark(),
            up,
            metres_per_unit,
        };
        let found = labelled.objects(&session, &ObjectSettings::default(), false)?;
        write_objects(&session, &labelled, &found)?;
        print(&summary(&found));
    }
    session.finish()
}

/// The classes of a segmentation network, by number where they have no names.
pub(super) fn own_classes(classes: &Classes, network: &Network) -> Result<LabelSet> {
    if classes.text.is_some() {
        let text = "--text is for language networks; name the classes with --text-names";
        return Err(WrongUse(text.to_owned()).into());
    }
    let count = network.model().out_channels();
    let names = match &classes.text_names {
        Some(path) => read_names(path)?,
        None => (0..count).map(|i| format!("class {i}")).collect(),
    };
    if names.len() != count {
        let text = format!("--text-names: {} names for {count} classes", names.len());
        return Err(WrongUse(text).into());
    }
    Ok(LabelSet::new(names)?)
}
