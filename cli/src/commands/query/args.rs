//! The flags of `query`, and what they ask for.

use crate::budget::BudgetArgs;
use crate::commands::classes::Classes;
use crate::effects::EffectArgs;
use crate::flags::{Inference, PreviewArgs, Shared};
use std::path::PathBuf;

/// Writes scores.npy (cosine with the query), selection.npy (0 or 1), query.ply (a heat map with
/// score and label columns), preview.png and a receipt; prints where the object is.
///
/// For the network inside the program the query is any phrase: what its vocabulary knows ("red chair",
/// "furniture") is looked for as such, anything else as the class that is most like it, which is said. With --text it is
/// the name of a row, or, with --text-model, any phrase: SigLIP 2 reads it for networks that were trained with it, and a
/// sentence encoder guesses its vector; or any text whose embedding is given by --embedding.
/// A Gaussian is selected when the query scores best among all rows of --text (if there are
/// several), its score reaches --min-score, and most of its neighbors agree.
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
    /// Neighbors that vote on the selection; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian, such as
    /// lang_feat.npy of lift-labels or features.npy; or segment_index.npy of lift-labels, with segment_features.npy beside it.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
    /// The picture.
    #[command(flatten)]
    pub preview: PreviewArgs,
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
