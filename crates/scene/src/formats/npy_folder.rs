//! The preprocessed scene: a folder with one `.npy` file per field.
//!
//! Values there are *activated* (opacity a probability, scale in meters, color a byte) while
//! [`GaussianScene`] holds them before activation; color bytes survive both ways exactly. There is
//! no file for spherical harmonics beyond the DC term.

mod writer;

pub use writer::write_npy_folder;
pub(super) use writer::write_npy_scene;

use super::color_columns::{ColorType, FileColors};
use super::label_column::{
    INSTANCE_RULES, LabelRules, SEGMENT_RULES, labels_from_f64, labels_from_i64,
};
use super::labelled_ply::finite_points;
use super::npy::{NpyFile, NpyType};
use super::semantics::clean_code;
use super::{LoadedScene, ReadOptions, SceneFormat};
use crate::gaussian_scene::{probability_to_logit, u8_to_dc};
use crate::place::{NO_ORIGIN, origin_of, sample_rows};
use crate::value_policy::{DEFAULT_GREY, DEFAULT_SCALE, Rule};
use crate::{
    ExtraColumn, GaussianScene, LabelledPoints, LanguageCode, LanguageCodebook, LanguageFeatures,
    RepairReport, SceneError, UnreadColumn,
};
use half::f16;
use rayon::prelude::*;
use std::path::Path;

/// Stems of the files with a meaning here.
const STEMS: [&str; 17] = [
    "coord",
    "color",
    "opacity",
    "scale",
    "quat",
    "normal",
    "lang_feat",
    "valid_feat_mask",
    "segment",
    "instance",
    "score",
    "lang_code",
    "lang_codebook_mean",
    "lang_codebook_axes",
    "pc_coord",
    "pc_segment",
    "pc_instance",
];

/// Reads a scene from a folder of `.npy` files.
///
/// Required is `coord`; doubles far from 0 are kept relative to an origin, and `pc_coord` with them.
/// Defaults, each reported: `scale` (0.01 m), `quat` (no rotation), `opacity`
/// (1), `color` (gray). Read if there: `normal`, `lang_feat`, `valid_feat_mask` (else: where any
/// feature is not 0), labels, `instance`, and the labeled points `pc_coord`, `pc_instance` and
/// `pc_` + the file of labels. Labels of several columns count by their first. Logits and
/// logarithms are taken in f64. Other arrays of a row for each Gaussian are kept in `extra` if
/// `options.extra` asks for them, else named.
///
/// # Errors
/// As [`super::open_scene`]; also if a file has another number of rows than `coord`, or if the
/// labels asked for are not there.
pub fn read_npy_folder(folder: &Path, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    let coord = open(folder, "coord")?.ok_or_else(|| {
        SceneError::format(folder, "is a folder without coord.npy", "every scene needs positions")
    })?;
    let origin = far_origin(&coord)?;
    let coord = positions(&coord, origin)?;
    let mut reader = Reader { folder, rows: coord.len(), origin, report: RepairReport::default() };
    let log_scale = reader.log_scale()?;
    let quat = match reader.open("quat")? {
        Some(file) => rows::<4>(&file, Some(reader.rows))?,
        None => {
            reader.missing(Rule::QuatMissing);
            vec![[1.0, 0.0, 0.0, 0.0]; reader.rows]
        }
    };
    let opacity_logit = reader.opacity()?;
    let sh_dc = reader.sh_dc()?;
    let normal =
        reader.open("normal")?.map(|file| rows::<3>(&file, Some(reader.rows))).transpose()?;
    let (lang_feat, valid_feat_mask) = reader.features(options.lang_feat)?;
    let label_stem = reader.label_stem(options.segment.as_deref())?;
    let segment = match &label_stem {
        Some(stem) => reader.labels(stem, reader.rows, SEGMENT_RULES)?,
        None => None,
    };
    let instance = reader.labels("instance", reader.rows, INSTANCE_RULES)?;
    let segment_score = match (&segment, reader.open("score")?) {
        (Some(_), Some(file)) if *file.shape() == [reader.rows] => Some(file.read_f32()?),
        (Some(_), Some(file)) => return Err(wrong_shape(&file, Some(reader.rows), "")),
        _ => None,
    };
    let lang_code = reader.language_code()?;
    let labelled_points =
        reader.labelled_points(options.segment.as_deref(), label_stem.as_deref())?;
    let (extra, unread) = reader.unknown(options, segment.is_some(), label_stem.as_deref())?;
    let scene = GaussianScene {
        origin,
        coord,
        log_scale,
        quat,
        opacity_logit,
        sh_dc,
        normal,
        segment,
        segment_score,
        instance,
        lang_code,
        lang_feat,
        valid_feat_mask,
        labelled_points,
        extra,
        ..GaussianScene::default()
    };
    let (policy, kind) = (options.policy, SceneFormat::NpyFolder);
    let loaded = LoadedScene::finish(scene, reader.report, policy, folder, kind)?;
    Ok(LoadedScene { unread, ..loaded })
}

/// Opens the file of that stem if it exists.
fn open(folder: &Path, stem: &str) -> Result<Option<NpyFile>, SceneError> {
    let path = folder.join(format!("{stem}.npy"));
    if path.exists() { NpyFile::open(&path).map(Some) } else { Ok(None) }
}

/// Reads an array of shape `[N, W]`.
fn rows<const W: usize>(
    file: &NpyFile,
    expected: Option<usize>,
) -> Result<Vec<[f32; W]>, SceneError> {
    let shape = file.shape();
    let fits =
        matches!(shape, [_, width] if *width == W) && expected.is_none_or(|rows| rows == shape[0]);
    if !fits {
        return Err(wrong_shape(file, expected, &W.to_string()));
    }
    Ok(file.read_f32()?.as_chunks::<W>().0.to_vec())
}

/// The origin of positions; zero unless they are doubles, far from 0.
fn far_origin(file: &NpyFile) -> Result<[f64; 3], SceneError> {
    if !matches!(file.shape(), [_, 3]) {
        return Err(wrong_shape(file, None, "3"));
    }
    if file.ty() != NpyType::Float(8) {
        return Ok(NO_ORIGIN);
    }
    Ok(origin_of(sample_rows(file.shape()[0]).map(|row| file.position(row))))
}

/// Reads positions relative to an origin.
fn positions(file: &NpyFile, origin: [f64; 3]) -> Result<Vec<[f32; 3]>, SceneError> {
    match file.shape() {
        [_, 3] if origin != NO_ORIGIN => file.read_about(origin),
        _ => rows::<3>(file, None),
    }
}

/// Whether an array is `[N]` or `[N, 1]`.
fn is_column(file: &NpyFile, rows: usize) -> bool {
    matches!(file.shape(), [n] | [n, 1] if *n == rows)
}

/// The error for an array that does not go with `coord`.
fn wrong_shape(file: &NpyFile, rows: Option<usize>, width: &str) -> SceneError {
    let rows = rows.map_or_else(|| "N".to_owned(), |rows| rows.to_string());
    let comma = if width.is_empty() { "," } else { ", " };
    let problem = format!("expected shape ({rows}{comma}{width}), got {:?}", file.shape());
    SceneError::format(file.path(), problem, "all files of a folder must be of the same scene")
}

struct Reader<'a> {
    folder: &'a Path,
    rows: usize,
    /// Of all positions.
    origin: [f64; 3],
    report: RepairReport,
}

impl Reader<'_> {
    fn open(&self, stem: &str) -> Result<Option<NpyFile>, SceneError> {
        open(self.folder, stem)
    }

    fn missing(&mut self, rule: Rule) {
        self.report.add(rule, self.rows, 0, "");
    }

    fn log_scale(&mut self) -> Result<Vec<[f32; 3]>, SceneError> {
        let Some(file) = self.open("scale")? else {
            self.missing(Rule::ScaleMissing);
            return Ok(vec![[DEFAULT_SCALE.ln(); 3]; self.rows]);
        };
        let scale = if is_column(&file, self.rows) {
            self.missing(Rule::ScaleOne);
            file.read_f32()?.into_iter().map(|s| [s; 3]).collect()
        } else {
            rows::<3>(&file, Some(self.rows))?
        };
        // The logarithm of a negative number is NaN, and such a row is dropped.
        let ln = |v: f32| f64::from(v).ln() as f32;
        Ok(scale.into_par_iter().map(|s| s.map(ln)).collect())
    }

    fn opacity(&mut self) -> Result<Vec<f32>, SceneError> {
        let Some(file) = self.open("opacity")? else {
            self.missing(Rule::OpacityMissing);
            return Ok(vec![f32::INFINITY; self.rows]);
        };
        if !is_column(&file, self.rows) {
            return Err(wrong_shape(&file, Some(self.rows), ""));
        }
        let values = file.read_f32()?;
        for (row, value) in values.iter().enumerate() {
            if *value < 0.0 || *value > 1.0 {
                self.report.add(Rule::OpacityOutside, 1, row, &value.to_string());
            }
        }
        Ok(values.into_par_iter().map(|p| probability_to_logit(p.clamp(0.0, 1.0))).collect())
    }

    fn sh_dc(&mut self) -> Result<Vec<[f32; 3]>, SceneError> {
        let Some(file) = self.open("color")? else {
            self.missing(Rule::ColorMissing);
            return Ok(vec![[u8_to_dc(DEFAULT_GREY); 3]; self.rows]);
        };
        if file.shape() != [self.rows, 3] {
            return Err(wrong_shape(&file, Some(self.rows), "3"));
        }
        let ty = match file.ty() {
            NpyType::UInt(1) => ColorType::Byte,
            NpyType::UInt(2) => ColorType::Short,
            NpyType::Float(_) => ColorType::Float,
            _ => ColorType::Whole,
        };
        let values = file.read_f32()?;
        Ok(FileColors::decide(values, ty, "color.npy", &mut self.report).dc())
    }

    /// Language features and which rows have one.
    fn features(
        &mut self,
        wanted: bool,
    ) -> Result<(Option<LanguageFeatures>, Option<Vec<bool>>), SceneError> {
        let mut mask = None;
        if let Some(file) = self.open("valid_feat_mask")? {
            if !is_column(&file, self.rows) {
                return Err(wrong_shape(&file, Some(self.rows), ""));
            }
            let values = file.read_f64()?;
            for (row, value) in values.iter().enumerate() {
                if *value != 0.0 && *value != 1.0 {
                    self.report.add(Rule::MaskInvalid, 1, row, &value.to_string());
                }
            }
            mask = Some(values.into_iter().map(|v| v != 0.0).collect());
        }
        let file = if wanted { self.open("lang_feat")? } else { None };
        let Some(file) = file else { return Ok((None, mask)) };
        let &[rows, dim] = file.shape() else {
            return Err(wrong_shape(&file, Some(self.rows), "D"));
        };
        if rows != self.rows || dim == 0 {
            return Err(wrong_shape(&file, Some(self.rows), "D"));
        }
        let values = file.read_f16()?;
        let mask = mask.unwrap_or_else(|| {
            values.par_chunks_exact(dim).map(|row| row.iter().any(|&v| v != f16::ZERO)).collect()
        });
        Ok((Some(LanguageFeatures { values, dim }), Some(mask)))
    }

    /// Codes with their codebook, if there are any.
    fn language_code(&mut self) -> Result<Option<LanguageCode>, SceneError> {
        let Some(code) = self.open("lang_code")? else { return Ok(None) };
        let [mean, axes] = ["lang_codebook_mean", "lang_codebook_axes"].map(|s| self.open(s));
        let (Some(mean), Some(axes)) = (mean?, axes?) else {
            let problem = "has lang_code.npy without lang_codebook_mean.npy and \
                           lang_codebook_axes.npy";
            return Err(SceneError::format(self.folder, problem, "write the codes again"));
        };
        let ([n, k], [width]) = (code.shape(), mean.shape()) else {
            return Err(wrong_shape(&code, Some(self.rows), ", k"));
        };
        if *n != self.rows || axes.shape() != [*k, *width] {
            return Err(wrong_shape(&axes, Some(*k), ", D"));
        }
        let codebook = LanguageCodebook { mean: mean.read_f32()?, axes: axes.read_f32()? };
        codebook.check()?;
        let values = code.read_f16()?;
        Ok(Some(clean_code(LanguageCode { values, codebook }, &mut self.report)))
    }

    /// Labels from the first column of a file; `None` if there is no such file.
    fn labels(
        &mut self,
        stem: &str,
        rows: usize,
        rules: LabelRules,
    ) -> Result<Option<Vec<i32>>, SceneError> {
        let Some(file) = self.open(stem)? else { return Ok(None) };
        let width = match *file.shape() {
            [n] if n == rows => 1,
            [n, width] if n == rows && width > 0 => width,
            _ => return Err(wrong_shape(&file, Some(rows), "")),
        };
        if width > 1 {
            let note = format!("of the {width} columns of {stem}.npy only the first is read");
            self.report.notes.push(note);
        }
        if file.ty().is_float() {
            let values = file.read_f64()?;
            let first = values.into_iter().step_by(width);
            return Ok(Some(labels_from_f64(first, rules, &mut self.report)));
        }
        let none = (file.ty() == NpyType::UInt(2)).then_some(i64::from(u16::MAX));
        let values = file.read_i64()?;
        let first = values.into_iter().step_by(width);
        Ok(Some(labels_from_i64(first, none, rules, &mut self.report)))
    }

    /// The arrays that nothing above reads: kept, if they are wanted and have a row for each Gaussian,
    /// else named.
    fn unknown(
        &self,
        options: &ReadOptions,
        has_labels: bool,
        label_stem: Option<&str>,
    ) -> Result<(Vec<ExtraColumn>, Vec<UnreadColumn>), SceneError> {
        let (mut kept, mut unread) = (Vec::new(), Vec::new());
        let points = options.segment.as_deref().or(label_stem).map(|stem| format!("pc_{stem}"));
        for stem in self.array_files("")? {
            let is_known = STEMS.contains(&stem.as_str()) && (stem != "score" || has_labels);
            if is_known || Some(stem.as_str()) == label_stem || Some(&stem) == points.as_ref() {
                continue;
            }
            if stem.starts_with("pc_") {
                unread.push(UnreadColumn::other(&stem, "an array of the labeled points"));
                continue;
            }
            if !options.extra {
                unread.push(UnreadColumn::of_numbers(&stem, "array".to_owned(), true));
                continue;
            }
            match self.extra_column(&stem) {
                Ok(column) => kept.push(column),
                Err(problem) => unread.push(UnreadColumn::other(&stem, problem)),
            }
        }
        Ok((kept, unread))
    }

    /// An array with a row for each Gaussian, or why it is none.
    fn extra_column(&self, stem: &str) -> Result<ExtraColumn, String> {
        let not_numbers = |error: SceneError| match error {
            SceneError::Format { problem, .. } => format!("an array that {problem}"),
            error => error.to_string(),
        };
        let path = self.folder.join(format!("{stem}.npy"));
        let file = NpyFile::open(&path).map_err(not_numbers)?;
        let Some((&rows, row_shape)) = file.shape().split_first() else {
            return Err("a single number".to_owned());
        };
        if rows != self.rows || row_shape.contains(&0) {
            return Err(format!("an array of shape {:?}, not of {} rows", file.shape(), self.rows));
        }
        let bytes = file.read_bytes().map_err(not_numbers)?;
        let (name, row_shape) = (stem.to_owned(), row_shape.to_vec());
        Ok(ExtraColumn { name, ty: file.ty(), row_shape, bytes })
    }

    /// Stems of files that begin with `prefix`, sorted.
    fn array_files(&self, prefix: &str) -> Result<Vec<String>, SceneError> {
        let failed = || SceneError::io(self.folder, "cannot list the folder");
        let mut stems = Vec::new();
        for entry in std::fs::read_dir(self.folder).map_err(failed())? {
            let name = entry.map_err(failed())?.file_name();
            let stem = name.to_str().and_then(|name| name.strip_suffix(".npy"));
            if let Some(stem) = stem.filter(|stem| stem.starts_with(prefix)) {
                stems.push(stem.to_owned());
            }
        }
        stems.sort();
        Ok(stems)
    }

    /// Which file the labels come from.
    fn label_stem(&mut self, wanted: Option<&str>) -> Result<Option<String>, SceneError> {
        let found = self.array_files("segment")?;
        if let Some(stem) = wanted {
            // Any name will do, also one that is not found by itself.
            if self.folder.join(format!("{stem}.npy")).is_file() {
                return Ok(Some(stem.to_owned()));
            }
            if self.folder.join(format!("pc_{stem}.npy")).is_file() {
                // Labeled points have them; the Gaussians have none.
                return Ok(None);
            }
            let there = if found.is_empty() { "no labels".to_owned() } else { found.join(", ") };
            let problem = format!("has no {stem}.npy to read labels from; it has {there}");
            return Err(SceneError::format(self.folder, problem, "choose other labels"));
        }
        Ok(self.usual(found, "segment"))
    }

    /// Of several label files the one of that stem, or the only one; else a note says what to do.
    fn usual(&mut self, mut found: Vec<String>, stem: &str) -> Option<String> {
        if found.iter().any(|f| f == stem) {
            return Some(stem.to_owned());
        }
        if found.len() > 1 {
            let names = found.join(", ");
            self.report.notes.push(format!("labels not read, choose one of {names}"));
            return None;
        }
        found.pop()
    }

    fn labelled_points(
        &mut self,
        wanted: Option<&str>,
        label_stem: Option<&str>,
    ) -> Result<Option<LabelledPoints>, SceneError> {
        let Some(coord) = self.open("pc_coord")? else { return Ok(None) };
        let coord = positions(&coord, self.origin)?;
        let instance = self.labels("pc_instance", coord.len(), INSTANCE_RULES)?;
        let stems = match wanted.or(label_stem) {
            Some(stem) => vec![format!("pc_{stem}")],
            None => self.array_files("pc_segment")?,
        };
        let segment = match self.usual(stems, "pc_segment") {
            Some(stem) => self.labels(&stem, coord.len(), SEGMENT_RULES)?,
            None => None,
        };
        let mut points = LabelledPoints { coord, segment, instance };
        if let Some(finite) = finite_points(&points.coord, &mut self.report) {
            points.retain(&finite);
        }
        Ok(Some(points))
    }
}
