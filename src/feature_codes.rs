//! A trained autoencoder over the language features of scenes: folders with codes in their place, and back.

use candle_core::{Device, Tensor};
use half::f16;
use scenesplat_models::autoencoder::Autoencoder;
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{Compute, LoadPolicy, Mode, ParamStore};
use scenesplat_scene::SceneError;
use scenesplat_scene::formats::npy::{NpyFile, NpyType};
use scenesplat_scene::formats::npy_writer::{NpyRowWriter, write_npy};
use scenesplat_scene::input_file::read_text_file;
use scenesplat_trainers::tasks::autoencoder::AutoencoderConfig;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// What `train` writes beside the weights of an autoencoder.
pub const AUTOENCODER_FILE: &str = "autoencoder.json";
/// The file that is read and written.
const FEATURES: &str = "lang_feat.npy";
/// Which rows have a feature.
const MASK: &str = "valid_feat_mask.npy";
/// Rows computed at once.
const BLOCK: usize = 8192;

/// Which way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CodeDirection {
    /// Features to codes.
    Encode,
    /// Codes to features.
    Decode,
}

/// Why codes cannot be made or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureCodeError {
    /// A path without an autoencoder in it.
    #[error("{}: is no folder of an autoencoder ({AUTOENCODER_FILE} and weights), as `train` leaves one", path.display())]
    NoAutoencoder {
        /// Which.
        path: PathBuf,
    },
    /// Settings of an autoencoder that cannot be read or are out of range.
    #[error("{}: {problem}", path.display())]
    Settings {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A scene without features in a file of their own.
    #[error(
        "{}: has no {FEATURES}; features are read from scenes as folders of .npy files",
        path.display()
    )]
    NoFeatures {
        /// Which scene.
        path: PathBuf,
    },
    /// An array of another shape.
    #[error("{}: expected shape {expected}, got {got:?}{help}", path.display())]
    Shape {
        /// Which file.
        path: PathBuf,
        /// What fits.
        expected: String,
        /// What it has.
        got: Vec<usize>,
        /// What most likely helps, after a semicolon.
        help: String,
    },
    /// The caller canceled.
    #[error("interrupted; nothing was written")]
    Stopped,
    /// A file that cannot be copied.
    #[error("{}: cannot copy it to {}", from.display(), to.display())]
    Copy {
        /// From where.
        from: PathBuf,
        /// To where.
        to: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file that cannot be read or written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Weights that cannot be had or do not fit.
    #[error(transparent)]
    Model(#[from] candle_core::Error),
}

/// Result of recoding the features of a scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FeatureCodeReport {
    /// Rows of the scene.
    pub rows: usize,
    /// Those of them with a feature (or code).
    pub with_feature: usize,
    /// Rows marked as having one that hold NaN or infinity; they lose the mark.
    pub not_finite: usize,
    /// Rows marked as having one that hold zeros; they lose the mark.
    pub zero: usize,
    /// Of codes: mean cosine between a feature and what comes back from its code; `None` without rows.
    pub mean_cosine: Option<f64>,
    /// Of codes: the lowest of these cosines.
    pub lowest_cosine: Option<f64>,
    /// Entries of the folder that were not copied, as they are no arrays.
    pub left_out: Vec<String>,
}

/// An autoencoder as `train` leaves it.
#[derive(Debug)]
pub struct TrainedAutoencoder {
    network: Autoencoder,
    files: Vec<PathBuf>,
}

impl TrainedAutoencoder {
    /// Reads a folder with `autoencoder.json` and weights.
    ///
    /// # Errors
    /// If it is none, or the weights do not fit the settings.
    pub fn read(folder: &Path) -> Result<Self, FeatureCodeError> {
        let path = folder.join(AUTOENCODER_FILE);
        if !path.is_file() {
            return Err(FeatureCodeError::NoAutoencoder { path: folder.to_owned() });
        }
        let text = read_text_file(&path)?;
        let bad = |problem: String| FeatureCodeError::Settings { path: path.clone(), problem };
        let config: AutoencoderConfig =
            serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
        config.check().map_err(|e| bad(e.to_string()))?;
        let weights = resolve(folder)?;
        let mut files: Vec<PathBuf> = weights.files.iter().map(|f| f.path().to_owned()).collect();
        let source = WeightSource::files(weights.files, SourceOptions::default())?;
        let store = ParamStore::frozen(source);
        let network = Autoencoder::new(&config.widths, Compute::default(), &store.builder())?;
        store.report().check(LoadPolicy::Strict, &folder.display().to_string())?;
        files.push(path);
        Ok(Self { network, files })
    }

    /// The files that it was read from.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Widths of what comes in and of what comes out.
    pub fn widths(&self, direction: CodeDirection) -> [usize; 2] {
        let widths = self.network.widths();
        let (features, codes) = (widths[0], widths[widths.len() - 1]);
        match direction {
            CodeDirection::Encode => [features, codes],
            CodeDirection::Decode => [codes, features],
        }
    }

    /// Rows of unit length from rows of any length that is not 0; `[R, from] → [R, to]`.
    ///
    /// # Errors
    /// If the rows are no multiple of the width.
    pub fn apply(
        &self,
        direction: CodeDirection,
        rows: &[f32],
    ) -> Result<Vec<f32>, FeatureCodeError> {
        let [from, _] = self.widths(direction);
        let mut unit = rows.to_vec();
        for row in unit.chunks_exact_mut(from) {
            let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            row.iter_mut().for_each(|v| *v = (f64::from(*v) / norm) as f32);
        }
        let rows = Tensor::from_vec(unit, (rows.len() / from, from), &Device::Cpu)?;
        let out = match direction {
            CodeDirection::Encode => self.network.encode(&rows, Mode::Eval)?,
            CodeDirection::Decode => self.network.decode(&rows)?,
        };
        Ok(out.flatten_all()?.to_vec1()?)
    }

    /// Writes the arrays of the scene folder `scene` into the empty folder `to`, its `lang_feat.npy`
    /// (f16, rows of unit length) in the other form. Rows without a feature have zeros. Where the scene
    /// has a `valid_feat_mask.npy`, rows lose their mark whose feature is not finite or zero.
    ///
    /// All other arrays are copied as they are. `progress` gets the fraction done; returning `false` cancels.
    ///
    /// # Errors
    /// If the scene has no features, they have another width, a file cannot be read or written, or
    /// `progress` stops it.
    pub fn recode_scene(
        &self,
        direction: CodeDirection,
        scene: &Path,
        to: &Path,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<FeatureCodeReport, FeatureCodeError> {
        let path = scene.join(FEATURES);
        if !path.is_file() {
            return Err(FeatureCodeError::NoFeatures { path: scene.to_owned() });
        }
        let file = NpyFile::open(&path)?;
        let rows = self.check_shape(direction, &file)?;
        let mut report = FeatureCodeReport { rows, ..FeatureCodeReport::default() };
        let mask = read_mask(scene, rows)?;
        for entry in entries(scene)? {
            let (from, name) = (scene.join(&entry), entry.to_string_lossy().into_owned());
            if name == FEATURES || name == MASK {
                continue;
            }
            if !(name.ends_with(".npy") && from.is_file()) {
                report.left_out.push(name);
                continue;
            }
            let to = to.join(&entry);
            std::fs::copy(&from, &to).map_err(|source| FeatureCodeError::Copy {
                from,
                to,
                source,
            })?;
        }
        let has =
            self.write_features(direction, &file, mask.as_deref(), to, &mut report, progress)?;
        if mask.is_some() {
            let marks: Vec<u8> = has.into_iter().map(u8::from).collect();
            write_npy(&to.join(MASK), &[rows], &marks)?;
        }
        Ok(report)
    }

    /// The number of rows of features that fit.
    fn check_shape(
        &self,
        direction: CodeDirection,
        file: &NpyFile,
    ) -> Result<usize, FeatureCodeError> {
        let [from, to] = self.widths(direction);
        match *file.shape() {
            [rows, width] if width == from => Ok(rows),
            ref got => {
                let is_other = got.get(1) == Some(&to) && direction == CodeDirection::Encode;
                let help = if is_other { "; these are as wide as codes: decode them" } else { "" };
                Err(FeatureCodeError::Shape {
                    path: file.path().to_owned(),
                    expected: format!("(N, {from})"),
                    got: got.to_vec(),
                    help: help.to_owned(),
                })
            }
        }
    }

    /// Gives which rows have one.
    fn write_features(
        &self,
        direction: CodeDirection,
        file: &NpyFile,
        mask: Option<&[bool]>,
        to: &Path,
        report: &mut FeatureCodeReport,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Vec<bool>, FeatureCodeError> {
        let [width, out_width] = self.widths(direction);
        let values: Vec<f16> = file.read_f16()?;
        let mut writer =
            NpyRowWriter::<f16>::create(&to.join(FEATURES), report.rows, &[out_width])?;
        let mut has = Vec::with_capacity(report.rows);
        let (mut sum, mut lowest) = (0.0, f64::INFINITY);
        for (block, part) in values.chunks(BLOCK * width).enumerate() {
            if !progress((block * BLOCK) as f64 / report.rows as f64) {
                return Err(FeatureCodeError::Stopped);
            }
            let first = has.len();
            let mut chosen = Vec::new();
            for (i, row) in part.chunks_exact(width).enumerate() {
                let marked = mask.is_none_or(|mask| mask[first + i]);
                let finite = row.iter().all(|v| v.is_finite());
                let zero = row.iter().all(|v| *v == f16::ZERO);
                report.not_finite += usize::from(marked && !finite);
                report.zero += usize::from(mask.is_some() && marked && zero);
                let counts = marked && finite && !zero;
                has.push(counts);
                if counts {
                    chosen.extend(row.iter().map(|v| v.to_f32()));
                }
            }
            let out: Vec<f16> =
                self.apply(direction, &chosen)?.into_iter().map(f16::from_f32).collect();
            if direction == CodeDirection::Encode {
                let codes: Vec<f32> = out.iter().map(|v| v.to_f32()).collect();
                let back = self.apply(CodeDirection::Decode, &codes)?;
                for (a, b) in chosen.chunks_exact(width).zip(back.chunks_exact(width)) {
                    let cosine = cosine(a, b);
                    sum += cosine;
                    lowest = lowest.min(cosine);
                }
            }
            let mut rows = vec![f16::ZERO; part.len() / width * out_width];
            let places = rows.chunks_exact_mut(out_width).zip(&has[first..]);
            for ((place, _), row) in places.filter(|(_, has)| **has).zip(out.chunks(out_width)) {
                place.copy_from_slice(row);
            }
            writer.write_rows(&rows)?;
        }
        writer.finish()?;
        report.with_feature = has.iter().filter(|has| **has).count();
        if direction == CodeDirection::Encode && report.with_feature > 0 {
            report.mean_cosine = Some(sum / report.with_feature as f64);
            report.lowest_cosine = Some(lowest);
        }
        Ok(has)
    }
}

/// The cosine of rows that are not 0.
fn cosine(a: &[f32], b: &[f32]) -> f64 {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let length = (dot(a, a) * dot(b, b)).sqrt();
    if length > 0.0 { dot(a, b) / length } else { 0.0 }
}

/// The mask of a folder, if it has one.
fn read_mask(scene: &Path, rows: usize) -> Result<Option<Vec<bool>>, FeatureCodeError> {
    let path = scene.join(MASK);
    if !path.is_file() {
        return Ok(None);
    }
    let file = NpyFile::open(&path)?;
    if !matches!(*file.shape(), [n] | [n, 1] if n == rows) {
        return Err(FeatureCodeError::Shape {
            path,
            expected: format!("({rows},)"),
            got: file.shape().to_vec(),
            help: "; all files of a folder must be of the same scene".to_owned(),
        });
    }
    let marks = match file.ty() {
        NpyType::Bool => file.read_u8()?.into_iter().map(|v| v != 0).collect(),
        _ => file.read_f64()?.into_iter().map(|v| v != 0.0).collect(),
    };
    Ok(Some(marks))
}

/// Names in a folder, sorted; hidden files are ignored.
fn entries(folder: &Path) -> Result<Vec<OsString>, FeatureCodeError> {
    let failed = |source| SceneError::Io {
        path: folder.to_owned(),
        action: "cannot list the folder",
        source,
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        if !name.to_string_lossy().starts_with('.') {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}
