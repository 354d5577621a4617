//! The files a scene can come from and go to.
//!
//! [`open_scene`] finds out what a path holds by looking into it, never by its name.

pub mod cameras;
mod color_columns;
pub mod compressed_ply;
pub mod depth_map;
pub mod gltf;
pub mod inria_ply;
mod json_text;
pub mod ksplat;
mod label_column;
pub mod labelled_ply;
mod language_columns;
mod limit_tally;
pub(crate) mod memory;
mod mip_filter;
mod named;
pub mod npy;
pub mod npy_folder;
pub mod npy_writer;
mod open;
mod output_names;
mod packed_values;
pub mod ply;
mod scene_blocks;
pub mod semantics;
pub mod sog;
pub mod splat;
pub mod spz;
pub mod table;
mod trained_folder;
pub mod usd;
pub mod write;

pub(crate) use packed_values::unit_f64;

use ply::Remarks;

pub use open::{open_scene, open_scene_bytes, read_ply};
pub(crate) use table::Writer;
pub use table::{FORMATS, FormatRow, SceneFormat};
#[cfg(target_family = "wasm")]
pub use write::written_scene;
pub use write::{PrecisionLimit, WriteOptions, WriteProgress, WriteReport, write_scene};

use crate::extra_columns::UnreadColumn;
use crate::place::origin_note;
use crate::value_policy::clean_scene;
use crate::{GaussianScene, Policy, RepairReport, SceneError, StatedUp};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What to read, and what to do about bad values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReadOptions {
    /// Whether bad values are repaired or the file is refused.
    pub policy: Policy,
    /// Which labels become `segment`: the stem of a file in a folder (`segment20`), or a PLY
    /// property. `None`: `segment`, or else `label` (PLY) or the only file `segment*` (folder).
    pub segment: Option<String>,
    /// Whether to read language features; they are by far the largest part of a scene.
    pub lang_feat: bool,
    /// Whether to read spherical harmonics beyond the DC term.
    pub sh_rest: bool,
    /// The frame that SPZ files are taken to be in.
    pub spz_frame: SpzFrame,
    /// Whether to keep columns whose meaning is not known; they are named if not.
    pub extra: bool,
    /// Level of detail of a streamed scene, 0 = finest; formats without levels ignore it.
    pub lod: usize,
}

/// The frame of the numbers in an SPZ file, which the file itself does not say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpzFrame {
    /// Right, up, back, as the format prescribes; converted to the canonical frame.
    #[default]
    Rub,
    /// As in the PLY file it was made from, as several programs write it; not converted.
    Raw,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            policy: Policy::Repair,
            segment: None,
            lang_feat: true,
            sh_rest: true,
            spz_frame: SpzFrame::Rub,
            extra: false,
            lod: 0,
        }
    }
}

/// A scene with what is needed to write results back to where it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedScene {
    /// The usable Gaussians.
    pub scene: GaussianScene,
    /// What was noticed on the way.
    pub report: RepairReport,
    /// Rows of the source that `scene` is made of, ascending; `None` if all of them.
    pub kept_rows: Option<Vec<u32>>,
    /// The file or folder.
    pub path: PathBuf,
    /// What it is.
    pub kind: SceneFormat,
    /// What the file, or the convention of its format, says about up.
    pub stated_up: StatedUp,
    /// What the file holds besides, which was not read.
    pub unread: Vec<UnreadColumn>,
}

impl LoadedScene {
    /// Applies the value policy to a scene as it was read.
    pub(crate) fn finish(
        scene: GaussianScene,
        mut report: RepairReport,
        policy: Policy,
        path: &Path,
        kind: SceneFormat,
    ) -> Result<Self, SceneError> {
        report.notes.extend(origin_note(scene.origin));
        if scene.antialiased {
            report.notes.push("trained for antialiased rendering".to_owned());
        }
        let (scene, kept_rows) = clean_scene(scene, &mut report, policy, path)?;
        let stated_up = kind.stated_up();
        let (path, unread) = (path.to_owned(), Vec::new());
        Ok(Self { scene, report, kept_rows, path, kind, stated_up, unread })
    }

    /// A scene of arrays that no file holds, by the same rules for bad values as files. `name`: what messages call it.
    ///
    /// # Errors
    /// If arrays differ in rows, a value is bad and the policy is strict, or no Gaussian is left.
    pub fn of_arrays(
        scene: GaussianScene,
        policy: Policy,
        name: &Path,
    ) -> Result<Self, SceneError> {
        scene.check_rows()?;
        let report = RepairReport { source_rows: scene.len(), ..RepairReport::default() };
        Self::finish(scene, report, policy, name, SceneFormat::Ply)
    }

    /// With what the comments of a PLY file say about up: the name of an axis, as Nerfstudio's exporter
    /// writes it, or three numbers, as Brush's does.
    pub(crate) fn with_remarks(mut self, remarks: &Remarks) -> Self {
        let axis = remarks.vertical_axis.as_ref();
        let up = axis
            .and_then(|axis| axis.split_whitespace().collect::<Vec<_>>().join(",").parse().ok());
        if let Some(direction) = up {
            self.stated_up = StatedUp { direction, source: StatedUp::COMMENT };
        }
        self
    }

    /// Number of rows in the source, those left out included.
    pub fn source_rows(&self) -> usize {
        self.report.source_rows
    }

    /// One value per row of the source, from one value per Gaussian; rows left out get `fill`.
    ///
    /// # Errors
    /// If `values` does not have one row per Gaussian.
    pub fn to_source_rows<T: Clone>(&self, values: &[T], fill: T) -> Result<Vec<T>, SceneError> {
        if values.len() != self.scene.len() {
            let expected = self.scene.len();
            return Err(SceneError::RowCount { field: "values", expected, got: values.len() });
        }
        let Some(kept) = &self.kept_rows else { return Ok(values.to_vec()) };
        let mut out = vec![fill; self.source_rows()];
        for (&row, value) in kept.iter().zip(values) {
            out[row as usize] = value.clone();
        }
        Ok(out)
    }
}
