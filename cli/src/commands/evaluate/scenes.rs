//! The scenes that `evaluate` is given: files, or rooms that are made on the spot.

use crate::commands::WrongUse;
use crate::flags::Inference;
use crate::session::Session;
use anyhow::Result;
use scenesplat::datasets::sources::MAX_ROOMS;
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
        let Some((count, seed, room)) = numbers(rest) else {
            let text = format!(
                "{scene:?}: write synthetic:COUNT:SEED, such as synthetic:20:7, or scanned:COUNT:SEED; a \
                 third number is where the count begins, 0 if left out"
            );
            return Err(WrongUse(text).into());
        };
        let settings = SyntheticRoomSettings { capture, room, ..SyntheticRoomSettings::default() };
        let rooms = Arc::new(SyntheticRooms::new(count, settings, seed)?);
        all.extend((0..count).map(|index| Input::Room { rooms: Arc::clone(&rooms), index }));
    }
    Ok(all)
}

/// How many rooms, of which seed, from which number on.
fn numbers(text: &str) -> Option<(usize, u64, u64)> {
    let mut parts = text.split(':');
    let count = parts.next()?.parse::<usize>().ok().filter(|c| (1..=MAX_ROOMS).contains(c))?;
    let seed = parts.next()?.parse().ok()?;
    let first = parts.next().map_or(Some(0), |first| first.parse().ok())?;
    parts.next().is_none().then_some((count, seed, first))
}

/// Each of the scenes by itself, as an argument: rooms that are made on the spot one by one.
pub fn one_by_one(scene: &str) -> Vec<String> {
    for kind in ["synthetic:", "scanned:"] {
        if let Some((count, seed, first)) = scene.strip_prefix(kind).and_then(numbers) {
            let name = |i| format!("{kind}1:{seed}:{}", first.wrapping_add(i as u64));
            return (0..count).map(name).collect();
        }
    }
    vec![scene.to_owned()]
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
