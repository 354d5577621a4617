//! A scene with labels: of a network, of features, or its own. What `segment`, `objects` and `view` begin with.

use super::classes::Classes;
use crate::effects::{EffectArgs, Wish};
use crate::error::{WrongUse, refuse};
use crate::flags::Inference;
use crate::frame::Frame;
use crate::label_ids::LabelIdArgs;
use crate::session::{FeatureSource, Session};
use crate::setting::VOTE_K;
use crate::surfaces::{Agreeing, Asked, SurfaceArgs};
use anyhow::{Context, Result};
use scenesplat::effect_costs::FoundEffect;
use scenesplat::labels::{self, label_agreeing_with_vote};
use scenesplat::objects::surfaces::SceneSurfaces;
use scenesplat::objects::{Catalogue, ObjectInput, ObjectSettings, find_objects};
use scenesplat::outputs::OpenedScene;
use scenesplat::recognition::{KNOWN, SURE};
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{LabelSet, ReadOptions, TextTable, label_names};
use scenesplat::taught::taught_labels;
use scenesplat::{Network, SceneFeatures};
use scenesplat_lab::compensation::Consumer;
use std::path::{Path, PathBuf};

/// How a network, or features made before, label a scene.
#[derive(Debug, Clone, clap::Args)]
pub struct Labelling {
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Neighbors that vote on each label; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian, such as
    /// lang_feat.npy of lift-labels or features.npy; or segment_index.npy of lift-labels, with segment_features.npy beside it.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
    /// The folder that collect-labels --teacher wrote for this scene: what the teacher names there overrules the labels.
    #[arg(long, value_name = "DIR")]
    pub taught: Option<PathBuf>,
    /// Whether surfaces have one label.
    #[command(flatten)]
    pub surfaces: SurfaceArgs,
    /// What becomes of surfaces, or of a whole scene, that look like nothing the network inside the program was
    /// trained on (a garden, a bicycle): they are labeled all the same, or stay unknown. [default: auto]
    #[arg(long, value_name = "WHAT")]
    pub strange: Option<Strange>,
    /// What is done about effects of the capture.
    #[command(flatten)]
    pub effects: EffectArgs,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
}

/// Where labels come from, and what is an object.
#[derive(Debug, Clone, clap::Args)]
pub struct LabelArgs {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Takes the labels that the scene carries, whose names these are (one a line, or a JSON list), instead of a network.
    #[arg(long, value_name = "FILE", conflicts_with = "features")]
    pub label_names: Option<PathBuf>,
    /// From where the ids of those labels count.
    #[command(flatten)]
    pub label_ids: LabelIdArgs,
    /// Looks for objects even where the scene carries instances.
    #[arg(long)]
    pub pieces: bool,
    /// Fewest Gaussians of an object.
    #[arg(long, value_name = "N", default_value_t = MIN_COUNT)]
    pub min_count: usize,
    /// Gaussians of a class this near to each other, meters, belong together; by default 2.5 spacings of the class.
    #[arg(long, value_name = "M", value_parser = crate::flags::parse_positive)]
    pub gap: Option<f64>,
    /// What labels it otherwise.
    #[command(flatten)]
    pub labelling: Labelling,
}

/// Fewest Gaussians of an object.
pub const MIN_COUNT: usize = 20;

/// A smaller share of a scene that stays unknown is only counted.
const WORTH_A_WARNING: f64 = 0.02;

/// Labels all the same, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Strange {
    /// No label where a surface is probably strange; none at all where most of the scene is.
    Auto,
    /// The nearest class of each Gaussian, and a warning.
    Label,
    /// No label where a surface may be strange.
    Unknown,
}

/// What gave the labels of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LabelOrigin {
    /// The scene carries them.
    Scene,
    /// The network inside the program.
    Embedded,
    /// Another network.
    Network,
    /// Features of a file.
    Features,
}

impl LabelOrigin {
    /// As files say it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Embedded => "embedded network",
            Self::Network => "network",
            Self::Features => "features",
        }
    }
}

/// A scene with labels.
pub struct Labelled {
    /// The scene.
    pub opened: OpenedScene,
    /// Class of each Gaussian, −1 = none.
    pub labels: Vec<i32>,
    /// How sure it is.
    pub scores: Option<Vec<f32>>,
    /// Names of the classes.
    pub names: Vec<String>,
    /// Features with the texts of the classes, where there are texts.
    pub features: Option<(SceneFeatures, TextTable)>,
    /// Whether the classes are those of the network inside the program.
    pub is_vocabulary: bool,
    /// What gave the labels.
    pub origin: LabelOrigin,
    /// Effects of the capture that the scene shows; none are looked for without a network.
    pub effects: Vec<FoundEffect>,
    /// What to add to a title where the result means nothing.
    pub remark: &'static str,
}

impl LabelArgs {
    /// Notes what is read.
    pub fn claim_inputs(&self, session: &Session<'_>) -> Result<()> {
        session.outputs.reads_any([Some(self.scene.as_path()), self.label_names.as_deref()])?;
        self.labelling.classes.check_model()?;
        self.labelling.classes.claim_inputs(&session.outputs)
    }

    /// With the parts of the setting among the flags.
    pub fn settled(&self) -> Result<Self> {
        Ok(Self { labelling: self.labelling.settled()?, ..self.clone() })
    }

    /// What is an object.
    pub fn settings(&self) -> ObjectSettings {
        ObjectSettings { min_count: self.min_count, gap: self.gap, ..ObjectSettings::default() }
    }

    /// Reads the scene and labels it.
    pub fn label(&self, session: &Session<'_>, sh_rest: bool) -> Result<Labelled> {
        match &self.label_names {
            Some(path) => self.own_labels(session, path, sh_rest),
            None => {
                if self.label_ids.label_base.is_some() {
                    refuse!("--label-base needs --label-names: it is about the scene's own labels");
                }
                let wish = self.labelling.wish(session)?;
                self.labelling.run(session, &self.scene, &wish)
            }
        }
    }

    fn own_labels(&self, session: &Session<'_>, path: &Path, sh_rest: bool) -> Result<Labelled> {
        let Labelling { classes, surfaces, strange, inference, .. } = &self.labelling;
        let taught = self.labelling.taught.as_ref().map(|_| "--taught");
        let flag = strange.map(|_| "--strange").or(surfaces.given()).or(taught);
        if let Some(flag) = flag.or(inference.only_network_flag()) {
            refuse!("{flag} is about a network, which --label-names leaves out");
        }
        if inference.network.weights.is_some() || classes.text.is_some() {
            refuse!("--label-names takes the scene's own labels: leave out --weights and --text");
        }
        let names = read_names(path)?;
        session.receipt.fingerprint("label_names", path)?;
        let options = ReadOptions { sh_rest, ..inference.source.options() };
        let mut opened = session.open_with(&self.scene, &options)?;
        self.label_ids.number(session, &mut opened, names.len())?;
        let scene = &opened.loaded.scene;
        let labels = scene.segment.clone().ok_or_else(|| {
            let path = self.scene.display();
            WrongUse(match label_names(&opened.loaded.unread) {
                Some(names) => format!(
                    "--label-names: {path} carries no column segment or label; choose with \
                     --segment-name {names}, or leave out --label-names to run a network"
                ),
                None => format!(
                    "--label-names: {path} carries no labels; leave it out to run a network"
                ),
            })
        })?;
        session.receipt.setting("labels", "scene", "labels that the scene carries");
        let scores = scene.segment_score.clone();
        Ok(Labelled {
            opened,
            labels,
            scores,
            names,
            features: None,
            is_vocabulary: false,
            origin: LabelOrigin::Scene,
            effects: Vec::new(),
            remark: "",
        })
    }
}

impl Labelling {
    /// With the parts of the setting among the flags.
    pub fn settled(&self) -> Result<Self> {
        let (inference, vote_k) = self.inference.settled(self.vote_k)?;
        Ok(Self { inference, vote_k: Some(vote_k), ..self.clone() })
    }

    /// What is to be done about the effects of the capture.
    pub fn wish(&self, session: &Session<'_>) -> Result<Wish> {
        self.effects.wish(session, self.features.is_none(), true)
    }

    /// Reads a scene and labels it, by settled flags.
    pub fn run(&self, session: &Session<'_>, scene: &Path, wish: &Wish) -> Result<Labelled> {
        let (opened, source, text) = self.open(session, scene)?;
        let is_own = source.is_network() && self.inference.network.is_embedded();
        let names = match source.classifier() {
            Some(network) => own_classes(&self.classes, network)?,
            None => LabelSet::new(text.iter().flat_map(|text| &text.names).cloned().collect())?,
        };
        let options = self.classes.options(&names)?;
        self.classes.record(session)?;
        let scene = &opened.loaded.scene;
        let consumer = Consumer { network: source.is_network(), labels: true };
        let about = session.compensation(wish, &opened, &self.inference, consumer)?;
        let features = session.features(&opened, &source, &self.inference, &about)?;
        let classes = match &text {
            Some(text) => labels::Classes::Texts(text),
            None => labels::Classes::Probabilities(names.len()),
        };
        let is_vocabulary = text.is_some() && (is_own || self.classes.vocabulary()?.is_some());
        let (is_network, is_classifier) = (source.is_network(), text.is_none());
        let asked = Asked { names: &names.names, is_vocabulary, is_network, is_classifier };
        let agreeing = self.surfaces.find(session, &opened, &self.inference, asked)?;
        let mut found = {
            let _stage = session.receipt.stage("labels");
            let k = self.vote_k.unwrap_or(VOTE_K);
            session.receipt.setting("vote_k", k, "neighbors that vote on each label");
            let agreement = agreeing.agreement(scene, &names.names);
            label_agreeing_with_vote(&features, classes, &options, &agreement, &scene.coord, k)?
        };
        if found.num_withheld + found.num_unusable > 0 {
            session.progress.say(format!(
                "{} voxels unknown by the thresholds, {} without a usable feature",
                found.num_withheld, found.num_unusable
            ));
        }
        session.note_withheld(found.withhold(about.withheld()), "labels");
        if let Some(strange) = self.strange_rows(session, &opened, &features, &agreeing, is_own)? {
            let taken = found.withhold(&strange);
            if taken > 0 {
                let text = format!(
                    "{taken} labels are left out: the network does not know what it sees there"
                );
                session.receipt.setting("strange", taken, &text);
                session.progress.say(text);
            }
        }
        if let Some(folder) = &self.taught {
            session.outputs.reads(folder)?;
            overrule(session, folder, &opened, (&names.names, is_vocabulary), &mut found)?;
        }
        let effects = match is_network {
            true => session.note_effects(&opened, &self.inference, is_own)?,
            false => Vec::new(),
        };
        session.check_stop()?;
        Ok(Labelled {
            effects,
            labels: found.labels,
            scores: Some(found.scores),
            names: names.names,
            features: text.map(|text| (features, text)),
            is_vocabulary,
            origin: match (is_own, is_network) {
                (true, _) => LabelOrigin::Embedded,
                (false, true) => LabelOrigin::Network,
                (false, false) => LabelOrigin::Features,
            },
            remark: source.remark(),
            opened,
        })
    }

    /// The scene, the source of its features, and the texts of the classes unless a network has its own.
    fn open(
        &self,
        session: &Session<'_>,
        scene: &Path,
    ) -> Result<(OpenedScene, FeatureSource, Option<TextTable>)> {
        let embedded = self.inference.network.is_embedded();
        let check_own = |is_own: bool| -> Result<()> {
            if self.strange.is_some() && !is_own {
                refuse!(
                    "--strange is about the network inside the program, which is not used here"
                );
            }
            Ok(())
        };
        check_own(embedded && self.features.is_none())?;
        // A bad table is better found before the scene is read.
        let given = self.classes.text.as_ref();
        let table = given.map(|_| self.classes.text_table(false)).transpose()?;
        let (opened, source) = session.open_with_source(
            scene,
            &self.inference,
            self.features.as_deref(),
            |network| {
                let needed = !network.is_classifier() && table.is_none();
                if needed { self.classes.text_table(embedded).map(drop) } else { Ok(()) }
            },
        )?;
        let is_own = embedded && source.is_network();
        check_own(is_own)?;
        let text = match source.classifier() {
            Some(_) => None,
            None => Some(table.map_or_else(|| self.classes.text_table(is_own), Ok)?),
        };
        Ok((opened, source, text))
    }

    /// The Gaussians that stay without a label because they look like nothing that the network was trained on.
    fn strange_rows(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        features: &SceneFeatures,
        agreeing: &Agreeing,
        is_own: bool,
    ) -> Result<Option<Vec<bool>>> {
        if !is_own {
            return Ok(None);
        }
        let strange = self.strange.unwrap_or(Strange::Auto);
        let surfaces = agreeing.surfaces().map(SceneSurfaces::largest);
        let Some(found) = session.recognize(opened, &self.inference, features, surfaces)? else {
            if self.strange == Some(Strange::Unknown) {
                refuse!(
                    "--strange unknown: these features, or so few Gaussians, do not tell how strange the scene is; leave it \
                     out, or the codes"
                );
            }
            return Ok(None);
        };
        let least = if strange == Strange::Unknown { SURE } else { KNOWN };
        let rows = found.strange(least);
        let share = rows.iter().filter(|is| **is).count() as f64 / rows.len() as f64;
        if share >= WORTH_A_WARNING {
            session.warn_strange(
                share,
                match strange {
                    Strange::Label => {
                        "its labels are guesses; without --strange label they are left out"
                    }
                    _ if share == 1.0 => {
                        "all labels are left out; --strange label keeps them, as guesses"
                    }
                    _ => "those labels are left out; --strange label keeps them, as guesses",
                },
            );
        }
        Ok((strange != Strange::Label).then_some(rows))
    }
}

/// Puts the labels of a teacher of pictures over others, and says what became of them.
fn overrule(
    session: &Session<'_>,
    folder: &Path,
    opened: &OpenedScene,
    (names, is_vocabulary): (&[String], bool),
    found: &mut labels::Labels,
) -> Result<()> {
    let taught = taught_labels(folder, names, is_vocabulary)?;
    let (has, rows) = (taught.labels.len(), opened.loaded.source_rows());
    anyhow::ensure!(
        has == rows,
        "--taught {}: has {has} rows, the scene {rows}; give the folder that was made from this scene",
        folder.display()
    );
    let named = taught.labels.iter().filter(|label| **label >= 0).count();
    let kept = opened.loaded.kept_rows.as_deref();
    let changed = taught.overrule(&mut found.labels, &mut found.scores, kept);
    let text = format!("of {named} Gaussians that the teacher names, {changed} had another label");
    session.receipt.setting("taught", changed, &text);
    session.progress.say(text);
    if !taught.unused.is_empty() {
        let names: Vec<String> =
            taught.unused.iter().map(|(name, count)| format!("{count} {name:?}")).collect();
        let text = format!("the teacher's names that are no class here: {}", names.join(", "));
        session.receipt.setting("taught_unused", taught.unused.len(), &text);
        session.progress.say(text);
    }
    if named == 0 {
        session.warn(format!("--taught {}: names none of the classes", folder.display()));
    }
    Ok(())
}

/// The classes of a segmentation network, by number where they have no names.
fn own_classes(classes: &Classes, network: &Network) -> Result<LabelSet> {
    if classes.text.is_some() {
        refuse!("--text is for language networks; name the classes with --text-names");
    }
    let count = network.model().out_channels();
    let names = match &classes.text_names {
        Some(path) => read_names(path)?,
        None => (0..count).map(|i| format!("class {i}")).collect(),
    };
    if names.len() != count {
        refuse!("--text-names: {} names for {count} classes", names.len());
    }
    Ok(LabelSet::new(names)?)
}

impl Labelled {
    /// The labels alone, as what works on objects takes them.
    pub fn input(&self, frame: Frame) -> ObjectInput<'_> {
        ObjectInput {
            scene: &self.opened.loaded.scene,
            labels: &self.labels,
            scores: None,
            instances: None,
            features: None,
            names: &self.names,
            upright: frame.upright,
            metres_per_unit: frame.metres_per_unit,
            floor: frame.floor,
        }
    }

    /// The objects; `pieces`: even where the scene carries instances.
    pub fn objects(
        &self,
        session: &Session<'_>,
        settings: &ObjectSettings,
        pieces: bool,
        frame: Frame,
    ) -> Result<Catalogue> {
        let _stage = session.receipt.stage("objects");
        let scene = &self.opened.loaded.scene;
        let instances =
            scene.instance.as_deref().filter(|ids| !pieces && ids.iter().any(|i| *i >= 0));
        if instances.is_some() {
            let text = "the scene carries instances: each is an object (--pieces looks for objects instead)";
            session.progress.detail(text);
            session.receipt.setting("instances", "scene", text);
        }
        let features = self.features.as_ref().map(|(features, _)| features);
        let add = |row: usize, sum: &mut [f32]| {
            let Some(features) = features else { return };
            // A row that cannot be read says nothing about what belongs together.
            if let Ok(values) = features.gaussian_rows(row..row + 1) {
                sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
            }
        };
        let features = features.map(|f| (f.width(), &add as _));
        let scores = self.scores.as_deref();
        let input = ObjectInput { scores, instances, features, ..self.input(frame) };
        find_objects(&input, settings).context("no objects can be looked for")
    }
}
