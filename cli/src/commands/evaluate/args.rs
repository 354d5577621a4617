//! The flags of `evaluate`, and what they choose.

use crate::commands::classes::Classes;
use crate::commands::many::Many;
use crate::effects::{EffectArgs, Wish};
use crate::error::refuse;
use crate::flags::{Inference, Shared};
use crate::label_ids::LabelIdArgs;
use crate::outputs::Outputs;
use crate::session::{FeatureSource, Session};
use crate::surfaces::SurfaceArgs;
use anyhow::Result;
use scenesplat::Network;
use scenesplat::evaluation::{self, EvaluationSettings, background, own_directions};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{ClassMap, LabelSet, TextTable};
use scenesplat::text::class_list;
use std::path::{Path, PathBuf};

/// Labels scenes and compares with their own labels; prints and writes evaluation.json.
///
/// Before anything is reported, the truth itself goes through the same chain (each point gets the
/// text of its own class as its feature). If that oracle falls short of its analytic value by a
/// single point, the evaluation is refused.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Scenes with labels: .ply files, folders of .npy files, or synthetic:COUNT:SEED for rooms that
    /// are made on the spot, scanned:COUNT:SEED for rooms in which density and size tell no class,
    /// public:COUNT:SEED for offices, shops, wards and the like, depth:COUNT:SEED for what a depth camera leaves of
    /// both, furnished:COUNT:SEED[@PART] for rooms with the furniture of the catalogue SCENESPLAT_FURNITURE, of
    /// which PART is all, train, held_out, without:LIBRARY or only:LIBRARY.
    #[arg(required_unless_present = "manifest", value_name = "SCENE|synthetic:COUNT:SEED")]
    pub scenes: Vec<String>,
    /// Which of many scenes; with one of these flags each is evaluated by itself, for `scenesplat merge`.
    #[command(flatten)]
    pub many: Many,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Names of the labels in the scenes, one a line or as JSON; if not given, labels are rows of
    /// --text.
    #[arg(long, value_name = "FILE")]
    pub label_names: Option<PathBuf>,
    /// From where the ids of labels count.
    #[command(flatten)]
    pub label_ids: LabelIdArgs,
    /// Which class of --text each label name means (TOML or JSON); labels without one are ignored.
    #[arg(long, value_name = "FILE")]
    pub class_map: Option<PathBuf>,
    /// Classes left out of f-mIoU and f-mAcc, comma-separated.
    /// [default: those of wall, floor, ceiling that exist]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub exclude: Option<Vec<String>>,
    /// Lets only Gaussians vote that have a collected language feature (valid_feat_mask), as the
    /// original does; its numbers then depend on where labels were collected.
    #[arg(long)]
    pub vote_valid_only: bool,
    /// "oracle", or features made before (.npy, [N, D]; one scene only) instead of a network.
    #[arg(long, value_name = "oracle|FILE.npy")]
    pub features: Option<String>,
    /// Neighbors that vote on each label; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Whether surfaces have one label.
    #[command(flatten)]
    pub surfaces: SurfaceArgs,
    /// Spoils this row of the oracle with the text of another class, to see the refusal.
    #[arg(long, value_name = "ROW")]
    pub break_oracle: Option<usize>,
    /// Also writes the figures as JSON here: f_miou, f_macc, miou, macc, per_class, oracle, seconds.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// What is done about effects of the capture. Withheld labels count as wrong in one row of the table, and are
    /// left out in another.
    #[command(flatten)]
    pub effects: EffectArgs,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// In the place of features: the truth itself.
const ORACLE: &str = "oracle";

impl Args {
    /// With the parts of the setting among the flags, and how many neighbors vote.
    pub fn settled(&self) -> Result<(Self, usize)> {
        let (inference, k) = self.inference.settled(self.vote_k)?;
        Ok((Self { inference, ..self.clone() }, k))
    }

    /// Notes the files that are read, and the one that is written outside of the output folder.
    pub fn claim_inputs(&self, outputs: &Outputs) -> Result<()> {
        self.scenes.iter().try_for_each(|scene| outputs.reads(Path::new(scene)))?;
        self.classes.check_model()?;
        self.classes.claim_inputs(outputs)?;
        let features = self.features.as_deref().map(Path::new);
        outputs.reads_any([self.label_names.as_deref(), self.class_map.as_deref(), features])?;
        outputs.claim_any("--json", self.json.as_ref())
    }

    /// What to do about the effects of the captures of so many scenes.
    pub fn wish(&self, session: &Session<'_>, scenes: usize) -> Result<Wish> {
        if let (Some(path), true) = (&self.effects.effect_plan, scenes > 1) {
            refuse!("--effect-plan {} is of one scene only", path.display());
        }
        let labels = self.features.as_deref() != Some(ORACLE);
        if self.effects.effect_plan.is_some() && !labels {
            refuse!("--effect-plan is about labels; --features oracle has none");
        }
        self.effects.wish(session, self.features.is_none(), labels)
    }

    /// Where features come from; `None` if the truth alone is looked at.
    pub fn source(&self, session: &Session<'_>, scenes: usize) -> Result<Option<FeatureSource>> {
        if let (Some(features), Some(key)) = (&self.features, self.inference.network_part()) {
            refuse!("--setting {key} is about the network, which --features {features} replaces");
        }
        match self.features.as_deref() {
            Some(ORACLE) => match self.surfaces.given() {
                Some(flag) => {
                    refuse!("{flag} is about labels; --features oracle has none");
                }
                None => Ok(None),
            },
            Some(_) if scenes > 1 => {
                refuse!("--features FILE holds the features of one scene only");
            }
            Some(file) => Ok(Some(FeatureSource::File(file.into()))),
            None => {
                let network = session.network(&self.inference)?;
                Ok(Some(FeatureSource::Network(network)))
            }
        }
    }

    /// The classes.
    pub fn text_table(&self, source: Option<&FeatureSource>) -> Result<TextTable> {
        match source.and_then(FeatureSource::classifier) {
            Some(network) => self.own_classes(network),
            None => self.classes.text_table(self.inference.network.is_embedded()),
        }
    }

    /// Whether the classes are those of the built-in vocabulary.
    pub fn has_vocabulary(&self, source: &FeatureSource) -> Result<bool> {
        let is_own = source.is_network() && self.inference.network.is_embedded();
        Ok(match &self.classes.text {
            Some(_) => self.classes.vocabulary()?.is_some(),
            None => is_own,
        })
    }

    /// The classes of a segmentation network.
    fn own_classes(&self, network: &Network) -> Result<TextTable> {
        let count = network.model().out_channels();
        let Some(path) = &self.classes.text_names else {
            refuse!("--text-names is missing: the names of the network's classes, one a line");
        };
        let names = read_names(path)?;
        if names.len() != count || self.classes.text.is_some() {
            refuse!(
                "a segmentation network takes no --text, and --text-names with {count} names; got {}",
                names.len()
            );
        }
        Ok(own_directions(names)?)
    }

    /// How scenes are scored.
    pub fn settings(&self, text: &TextTable, vote_k: usize) -> Result<EvaluationSettings> {
        let set = LabelSet::new(text.names.clone())?;
        let excluded = match &self.exclude {
            Some(names) => class_list(&set, names)?,
            None => background(&set),
        };
        Ok(EvaluationSettings {
            excluded,
            options: self.classes.options(&set)?,
            vote_k,
            voters_with_feature: self.vote_valid_only,
            keeps_unknown: self.surfaces.min_probability.is_some(),
            seed: self.inference.seed,
        })
    }

    /// Makes the labels of a scene's file rows of so many names.
    pub fn number_labels(
        &self,
        session: &Session<'_>,
        opened: &mut OpenedScene,
        names: usize,
    ) -> Result<()> {
        let found = self.label_ids.number(session, opened, names)?;
        // Without a list of names, ids that are no class are of another list.
        if let (None, Some(text)) = (&self.label_names, found.unnamed_text()) {
            let scene = opened.loaded.path.display();
            anyhow::bail!("{scene}: {text}; give the names with --label-names");
        }
        Ok(())
    }

    /// Class of --text for each label of the scenes, if the labels have names.
    pub fn classes_of_labels(&self, classes: &[String]) -> Result<Option<Vec<i32>>> {
        let Some(path) = &self.label_names else {
            if self.class_map.is_some() {
                refuse!("--class-map needs --label-names");
            }
            return Ok(None);
        };
        let labels = read_names(path)?;
        let map = self.class_map.as_deref().map(ClassMap::read).transpose()?;
        Ok(Some(evaluation::classes_of_labels(&labels, map.as_ref(), classes)?))
    }
}
