//! The files of one granularity.

use anyhow::{Context, Result};
use half::f16;
use scenesplat::lifted::FULL;
use scenesplat::outputs::OpenedScene;
use scenesplat::principal::{PrincipalDirections, sample_step, stretched_colors};
use scenesplat::rasterizer::lifting::{BlockFeatures, LiftError, SegmentTables};
use scenesplat::scene::SceneError;
use scenesplat::scene::formats::npy_writer::{NpyElement, NpyRowWriter, write_npy};
use std::path::{Path, PathBuf};

/// The files of one granularity in the full form, with the picture of them.
pub(super) const FILES: [&str; 6] =
    [FULL, "valid_feat_mask.npy", "confidence.npy", "views.npy", "coverage.npy", "preview.png"];

/// Writes features as they come and keeps what is small.
pub(super) struct Writer<'a> {
    opened: &'a OpenedScene,
    folder: PathBuf,
    dim: usize,
    features: NpyRowWriter<f16>,
    valid: Vec<u8>,
    confidence: Vec<f32>,
    views: Vec<i32>,
    coverage: Vec<f32>,
    directions: PrincipalDirections,
    /// One row per Gaussian; none without a feature.
    projected: Vec<Option<[f32; 3]>>,
}

/// What was written.
pub(super) struct Written {
    /// Files and their sizes.
    pub(super) files: Vec<(PathBuf, u64)>,
    /// Of the Gaussians.
    pub(super) colors: Vec<[u8; 3]>,
    /// Gaussians with a feature.
    pub(super) valid: usize,
    /// Of those with a feature.
    pub(super) mean_confidence: f64,
    /// Of those with a feature.
    pub(super) mean_views: f64,
}

impl<'a> Writer<'a> {
    pub(super) fn new(
        opened: &'a OpenedScene,
        folder: &Path,
        tables: &SegmentTables,
    ) -> Result<Self> {
        let (rows, dim) = (opened.loaded.source_rows(), tables.dim());
        let path = folder.join(FULL);
        let step = sample_step(tables.len());
        let sample = (0..tables.len()).step_by(step).flat_map(|s| tables.row(s as u32)).copied();
        let directions = PrincipalDirections::find(sample.collect(), dim);
        Ok(Self {
            opened,
            folder: folder.to_owned(),
            dim,
            features: NpyRowWriter::create(&path, rows, &[dim])?,
            valid: Vec::new(),
            confidence: Vec::new(),
            views: Vec::new(),
            coverage: Vec::new(),
            directions,
            projected: Vec::new(),
        })
    }

    /// Takes the next block.
    pub(super) fn add(&mut self, block: &BlockFeatures) -> Result<(), LiftError> {
        let values: Vec<f16> = block.features.iter().map(|&v| f16::from_f32(v)).collect();
        self.write_rows(block.first, block.valid.len(), &values)?;
        for (feature, &valid) in block.features.chunks_exact(self.dim).zip(&block.valid) {
            self.projected.push(valid.then(|| self.directions.project(feature)));
        }
        self.valid.extend(block.valid.iter().map(|&v| u8::from(v)));
        self.confidence.extend(&block.confidence);
        self.views.extend(block.views.iter().map(|&v| i32::try_from(v).unwrap_or(i32::MAX)));
        self.coverage.extend(&block.coverage);
        Ok(())
    }

    /// Writes rows at their places in the source: rows that were left out stay 0.
    fn write_rows(&self, first: usize, count: usize, values: &[f16]) -> Result<(), SceneError> {
        let Some(kept) = &self.opened.loaded.kept_rows else {
            return self.features.write_rows_at(first, values).map(|_| ());
        };
        let rows = &kept[first..first + count];
        let mut start = 0;
        // Runs of rows that follow each other in the source, too.
        for run in rows.chunk_by(|a, b| a + 1 == *b) {
            let part = &values[start * self.dim..(start + run.len()) * self.dim];
            self.features.write_rows_at(run[0] as usize, part)?;
            start += run.len();
        }
        Ok(())
    }

    /// Completes the files.
    pub(super) fn finish(self) -> Result<Written> {
        self.features.finish_with_zeros()?;
        let valid = self.valid.iter().filter(|&&v| v == 1).count();
        let mean = |values: &mut dyn Iterator<Item = f64>| {
            let labelled = values.zip(&self.valid).filter(|(_, v)| **v == 1);
            labelled.map(|(value, _)| value).sum::<f64>() / valid.max(1) as f64
        };
        let mean_confidence = mean(&mut self.confidence.iter().map(|&v| f64::from(v)));
        let mean_views = mean(&mut self.views.iter().map(|&v| f64::from(v)));
        let column = Column { opened: self.opened, folder: &self.folder };
        let mut files = vec![with_size(self.folder.join(FULL))?];
        files.push(column.write("valid_feat_mask.npy", &self.valid)?);
        files.push(column.write("confidence.npy", &self.confidence)?);
        files.push(column.write("views.npy", &self.views)?);
        files.push(column.write("coverage.npy", &self.coverage)?);
        let colors = stretched_colors(&self.projected);
        Ok(Written { files, colors, valid, mean_confidence, mean_views })
    }
}

/// Where columns go.
pub(super) struct Column<'a> {
    pub(super) opened: &'a OpenedScene,
    pub(super) folder: &'a Path,
}

impl Column<'_> {
    /// One value per row of the source, the usual one (mostly 0) where a row was left out.
    pub(super) fn write<T: NpyElement + Default>(
        &self,
        name: &str,
        values: &[T],
    ) -> Result<(PathBuf, u64)> {
        let path = self.folder.join(name);
        let rows = self.opened.loaded.to_source_rows(values, T::default())?;
        write_npy(&path, &[rows.len()], &rows)?;
        with_size(path)
    }
}

/// A file and its size.
pub(super) fn with_size(path: PathBuf) -> Result<(PathBuf, u64)> {
    let about = std::fs::metadata(&path).with_context(|| path.display().to_string())?;
    Ok((path, about.len()))
}
