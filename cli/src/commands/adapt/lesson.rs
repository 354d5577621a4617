//! What is learned: a scene as its network reads it, with labels of which some are held out.

use super::Args;
use crate::error::refuse;
use crate::label_ids::LabelIdArgs;
use crate::session::Session;
use anyhow::Result;
use scenesplat::adaptation::{
    self, AdaptSettings, Exam, Folders, LabelFiles, Progress, class_of_names,
};
use scenesplat::alignment::Alignment;
use scenesplat::network::Weights;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{ClassMap, GaussianScene, TextTable, label_names};
use scenesplat::{AlignmentSettings, Network, SceneEncoder};

/// A scene with labels.
pub struct Lesson {
    /// The scene upright, in meters.
    pub scene: GaussianScene,
    /// How it was turned and scaled for that.
    pub alignment: Alignment,
    /// Texts of the classes.
    pub texts: TextTable,
    /// The labels, −1 for none. `[N]`
    labels: Vec<i32>,
    held_out: Vec<bool>,
    truth: Option<Vec<i32>>,
    settings: AdaptSettings,
}

impl Lesson {
    /// Reads a scene and its labels.
    pub fn read(
        args: &Args,
        session: &Session<'_>,
        network: &Network,
        texts: TextTable,
    ) -> Result<Self> {
        let names = args.label_names.as_deref().map(read_names).transpose()?;
        let map = args.class_map.as_deref().map(ClassMap::read).transpose()?;
        let mut files =
            LabelFiles { path: &args.labels, names: names.as_deref(), map: map.as_ref() };
        if files.are_collected() && args.truth {
            // The names are those of the truth.
            (files.names, files.map) = (None, None);
        }
        let mut opened = session.open_with(&args.scene, &args.source.options())?;
        let own = files.read(&texts.names, &opened.loaded)?;
        for file in &own.files {
            session.receipt.fingerprint("labels", file)?;
        }
        if !own.unused.is_empty() {
            let each = own.unused.iter().map(|(name, count)| format!("{count} {name:?}"));
            let text =
                format!("names that are no class here: {}", each.collect::<Vec<_>>().join(", "));
            session.receipt.setting("labels_unused", own.unused.len(), &text);
            session.progress.say(text);
        }
        if own.labels.iter().all(|label| *label < 0) {
            refuse!("--labels {}: name none of the classes", args.labels.display());
        }
        let truth = match args.truth {
            true => Some(truth(session, &mut opened, names.as_deref(), map.as_ref(), &texts)?),
            false => None,
        };
        let settings = args.alignment(&opened.loaded, network.is_square());
        let alignment = match args.weights {
            Weights::Embedded => {
                session.judged_alignment(&opened, &settings, &SceneEncoder::new(network))?
            }
            _ => session.shape_alignment(&opened, &settings),
        };
        session.tell_alignment(&alignment, false);
        let scene = alignment.apply(&opened.loaded.scene).into_owned();
        let settings = args.settings();
        let held_out =
            adaptation::held_out(&scene.coord, &own.labels, settings.held_out, settings.seed);
        let learned = own.labels.iter().zip(&held_out).filter(|(l, out)| **l >= 0 && !**out);
        if learned.count() == 0 {
            refuse!(
                "--held-out {}: nothing is left to learn of the {} labels; give a smaller share",
                settings.held_out,
                own.labels.iter().filter(|label| **label >= 0).count()
            );
        }
        Ok(Self { scene, alignment, texts, labels: own.labels, held_out, truth, settings })
    }

    /// What is asked of networks.
    pub fn exam(&self) -> Exam<'_> {
        Exam {
            texts: &self.texts,
            scene: &self.scene,
            labels: &self.labels,
            held_out: &self.held_out,
            truth: self.truth.as_deref(),
            rooms: self.settings.rooms,
            room_gaussians: self.settings.room_gaussians,
        }
    }

    /// Flags by which other commands read the scene as it was read here; none where its shape alone tells.
    pub fn flags(&self) -> Option<String> {
        let Alignment { judged, sized, turned_from, scale, .. } = &self.alignment;
        let up = judged.then(|| format!("--up {turned_from}"));
        let unit = sized.as_ref().map(|_| format!("--unit {scale}"));
        let flags: Vec<String> = up.into_iter().chain(unit).collect();
        (!flags.is_empty()).then(|| flags.join(" "))
    }

    /// Names of the classes that the labels name.
    pub fn known(&self) -> Vec<&str> {
        let known = self.exam().known().into_iter().zip(&self.texts.names);
        known.filter(|(is, _)| *is).map(|(_, name)| name.as_str()).collect()
    }

    /// Writes the scene as it is learned from, with the network's own rows where there is no label.
    pub fn write(
        &self,
        network: &Network,
        folders: &Folders,
        progress: &mut Progress<'_>,
    ) -> Result<()> {
        let as_is = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
        let encoder = SceneEncoder { alignment: as_is, ..SceneEncoder::new(network) };
        let rows = encoder.encode(&self.scene, &mut |at| progress("the scene", at))?;
        let labels = (&*self.labels, &*self.held_out);
        Ok(adaptation::write_scene(&self.scene, labels, &rows, folders)?)
    }
}

/// The classes that the labels of the scene itself mean.
fn truth(
    session: &Session<'_>,
    opened: &mut OpenedScene,
    names: Option<&[String]>,
    map: Option<&ClassMap>,
    texts: &TextTable,
) -> Result<Vec<i32>> {
    let names = names.unwrap_or(&texts.names);
    LabelIdArgs::default().number(session, opened, names.len())?;
    let class_of = class_of_names(names, map, &texts.names)?;
    let loaded = &opened.loaded;
    let Some(segment) = &loaded.scene.segment else {
        let path = loaded.path.display();
        match label_names(&loaded.unread) {
            Some(names) => refuse!(
                "--truth: {path} carries no column segment or label; choose with --segment-name {names}"
            ),
            None => refuse!("--truth: {path} carries no labels; leave it out"),
        }
    };
    let class = |label: &i32| usize::try_from(*label).map_or(-1, |label| class_of[label]);
    Ok(segment.iter().map(class).collect())
}
