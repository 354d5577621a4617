//! Writing the chunks of one scene.

use super::npy_copy::copy_rows;
use super::{Chunk, ChunkPlan, ChunkSettings, plan_chunks};
use crate::DataError;
use crate::files::{arrays, positions};
use crate::rng::name_number;
use half::f16;
use rayon::prelude::*;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::{
    GaussianScene, LabelledPoints, LanguageFeatures, LoadedScene, ReadOptions, SceneError,
    open_scene,
};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};

/// What became of one scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ChunkReport {
    /// Name of the scene.
    pub scene: String,
    /// Gaussians of the file.
    pub source_rows: usize,
    /// Those of them that cannot be used.
    pub dropped_rows: usize,
    /// Gaussians left after the sampling of cells.
    pub sampled: usize,
    /// Length along x and y, meters.
    pub extent: [f64; 2],
    /// Chunks there are now, and the Gaussians of each.
    pub chunks: Vec<(String, usize)>,
    /// Those of them that were there before.
    pub found: usize,
    /// Chunks left out because they hold too few Gaussians.
    pub below_minimum: usize,
    /// Chunks left out because there are too many.
    pub beyond_limit: usize,
    /// What is unusual.
    pub notes: Vec<String>,
}

/// Says how far a scene is, 0 to 1; gives `false` to stop.
pub(super) type Progress<'a> = &'a mut dyn FnMut(f64) -> bool;

/// Cuts one scene and writes its chunks into folders of `out`. Each appears when it is complete; one
/// that is there already is not written again.
pub(super) fn write_chunks(
    source: &Path,
    out: &Path,
    name: &str,
    settings: &ChunkSettings,
    progress: Progress<'_>,
) -> Result<ChunkReport, DataError> {
    let is_npy = source.join("coord.npy").is_file();
    // Features of a folder are copied from their file; they need not be in memory beside it.
    let options = ReadOptions { lang_feat: !is_npy, sh_rest: false, ..ReadOptions::default() };
    let loaded = open_scene(source, &options)?;
    let mask = loaded.scene.valid_feat_mask.as_deref();
    let plan = plan_chunks(&loaded.scene.coord, mask, settings, name_number(name))?;
    let names: Vec<String> = (0..plan.chunks.len()).map(|i| format!("{name}_{i}")).collect();
    let mut report = ChunkReport {
        scene: name.to_owned(),
        source_rows: loaded.source_rows(),
        dropped_rows: loaded.report.dropped_rows,
        sampled: plan.sampled,
        extent: plan.extent,
        below_minimum: plan.below_minimum,
        beyond_limit: plan.beyond_limit,
        ..ChunkReport::default()
    };
    report.notes = notes(&plan, &loaded, settings);
    let mut todo = Vec::new();
    for (chunk, name) in plan.chunks.iter().zip(names) {
        if out.join(&name).exists() {
            report.found += 1;
        } else {
            todo.push(Staged::create(out, &name, chunk)?);
        }
        report.chunks.push((name, chunk.rows.len()));
    }
    if !todo.is_empty() {
        if is_npy {
            let left_out = copy_folder(source, &loaded, &plan, &todo, settings, progress)?;
            report.notes.extend(left_out);
        } else {
            write_scenes(loaded, &plan, &todo, settings, progress)?;
        }
    }
    for staged in todo {
        staged.commit()?;
    }
    Ok(report)
}

fn notes(plan: &ChunkPlan, loaded: &LoadedScene, settings: &ChunkSettings) -> Vec<String> {
    let mut notes = Vec::new();
    if loaded.report.dropped_rows > 0 {
        let rows = loaded.report.dropped_rows;
        notes.push(format!("left out of every chunk, as they cannot be used: {rows} Gaussians"));
    }
    let short = (0..2).any(|a| plan.extent[a] <= settings.range[a] - settings.stride[a]);
    let [x, y] = plan.extent;
    if plan.chunks.is_empty() {
        let why = match (short && settings.exact, plan.below_minimum) {
            (true, _) => "it is not longer than range less stride".to_owned(),
            (_, n) => format!("{n} of fewer than {} Gaussians", settings.minimum_size),
        };
        notes.push(format!("no chunk of {x:.2} m x {y:.2} m: {why}"));
    } else if short {
        notes.push(format!("only {x:.2} m x {y:.2} m; the original would cut no chunk of it"));
    }
    notes
}

/// A folder that appears under its name when it is complete.
struct Staged<'a> {
    chunk: &'a Chunk,
    part: PathBuf,
    target: PathBuf,
    done: bool,
}

impl<'a> Staged<'a> {
    fn create(out: &Path, name: &str, chunk: &'a Chunk) -> Result<Self, SceneError> {
        let part = out.join(format!(".{name}.part"));
        let failed = |source| SceneError::Io {
            path: part.clone(),
            action: "cannot make the folder of a chunk",
            source,
        };
        // What an interrupted run left.
        if part.exists() {
            fs::remove_dir_all(&part).map_err(failed)?;
        }
        // Not over anything: a link in the way would lead out of the folder.
        fs::create_dir(&part).map_err(failed)?;
        Ok(Self { chunk, target: out.join(name), part, done: false })
    }

    fn commit(mut self) -> Result<(), SceneError> {
        fs::rename(&self.part, &self.target).map_err(|source| SceneError::Io {
            path: self.target.clone(),
            action: "cannot put the finished chunk in place",
            source,
        })?;
        self.done = true;
        Ok(())
    }
}

impl Drop for Staged<'_> {
    fn drop(&mut self) {
        if !self.done {
            // An error is on its way already.
            let _ = fs::remove_dir_all(&self.part);
        }
    }
}

/// Copies the rows of every array of a folder, under its name and in its type; gives what was left
/// out.
fn copy_folder(
    source: &Path,
    loaded: &LoadedScene,
    plan: &ChunkPlan,
    todo: &[Staged<'_>],
    settings: &ChunkSettings,
    progress: Progress<'_>,
) -> Result<Vec<String>, DataError> {
    let source_row = |row: &u32| match &loaded.kept_rows {
        Some(kept) => kept[*row as usize],
        None => *row,
    };
    let rows: Vec<Vec<u32>> =
        todo.iter().map(|staged| staged.chunk.rows.iter().map(source_row).collect()).collect();
    let points = source.join("pc_coord.npy");
    let origin = loaded.scene.origin;
    let points = points.is_file().then(|| positions(&points, origin)).transpose()?;
    let point_rows: Vec<Vec<u32>> = match &points {
        Some(coord) => {
            todo.iter().map(|s| rows_inside(coord, plan.corner, s.chunk, settings)).collect()
        }
        None => Vec::new(),
    };
    let mut left_out = Vec::new();
    let files = arrays(source)?;
    for (i, stem) in files.iter().enumerate() {
        if !progress(i as f64 / files.len() as f64) {
            return Err(SceneError::Stopped.into());
        }
        let file = NpyFile::open(&source.join(format!("{stem}.npy")))?;
        let picked = match (file.shape().first(), &points) {
            (Some(&n), Some(points)) if stem.starts_with("pc_") && n == points.len() => &point_rows,
            (Some(&n), _) if !stem.starts_with("pc_") && n == loaded.source_rows() => &rows,
            _ => {
                let shape = file.shape();
                left_out.push(format!("{stem}.npy is left out: its shape {shape:?} is of no rows"));
                continue;
            }
        };
        let paths: Vec<PathBuf> =
            todo.iter().map(|staged| staged.part.join(format!("{stem}.npy"))).collect();
        let parts: Vec<(&[u32], &Path)> =
            picked.iter().map(Vec::as_slice).zip(paths.iter().map(PathBuf::as_path)).collect();
        let width: usize = file.shape()[1..].iter().product();
        copy_rows(&file, &parts, |values| {
            if stem == "lang_feat" {
                normalise(values, width);
            }
        })?;
    }
    Ok(left_out)
}

/// Writes scenes of other formats.
fn write_scenes(
    loaded: LoadedScene,
    plan: &ChunkPlan,
    todo: &[Staged<'_>],
    settings: &ChunkSettings,
    progress: Progress<'_>,
) -> Result<(), DataError> {
    let mut scene: GaussianScene = loaded.scene;
    if let Some(LanguageFeatures { values, dim }) = &mut scene.lang_feat {
        normalise(values, *dim);
    }
    for (i, staged) in todo.iter().enumerate() {
        if !progress(i as f64 / todo.len() as f64) {
            return Err(SceneError::Stopped.into());
        }
        let rows: Vec<usize> = staged.chunk.rows.iter().map(|&row| row as usize).collect();
        let mut part = scene.select_rows(&rows)?;
        if let Some(points) = &mut part.labelled_points {
            let rows = rows_inside(&points.coord, plan.corner, staged.chunk, settings);
            let pick = |v: &Vec<i32>| rows.iter().map(|&row| v[row as usize]).collect();
            *points = LabelledPoints {
                coord: rows.iter().map(|&row| points.coord[row as usize]).collect(),
                segment: points.segment.as_ref().map(pick),
                instance: points.instance.as_ref().map(pick),
            };
        }
        write_npy_folder(&part, &staged.part, true)?;
    }
    Ok(())
}

/// Divides every row that is finite and not 0 by its norm.
///
/// The original computes norm and quotient in f16; here both are f64, rounded once.
fn normalise(values: &mut [f16], width: usize) {
    values.par_chunks_mut(width.max(1)).for_each(|row| {
        let norm = row.iter().map(|v| v.to_f64() * v.to_f64()).sum::<f64>().sqrt();
        if norm.is_finite() && norm > 0.0 {
            row.iter_mut().for_each(|v| *v = f16::from_f64(v.to_f64() / norm));
        }
    });
}

/// Points of the square of a chunk.
fn rows_inside(
    coord: &[[f32; 3]],
    corner: [f32; 3],
    chunk: &Chunk,
    settings: &ChunkSettings,
) -> Vec<u32> {
    let inside = |c: &[f32; 3]| {
        (0..2).all(|a| {
            let place = f64::from(c[a] - corner[a]);
            chunk.origin[a] <= place && place < chunk.origin[a] + settings.range[a]
        })
    };
    (0_u32..).zip(coord).filter(|(_, c)| inside(c)).map(|(row, _)| row).collect()
}
