//! The sets of scenes: files as they are, synthetic rooms as files in a scratch folder, so that
//! reading is a part of what is timed.

use super::request::Scene;
use crate::error::{WrongUse, refuse};
use crate::progress::{Progress, interrupted};
use crate::receipt::sha256_of;
use anyhow::Result;
use scenesplat::datasets::{DataSource, SyntheticRooms};
use scenesplat::rooms::SyntheticRoomSettings;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use sha2::{Digest, Sha256};
use std::path::Path;

/// Scenes that are measured together.
#[derive(Debug, Clone)]
pub struct Set {
    /// As it was given.
    pub name: String,
    /// Its scenes.
    pub scenes: Vec<Scene>,
    /// SHA-256 of their files.
    pub hash: String,
}

/// Reads `synthetic:COUNT:SEED`; `None` for anything else.
///
/// # Errors
/// If it begins so and goes on otherwise.
fn synthetic(text: &str) -> Result<Option<(usize, u64)>> {
    let Some(rest) = text.strip_prefix("synthetic:") else { return Ok(None) };
    let numbers = rest.split_once(':').and_then(|(count, seed)| {
        let count = count.parse::<usize>().ok().filter(|c| (1..=10_000).contains(c))?;
        Some((count, seed.parse().ok()?))
    });
    let wrong =
        || WrongUse(format!("{text:?}: write synthetic:COUNT:SEED, such as synthetic:20:7"));
    Ok(Some(numbers.ok_or_else(wrong)?))
}

/// The sets that the arguments name.
pub fn sets(names: &[String], scratch: &Path, progress: &Progress) -> Result<Vec<Set>> {
    let mut all: Vec<Set> = Vec::new();
    for name in names {
        if all.iter().any(|set| set.name == *name) {
            refuse!("--scenes {name}: is there twice");
        }
        let scenes = match synthetic(name)? {
            None => {
                let file = Path::new(name).file_name().unwrap_or_default().to_string_lossy();
                vec![Scene { name: file.into_owned(), path: name.into(), is_room: false }]
            }
            Some((count, seed)) => {
                let rooms = SyntheticRooms::new(count, SyntheticRoomSettings::default(), seed)?;
                progress.say(format!("making {count} rooms of seed {seed}"));
                let mut scenes = Vec::new();
                for (index, id) in rooms.scene_ids().iter().enumerate() {
                    if interrupted() {
                        return Err(crate::bench::Stopped.into());
                    }
                    let path = scratch.join(format!("set{}-{index:05}.ply", all.len()));
                    write_inria_ply(&rooms.room(index)?.scene, &[], &path)?;
                    scenes.push(Scene { name: id.clone(), path, is_room: true });
                }
                scenes
            }
        };
        let mut hasher = Sha256::new();
        for scene in &scenes {
            hasher.update(sha256_of(&scene.path)?.0.as_bytes());
        }
        let hash = hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        all.push(Set { name: name.clone(), scenes, hash });
    }
    Ok(all)
}
