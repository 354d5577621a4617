//! A whole scene through the network: passes, tiles, and scattering rows to every Gaussian.

use crate::alignment::{Alignment, AlignmentSettings};
use crate::network::Network;
use candle_core::{Device, Tensor};
use rand_chacha::ChaCha8Rng;
use scenesplat_datasets::{
    Anchor, ExactPlan, FastPlan, InferencePlan, NetworkInput, TileSettings, sample_rng,
    split_into_tiles,
};
use scenesplat_models::ops::normalize_rows;
use scenesplat_models::{Backbone, Calibrated, Forward, Orders, PointCloud};
use scenesplat_scene::{Floors, GaussianScene};
use std::fs::File;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

mod augmentation;
mod budget;
mod clusters;
mod codes;
mod example;
mod kept;
mod slots;

pub use augmentation::MAX_COPIES;
pub(crate) use budget::{MemoryNeed, scene_bytes};
pub use codes::FeatureCodes;
use slots::SlotStore;

/// Why a scene could not be encoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The scene cannot be turned into network input.
    #[error(transparent)]
    Data(#[from] scenesplat_datasets::DataError),
    /// The network refused its input, or was stopped.
    #[error("the network failed")]
    Network(#[from] candle_core::Error),
    /// Features did not fit into memory and could not be kept in a file.
    #[error("{}: cannot keep features in a file", path.display())]
    Spill {
        /// Which file.
        path: PathBuf,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// The memory limit leaves nothing to work with.
    #[error(
        "a memory limit of {limit} is too low: the scene, the weights and {voxels} voxels already \
         need {needed}; allow at least {advice}"
    )]
    Memory {
        /// The limit.
        limit: crate::memory::Bytes,
        /// What is needed before the first voxel is computed.
        needed: crate::memory::Bytes,
        /// A limit that works.
        advice: crate::memory::Bytes,
        /// Voxels of the scene.
        voxels: usize,
    },
    /// The user asked to stop.
    #[error("stopped; nothing was written")]
    Stopped,
    /// A setting out of range.
    #[error("{0}")]
    Setting(String),
    /// Features that were read from a scene were to be changed.
    #[error("stored language features cannot be changed")]
    ReadOnly,
}

/// Which Gaussians are read, and how often.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fidelity {
    /// One pass over the voxels: the Gaussian nearest to a voxel's center stands for it. Differs
    /// from [`Fidelity::Exact`] where several Gaussians share a voxel: they share its feature.
    #[default]
    Fast,
    /// The first so many passes of [`Fidelity::Exact`]; Gaussians that none of them reads share the
    /// feature of the nearest in their voxel that one did. 1 is not [`Fidelity::Fast`], which reads
    /// another Gaussian of a voxel.
    Passes(usize),
    /// The original's steps: every Gaussian of a 1 cm sampling is read, in several passes, and
    /// features are averaged.
    Exact,
}

/// How far the work has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncodeProgress {
    /// Current pass, from 1.
    pub pass: usize,
    /// Number of passes.
    pub passes: usize,
    /// Current tile of the pass, from 1.
    pub tile: usize,
    /// Number of tiles of the pass.
    pub tiles: usize,
    /// Fraction of all work done, 0..=1.
    pub done: f64,
}

impl EncodeProgress {
    /// The same within all copies.
    fn of_copy(self, index: usize, copies: usize) -> Self {
        Self {
            pass: index * self.passes + self.pass,
            passes: copies * self.passes,
            done: (index as f64 + self.done) / copies as f64,
            ..self
        }
    }
}

/// Turns scenes into features.
#[derive(Debug, Clone)]
pub struct SceneEncoder<'a> {
    /// The network.
    pub network: &'a Network,
    /// Which Gaussians are read.
    pub fidelity: Fidelity,
    /// Size of the network's voxels, meters; by default the one it was trained at.
    pub grid_size: f64,
    /// Where voxels are counted from.
    pub anchor: Anchor,
    /// Limit for the whole process, bytes; larger scenes go through tiles.
    pub max_memory: Option<u64>,
    /// Context around a tile, voxels.
    pub halo: u32,
    /// Shuffles the curve orders with this seed, as the original does without one.
    pub shuffle_orders: Option<u64>,
    /// Test-time augmentation: the mean over so many copies of the scene, 1 to 12: as it lies, its three
    /// other quarter turns about the vertical, and these four at 0.95 and 1.05 times the size.
    pub tta: usize,
    /// Brings features down to so many numbers, fewer than the network gives; `None`: as it gives
    /// them. Texts follow by themselves, see [`SceneFeatures::codes`].
    pub codes: Option<usize>,
    /// Where features go that do not fit into memory.
    pub spill_folder: PathBuf,
    /// What is known of the scene; by default its up and unit are estimated, and a scene that lies
    /// on its side or is in millimeters is read as a turned or scaled copy.
    pub alignment: AlignmentSettings,
}

/// Features of a scene: one row per voxel (or read Gaussian), and which row each Gaussian has.
#[derive(Debug)]
pub struct SceneFeatures {
    slots: SlotStore,
    inverse: Vec<u32>,
    sampled: Vec<u32>,
    codes: Option<FeatureCodes>,
    voters: Option<Vec<bool>>,
    /// Layers that an example of the scene decided, with the part of their variance that they keep,
    /// 0..=1; see [`Backbone::calibrated`].
    pub calibrated: Vec<(String, f64)>,
    /// How the scene was cut.
    pub summary: EncodeSummary,
    /// How the scene was turned and scaled for the network; `None` if none was run.
    pub alignment: Option<Alignment>,
}

/// What was done to a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct EncodeSummary {
    /// Voxels of a pass.
    pub voxels: usize,
    /// Passes of the network.
    pub passes: usize,
    /// Tiles over all passes; equal to the passes when nothing was cut.
    pub tiles: usize,
    /// Voxels computed over all tiles, halos included.
    pub voxels_computed: usize,
    /// Narrowest halo of all tiles, voxels.
    pub smallest_halo: u32,
    /// Tiles whose halo had to be narrower than asked for.
    pub shrunk_halos: usize,
    /// Whether features went through a file.
    pub spilled: bool,
    /// Whether the network's device takes fewer voxels at once than the limit of memory allows.
    pub limited_by_device: bool,
}

/// Called before each part of the work; an error stops it.
pub type ProgressFn<'a> = dyn FnMut(EncodeProgress) -> Result<(), EncodeError> + 'a;

impl<'a> SceneEncoder<'a> {
    /// The default: fast, no memory limit, orders as listed.
    pub fn new(network: &'a Network) -> Self {
        Self {
            network,
            fidelity: Fidelity::Fast,
            grid_size: network.grid_size(),
            max_memory: None,
            halo: 50,
            shuffle_orders: None,
            tta: 1,
            codes: None,
            anchor: Anchor::Box,
            spill_folder: temporary_folder(),
            alignment: AlignmentSettings { square: network.is_square(), ..Default::default() },
        }
    }

    /// Features of every Gaussian of a scene.
    ///
    /// For a language network rows have unit length; for a classifier they are class
    /// probabilities, averaged over the passes and copies. The network reads the scene upright and in meters,
    /// as [`alignment`](Self::alignment) says; what was done is in the result.
    ///
    /// # Errors
    /// If the scene is empty or cannot be put on the grid, the network refuses it, memory does not
    /// suffice, or `progress` stops the work.
    pub fn encode(
        &self,
        scene: &GaussianScene,
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        self.encode_aligned(scene, Alignment::of(scene, &self.alignment), progress)
    }

    /// As [`encode`](Self::encode), with an alignment that was worked out before.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    pub fn encode_aligned(
        &self,
        scene: &GaussianScene,
        alignment: Alignment,
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        let aligned = alignment.apply(scene);
        // The copy and the scene are both there.
        let beside = if alignment.is_identity() { 0 } else { scene_bytes(scene) };
        let mut features = self.encode_as_is(&aligned, &alignment.floors, beside, progress)?;
        features.alignment = Some(alignment);
        Ok(features)
    }

    /// Features of a scene as the network reads it; `beside`: bytes of what stays in memory.
    fn encode_as_is(
        &self,
        scene: &GaussianScene,
        floors: &Floors,
        beside: u64,
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        self.check_copies()?;
        self.check_codes(self.network.model().out_channels())?;
        let first = &mut |at: EncodeProgress| progress(at.of_copy(0, self.tta));
        let mut features = self.encode_copy(scene, floors, beside, first)?;
        if self.tta > 1 {
            self.add_copies(scene, floors, beside, &mut features, progress)?;
        }
        match self.codes {
            Some(codes) => features.into_codes(codes),
            None => Ok(features),
        }
    }

    /// Features of one copy, as the network gives them.
    fn encode_copy(
        &self,
        scene: &GaussianScene,
        floors: &Floors,
        beside: u64,
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        let plan = self.plan(scene)?.above(floors.clone());
        let passes = plan.num_inputs();
        if passes == 0 {
            return Err(EncodeError::Setting("the scene has no Gaussian".to_owned()));
        }
        check_inverse_map(scene, &plan, self.grid_size)?;
        let network = self.network.model();
        let width = network.out_channels();
        let budget = self.budget(scene, beside, &plan, width)?;
        let mut slots = if budget.spill {
            SlotStore::file(&self.spill_folder, plan.num_slots(), width)?
        } else {
            SlotStore::memory(plan.num_slots(), width)
        };
        let calibrated = self.calibrated(&plan, progress)?;
        let model = calibrated.as_ref().map_or(network, |c| &*c.backbone);
        let mut summary = EncodeSummary {
            voxels: plan.num_voxels(),
            passes,
            smallest_halo: self.halo,
            spilled: budget.spill,
            limited_by_device: network.most_voxels() == Some(budget.max_voxels),
            ..EncodeSummary::default()
        };
        for pass in 0..passes {
            let input = plan.input(pass)?;
            self.run_pass(
                model,
                &input,
                (pass, budget.max_voxels),
                &mut slots,
                &mut summary,
                progress,
            )?;
        }
        if self.network.is_classifier() {
            slots.finish(|row, count| row.iter_mut().for_each(|v| *v /= count as f32))?;
        } else {
            slots.finish(|row, _| normalize_rows(row, width))?;
        }
        let InferencePlan { sampled, inverse, .. } = plan;
        let calibrated = calibrated.map_or(Vec::new(), |c| c.kept);
        Ok(SceneFeatures { sampled, calibrated, ..SceneFeatures::new(slots, inverse, summary) })
    }

    /// The network with what an example decides, if it waits for one.
    fn calibrated(
        &self,
        plan: &InferencePlan<'_>,
        progress: &mut ProgressFn<'_>,
    ) -> Result<Option<Calibrated>, EncodeError> {
        let network = self.network.model();
        if !network.needs_example() {
            return Ok(None);
        }
        let (pass, passes, tile, tiles, done) = (1, plan.num_inputs(), 1, 1, 0.0);
        progress(EncodeProgress { pass, passes, tile, tiles, done })?;
        let input = example::example(&plan.input(0)?, network.alignment());
        Ok(network.calibrated(&points(&input)?)?)
    }

    /// Which Gaussians are read in which pass.
    fn plan<'s>(&self, scene: &'s GaussianScene) -> Result<InferencePlan<'s>, EncodeError> {
        let (grid_size, anchor) = (self.grid_size, self.anchor);
        let features = self.network.input().clone();
        let passes = match self.fidelity {
            Fidelity::Fast => return Ok(FastPlan { grid_size, anchor, features }.build(scene)?),
            Fidelity::Passes(passes) => Some(passes),
            Fidelity::Exact => None,
        };
        let sample_size = grid_size / 2.0;
        let plan =
            ExactPlan { grid_size, sample_size, passes, anchor, features, ..ExactPlan::default() };
        Ok(plan.build(scene)?)
    }

    /// Runs the network over the tiles of one pass, and adds its rows to their slots.
    fn run_pass(
        &self,
        model: &dyn Backbone,
        input: &NetworkInput,
        (pass, max_voxels): (usize, usize),
        slots: &mut SlotStore,
        summary: &mut EncodeSummary,
        progress: &mut ProgressFn<'_>,
    ) -> Result<(), EncodeError> {
        let align = self.network.model().alignment().max(1);
        let tiling = split_into_tiles(input, &TileSettings { max_voxels, halo: self.halo, align })?;
        summary.smallest_halo = summary.smallest_halo.min(tiling.smallest_halo);
        summary.shrunk_halos += tiling.num_shrunk;
        let (passes, tiles) = (summary.passes, tiling.tiles.len());
        let work: usize = tiling.tiles.iter().map(|t| t.voxels.len()).sum();
        let mut computed = 0;
        for (i, tile) in tiling.tiles.iter().enumerate() {
            let mut report = |within: f64| {
                let here = (computed as f64 + within * tile.voxels.len() as f64) / work as f64;
                let done = (pass as f64 + here) / passes as f64;
                progress(EncodeProgress { pass: pass + 1, passes, tile: i + 1, tiles, done })
            };
            let cut = (tiles > 1).then(|| tile.input(input));
            let part = cut.as_ref().unwrap_or(input);
            let values = self.forward(model, part, [pass, i], &mut report)?;
            slots.add(&part.slots, &values, cut.is_some().then_some(tile.is_core.as_slice()))?;
            computed += tile.voxels.len();
        }
        summary.tiles += tiles;
        summary.voxels_computed += computed;
        Ok(())
    }

    /// That features of this width can be brought down.
    fn check_codes(&self, width: usize) -> Result<(), EncodeError> {
        let Some(codes) = self.codes else { return Ok(()) };
        let error = |why: String| Err(EncodeError::Setting(format!("codes: {codes} {why}")));
        if self.network.is_classifier() {
            return error("numbers cannot hold the probabilities of classes".to_owned());
        }
        if codes == 0 || codes >= width {
            return error(format!(
                "is not in 1 to {}: the network's features have {width} numbers",
                width.saturating_sub(1)
            ));
        }
        Ok(())
    }

    /// One call of the network.
    fn forward(
        &self,
        model: &dyn Backbone,
        input: &NetworkInput,
        [pass, tile]: [usize; 2],
        report: &mut dyn FnMut(f64) -> Result<(), EncodeError>,
    ) -> Result<Vec<f32>, EncodeError> {
        let points = points(input)?;
        // Each call draws its own orders, as in the original.
        let seed = self.shuffle_orders.unwrap_or(0);
        let mut rng: ChaCha8Rng = sample_rng(seed, pass as u64, tile as u64);
        let orders = if self.shuffle_orders.is_some() { Orders::Shuffled } else { Orders::Listed };
        let cost = model.cost();
        let total = cost.as_ref().map_or(1.0, |cost| cost.work_per_voxel());
        let costs = cost.map_or(Vec::new(), |cost| cost.parts);
        let mut done = 0.0;
        let mut stopped = None;
        report(0.0)?;
        let mut observer = |name: &str, _: &Tensor| {
            done += costs.iter().find(|(n, _)| n == name).map_or(0.0, |(_, c)| c / total);
            report(done.min(1.0)).map_err(|e| {
                stopped = Some(e);
                candle_core::Error::Msg("stopped".to_owned())
            })
        };
        let mut cx = Forward { orders, observer: Some(&mut observer), ..Forward::eval(&mut rng) };
        let out = model.forward(&points, &mut cx);
        if let Some(error) = stopped {
            return Err(error);
        }
        let mut values = out?.flatten_all()?.to_vec1::<f32>()?;
        if self.network.is_classifier() {
            softmax_rows(&mut values, model.out_channels());
        }
        Ok(values)
    }

    /// How many voxels a tile may have, and whether features must go to a file.
    fn budget(
        &self,
        scene: &GaussianScene,
        beside: u64,
        plan: &InferencePlan<'_>,
        width: usize,
    ) -> Result<Budget, EncodeError> {
        let most = self.network.model().most_voxels().unwrap_or(usize::MAX);
        let Some(limit) = self.max_memory else {
            return Ok(Budget { max_voxels: most, spill: false });
        };
        let Some(cost) = self.network.model().cost() else {
            return Err(EncodeError::Setting(
                "max_memory: the backbone does not say how much memory it needs (Backbone::cost)"
                    .to_owned(),
            ));
        };
        let per_voxel = cost.bytes_per_voxel.max(1) as u64;
        let need = MemoryNeed {
            rows: scene.len(),
            scene: scene_bytes(scene) + beside,
            voxels: plan.num_voxels(),
            channels: plan.channels(),
            slots: plan.num_slots(),
            width: width + self.codes.unwrap_or(0),
            weights: self.network.weight_bytes() as u64,
            per_voxel,
        };
        let (fixed, features) = (need.fixed(), need.features());
        // Features move to a file once they would take more than a third of what is left.
        let spill = features > limit.saturating_sub(fixed) / 3;
        let rest = limit.saturating_sub(fixed + if spill { 0 } else { features });
        let max_voxels = usize::try_from(rest / per_voxel).unwrap_or(usize::MAX);
        const FEWEST: usize = 4096;
        if max_voxels < FEWEST.min(plan.num_voxels()) {
            return Err(EncodeError::Memory {
                limit: crate::memory::Bytes(limit),
                needed: crate::memory::Bytes(fixed),
                advice: crate::memory::Bytes(fixed + FEWEST as u64 * per_voxel * 3 / 2),
                voxels: plan.num_voxels(),
            });
        }
        Ok(Budget { max_voxels: max_voxels.min(most), spill })
    }
}

/// Where features go that do not fit into memory; a browser has no such place, and asking it for one would stop the program.
fn temporary_folder() -> PathBuf {
    if cfg!(target_family = "wasm") { PathBuf::new() } else { std::env::temp_dir() }
}

/// An input as the network takes it.
fn points(input: &NetworkInput) -> candle_core::Result<PointCloud> {
    let feat = Tensor::from_slice(&input.feat, (input.len(), input.channels), &Device::Cpu)?;
    PointCloud::single(input.grid_coord.clone(), feat)
}

/// Checks that every Gaussian gets the feature of a Gaussian of its own voxel: a row that went astray
/// would give plausible nonsense.
fn check_inverse_map(
    scene: &GaussianScene,
    plan: &InferencePlan<'_>,
    grid_size: f64,
) -> Result<(), EncodeError> {
    // Coordinates are shifted and rounded to f32 before they are put on the grid.
    let widest = scene.coord.iter().flatten().fold(1.0f32, |a, v| a.max(v.abs()));
    let allowed = grid_size + 8.0 * f64::from(f32::EPSILON) * f64::from(widest);
    for (row, &slot) in plan.inverse.iter().enumerate() {
        let from = scene.coord[plan.sampled[slot as usize] as usize];
        let here = scene.coord[row];
        for axis in 0..3 {
            let apart = (f64::from(from[axis]) - f64::from(here[axis])).abs();
            if apart > allowed {
                return Err(EncodeError::Setting(format!(
                    "internal error: Gaussian {row} would get the feature of one {apart} m away"
                )));
            }
        }
    }
    Ok(())
}

struct Budget {
    max_voxels: usize,
    spill: bool,
}

fn softmax_rows(values: &mut [f32], width: usize) {
    for row in values.chunks_exact_mut(width) {
        let top = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let sum: f32 = row
            .iter_mut()
            .map(|v| {
                *v = (*v - top).exp();
                *v
            })
            .sum();
        row.iter_mut().for_each(|v| *v /= sum);
    }
}

impl SceneFeatures {
    /// The features that a scene carries as language codes, at unit length; no network is run.
    /// `None` if it carries none.
    pub fn from_codes(scene: &GaussianScene) -> Option<Self> {
        let code = scene.lang_code.clone()?;
        Some(Self::of_gaussians(SlotStore::codes(scene.len(), code), scene.len()))
    }

    /// Features that were made before, one row per Gaussian, such as those lifted from pictures. Rows
    /// are brought to unit length; rows of zeros stay, and have no class. `[N, width]`
    ///
    /// # Errors
    /// If there is no value, or the number of values is no multiple of `width`.
    pub fn from_rows(mut values: Vec<f32>, width: usize) -> Result<Self, EncodeError> {
        if width == 0 || values.is_empty() || !values.len().is_multiple_of(width) {
            return Err(EncodeError::Setting(format!(
                "features: {} values are no rows of {width}",
                values.len()
            )));
        }
        normalize_rows(&mut values, width);
        let rows = values.len() / width;
        Ok(Self::of_gaussians(SlotStore::rows(values, width), rows))
    }

    fn new(slots: SlotStore, inverse: Vec<u32>, summary: EncodeSummary) -> Self {
        let (codes, voters, alignment) = (None, None, None);
        let (sampled, calibrated) = (Vec::new(), Vec::new());
        Self { slots, inverse, sampled, codes, voters, calibrated, summary, alignment }
    }

    /// One row for each Gaussian; no network was run.
    fn of_gaussians(slots: SlotStore, count: usize) -> Self {
        let rows: Vec<u32> = (0..count as u32).collect();
        let summary = EncodeSummary { voxels: count, ..EncodeSummary::default() };
        Self { sampled: rows.clone(), ..Self::new(slots, rows, summary) }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.inverse.len()
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.inverse.is_empty()
    }

    /// Values of a row.
    pub fn width(&self) -> usize {
        self.slots.width()
    }

    /// Number of distinct rows.
    pub fn num_slots(&self) -> usize {
        self.sampled.len()
    }

    /// Distinct row of each Gaussian. `[N]`
    pub fn inverse(&self) -> &[u32] {
        &self.inverse
    }

    /// Gaussian that each distinct row was read from. `[S]`
    pub fn sampled(&self) -> &[u32] {
        &self.sampled
    }

    /// Distinct rows, `[rows.len(), width]`.
    ///
    /// # Errors
    /// If they were kept in a file and it cannot be read.
    pub fn slot_rows(&self, rows: Range<usize>) -> Result<Vec<f32>, EncodeError> {
        self.slots.read(rows)
    }

    /// Rows of some Gaussians, `[rows.len(), width]`.
    ///
    /// # Errors
    /// If they were kept in a file and it cannot be read.
    pub fn gaussian_rows(&self, rows: Range<usize>) -> Result<Vec<f32>, EncodeError> {
        self.slots.gather(&self.inverse[rows])
    }

    /// Rows of some Gaussians as a tensor of the CPU, f32, without a gradient. `[rows.len(), width]`
    ///
    /// # Errors
    /// As [`gaussian_rows`](Self::gaussian_rows).
    pub fn tensor(&self, rows: Range<usize>) -> Result<Tensor, EncodeError> {
        let shape = (rows.len(), self.width());
        Ok(Tensor::from_vec(self.gaussian_rows(rows)?, shape, &Device::Cpu)?)
    }
}

/// A file that is removed when dropped. Rows are read from several threads, and a position is
/// shared, so each access is locked.
#[derive(Debug)]
struct ScratchFile {
    file: Mutex<File>,
    path: PathBuf,
}

impl ScratchFile {
    fn lock(&self) -> MutexGuard<'_, File> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ScratchFile {
    fn drop(&mut self) {
        // A scratch file that cannot be removed is no reason to fail.
        let _ = std::fs::remove_file(&self.path);
    }
}
