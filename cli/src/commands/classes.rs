//! Flags that choose classes: of `segment`, `query` and `evaluate`.

use crate::error::{WrongUse, refuse};
use crate::outputs::Outputs;
use crate::session::Session;
use anyhow::{Result, anyhow};
use scenesplat::metrics::{UnknownRule, ZeroShotOptions};
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{LabelSet, TextTable};
use scenesplat::text::{TextError, class_list, read_text_table};
use scenesplat::text_model::{TextModel, TextModelError};
use std::path::{Path, PathBuf};

/// Which classes compete, and when none wins.
#[derive(Debug, Clone, clap::Args)]
pub struct Classes {
    /// Text embeddings of the classes: .safetensors or .pt; or `vocabulary`, the words of the
    /// synthetic rooms (`vocabulary:768` for a network of that width). By default, for the network
    /// inside the program, the classes it knows. With --text-model also a file of names, one a line or as JSON.
    #[arg(long, value_name = "FILE|vocabulary[:D]")]
    pub text: Option<PathBuf>,
    /// Names of the rows of --text, one a line, where the file has none.
    #[arg(long, value_name = "FILE")]
    pub text_names: Option<PathBuf>,
    /// Folder of a text model that reads the names of --text: SigLIP 2 (siglip2-base-patch16-512) for networks that were
    /// trained with it, or a sentence encoder (all-MiniLM-L6-v2). In `query` it reads any phrase.
    #[arg(long, value_name = "DIR")]
    pub text_model: Option<PathBuf>,
    /// What SigLIP reads a name in; several are averaged. [default: "this is a {}"]
    #[arg(long, value_name = "TEXT", requires = "text_model")]
    pub template: Vec<String>,
    /// Classes that may not be predicted, comma-separated.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub without: Vec<String>,
    /// Leaves Gaussians unlabeled whose best cosine (or probability, for a classifier) is below
    /// this.
    #[arg(long, value_name = "COS", allow_hyphen_values = true)]
    pub min_score: Option<f32>,
    /// Leaves Gaussians unlabeled whose best cosine (or probability) leads the second by less than
    /// this.
    #[arg(long, value_name = "COS")]
    pub min_margin: Option<f32>,
}

impl Classes {
    /// Notes the files that the choice is read from.
    pub fn claim_inputs(&self, outputs: &Outputs) -> Result<()> {
        let Self { text, text_names, text_model, .. } = self;
        outputs.reads_any([text.as_deref(), text_names.as_deref(), text_model.as_deref()])
    }

    /// Refuses a text model that has no names to read.
    pub fn check_model(&self) -> Result<()> {
        if self.text_model.is_some() && !self.is_list()? {
            let given = match &self.text {
                Some(path) => format!("{} is none", path.display()),
                None => "--text is missing".to_owned(),
            };
            refuse!(
                "--text-model reads the names of --text, a file with one a line or as JSON; {given}"
            );
        }
        Ok(())
    }

    /// The text model, if there is one.
    pub fn model(&self) -> Result<Option<TextModel>> {
        self.text_model.as_deref().map(|dir| open_text_model(dir, &self.template)).transpose()
    }

    /// Whether --text is a list of names, which the text model reads.
    pub fn is_list(&self) -> Result<bool> {
        let Some(path) = &self.text else { return Ok(false) };
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let is_table = ["safetensors", "pt", "pth"].contains(&ending);
        Ok(self.text_model.is_some() && !is_table && self.vocabulary()?.is_none())
    }

    /// The texts: those given, or the vocabulary of the network inside the program, or a hint what
    /// to give.
    pub fn text_table(&self, embedded: bool) -> Result<TextTable> {
        match &self.text {
            Some(path) => match self.vocabulary()? {
                Some(vocabulary) => Ok(vocabulary.class_table()),
                None if self.is_list()? => match self.model()? {
                    Some(model) => self.read_by(&model, path),
                    None => refuse!("--text-model is missing"),
                },
                None if path.extension().is_some_and(|e| e == "txt" || e == "json") => refuse!(
                    "--text {}: a list of names needs --text-model DIR, which reads them; without one give their vectors \
                     (.safetensors or .pt)",
                    path.display()
                ),
                None => match read_text_table(path, self.text_names.as_deref()) {
                    Err(error @ TextError::NoNames { .. }) => {
                        Err(anyhow!("{error}: give it with --text-names FILE"))
                    }
                    read => Ok(read?),
                },
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

    /// The names of a file as a model reads them.
    pub fn read_by(&self, model: &TextModel, path: &Path) -> Result<TextTable> {
        if self.text_names.is_some() {
            refuse!(
                "--text-names is for a table without names; --text {} has them",
                path.display()
            );
        }
        let (table, cut) = model.table(read_names(path)?)?;
        if let Some(&first) = cut.first() {
            let name: String = table.names[first].chars().take(60).collect();
            refuse!("{}: {name:?}… is longer than the text model reads", path.display());
        }
        Ok(table)
    }

    /// The built-in vocabulary, if --text asks for it: `vocabulary` has the width of the network
    /// inside the program, `vocabulary:D` the width D.
    pub fn vocabulary(&self) -> Result<Option<Vocabulary>> {
        let Some(text) = self.text.as_deref().and_then(Path::to_str) else { return Ok(None) };
        match text.strip_prefix("vocabulary") {
            Some("") => Ok(Some(scenesplat::embedded::vocabulary()?)),
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
        if let Some(folder) = &self.text_model {
            receipt.fingerprint("text_model", folder)?;
        }
        if !self.template.is_empty() {
            receipt.setting("template", self.template.join(" | "), "what names are read in");
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

/// The text model of a folder, with what it reads names in.
pub fn open_text_model(folder: &Path, templates: &[String]) -> Result<TextModel> {
    TextModel::open(folder, templates).map_err(|error| match error {
        TextModelError::Template { .. } => WrongUse(format!("--template: {error}")).into(),
        other => other.into(),
    })
}
