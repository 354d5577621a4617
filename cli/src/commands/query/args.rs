//! The flags of `query`, and what they ask for.

use crate::budget::{BudgetArgs, Chosen, Job, within_budget};
use crate::commands::WrongUse;
use crate::commands::classes::Classes;
use crate::effects::EffectArgs;
use crate::flags::{Inference, Shared};
use anyhow::Result;
use scenesplat::query::Query;
use scenesplat::scene::label_set::nearest_names;
use scenesplat::text::read_text_vector;
use std::path::PathBuf;

/// Writes scores.npy (cosine with the query), selection.npy (0 or 1), query.ply (a heat map with
/// score and label columns), preview.png and a receipt; prints where the object is.
///
/// The query is the name of a row of --text, or any text whose embedding is given by --embedding;
/// for the network inside the program, what its vocabulary knows ("red chair", "furniture").
/// A Gaussian is selected when the query scores best among all rows of --text (if there are
/// several), its score reaches --min-score, and most of its neighbours agree.
#[derive(Debug, Clone, clap::Args)]
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
    /// Neighbours that vote on the selection; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian, such as
    /// lang_feat.npy of lift-labels or features.npy.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
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
    pub fn chosen(&self) -> Result<(Self, Option<Chosen>)> {
        let job = Job {
            command: "query",
            scene: &self.scene,
            inference: &self.inference,
            vote_k: self.vote_k,
            features: self.features.as_deref(),
        };
        let (inference, chosen) = within_budget(&self.budget, self.shared.threads, &job)?;
        Ok((Self { inference, ..self.clone() }, chosen))
    }

    /// With the parts of the setting among the flags, and how many neighbours vote.
    pub fn settled(&self) -> Result<(Self, usize)> {
        let (inference, k) = self.inference.settled(self.vote_k)?;
        Ok((Self { inference, ..self.clone() }, k))
    }
}

/// What is asked for, with its rivals.
pub fn query(args: &Args) -> Result<Query> {
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
    let vector = read_text_vector(path)?;
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
