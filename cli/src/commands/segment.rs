//! `scenesplat segment`

use super::WrongUse;
use crate::flags::{Inference, Shared};
use crate::outputs::Outputs;
use crate::session::{FeatureSource, Session};
use crate::terminal::write_text;
use anyhow::Result;
use scenesplat::labels::{self, label_with_vote};
use scenesplat::metrics::{UnknownRule, ZeroShotOptions};
use scenesplat::outputs::{
    ResultColumns, label_colors, legend, write_colored_ply, write_scene_preview,
};
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{LabelSet, TextTable};
use scenesplat::text::{class_list, read_text_table};
use std::path::{Path, PathBuf};

/// Writes labels.npy, scores.npy, segmented.ply (class colours, label and score columns),
/// classes.json, preview.png and a receipt.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Neighbours that vote on each label; 0 or 1 for no vote.
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

/// Which classes compete, and when none wins.
#[derive(Debug, clap::Args)]
pub struct Classes {
    /// Text embeddings of the classes: .safetensors or .pt; or `vocabulary`, the words of the
    /// synthetic rooms (`vocabulary:768` for a network of that width). By default, for the network
    /// inside the program, the classes it knows.
    #[arg(long, value_name = "FILE|vocabulary[:D]")]
    pub text: Option<PathBuf>,
    /// Names of the rows of --text, one a line, where the file has none.
    #[arg(long, value_name = "FILE")]
    pub text_names: Option<PathBuf>,
    /// Classes that may not be predicted, comma-separated.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub without: Vec<String>,
    /// Leaves Gaussians unlabelled whose best cosine (or probability, for a classifier) is below
    /// this.
    #[arg(long, value_name = "COS", allow_hyphen_values = true)]
    pub min_score: Option<f32>,
    /// Leaves Gaussians unlabelled whose best cosine (or probability) leads the second by less than
    /// this.
    #[arg(long, value_name = "COS")]
    pub min_margin: Option<f32>,
}

impl Classes {
    /// Notes the files that the choice is read from.
    pub fn claim_inputs(&self, outputs: &Outputs) -> Result<()> {
        outputs.reads_any([self.text.as_deref(), self.text_names.as_deref()])
    }

    /// The texts: those given, or the vocabulary of the network inside the program, or a hint what
    /// to give.
    pub fn text_table(&self, embedded: bool) -> Result<TextTable> {
        match &self.text {
            Some(path) => match self.vocabulary()? {
                Some(vocabulary) => Ok(vocabulary.class_table()),
                None => read_text_table(path, self.text_names.as_deref()),
            },
            None if embedded => Ok(scenesplat::embedded::vocabulary()?.class_table()),
            None => Err(WrongUse(
                "--text is missing: give the text embeddings of the classes (.safetensors or .pt), \
                 or --text vocabulary for a network that was trained with the built-in one"
                    .to_owned(),
            )
            .into()),
        }
    }

    /// The built-in vocabulary, if --text asks for it: `vocabulary` has the width of the network
    /// inside the program, `vocabulary:D` the width D.
    pub fn vocabulary(&self) -> Result<Option<Vocabulary>> {
        let Some(text) = self.text.as_deref().and_then(Path::to_str) else { return Ok(None) };
        match text.strip_prefix("vocabulary") {
            Some("") => scenesplat::embedded::vocabulary().map(Some),
            Some(dim) if dim.starts_with(':') => {
                let dim = dim[1..].parse().map_err(|_| {
                    WrongUse(format!(
                        "--text {text}: the width must be a number, as in vocabulary:96"
                    ))
                })?;
                let built = Vocabulary::new(dim);
                Ok(Some(built.map_err(|e| WrongUse(format!("--text {text}: {e}")))?))
            }
            _ => Ok(None),
        }
    }

    /// Notes in the receipt what changes the result.
    pub fn record(&self, session: &Session<'_>) -> Result<()> {
        let receipt = &session.receipt;
        match (&self.text, self.vocabulary()?) {
            (Some(_), Some(vocabulary)) => {
                let text = format!("vocabulary:{}", vocabulary.dim());
                receipt.setting("text", text, "words of the synthetic rooms");
            }
            (Some(path), None) => receipt.fingerprint("text", path)?,
            (None, _) => {}
        }
        if !self.without.is_empty() {
            receipt.setting("without", self.without.join(","), "classes that may not be predicted");
        }
        if let Some(min) = self.min_score {
            receipt.setting("min_score", min, "lower scores stay unknown");
        }
        if let Some(min) = self.min_margin {
            receipt.setting("min_margin", min, "smaller leads stay unknown");
        }
        Ok(())
    }

    /// Settings of the classification.
    pub fn options(&self, labels: &LabelSet) -> Result<ZeroShotOptions> {
        let candidates = if self.without.is_empty() {
            None
        } else {
            let barred = class_list(labels, &self.without)?;
            Some((0..labels.len()).map(|c| !barred.contains(&c)).collect())
        };
        let unknown = UnknownRule { min_cosine: self.min_score, min_margin: self.min_margin };
        Ok(ZeroShotOptions { unknown, candidates })
    }
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start_with(&args.shared, &args.inference.network, line)?;
    session.outputs.reads(&args.scene)?;
    args.classes.claim_inputs(&session.outputs)?;
    let names = ["labels.npy", "scores.npy", "classes.json", "segmented.ply", "preview.png"];
    session.make_out(&names)?;
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
        if args.classes.text.is_some() {
            let text = "--text is for language networks; name the classes with --text-names";
            return Err(WrongUse(text.to_owned()).into());
        }
        let count = network.model().out_channels();
        let names = match &args.classes.text_names {
            Some(path) => read_names(path)?,
            None => (0..count).map(|i| format!("class {i}")).collect(),
        };
        if names.len() != count {
            let text = format!("--text-names: {} names for {count} classes", names.len());
            return Err(WrongUse(text).into());
        }
        (LabelSet::new(names)?, None)
    } else {
        let own = embedded && matches!(source, FeatureSource::Network(_));
        let text = table.map_or_else(|| args.classes.text_table(own), Ok)?;
        (LabelSet::new(text.names.clone())?, Some(text))
    };
    let options = args.classes.options(&labels_of)?;
    args.classes.record(&session)?;
    let scene = &opened.loaded.scene;
    let features = session.features(&opened, &source, &args.inference)?;

    let classes = match &text {
        Some(text) => labels::Classes::Texts(text),
        None => labels::Classes::Probabilities(labels_of.len()),
    };
    let found = {
        let _stage = session.receipt.stage("labels");
        session.receipt.setting("vote_k", args.vote_k, "neighbours that vote on each label");
        label_with_vote(&features, classes, &options, &scene.coord, args.vote_k)?
    };
    if found.num_withheld + found.num_unusable > 0 {
        session.progress.say(format!(
            "{} voxels unknown by the thresholds, {} without a usable feature",
            found.num_withheld, found.num_unusable
        ));
    }
    let (labels, scores) = (found.labels, found.scores);
    session.check_stop()?;
    {
        let _stage = session.receipt.stage("write");
        let rows = opened.loaded.source_rows();
        let path = session.out("labels.npy")?;
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&labels, -1)?)?;
        session.wrote(&path, (rows * 4 + 128) as u64);
        let path = session.out("scores.npy")?;
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&scores, 0.0)?)?;
        session.wrote(&path, (rows * 4 + 128) as u64);
        let path = session.out("classes.json")?;
        let bytes = write_text(&path, &serde_json::to_string_pretty(&labels_of.names)?)?;
        session.wrote(&path, bytes);
        let path = session.out("segmented.ply")?;
        let columns = ResultColumns { label: Some(&labels), score: Some(&scores) };
        let bytes = write_colored_ply(&opened, &label_colors(&labels), &columns, &path)?;
        session.wrote(&path, bytes);
        session.receipt.add_rows_out(rows);
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
    session.finish()
}
