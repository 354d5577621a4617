//! A scene with labels: of a network, of features, or its own. What `segment`, `objects` and `view` begin with.

use super::WrongUse;
use super::classes::Classes;
use crate::effects::{EffectArgs, Wish};
use crate::flags::Inference;
use crate::session::{FeatureSource, Session, Strangeness};
use crate::surfaces::{Asked, SurfaceArgs};
use anyhow::{Context, Result};
use scenesplat::alignment::{Alignment, AlignmentSettings};
use scenesplat::labels::{self, label_agreeing_with_vote};
use scenesplat::objects::{Catalogue, ObjectInput, ObjectSettings, find_objects};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::frame::Matrix3;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{LabelSet, TextTable, UpAxis};
use scenesplat::{Network, SceneFeatures};
use scenesplat_lab::compensation::Consumer;
use std::path::{Path, PathBuf};

/// Where labels come from, and what is an object.
#[derive(Debug, Clone, clap::Args)]
pub struct LabelArgs {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Takes the labels that the scene carries, whose names these are (one a line, or a JSON list), instead of a network.
    #[arg(long, value_name = "FILE", conflicts_with = "features")]
    pub label_names: Option<PathBuf>,
    /// Looks for objects even where the scene carries instances.
    #[arg(long)]
    pub pieces: bool,
    /// Fewest Gaussians of an object.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub min_count: usize,
    /// Gaussians of a class this near to each other, metres, belong together; by default 2.5 spacings of the class.
    #[arg(long, value_name = "M", value_parser = crate::flags::parse_positive)]
    pub gap: Option<f64>,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Neighbours that vote on each label; 0 or 1 for no vote. [default: 25]
    #[arg(long, value_name = "K")]
    pub vote_k: Option<usize>,
    /// Features made before instead of a network: .npy, [N, D], one row per Gaussian.
    #[arg(long, value_name = "FILE.npy")]
    pub features: Option<PathBuf>,
    /// Whether surfaces have one label.
    #[command(flatten)]
    pub surfaces: SurfaceArgs,
    /// What becomes of strange scenes.
    #[command(flatten)]
    pub strange: StrangeArgs,
    /// What is done about effects of the capture.
    #[command(flatten)]
    pub effects: EffectArgs,
    /// Flags of the network.
    #[command(flatten)]
    pub inference: Inference,
}

/// What becomes of a scene that is strange to the network inside the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::Args)]
pub struct StrangeArgs {
    /// What becomes of a scene that looks like nothing the network inside the program was trained on (a garden, a
    /// bicycle): it is labelled all the same, or stays unknown. [default: auto]
    #[arg(long, value_name = "WHAT")]
    pub strange: Option<Strange>,
}

/// Labels all the same, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Strange {
    /// No label where it is clearly strange, a warning where it is strange.
    Auto,
    /// The nearest class of each Gaussian, and a warning.
    Label,
    /// No label where it is strange.
    Unknown,
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
    /// Whether that network labelled it.
    pub is_own: bool,
    /// What to add to a title where the result means nothing.
    pub remark: &'static str,
}

/// What labels a scene.
pub struct Labelling<'a> {
    /// The scene's file.
    pub scene: &'a Path,
    /// Choice of classes.
    pub classes: &'a Classes,
    /// Features made before instead of a network.
    pub features: Option<&'a Path>,
    /// Whether surfaces have one label.
    pub surfaces: SurfaceArgs,
    /// What becomes of a strange scene.
    pub strange: StrangeArgs,
    /// Flags of the network.
    pub inference: &'a Inference,
    /// Neighbours that vote on each label.
    pub vote_k: usize,
}

impl LabelArgs {
    /// With the parts of the setting among the flags, and how many neighbours vote.
    pub fn settled(&self) -> Result<(Self, usize)> {
        let (inference, k) = self.inference.settled(self.vote_k)?;
        Ok((Self { inference, ..self.clone() }, k))
    }

    /// Notes what is read.
    pub fn claim_inputs(&self, session: &Session<'_>) -> Result<()> {
        session.outputs.reads_any([Some(self.scene.as_path()), self.label_names.as_deref()])?;
        self.classes.claim_inputs(&session.outputs)
    }

    /// What is an object.
    pub fn settings(&self) -> ObjectSettings {
        ObjectSettings { min_count: self.min_count, gap: self.gap, ..ObjectSettings::default() }
    }

    /// Reads the scene and labels it.
    pub fn label(&self, session: &Session<'_>, vote_k: usize, sh_rest: bool) -> Result<Labelled> {
        match &self.label_names {
            Some(path) => self.own_labels(session, path, sh_rest),
            None => {
                let wish = self.effects.wish(session, self.features.is_none(), true)?;
                let labelling = Labelling {
                    scene: &self.scene,
                    classes: &self.classes,
                    features: self.features.as_deref(),
                    surfaces: self.surfaces,
                    strange: self.strange,
                    inference: &self.inference,
                    vote_k,
                };
                labelling.run(session, &wish)
            }
        }
    }

    fn own_labels(&self, session: &Session<'_>, path: &Path, sh_rest: bool) -> Result<Labelled> {
        if self.strange.strange.is_some() {
            let text = "--strange is about a network, which --label-names leaves out";
            return Err(WrongUse(text.to_owned()).into());
        }
        if let Some(flag) = self.surfaces.given() {
            let text =
                format!("{flag} is about labels of a network, which --label-names leaves out");
            return Err(WrongUse(text).into());
        }
        if let Some(flag) = self.inference.only_network_flag() {
            let text = format!("{flag} is about a network, which --label-names leaves out");
            return Err(WrongUse(text).into());
        }
        if self.inference.network.weights.is_some() || self.classes.text.is_some() {
            let text = "--label-names takes the scene's own labels: leave out --weights and --text";
            return Err(WrongUse(text.to_owned()).into());
        }
        let names = read_names(path)?;
        session.receipt.fingerprint("label_names", path)?;
        let options = scenesplat::scene::ReadOptions { sh_rest, ..self.inference.source.options() };
        let opened = session.open_with(&self.scene, &options)?;
        let scene = &opened.loaded.scene;
        let labels = scene.segment.clone().ok_or_else(|| {
            let path = self.scene.display();
            WrongUse(format!(
                "--label-names: {path} carries no labels; leave it out to run a network"
            ))
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
            is_own: false,
            remark: "",
        })
    }
}

impl Labelling<'_> {
    /// Reads the scene and labels it by a network, or by features made before.
    pub fn run(&self, session: &Session<'_>, wish: &Wish) -> Result<Labelled> {
        let embedded = self.inference.network.is_embedded();
        let not_own = || {
            let text = "--strange is about the network inside the program, which is not used here";
            anyhow::Error::from(WrongUse(text.to_owned()))
        };
        let strange = self.strange.strange;
        if strange.is_some() && !(embedded && self.features.is_none()) {
            return Err(not_own());
        }
        // A bad table is better found before the scene is read.
        let table = match &self.classes.text {
            Some(_) => Some(self.classes.text_table(false)?),
            None => None,
        };
        let (opened, source) =
            session.open_with_source(self.scene, self.inference, self.features, |network| {
                let needed = !network.is_classifier() && table.is_none();
                if needed { self.classes.text_table(embedded).map(drop) } else { Ok(()) }
            })?;
        let is_own = embedded && matches!(source, FeatureSource::Network(_));
        if strange.is_some() && !is_own {
            return Err(not_own());
        }
        let (labels_of, text) = if let Some(network) = source.classifier() {
            (own_classes(self.classes, network)?, None)
        } else {
            let text = table.map_or_else(|| self.classes.text_table(is_own), Ok)?;
            (LabelSet::new(text.names.clone())?, Some(text))
        };
        let options = self.classes.options(&labels_of)?;
        self.classes.record(session)?;
        let scene = &opened.loaded.scene;
        let consumer = Consumer { network: source.is_network(), labels: true };
        let about = session.compensation(wish, scene, self.inference, consumer)?;
        let features = session.features(&opened, &source, self.inference, &about)?;
        let classes = match &text {
            Some(text) => labels::Classes::Texts(text),
            None => labels::Classes::Probabilities(labels_of.len()),
        };
        let is_vocabulary = text.is_some() && (is_own || self.classes.vocabulary()?.is_some());
        let (is_network, is_classifier) = (source.is_network(), text.is_none());
        let asked = Asked { names: &labels_of.names, is_vocabulary, is_network, is_classifier };
        let agreeing = self.surfaces.find(session, &opened, self.inference, asked)?;
        let mut found = {
            let _stage = session.receipt.stage("labels");
            session.receipt.setting("vote_k", self.vote_k, "neighbours that vote on each label");
            let agreement = agreeing.agreement();
            let k = self.vote_k;
            label_agreeing_with_vote(&features, classes, &options, &agreement, &scene.coord, k)?
        };
        if found.num_withheld + found.num_unusable > 0 {
            session.progress.say(format!(
                "{} voxels unknown by the thresholds, {} without a usable feature",
                found.num_withheld, found.num_unusable
            ));
        }
        session.note_withheld(found.withhold(about.withheld()), "labels");
        let least = match strange.unwrap_or(Strange::Auto) {
            Strange::Auto => Some(Strangeness::Clear),
            Strange::Unknown => Some(Strangeness::Some),
            Strange::Label => None,
        };
        let is_left_out = |how: Strangeness| least.is_some_and(|least| how >= least);
        let how = match is_own {
            false => None,
            true => session.strangeness(&features, |how| match is_left_out(how) {
                true => "all labels are left out; --strange label keeps them, as guesses",
                false => "its labels are guesses; --strange unknown leaves them out",
            })?,
        };
        if how.is_none() && strange == Some(Strange::Unknown) {
            let text = "--strange unknown: these features do not tell how strange the scene is; leave it out, or the codes";
            return Err(WrongUse(text.to_owned()).into());
        }
        if how.is_some_and(is_left_out) {
            let all = vec![true; found.labels.len()];
            let taken = found.withhold(&all);
            let text = format!("{taken} labels are left out: the scene is strange");
            session.receipt.setting("strange", "unknown", &text);
            session.progress.say(text);
        }
        session.check_stop()?;
        Ok(Labelled {
            labels: found.labels,
            scores: Some(found.scores),
            names: labels_of.names,
            features: text.map(|text| (features, text)),
            is_vocabulary,
            is_own,
            remark: source.remark(),
            opened,
        })
    }
}

/// The classes of a segmentation network, by number where they have no names.
fn own_classes(classes: &Classes, network: &Network) -> Result<LabelSet> {
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

/// How a scene lies, for the boxes of its objects.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// The axis that is next to up.
    pub up: UpAxis,
    /// The rotation that brings +z up and the floor level.
    pub upright: Matrix3,
    /// What one unit of the scene is, metres.
    pub metres_per_unit: f64,
    /// Height of the floor along up, metres, if --floor says it.
    pub floor: Option<f64>,
}

/// Which way is up and what a unit is, as a network would read the scene.
pub fn frame(opened: &OpenedScene, inference: &Inference) -> Frame {
    let scene = &opened.loaded.scene;
    let alignment = Alignment::of(
        scene,
        &AlignmentSettings {
            up: inference.up,
            metres_per_unit: inference.unit,
            floor: inference.floor,
            as_is: inference.as_is,
            ..AlignmentSettings::default()
        },
    );
    // A network that reads the scene as it is changes nothing about which way is up.
    let given = inference.up.filter(|_| inference.as_is);
    Frame {
        up: inference.up.unwrap_or(alignment.turned_from),
        upright: given.map_or_else(|| alignment.rotation(), UpAxis::upright),
        metres_per_unit: alignment.scale,
        floor: inference.floor.map(|floor| floor * alignment.scale),
    }
}

impl Labelled {
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
            session.progress.say(text);
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
        let input = ObjectInput {
            scene,
            labels: &self.labels,
            scores: self.scores.as_deref(),
            instances,
            features: features.map(|f| (f.width(), &add as _)),
            names: &self.names,
            upright: frame.upright,
            metres_per_unit: frame.metres_per_unit,
            floor: frame.floor,
        };
        find_objects(&input, settings).context("no objects can be looked for")
    }
}
