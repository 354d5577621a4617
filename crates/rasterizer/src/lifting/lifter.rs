//! From pictures with segments to features of Gaussians.

use super::finalise::{BlockFeatures, FinaliseSettings, finalise_block};
use super::segment_map::SegmentMap;
use super::spool::{BlockWeights, SegmentWeight, WeightSpool};
use super::tables::SegmentTables;
use super::tile_segments::MAX_LEVELS;
use super::view_weights::{
    DepthTolerance, LabelledView, LiftRule, ViewWeights, weights_of_all_and_agreeing,
    weights_with_own_depth,
};
use super::{Disagreement, LiftError, Panes};
use crate::{Gaussians, RasterSettings, View};
use std::borrow::Cow;
use std::path::PathBuf;

/// Bytes of features that are in memory at a time.
const BLOCK_BYTES: usize = 64 << 20;
/// Gaussians that the disagreement is measured on, about.
const SAMPLED_GAUSSIANS: usize = 20_000;
/// Memory for weights that wait.
const DEFAULT_MEMORY: u64 = 1 << 30;

/// How labels are lifted.
#[derive(Debug, Clone, PartialEq)]
pub struct LiftSettings {
    /// Which pixels count.
    pub rule: LiftRule,
    /// Constants of the renderer.
    pub raster: RasterSettings,
    /// Pixels along the borders of segments that label nothing; see [`SegmentMap::eroded`].
    pub erosion: u32,
    /// Only pixels whose depth agrees label a Gaussian: the depth given with the picture, or else the
    /// median depth of the render itself, which costs a second pass over the pixels.
    pub depth: Option<DepthTolerance>,
    /// Bytes of weights that wait in memory, at least [`least_memory`](Self::least_memory); more wait in
    /// a file.
    pub memory: u64,
    /// Folder of that file.
    pub spill_folder: PathBuf,
}

impl Default for LiftSettings {
    /// All pixels, gsplat 1.6, 1 GiB, the system's folder for temporary files.
    fn default() -> Self {
        Self {
            rule: LiftRule::AlphaWeighted,
            raster: RasterSettings::default(),
            erosion: 0,
            depth: None,
            memory: DEFAULT_MEMORY,
            spill_folder: std::env::temp_dir(),
        }
    }
}

impl LiftSettings {
    /// The least `memory` for pictures of so many granularities: room for 1024 weights of each.
    pub fn least_memory(levels: usize) -> u64 {
        WeightSpool::LEAST_BUDGET.saturating_mul(levels as u64)
    }

    /// The rule and the constants that labels were first lifted with: [`LiftRule::CentrePixel`].
    pub fn centre_pixel() -> Self {
        let raster = RasterSettings::gsplat_1_4();
        Self { rule: LiftRule::CentrePixel, raster, ..Self::default() }
    }
}

/// Whether wrong labels are guarded against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Robust {
    /// If the measured [`Disagreement`] is above this.
    Auto {
        /// In `0..=1`.
        above: f64,
    },
    /// Always.
    On,
    /// Never.
    Off,
}

impl Default for Robust {
    /// Above 0.2. On a synthetic room, labels without errors disagree by 0.10 to 0.14 (at borders
    /// between objects; more in small pictures), with a twentieth of the segments wrong by 0.20 to
    /// 0.25, with a fifth by 0.39 to 0.49; with depth agreement by about 0.05, 0.15 and 0.35.
    fn default() -> Self {
        Self::Auto { above: 0.2 }
    }
}

impl Robust {
    /// Whether to guard, given the disagreement.
    pub fn decide(self, disagreement: Option<f64>) -> bool {
        match self {
            Self::Auto { above } => disagreement.is_some_and(|d| d > above),
            Self::On => true,
            Self::Off => false,
        }
    }
}

/// A picture with its segments and their features.
#[derive(Debug, Clone, Copy)]
pub struct LabelledPicture<'a> {
    /// The camera.
    pub view: &'a View,
    /// One map per granularity, of the camera's size; ids are rows of `features`.
    pub levels: &'a [SegmentMap],
    /// `[S, D]`, finite, any norm: rows are divided by it. A segment with a row of zeros labels
    /// nothing.
    pub features: &'a [f32],
    /// Depth along the camera's axis where it was measured, 0 elsewhere. `[H, W]`, units of the world.
    pub depth: Option<&'a [f32]>,
}

/// What one picture brought.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PictureReport {
    /// Gaussians in the picture.
    pub visible: usize,
    /// Weight of all Gaussians, pixels.
    pub weight: f64,
    /// Part of it that lies in segments, per granularity, pixels.
    pub labelled: Vec<f64>,
    /// Segments that labeled something.
    pub segments: usize,
    /// Segments whose feature is 0.
    pub without_feature: usize,
}

/// Collects the labels of pictures and makes features of them.
///
/// ```
/// use scenesplat_rasterizer::lifting::{
///     FinaliseSettings, LabelledPicture, LiftSettings, Lifter, SegmentMap,
/// };
/// use scenesplat_rasterizer::{Gaussians, View};
///
/// // One Gaussian in front of a camera, whose picture is one segment.
/// let gaussians = Gaussians {
///     means: vec![[0.0, 0.0, 2.0]],
///     quats: vec![[1.0, 0.0, 0.0, 0.0]],
///     scales: vec![[0.1; 3]],
///     opacities: vec![0.9],
///     sh: vec![0.0; 3],
///     sh_degree: 0,
/// };
/// let world_to_camera = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
/// let (width, height) = (32, 32);
/// let view = View { world_to_camera, fx: 40.0, fy: 40.0, cx: 16.0, cy: 16.0, width, height };
/// let levels = [SegmentMap::new(width, height, vec![0; 32 * 32])?];
///
/// let mut lifter = Lifter::new(&gaussians, 1, 2, LiftSettings::default())?;
/// let features = [3.0, 4.0];
/// lifter.add(&LabelledPicture { view: &view, levels: &levels, features: &features, depth: None })?;
/// let lifted = lifter.collect(0, &FinaliseSettings::default())?;
/// assert_eq!(lifted.features, [0.6, 0.8]);
/// assert!(lifted.valid[0] && lifted.coverage[0] > 10.0);
/// # Ok::<(), scenesplat_rasterizer::lifting::LiftError>(())
/// ```
#[derive(Debug)]
pub struct Lifter<'a> {
    gaussians: &'a Gaussians,
    settings: LiftSettings,
    tables: SegmentTables,
    /// One per granularity.
    spools: Vec<WeightSpool>,
    block_rows: usize,
    /// All weight of each Gaussian, labeled or not.
    totals: Vec<f64>,
    weighted: usize,
    panes: Option<Panes>,
    /// Pictures that show one.
    through_panes: usize,
}

impl<'a> Lifter<'a> {
    /// Nothing seen yet; for pictures of `levels` granularities (1 to 4) and features of `dim` values.
    ///
    /// # Errors
    /// If a setting is out of range.
    pub fn new(
        gaussians: &'a Gaussians,
        levels: usize,
        dim: usize,
        settings: LiftSettings,
    ) -> Result<Self, LiftError> {
        gaussians.check()?;
        settings.raster.check()?;
        if let Some(tolerance) = settings.depth {
            tolerance.check()?;
        }
        if !(1..=MAX_LEVELS).contains(&levels) {
            let problem = format!("{levels}, 1 to {MAX_LEVELS} are expected");
            return Err(LiftError::argument("levels", problem));
        }
        if dim == 0 || dim > BLOCK_BYTES / 4 {
            let problem = format!("{dim} values, 1 to {} are expected", BLOCK_BYTES / 4);
            return Err(LiftError::argument("features", problem));
        }
        let block_rows = (BLOCK_BYTES / 4 / dim).clamp(1, 1 << 16);
        let least = LiftSettings::least_memory(levels);
        if settings.memory < least {
            let problem = format!(
                "{} bytes for {levels} granularities, at least {least} are needed",
                settings.memory
            );
            return Err(LiftError::argument("memory", problem));
        }
        let memory = settings.memory / levels as u64;
        let spool =
            || WeightSpool::new(gaussians.len(), block_rows, memory, &settings.spill_folder);
        Ok(Self {
            gaussians,
            tables: SegmentTables::new(dim),
            spools: std::iter::repeat_with(spool).take(levels).collect(),
            block_rows,
            totals: vec![0.0; gaussians.len()],
            weighted: 0,
            panes: None,
            through_panes: 0,
            settings,
        })
    }

    /// Keeps the labels of panes and of what is seen through them apart in the pictures that follow; pictures that
    /// show no pane are what they would be without.
    ///
    /// # Errors
    /// If the panes are of another number of Gaussians.
    pub fn with_panes(mut self, panes: Panes) -> Result<Self, LiftError> {
        panes.check(self.gaussians.len())?;
        self.panes = Some(panes);
        Ok(self)
    }

    /// Pictures that were split into what is in a pane and what is behind it.
    pub fn num_through_panes(&self) -> usize {
        self.through_panes
    }

    /// Gaussians that labels are lifted onto.
    pub fn num_gaussians(&self) -> usize {
        self.gaussians.len()
    }

    /// Segments of the pictures so far.
    pub fn tables(&self) -> &SegmentTables {
        &self.tables
    }

    /// Pictures that counted for less than others.
    pub fn num_weighted(&self) -> usize {
        self.weighted
    }

    /// Weights that wait, of all granularities.
    pub fn num_weights(&self) -> u64 {
        self.spools.iter().map(WeightSpool::len).sum()
    }

    /// Bytes of weights in the file.
    pub fn bytes_on_disk(&self) -> u64 {
        self.spools.iter().map(WeightSpool::bytes_on_disk).sum()
    }

    /// Adds the labels of one picture. The order of the pictures is that of sums.
    ///
    /// # Errors
    /// If maps, features or depth do not fit the camera or each other, the renderer refuses the view,
    /// or the file cannot be written.
    pub fn add(&mut self, picture: &LabelledPicture<'_>) -> Result<PictureReport, LiftError> {
        self.add_weighted(picture, 1.0)
    }

    /// As [`add`](Self::add), where a picture counts for less than others: a blurred one, say. Coverage and
    /// shares count as much as the labels. 1 is [`add`](Self::add), bit for bit.
    ///
    /// # Errors
    /// As [`add`](Self::add), and a weight that is not above 0 and at most 1.
    pub fn add_weighted(
        &mut self,
        picture: &LabelledPicture<'_>,
        weight: f32,
    ) -> Result<PictureReport, LiftError> {
        if !(weight > 0.0 && weight <= 1.0) {
            let problem = format!("{weight}; above 0 and at most 1 is expected");
            return Err(LiftError::argument("weight of a picture", problem));
        }
        self.check_picture(picture, self.spools.len())?;
        let LiftSettings { rule, raster, .. } = &self.settings;
        let measured = self.settings.depth.zip(picture.depth);
        let depth = measured.map(|(tolerance, depth)| (depth, tolerance));
        let own = if depth.is_none() { self.settings.depth } else { None };
        let levels = self.eroded(picture);
        let labelled = LabelledView { view: picture.view, levels: &levels, depth };
        let mut weights = match &self.panes {
            None => weights_with_own_depth(self.gaussians, &labelled, own, *rule, raster)?,
            Some(panes) => {
                let (weights, shown) =
                    panes.weights(self.gaussians, &labelled, own, *rule, raster)?;
                self.through_panes += usize::from(shown);
                weights
            }
        };
        if weight < 1.0 {
            self.weighted += 1;
            weights.scale(weight);
        }
        self.take(&weights, picture.features)
    }

    /// Adds the labels of all pixels to the first granularity, those of pixels whose depth agrees to the
    /// second. The picture has one.
    pub(super) fn add_twice(
        &mut self,
        picture: &LabelledPicture<'_>,
        tolerance: DepthTolerance,
    ) -> Result<PictureReport, LiftError> {
        self.check_picture(picture, 1)?;
        let LiftSettings { rule, raster, .. } = &self.settings;
        let levels = self.eroded(picture);
        let labelled = LabelledView { view: picture.view, levels: &levels, depth: None };
        let weights =
            weights_of_all_and_agreeing(self.gaussians, &labelled, tolerance, *rule, raster)?;
        self.take(&weights, picture.features)
    }

    fn eroded<'b>(&self, picture: &LabelledPicture<'b>) -> Cow<'b, [SegmentMap]> {
        match self.settings.erosion {
            0 => picture.levels.into(),
            pixels => picture.levels.iter().map(|map| map.eroded(pixels)).collect(),
        }
    }

    /// Keeps what a picture says; `weights` has a list for each granularity.
    fn take(
        &mut self,
        weights: &ViewWeights,
        features: &[f32],
    ) -> Result<PictureReport, LiftError> {
        let segments = features.len() / self.tables.dim();
        let (numbers, mut report) = self.number_segments(weights, features, segments)?;
        report.visible = weights.visible;
        for &(gaussian, weight) in &weights.totals {
            self.totals[gaussian as usize] += f64::from(weight);
            report.weight += f64::from(weight);
        }
        for (spool, level) in self.spools.iter_mut().zip(&weights.levels) {
            let numbered = level.iter().filter_map(|w| {
                let segment = numbers[w.segment as usize]?;
                Some(SegmentWeight { segment, ..*w })
            });
            report.labelled.push(numbered.clone().map(|w| f64::from(w.weight)).sum());
            spool.push(numbered)?;
        }
        Ok(report)
    }

    fn check_picture(
        &self,
        picture: &LabelledPicture<'_>,
        expected: usize,
    ) -> Result<(), LiftError> {
        let dim = self.tables.dim();
        if !picture.features.len().is_multiple_of(dim) {
            let problem = format!("{} values are no rows of {dim}", picture.features.len());
            return Err(LiftError::argument("segment features", problem));
        }
        if picture.levels.len() != expected {
            let problem = format!("{} maps, {expected} are expected", picture.levels.len());
            return Err(LiftError::argument("levels", problem));
        }
        let rows = picture.features.len() / dim;
        for map in picture.levels {
            if map.num_ids() > rows {
                let problem = format!("id {}, there are {rows} features", map.num_ids() - 1);
                return Err(LiftError::argument("segment map", problem));
            }
        }
        Ok(())
    }

    /// Gives the segments that weigh something their numbers, and keeps their features.
    fn number_segments(
        &mut self,
        weights: &ViewWeights,
        features: &[f32],
        segments: usize,
    ) -> Result<(Vec<Option<u32>>, PictureReport), LiftError> {
        let mut met = vec![false; segments];
        weights.levels.iter().flatten().for_each(|w| met[w.segment as usize] = true);
        let mut report = PictureReport::default();
        let mut kept = Vec::new();
        let mut place = vec![None; segments];
        for (segment, row) in features.chunks_exact(self.tables.dim()).enumerate() {
            if !met[segment] {
                continue;
            }
            if row.iter().all(|&v| v == 0.0) {
                report.without_feature += 1;
                continue;
            }
            place[segment] = Some(report.segments as u32);
            report.segments += 1;
            kept.extend_from_slice(row);
        }
        let first = self.tables.push(&kept)?;
        place.iter_mut().flatten().for_each(|number| *number += first);
        Ok((place, report))
    }

    fn spool(&mut self, level: usize) -> Result<&mut WeightSpool, LiftError> {
        let count = self.spools.len();
        let problem = || LiftError::argument("level", format!("{level}, there are {count}"));
        self.spools.get_mut(level).ok_or_else(problem)
    }

    /// Measures how far pictures contradict each other, on about 20,000 Gaussians spread over the
    /// scene.
    ///
    /// # Errors
    /// If there is no such level, or the file cannot be read.
    pub fn disagreement(&mut self, level: usize) -> Result<Disagreement, LiftError> {
        let step = self.sampling_step();
        let mut measured = Disagreement::new(self.tables.dim());
        for block in 0..self.num_blocks() {
            let weights = self.block(level, block)?;
            measured.add_block(&weights, &self.tables, step);
        }
        Ok(measured)
    }

    /// Step of a sample of the Gaussians where all would be too many.
    pub(super) fn sampling_step(&self) -> usize {
        self.gaussians.len().div_ceil(SAMPLED_GAUSSIANS)
    }

    /// Blocks of Gaussians, the same for every granularity.
    pub(super) fn num_blocks(&self) -> usize {
        self.spools[0].num_blocks()
    }

    /// The weights of a block of Gaussians.
    pub(super) fn block(&mut self, level: usize, block: usize) -> Result<BlockWeights, LiftError> {
        self.spool(level)?.block(block)
    }

    /// All weight of consecutive Gaussians, labeled or not.
    pub(super) fn totals(&self, first: usize, count: usize) -> &[f64] {
        &self.totals[first..first + count]
    }

    /// What the confidence of a Gaussian is worth: less where it may be a mirror image in a pane.
    pub(super) fn confidence(&self, gaussian: usize, confidence: f32) -> f32 {
        self.panes.as_ref().map_or(confidence, |panes| panes.confidence(gaussian, confidence))
    }

    /// Makes the features of a granularity, and hands them out block by block, in order.
    ///
    /// # Errors
    /// If a setting is out of range, there is no such level, or the file cannot be read; what `sink`
    /// gives.
    pub fn features(
        &mut self,
        level: usize,
        settings: &FinaliseSettings,
        mut sink: impl FnMut(BlockFeatures) -> Result<(), LiftError>,
    ) -> Result<(), LiftError> {
        settings.check()?;
        for block in 0..self.num_blocks() {
            let weights = self.block(level, block)?;
            let first = block * self.block_rows;
            let totals = self.totals(first, weights.len());
            let mut features = finalise_block(&weights, &self.tables, totals, settings);
            for (i, confidence) in features.confidence.iter_mut().enumerate() {
                *confidence = self.confidence(first + i, *confidence);
            }
            sink(features)?;
        }
        Ok(())
    }

    /// As [`features`](Self::features), all at once: for scenes whose features fit into memory.
    ///
    /// # Errors
    /// As [`features`](Self::features).
    pub fn collect(
        &mut self,
        level: usize,
        settings: &FinaliseSettings,
    ) -> Result<BlockFeatures, LiftError> {
        let mut all = BlockFeatures::default();
        self.features(level, settings, |block| {
            all.features.extend(block.features);
            all.valid.extend(block.valid);
            all.confidence.extend(block.confidence);
            all.views.extend(block.views);
            all.coverage.extend(block.coverage);
            Ok(())
        })?;
        Ok(all)
    }
}
