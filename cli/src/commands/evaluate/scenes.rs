//! The scenes that `evaluate` is given: files, or rooms that are made on the spot.

use crate::commands::WrongUse;
use crate::flags::Inference;
use crate::session::Session;
use anyhow::Result;
use scenesplat::datasets::{DataSource, SourceScene, SyntheticRooms};
use scenesplat::evaluation::classes_of_rooms;
use scenesplat::outputs::OpenedScene;
use scenesplat::rooms::{Capture, SyntheticRoomSettings};
use scenesplat::scene::{LoadedScene, SceneFormat};
use std::path::PathBuf;
use std::sync::Arc;

/// One scene to evaluate on.
pub enum Input {
    /// A file or folder.
    File(PathBuf),
    /// A synthetic room.
    Room { rooms: Arc<SyntheticRooms>, index: usize },
}

/// The scenes that the arguments name.
pub fn inputs(scenes: &[String]) -> Result<Vec<Input>> {
    let mut all = Vec::new();
    for scene in scenes {
        let made = scene.strip_prefix("synthetic:").map(|rest| (rest, Capture::Made));
        let scan = scene.strip_prefix("scanned:").map(|rest| (rest, Capture::Scan));
        let Some((rest, capture)) = made.or(scan) else {
            all.push(Input::File(scene.into()));
            continue;
        };
        let numbers = rest.split_once(':').and_then(|(count, seed)| {
            Some((
                count.parse::<usize>().ok().filter(|c| (1..=1_000_000).contains(c))?,
                seed.parse().ok()?,
            ))
        });
        let Some((count, seed)) = numbers else {
            let text = format!(
                "{scene:?}: write synthetic:COUNT:SEED, such as synthetic:20:7, or scanned:COUNT:SEED"
            );
            return Err(WrongUse(text).into());
        };
        let settings = SyntheticRoomSettings { capture, ..SyntheticRoomSettings::default() };
        let rooms = Arc::new(SyntheticRooms::new(count, settings, seed)?);
        all.extend((0..count).map(|index| Input::Room { rooms: Arc::clone(&rooms), index }));
    }
    Ok(all)
}

impl Input {
    /// Reads or makes it.
    pub fn open(&self, session: &Session<'_>, inference: &Inference) -> Result<OpenedScene> {
        match self {
            Self::File(path) => session.open(path, inference),
            Self::Room { rooms, index } => {
                let id = &rooms.scene_ids()[*index];
                session.progress.say(format!("making {id}"));
                let SourceScene { scene, report } = rooms.load(id)?;
                session.receipt.add_rows_in(scene.len());
                let path = PathBuf::from(id);
                let kind = SceneFormat::Ply;
                let loaded = LoadedScene { scene, report, kept_rows: None, path, kind };
                Ok(OpenedScene { loaded, converted: false })
            }
        }
    }

    /// Which of the text's classes each label means, where the scene knows its labels' names.
    pub fn classes_of_labels(&self, names: &[String]) -> Option<Vec<i32>> {
        match self {
            Self::Room { .. } => Some(classes_of_rooms(names)),
            Self::File(_) => None,
        }
    }
}
