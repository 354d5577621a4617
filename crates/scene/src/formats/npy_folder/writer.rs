//! Writing the preprocessed scene.

use super::STEMS;
use crate::StagedFolder;
use crate::formats::limit_tally::{LimitTally, Limits};
use crate::formats::npy::NpyFile;
use crate::formats::npy_writer::{NpyElement, NpyRowWriter, write_npy_bytes};
use crate::formats::output_names::output_names;
use crate::formats::packed_values::{
    ALPHA_ENDS, COLOR_CLIPPED, SIZE_CUT, SIZE_VANISHES, settle_float, tally_alpha, tally_colors,
    tally_sizes,
};
use crate::formats::{SceneFormat, WriteOptions, WriteProgress, WriteReport};
use crate::gaussian_scene::{probability_to_logit, sigmoid};
use crate::place::{NO_ORIGIN, plus};
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;
use std::ffi::OsString;
use std::path::Path;

/// Bytes written between two reports of progress: a few ms of work.
const BYTES_PER_TICK: usize = 4 << 20;
/// Rows computed by one task.
const ROWS_PER_TASK: usize = 4096;

/// Writes a scene as a folder of `.npy` files, with the names and types of the original
/// preprocessing; positions of a scene with an origin are f64. Spherical harmonics beyond the DC term are not part of the format.
///
/// All files are written to a temporary folder first and then moved. With `overwrite`, files of
/// this format that an earlier scene left in the folder are replaced or removed; others are kept.
///
/// # Errors
/// If the arrays do not match, if the folder holds a scene and `overwrite` is false, if it holds
/// labels of other names (`segment20.npy`) or other arrays of as many rows, which would be read as those
/// of the new scene, or if a file cannot be written. Then everything is as it was.
pub fn write_npy_folder(
    scene: &GaussianScene,
    folder: &Path,
    overwrite: bool,
) -> Result<(), SceneError> {
    scene.check_rows()?;
    let options = WriteOptions { overwrite, ..WriteOptions::default() };
    let mut report = WriteReport::new(SceneFormat::NpyFolder, scene.len());
    write_npy_scene(scene, folder, &options, &mut report, &mut |_| true)
}

/// As [`write_npy_folder`], and says what was written and what the format could not hold.
///
/// Reported are sizes that f32 cannot hold in meters (cut, or 0), alphas that become 0 or 1, and
/// colors beyond 0 to 1 (clipped).
///
/// # Errors
/// As [`write_npy_folder`]; also if `progress` says stop.
pub(in crate::formats) fn write_npy_scene(
    scene: &GaussianScene,
    folder: &Path,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let names = extra_names(scene, report);
    let old = replaced_files(folder, options.overwrite, scene.len(), &names)?;
    let staged = StagedFolder::create(folder)?;
    let total = total_bytes(scene);
    let mut writer = Writer { staged, progress, done: 0, total };
    write_files(scene, &mut writer, report)?;
    for (column, name) in scene.extra.iter().zip(&names) {
        let shape: Vec<usize> = [&[scene.len()], column.row_shape.as_slice()].concat();
        let path = writer.staged.add(format!("{name}.npy"));
        write_npy_bytes(&path, column.ty, &shape, &column.bytes)?;
        writer.tick(column.bytes.len())?;
    }
    writer.staged.commit(&old)?.iter().try_for_each(|file| report.wrote(file))
}

/// Names of the files of columns of unknown meaning; says which are not those of the columns.
fn extra_names(scene: &GaussianScene, report: &mut WriteReport) -> Vec<String> {
    let is_label = |name: &str| name.starts_with("segment");
    let labels = scene.extra.iter().filter(|column| is_label(&column.name)).count();
    // The only file of labels would be read as the labels; of several, none is.
    let lone = scene.segment.is_none() && labels == 1;
    let is_taken = |name: &str| {
        let name = name.to_ascii_lowercase();
        let score = name == "score" && scene.segment.is_none();
        (STEMS.contains(&name.as_str()) && !score)
            || name.starts_with("pc_")
            || name.starts_with('.')
            || (lone && is_label(&name))
    };
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    let (names, renamed) = output_names(&scene.extra, false, allowed, is_taken);
    renamed.iter().for_each(|text| report.left_out("extra", text));
    names.into_iter().flatten().collect()
}

/// Files of an earlier scene that make room for a new one of `rows` rows and `extra` columns, sorted; none
/// if there is no such folder.
fn replaced_files(
    folder: &Path,
    overwrite: bool,
    rows: usize,
    extra: &[String],
) -> Result<Vec<OsString>, SceneError> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let failed = || SceneError::io(folder, "cannot list the folder");
    let (mut known, mut labels, mut columns) = (Vec::new(), Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).map_err(failed())? {
        let name = entry.map_err(failed())?.file_name();
        let stem = name.to_str().and_then(|name| name.strip_suffix(".npy")).unwrap_or_default();
        if STEMS.contains(&stem) || extra.iter().any(|e| e == stem) {
            known.push(name);
        } else if stem.starts_with("segment") || stem.starts_with("pc_segment") {
            labels.push(name);
        } else if !stem.is_empty()
            && NpyFile::open(&folder.join(&name)).is_ok_and(|f| f.shape().first() == Some(&rows))
        {
            columns.push(name);
        }
    }
    known.sort();
    labels.sort();
    if let (false, Some(file)) = (overwrite, known.first().or(labels.first())) {
        let problem = format!("already holds a scene ({})", file.to_string_lossy());
        return Err(SceneError::format(folder, problem, "choose an empty folder or overwrite it"));
    }
    if !labels.is_empty() {
        let names: Vec<_> = labels.iter().map(|name| name.to_string_lossy()).collect();
        let problem =
            format!("holds {}, which would be taken for labels of the new scene", names.join(", "));
        return Err(SceneError::format(folder, problem, "move them away or choose another folder"));
    }
    columns.sort();
    if !columns.is_empty() {
        let names: Vec<_> = columns.iter().map(|name| name.to_string_lossy()).collect();
        let problem = format!(
            "holds {}, which would be taken for columns of the new scene",
            names.join(", ")
        );
        return Err(SceneError::format(folder, problem, "move them away or choose another folder"));
    }
    Ok(known)
}

/// Bytes of all arrays.
fn total_bytes(scene: &GaussianScene) -> usize {
    let rows = |there: bool, bytes: usize| if there { scene.len() * bytes } else { 0 };
    let code = scene.lang_code.as_ref().map_or(0, |code| {
        code.values.len() * 2 + (code.codebook.mean.len() + code.codebook.axes.len()) * 4
    });
    let position = if scene.has_origin() { 24 } else { 12 };
    rows(true, position + 3 + 4 + 12 + 16)
        + scene.extra.iter().map(|column| column.bytes.len()).sum::<usize>()
        + rows(scene.normal.is_some(), 12)
        + rows(scene.segment.is_some(), 4)
        + rows(scene.instance.is_some(), 4)
        + rows(scene.segment_score.is_some(), 4)
        + rows(scene.valid_feat_mask.is_some(), 8)
        + code
        + scene.lang_feat.as_ref().map_or(0, |feat| feat.values.len() * 2)
        + scene.labelled_points.as_ref().map_or(0, |points| points.coord.len() * (position + 8))
}

struct Writer<'a> {
    staged: StagedFolder,
    progress: WriteProgress<'a>,
    done: usize,
    total: usize,
}

impl Writer<'_> {
    fn start<T: NpyElement>(
        &mut self,
        stem: &str,
        rows: usize,
        row_shape: &[usize],
    ) -> Result<NpyRowWriter<T>, SceneError> {
        NpyRowWriter::create(&self.staged.add(format!("{stem}.npy")), rows, row_shape)
    }

    fn tick(&mut self, bytes: usize) -> Result<(), SceneError> {
        self.done += bytes;
        let fraction = (self.done as f64 / self.total.max(1) as f64).min(1.0);
        if (self.progress)(fraction) { Ok(()) } else { Err(SceneError::Stopped) }
    }

    /// Writes an array as it is.
    fn array<T: NpyElement>(
        &mut self,
        stem: &str,
        rows: usize,
        row_shape: &[usize],
        values: &[T],
    ) -> Result<(), SceneError> {
        let mut to = self.start::<T>(stem, rows, row_shape)?;
        let width = row_shape.iter().product::<usize>().max(1);
        let rows_per_tick = (BYTES_PER_TICK / (width * T::SIZE)).max(1);
        for values in values.chunks(rows_per_tick * width) {
            to.write_rows(values)?;
            self.tick(size_of_val(values))?;
        }
        to.finish()
    }

    /// Writes an array that is computed row by row, in parallel, and counts what it could not hold.
    fn computed<T: NpyElement + Default, const W: usize>(
        &mut self,
        stem: &str,
        rows: usize,
        row_shape: &[usize],
        value: impl Fn(usize, &mut Limits<2>) -> [T; W] + Sync,
    ) -> Result<[LimitTally; 2], SceneError> {
        let mut to = self.start::<T>(stem, rows, row_shape)?;
        let rows_per_tick = BYTES_PER_TICK / (W * T::SIZE);
        let mut buffer = vec![[T::default(); W]; rows.min(rows_per_tick)];
        let mut limits = Limits::default();
        for first in (0..rows).step_by(rows_per_tick) {
            let part = &mut buffer[..rows_per_tick.min(rows - first)];
            let found = part
                .par_chunks_mut(ROWS_PER_TASK)
                .enumerate()
                .map(|(task, part)| {
                    let mut limits = Limits::default();
                    for (i, into) in part.iter_mut().enumerate() {
                        *into = value(first + task * ROWS_PER_TASK + i, &mut limits);
                    }
                    limits
                })
                .reduce(Limits::default, Limits::merge);
            limits = limits.merge(found);
            to.write_rows(part.as_flattened())?;
            self.tick(size_of_val(part))?;
        }
        to.finish()?;
        Ok(limits.0)
    }
}

/// Writes positions in the coordinates of the file: as doubles where f32 would not hold them.
fn write_positions(
    stem: &str,
    coord: &[[f32; 3]],
    origin: [f64; 3],
    to: &mut Writer<'_>,
) -> Result<(), SceneError> {
    if origin == NO_ORIGIN {
        return to.array(stem, coord.len(), &[3], coord.as_flattened());
    }
    to.computed(stem, coord.len(), &[3], |row, _| plus(coord[row], origin)).map(|_| ())
}

fn write_files(
    scene: &GaussianScene,
    to: &mut Writer<'_>,
    report: &mut WriteReport,
) -> Result<(), SceneError> {
    let n = scene.len();
    write_positions("coord", &scene.coord, scene.origin, to)?;
    let [clipped, _] = to.computed("color", n, &[3], |row, Limits([clipped, _])| {
        tally_colors(row, scene.sh_dc[row], clipped);
        scene.color_u8(row)
    })?;
    let [ends, _] = to.computed("opacity", n, &[], |row, Limits([ends, _])| {
        let p = settle_float(scene.opacity(row), |p| sigmoid(probability_to_logit(p)));
        tally_alpha(row, scene.opacity_logit[row], p == 0.0 || p == 1.0, ends);
        [p]
    })?;
    let [large, small] = to.computed("scale", n, &[3], |row, Limits([large, small])| {
        // Infinity would not come back.
        let again = |s: f32| (f64::from(s).ln() as f32).exp().min(f32::MAX);
        let scale = scene.scale(row).map(|s| settle_float(s.min(f32::MAX), again));
        tally_sizes(row, scene.log_scale[row], scale, large, small);
        scale
    })?;
    report.limit("log_scale", SIZE_CUT, large);
    report.limit("log_scale", SIZE_VANISHES, small);
    report.limit("opacity_logit", ALPHA_ENDS, ends);
    report.limit("sh_dc", COLOR_CLIPPED, clipped);
    to.array("quat", n, &[4], scene.quat.as_flattened())?;
    write_optional(scene, to)
}

/// The arrays that not every scene has.
fn write_optional(scene: &GaussianScene, to: &mut Writer<'_>) -> Result<(), SceneError> {
    let n = scene.len();
    if let Some(normal) = &scene.normal {
        to.array("normal", n, &[3], normal.as_flattened())?;
    }
    if let Some(segment) = &scene.segment {
        to.array("segment", n, &[], segment)?;
    }
    if let Some(instance) = &scene.instance {
        to.array("instance", n, &[], instance)?;
    }
    if let Some(score) = &scene.segment_score {
        to.array("score", n, &[], score)?;
    }
    if let Some(code) = &scene.lang_code {
        let (k, width) = (code.width(), code.codebook.feature_width());
        to.array("lang_code", n, &[k], &code.values)?;
        to.array("lang_codebook_mean", width, &[], &code.codebook.mean)?;
        to.array("lang_codebook_axes", k, &[width], &code.codebook.axes)?;
    }
    if let Some(feat) = &scene.lang_feat {
        to.array("lang_feat", n, &[feat.dim], &feat.values)?;
    }
    if let Some(mask) = &scene.valid_feat_mask {
        to.computed("valid_feat_mask", n, &[], |row, _| [i64::from(mask[row])])?;
    }
    if let Some(points) = &scene.labelled_points {
        let m = points.coord.len();
        write_positions("pc_coord", &points.coord, scene.origin, to)?;
        if let Some(segment) = &points.segment {
            to.array("pc_segment", m, &[], segment)?;
        }
        if let Some(instance) = &points.instance {
            to.array("pc_instance", m, &[], instance)?;
        }
    }
    Ok(())
}
