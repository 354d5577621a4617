//! Flags that choose classes: of `segment`, `query` and `evaluate`.

use crate::error::WrongUse;
use crate::outputs::Outputs;
use crate::session::Session;
use anyhow::{Result, anyhow};
use scenesplat::metrics::{UnknownRule, ZeroShotOptions};
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::{LabelSet, TextTable};
use scenesplat::text::{TextError, class_list, read_text_table};
use std::path::{Path, PathBuf};

/// Which classes compete, and when none wins.
#[derive(Debug, Clone, clap::Args)]
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
        outputs.reads_any([self.text.as_deref(), self.text_names.as_deref()])
    }

    /// The texts: those given, or the vocabulary of the network inside the program, or a hint what
    /// to give.
    pub fn text_table(&self, embedded: bool) -> Result<TextTable> {
        match &self.text {
            Some(path) => match self.vocabulary()? {
                Some(vocabulary) => Ok(vocabulary.class_table()),
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
