//! The scenes that `evaluate` is given: files, or rooms that are made on the spot.

use crate::error::{WrongUse, refuse};
use crate::flags::Inference;
use crate::session::Session;
use anyhow::Result;
use scenesplat::datasets::sources::MAX_ROOMS;
use scenesplat::datasets::{DataSource, SourceScene, SyntheticRooms};
use scenesplat::evaluation::classes_of_rooms;
use scenesplat::outputs::OpenedScene;
use scenesplat::rooms::{Capture, FurnitureSplit, SyntheticRoomSettings};
use scenesplat::scene::{LoadedScene, SceneFormat, StatedUp};
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
        let Some(kind) = KINDS.into_iter().find(|kind| scene.starts_with(kind)) else {
            all.push(Input::File(scene.into()));
            continue;
        };
        let (numbers_of, split) = match kind {
            "furnished:" => split_of(&scene[kind.len()..])?,
            _ => (scene[kind.len()..].to_owned(), None),
        };
        let Some((count, seed, room)) = numbers(&numbers_of) else {
            refuse!(
                "{scene:?}: write synthetic:COUNT:SEED, such as synthetic:20:7, or scanned:, public:, depth: or \
                 furnished: instead of synthetic:; a third number is where the count begins, 0 if left out; after \
                 furnished:COUNT:SEED may come @held_out, @train, @without:LIBRARY or @only:LIBRARY"
            );
        };
        let capture = match kind {
            "scanned:" => Capture::Scan,
            "depth:" => Capture::Depth,
            _ => Capture::Made,
        };
        let public_share = match kind {
            "public:" => 1.0,
            "depth:" => 0.5,
            _ => 0.0,
        };
        let usual = SyntheticRoomSettings::default();
        let mut settings = SyntheticRoomSettings { capture, room, public_share, ..usual };
        if let Some(split) = split {
            settings.furniture = Some(catalogue()?);
            // What is asked for is the catalogue.
            settings.furniture_share = 1.0;
            settings.furniture_split = split;
        }
        let rooms = Arc::new(SyntheticRooms::new(count, settings, seed)?);
        all.extend((0..count).map(|index| Input::Room { rooms: Arc::clone(&rooms), index }));
    }
    Ok(all)
}

/// The beginnings of what means rooms that are made on the spot.
pub const KINDS: [&str; 5] = ["synthetic:", "scanned:", "furnished:", "public:", "depth:"];

/// Names the catalogue of furniture for `furnished:`.
const FURNITURE: &str = "SCENESPLAT_FURNITURE";

/// What comes before an `@`, and the part of the catalogue after it; all of it if there is none.
fn split_of(text: &str) -> Result<(String, Option<FurnitureSplit>)> {
    let Some((numbers, split)) = text.split_once('@') else {
        return Ok((text.to_owned(), Some(FurnitureSplit::All)));
    };
    Ok((numbers.to_owned(), Some(split.parse().map_err(WrongUse)?)))
}

fn catalogue() -> Result<PathBuf> {
    let path = std::env::var_os(FURNITURE).filter(|path| !path.is_empty());
    path.map(PathBuf::from).ok_or_else(|| {
        let text = format!(
            "furnished: needs a catalogue of furniture: set {FURNITURE} to a folder of .sh3f archives, such as \
             that of Debian's package sweethome3d-furniture (docs/data.md says how)"
        );
        WrongUse(text).into()
    })
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
    for kind in KINDS {
        let Some(rest) = scene.strip_prefix(kind) else { continue };
        let (rest, split) = rest.split_once('@').map_or((rest, None), |(a, b)| (a, Some(b)));
        let split = split.map_or_else(String::new, |split| format!("@{split}"));
        if let Some((count, seed, first)) = numbers(rest) {
            let name = |i| format!("{kind}1:{seed}:{}{split}", first.wrapping_add(i as u64));
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
                session.progress.detail(format!("making {id}"));
                let SourceScene { scene, report } = rooms.load(id)?;
                session.receipt.add_rows_in(scene.len());
                let path = PathBuf::from(id);
                let kind = SceneFormat::Ply;
                let stated_up = StatedUp::UPRIGHT;
                let (kept_rows, unread) = (None, Vec::new());
                let loaded =
                    LoadedScene { scene, report, kept_rows, path, kind, stated_up, unread };
                Ok(OpenedScene { loaded, converted: false })
            }
        }
    }

    /// Whether its labels are ids of a file.
    pub fn is_file(&self) -> bool {
        matches!(self, Self::File(_))
    }

    /// Which of the text's classes each label means, where the scene knows its labels' names.
    pub fn classes_of_labels(&self, names: &[String]) -> Option<Vec<i32>> {
        match self {
            Self::Room { .. } => Some(classes_of_rooms(names)),
            Self::File(_) => None,
        }
    }
}
