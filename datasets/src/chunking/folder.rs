//! The chunks of many scenes.

use super::write::write_chunks;
use super::{ChunkReport, ChunkSettings};
use crate::DataError;
use scenesplat_scene::{AtomicFile, SceneError};
use std::fs;
use std::path::{Path, PathBuf};

/// Where notes about the chunks of a folder are; not a scene, as its name begins with a dot.
const NOTES: &str = ".chunks";

/// A folder of chunks that all were cut alike.
///
/// It remembers the settings and which scenes are complete, so that a run that was interrupted goes
/// on, and one with other settings is refused.
#[derive(Debug, Clone)]
pub struct ChunkFolder {
    path: PathBuf,
    settings: ChunkSettings,
}

impl ChunkFolder {
    /// Opens or makes the folder for the chunks of a split in `out`.
    ///
    /// # Errors
    /// If a setting is out of range, the folder holds chunks of other settings, or cannot be made.
    pub fn open(out: &Path, split: &str, settings: ChunkSettings) -> Result<Self, DataError> {
        settings.check()?;
        let path = out.join(settings.folder_name(split));
        let notes = path.join(NOTES);
        fs::create_dir_all(&notes).map_err(|source| SceneError::Io {
            path: notes.clone(),
            action: "cannot make the folder of chunks",
            source,
        })?;
        let this = Self { path, settings };
        let file = notes.join("settings.json");
        let known = fs::read(&file).ok().and_then(|text| serde_json::from_slice(&text).ok());
        match known {
            Some(known) if this.settings != known => Err(SceneError::Format {
                path: this.path,
                problem: format!(
                    "holds chunks that were cut with other settings: {}",
                    differences(&this.settings, &known)
                ),
                help: "choose another folder or the same settings, or remove this folder"
                    .to_owned(),
            }
            .into()),
            Some(_) => Ok(this),
            None => {
                write_json(&file, &this.settings)?;
                Ok(this)
            }
        }
    }

    /// Where the chunks are.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The report of a scene that is complete: all its chunks are there.
    pub fn finished(&self, scene: &str) -> Option<ChunkReport> {
        let text = fs::read(self.record(scene)).ok()?;
        let report: ChunkReport = serde_json::from_slice(&text).ok()?;
        let complete = report.chunks.iter().all(|(name, _)| self.path.join(name).is_dir());
        complete.then_some(report)
    }

    /// Cuts a scene, unless it is complete. Chunks that are there are kept.
    ///
    /// `progress` gets the fraction done, 0 to 1, and gives `false` to stop.
    ///
    /// # Errors
    /// If the scene cannot be read or a chunk not be written, or on request; chunks are complete or
    /// not there.
    pub fn cut(
        &self,
        scene: &str,
        source: &Path,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<ChunkReport, DataError> {
        if let Some(mut report) = self.finished(scene) {
            report.found = report.chunks.len();
            return Ok(report);
        }
        let report = write_chunks(source, &self.path, scene, &self.settings, progress)?;
        write_json(&self.record(scene), &report)?;
        Ok(report)
    }

    fn record(&self, scene: &str) -> PathBuf {
        self.path.join(NOTES).join(format!("{scene}.scene.json"))
    }
}

/// Settings that differ, as `name: here, there`.
fn differences(here: &ChunkSettings, there: &ChunkSettings) -> String {
    let fields = |settings| match serde_json::to_value(settings) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (here, there) = (fields(here), fields(there));
    let differing = here.iter().filter(|(name, value)| there.get(*name) != Some(value));
    let texts: Vec<String> = differing
        .map(|(name, value)| format!("{name} is {} there, {value} here", there[name]))
        .collect();
    texts.join("; ")
}

/// Replaces the file by these notes.
fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), SceneError> {
    let failed =
        |source| SceneError::Io { path: path.to_owned(), action: "cannot write the notes", source };
    let text = serde_json::to_vec_pretty(value).map_err(|error| failed(error.into()))?;
    Ok(AtomicFile::write(path, &text)?)
}
