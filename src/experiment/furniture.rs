//! Attribution of the furniture models in the training rooms.

use super::{ExperimentConfig, ExperimentError};
use scenesplat_datasets::sources::SourceConfig;
use scenesplat_rooms::catalogue::Attribution;
use scenesplat_scene::AtomicFile;
use std::path::Path;

/// The file beside the weights.
pub const ATTRIBUTION: &str = "ATTRIBUTION.md";

/// Writes `ATTRIBUTION.md` into a model folder, if rooms with models of a catalogue were trained on, now or by
/// the network that the training started from; gives a remark about it.
///
/// # Errors
/// If the catalogue cannot be read any more, or the file not written.
pub(super) fn attribute(
    config: &ExperimentConfig,
    folder: &Path,
) -> Result<Option<String>, ExperimentError> {
    let mut all = Attribution::default();
    for entry in &config.train {
        let SourceConfig::Synthetic(rooms) = &entry.source else { continue };
        if let Some(catalogue) =
            rooms.room.catalogue().map_err(scenesplat_datasets::DataError::from)?
        {
            all.add(catalogue.attribution(&rooms.room.furniture_split));
        }
    }
    if let Some(start) = config.init_from.as_deref() {
        // A model folder, or a file in one.
        let beside = if start.is_dir() { start } else { start.parent().unwrap_or(start) };
        let list = beside.join(ATTRIBUTION);
        if list.is_file() {
            let text = std::fs::read_to_string(&list).map_err(ExperimentError::io(&list))?;
            all.add(Attribution::parse(&text));
        }
    }
    if all.is_empty() {
        return Ok(None);
    }
    let path = folder.join(ATTRIBUTION);
    AtomicFile::write(&path, all.to_string().as_bytes())?;
    Ok(Some(format!("{ATTRIBUTION}: the makers of {} models of furniture", all.len())))
}
