//! Stored features as a teacher.

use super::record::TeacherRecord;
use half::f16;
use scenesplat_datasets::{DataError, Sample, SceneTeacher, TeacherRows, TeacherView};
use scenesplat_scene::LanguageFeatures;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::input_file::open_regular_file;
use sha2::{Digest, Sha256};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Features of the scenes' Gaussians, from a folder or from the scenes themselves.
pub(super) struct StoredTeacher {
    pub folder: Option<PathBuf>,
    pub record: Arc<TeacherRecord>,
}

impl SceneTeacher for StoredTeacher {
    fn view(&self) -> TeacherView {
        TeacherView::Scene
    }

    fn teach(&self, shown: Sample) -> Result<TeacherRows, DataError> {
        let (count, valid) = (shown.len(), shown.valid_feat);
        let (rows, valid) = match &self.folder {
            None => match shown.lang_feat {
                Some(rows) => (rows, valid),
                None => {
                    return Err(DataError::teacher(
                        "it has no language features (lang_feat); collect them, or choose another \
                         teacher",
                    ));
                }
            },
            // Whether the scene has features of its own says nothing about these.
            Some(folder) => (read(&feature_file(folder, &shown.id)?, count)?, None),
        };
        self.record.with(|counts| counts.taught += 1);
        // A row of zeros is none.
        let there = |i: usize| {
            valid.as_ref().is_none_or(|valid| valid[i])
                && rows.values[i * rows.dim..(i + 1) * rows.dim].iter().any(|v| *v != f16::ZERO)
        };
        let of = |i: usize| if there(i) { i as u32 } else { TeacherRows::NONE };
        let row_of = (0..count).map(of).collect();
        Ok(TeacherRows { rows, row_of })
    }
}

/// The file with the features of a scene.
pub(super) fn feature_file(folder: &Path, id: &str) -> Result<PathBuf, DataError> {
    let names = [folder.join(id).join("features.npy"), folder.join(format!("{id}.npy"))];
    let missing = || {
        DataError::teacher(format!(
            "neither {} nor {} is there",
            names[0].display(),
            names[1].display()
        ))
    };
    names.iter().find(|path| path.is_file()).cloned().ok_or_else(missing)
}

/// Width of the features in a file.
pub(super) fn width(path: &Path) -> Result<usize, DataError> {
    let file = NpyFile::open(path)?;
    match file.shape() {
        [_, dim] if *dim > 0 => Ok(*dim),
        other => Err(wrong_shape(path, other, "[N, D]")),
    }
}

fn wrong_shape(path: &Path, shape: &[usize], expected: &str) -> DataError {
    DataError::teacher(format!("{}: has the shape {shape:?}, expected {expected}", path.display()))
}

fn read(path: &Path, gaussians: usize) -> Result<LanguageFeatures, DataError> {
    let dim = width(path)?;
    let file = NpyFile::open(path)?;
    if file.shape()[0] != gaussians {
        let expected = format!("{gaussians} rows, one for each Gaussian that is used of the scene");
        return Err(wrong_shape(path, file.shape(), &expected));
    }
    let values = file.read_f16()?;
    if let Some(at) = values.iter().position(|v| !v.is_finite()) {
        let (row, column) = (at / dim, at % dim);
        let value = values[at];
        let problem = format!("{}: [{row}, {column}] is {value} in f16", path.display());
        return Err(DataError::teacher(problem));
    }
    Ok(LanguageFeatures { values, dim })
}

/// Of a file's length and of 64 stretches of it: files of features are too large to be read for this.
pub(super) fn fingerprint(path: &Path, hash: &mut Sha256) -> Result<(), DataError> {
    const STRETCHES: u64 = 64;
    const LENGTH: u64 = 16 << 10;
    let failed = |e: std::io::Error| DataError::teacher(format!("{}: {e}", path.display()));
    let mut file = open_regular_file(path)?;
    let length = file.metadata().map_err(failed)?.len();
    hash.update(length.to_le_bytes());
    let last = length.saturating_sub(LENGTH);
    let mut bytes = Vec::new();
    for i in 0..STRETCHES {
        let start = if i + 1 == STRETCHES { last } else { last / (STRETCHES - 1) * i };
        file.seek(SeekFrom::Start(start)).map_err(failed)?;
        bytes.clear();
        (&mut file).take(LENGTH).read_to_end(&mut bytes).map_err(failed)?;
        hash.update(&bytes);
    }
    Ok(())
}
