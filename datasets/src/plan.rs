//! Which Gaussians of a whole scene the network reads, in which voxels and how often, and how its
//! output returns to every Gaussian.
//!
//! Two plans give the same structure:
//! - [`FastPlan`] (default): one pass over the 2 cm voxels; the Gaussian nearest to a voxel's
//!   center stands for the voxel, and every Gaussian receives the output of its voxel.
//! - [`ExactPlan`]: the steps of the original system. One Gaussian per 1 cm voxel is kept; the kept
//!   ones are read in several passes of at most one per 2 cm voxel, until each was read.

use crate::error::{check_finite, check_length, require};
use crate::rng::{below, sample_rng};
use crate::sample::bounds;
use crate::{DataError, InputFeatures};
use scenesplat_kernels::grid_sample::{GridSampleError, KeyOrder, VoxelGroups, voxel_groups};
use scenesplat_scene::{Floors, GaussianScene};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// One pass of the network over voxels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NetworkInput {
    /// Gaussian of the scene that stands for each voxel. `[M]`
    pub rows: Vec<u32>,
    /// Where the output of each voxel is collected, see [`InferencePlan::num_slots`]. `[M]`
    pub slots: Vec<u32>,
    /// Cell of each voxel, not negative. `[M, 3]`
    pub grid_coord: Vec<[i32; 3]>,
    /// Features, row-major. `[M, channels]`
    pub feat: Vec<f32>,
    /// Width of a feature row.
    pub channels: usize,
}

impl NetworkInput {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no voxel.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Checks that all arrays have one entry per voxel.
    ///
    /// # Errors
    /// Names the first array of another length.
    pub fn check(&self) -> Result<(), DataError> {
        check_length("slots", self.len(), self.slots.len())?;
        check_length("grid_coord", self.len(), self.grid_coord.len())?;
        check_length("feat", self.len() * self.channels, self.feat.len())
    }
}

scenesplat_kernels::settings! {
    /// One pass, one Gaussian per voxel.
    pub struct FastPlan {
        /// Voxel size, meters.
        pub grid_size: f64 = 0.02,
        /// Where voxels are counted from.
        pub anchor: Anchor = Anchor::Box,
        /// What the network reads.
        pub features: InputFeatures = InputFeatures::default(),
    }
}

/// Which Gaussian of a fine voxel is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Representative {
    /// The first one.
    #[default]
    First,
    /// A random one, as the original does; it does not fix a seed.
    Drawn {
        /// Seed of the draws.
        seed: u64,
    },
}

scenesplat_kernels::settings! {
    /// The steps of the original system.
    pub struct ExactPlan {
        /// Size of the fine voxels that keep one Gaussian each, meters.
        pub sample_size: f64 = 0.01,
        /// Size of the network's voxels, meters.
        pub grid_size: f64 = 0.02,
        /// Which Gaussian a fine voxel keeps.
        pub representative: Representative = Representative::First,
        /// The most passes; `None`: as many as the fullest voxel keeps Gaussians. Kept ones that no pass
        /// reads take the output of the nearest that one does, of those in their voxel.
        pub passes: Option<usize> = None,
        /// Where voxels are counted from.
        pub anchor: Anchor = Anchor::Box,
        /// What the network reads.
        pub features: InputFeatures = InputFeatures::default(),
    }
}

/// Passes of the network over a scene, and the inverse map to its Gaussians.
///
/// Outputs are collected in *slots*, one per Gaussian that is read at all: pass `i` adds row `m` of
/// its output to slot `input(i).slots[m]` (see [`SlotMean`]), and Gaussian `g` receives slot
/// `inverse[g]`. Inputs are made on demand, so only one is in memory.
#[derive(Debug, Clone)]
pub struct InferencePlan<'a> {
    scene: &'a GaussianScene,
    features: InputFeatures,
    /// What heights are measured from; looked for if not known.
    floors: Option<Floors>,
    grid_coord: Vec<[i32; 3]>,
    /// Groups of slots, for plans with more than one pass.
    fragments: Option<VoxelGroups>,
    /// Gaussian that each slot reads. `[S]`
    pub sampled: Vec<u32>,
    /// Slot of each Gaussian. `[N]`
    pub inverse: Vec<u32>,
}

impl FastPlan {
    /// Plans one pass over a scene.
    ///
    /// # Errors
    /// If a coordinate is not finite or the scene is too wide for the voxel size; row and axis are
    /// named.
    pub fn build<'a>(&self, scene: &'a GaussianScene) -> Result<InferencePlan<'a>, DataError> {
        scene.check_rows()?;
        let coord = self.anchor.shifted(&scene.coord);
        let mut groups = group(scene, &coord, self.grid_size, KeyOrder::Morton)?;
        let sampled = groups.nearest_to_centre(&coord)?;
        self.anchor.place(&mut groups);
        let VoxelGroups { grid_coord, inverse, .. } = groups;
        let features = self.features.clone();
        let (fragments, floors) = (None, None);
        Ok(InferencePlan { scene, features, floors, grid_coord, fragments, sampled, inverse })
    }
}

impl ExactPlan {
    /// Plans the passes over a scene.
    ///
    /// # Errors
    /// If a coordinate is not finite or the scene is too wide for the voxel size (row and axis are
    /// named), or there may be no pass.
    ///
    /// # Source
    /// Test pipeline and `tools/lang_inference.py` of SceneSplat be9d5e1: `CenterShift`, `GridSample`
    /// (train rule, 1 cm, with inverse), `GridSample` (test rule, 2 cm). Rows come in its order.
    /// Differs: its rotation by 0° re-normalizes quaternions in f64; ours are left as stored.
    pub fn build<'a>(&self, scene: &'a GaussianScene) -> Result<InferencePlan<'a>, DataError> {
        scene.check_rows()?;
        require(self.passes != Some(0), "passes", 0, "at least one")?;
        let coord = self.anchor.shifted(&scene.coord);
        let fine = group(scene, &coord, self.sample_size, KeyOrder::Fnv)?;
        let sampled = match self.representative {
            Representative::First => fine.first_rows(),
            Representative::Drawn { seed } => {
                let mut rng = sample_rng(seed, 0, 0);
                let bound = fine.largest_count() as u32;
                let draws: Vec<u32> =
                    (0..fine.num_voxels()).map(|_| below(&mut rng, bound)).collect();
                fine.drawn_rows(&draws)?
            }
        };
        let VoxelGroups { inverse, .. } = fine;
        let kept: Vec<[f32; 3]> = sampled.iter().map(|&r| coord[r as usize]).collect();
        drop(coord);
        let mut fragments = voxel_groups(&kept, self.grid_size, KeyOrder::Fnv)?;
        self.anchor.place(&mut fragments);
        let all = InferencePlan {
            scene,
            features: self.features.clone(),
            floors: None,
            grid_coord: fragments.grid_coord.clone(),
            fragments: Some(fragments),
            sampled,
            inverse,
        };
        match self.passes {
            Some(passes) if passes < all.num_inputs() => all.limited_to(passes, &kept),
            _ => Ok(all),
        }
    }
}

impl InferencePlan<'_> {
    /// The first passes of this plan alone; `kept`: where each slot's Gaussian is. `[S, 3]`
    fn limited_to(self, passes: usize, kept: &[[f32; 3]]) -> Result<Self, DataError> {
        let Some(all) = &self.fragments else { return Ok(self) };
        // Pass i reads element i of a voxel, so these are the first elements of each.
        let mut stands_for: Vec<u32> = (0..kept.len() as u32).collect();
        for voxel in 0..all.num_voxels() {
            let rows = all.rows_of(voxel);
            let (read, rest) = rows.split_at(passes.min(rows.len()));
            for &row in rest {
                let apart = |other: &u32| -> f32 {
                    let (a, b) = (kept[row as usize], kept[*other as usize]);
                    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
                };
                let nearest = read.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
                stands_for[row as usize] = nearest.copied().unwrap_or(row);
            }
        }
        // Slots that are read, in their order, numbered anew.
        let is_read = |slot: usize| stands_for[slot] as usize == slot;
        let read: Vec<usize> = (0..kept.len()).filter(|&slot| is_read(slot)).collect();
        let mut number = vec![0u32; kept.len()];
        read.iter().enumerate().for_each(|(new, &slot)| number[slot] = new as u32);
        let places: Vec<[f32; 3]> = read.iter().map(|&slot| kept[slot]).collect();
        // Each voxel keeps a Gaussian, so the cells are the same.
        let fragments = voxel_groups(&places, all.grid_size, KeyOrder::Fnv)?;
        let inverse = self.inverse.iter().map(|&s| number[stands_for[s as usize] as usize]);
        Ok(Self {
            grid_coord: fragments.grid_coord.clone(),
            sampled: read.iter().map(|&slot| self.sampled[slot]).collect(),
            inverse: inverse.collect(),
            fragments: Some(fragments),
            ..self
        })
    }

    /// The plan with known floors, for networks that read heights.
    pub fn above(self, floors: Floors) -> Self {
        Self { floors: Some(floors), ..self }
    }

    /// Number of passes; 0 for an empty scene.
    pub fn num_inputs(&self) -> usize {
        match &self.fragments {
            Some(groups) => groups.largest_count(),
            None => usize::from(!self.sampled.is_empty()),
        }
    }

    /// Number of slots that outputs are collected in.
    pub fn num_slots(&self) -> usize {
        self.sampled.len()
    }

    /// Voxels per pass.
    pub fn num_voxels(&self) -> usize {
        self.grid_coord.len()
    }

    /// Width of an input row.
    pub fn channels(&self) -> usize {
        self.features.width()
    }

    /// Makes the input of pass `index`.
    ///
    /// # Errors
    /// If there is no such pass, or a value that the network would read is not finite.
    pub fn input(&self, index: usize) -> Result<NetworkInput, DataError> {
        let ok = index < self.num_inputs();
        require(ok, "pass", index, "a number below the number of passes")?;
        let slots = match &self.fragments {
            Some(groups) => groups.fragment_rows(index),
            None => (0..self.sampled.len() as u32).collect(),
        };
        let rows: Vec<u32> = slots.iter().map(|&s| self.sampled[s as usize]).collect();
        let feat = self.features.rows_above(self.scene, &rows, self.floors.as_ref())?;
        let channels = self.features.width();
        Ok(NetworkInput { rows, slots, grid_coord: self.grid_coord.clone(), feat, channels })
    }

    /// The inputs of all passes, made one at a time.
    pub fn inputs(&self) -> impl Iterator<Item = Result<NetworkInput, DataError>> + '_ {
        (0..self.num_inputs()).map(|index| self.input(index))
    }
}

/// Mean of the rows that were added to each slot.
#[derive(Debug, Clone, PartialEq)]
pub struct SlotMean {
    sum: Vec<f32>,
    count: Vec<u32>,
    width: usize,
}

impl SlotMean {
    /// Empty slots for rows of `width` values.
    pub fn new(num_slots: usize, width: usize) -> Self {
        Self { sum: vec![0.0; num_slots * width], count: vec![0; num_slots], width }
    }

    /// Adds row `m` of `values` to slot `slots[m]`.
    ///
    /// # Shapes
    /// - `slots`: `[M]` · `values`: `[M, width]` row-major
    ///
    /// # Errors
    /// If the lengths do not fit or a slot is out of range; then nothing is added.
    pub fn add(&mut self, slots: &[u32], values: &[f32]) -> Result<(), DataError> {
        check_length("values", slots.len() * self.width, values.len())?;
        if let Some(&slot) = slots.iter().find(|&&s| s as usize >= self.count.len()) {
            return Err(DataError::RowOutOfRange { row: slot as usize, rows: self.count.len() });
        }
        for (m, &slot) in slots.iter().enumerate() {
            let slot = slot as usize;
            self.count[slot] += 1;
            let row = &values[m * self.width..(m + 1) * self.width];
            for (sum, value) in self.sum[slot * self.width..].iter_mut().zip(row) {
                *sum += value;
            }
        }
        Ok(())
    }

    /// The means, `[S, width]` row-major; slots that got nothing are 0.
    pub fn into_mean(mut self) -> Vec<f32> {
        for (slot, &count) in self.count.iter().enumerate() {
            if count > 1 {
                for sum in &mut self.sum[slot * self.width..(slot + 1) * self.width] {
                    *sum /= count as f32;
                }
            }
        }
        self.sum
    }
}

/// Where voxels are counted from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Anchor {
    /// The middle of the bounding box and its floor, as the original: labels do not depend on where a scene's origin
    /// is, but the outermost Gaussian moves the borders of all voxels.
    #[default]
    Box,
    /// The origin of the scene, in whole cells of the coarsest scale of a network: what is far away moves no border.
    World,
}

impl Anchor {
    /// All, each by the word for it.
    pub const ALL: [(&'static str, Self); 2] = [("box", Self::Box), ("world", Self::World)];

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::World => "world",
        }
    }

    /// Coordinates that voxels are counted from the origin of.
    fn shifted(self, coord: &[[f32; 3]]) -> Cow<'_, [[f32; 3]]> {
        match self {
            Self::Box => center_shift(coord).into(),
            Self::World => coord.into(),
        }
    }

    /// Moves cells, which begin at 0, so that cells of coarser scales do not depend on where the first one is.
    fn place(self, groups: &mut VoxelGroups) {
        if self == Self::World {
            let first = groups.min_cell.map(|cell| cell.rem_euclid(COARSEST) as i32);
            groups.grid_coord.iter_mut().for_each(|c| (0..3).for_each(|a| c[a] += first[a]));
        }
    }
}

/// Voxels of the widest cell that a network has: five scales, and one more for others.
const COARSEST: f64 = 64.0;

/// Moves the middle of the bounding box to x = y = 0 and its floor to z = 0.
///
/// In f32, as the original: the last bit decides on which side of a voxel border a Gaussian falls.
pub fn center_shift(coord: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let shift = box_shift(coord);
    coord.iter().map(|c| std::array::from_fn(|a| c[a] - shift[a])).collect()
}

/// The middle of the bounding box along x and y, its floor along z; 0 without a point.
fn box_shift(coord: &[[f32; 3]]) -> [f32; 3] {
    let Some([low, high]) = bounds(coord) else { return [0.0; 3] };
    [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]]
}

/// Groups shifted coordinates; errors show the coordinate of the file.
fn group(
    scene: &GaussianScene,
    coord: &[[f32; 3]],
    grid_size: f64,
    key_order: KeyOrder,
) -> Result<VoxelGroups, DataError> {
    check_finite("coord", &scene.coord)?;
    voxel_groups(coord, grid_size, key_order).map_err(|mut error| {
        match &mut error {
            GridSampleError::TooWide { row, axis, value, .. }
            | GridSampleError::NotFinite { row, axis, value } => {
                let axis = usize::from(*axis as u8 - b'x');
                *value = scene.coord[*row][axis];
            }
            _ => {}
        }
        error.into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn room(num_gaussians: usize) -> GaussianScene {
        generate(&SyntheticRoomSettings::with_count(num_gaussians, 5)).unwrap().scene
    }

    fn at(coord: Vec<[f32; 3]>) -> GaussianScene {
        let n = coord.len();
        GaussianScene {
            coord,
            log_scale: vec![[-4.0; 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logit: vec![1.0; n],
            sh_dc: vec![[0.0; 3]; n],
            ..GaussianScene::default()
        }
    }

    #[test]
    fn centre_shift_by_hand() {
        let moved = center_shift(&[[1.0, -2.0, 5.0], [3.0, 4.0, 6.0]]);
        assert_eq!(moved, [[-1.0, -3.0, 0.0], [1.0, 3.0, 1.0]]);
        assert!(center_shift(&[]).is_empty());
    }

    #[test]
    fn voxels_of_the_world_stay_when_the_outermost_gaussian_goes() {
        let scene = room(20_000);
        let far = |a: usize| {
            (0..scene.len()).max_by(|&i, &j| scene.coord[i][a].total_cmp(&scene.coord[j][a]))
        };
        let first = |a: usize| {
            (0..scene.len()).min_by(|&i, &j| scene.coord[i][a].total_cmp(&scene.coord[j][a]))
        };
        let gone: Vec<usize> = (0..3).flat_map(|a| [far(a).unwrap(), first(a).unwrap()]).collect();
        // A wall, too: the box gets narrower by 7.4 voxels.
        let stays = |row: &usize| !gone.contains(row) && scene.coord[*row][0] > 0.37;
        let kept: Vec<usize> = (0..scene.len()).filter(stays).collect();
        let hurt = scene.select_rows(&kept).unwrap();
        // The cell of each Gaussian as a network's coarsest scale numbers it, and inside of that cell.
        let cells = |scene: &GaussianScene, anchor, exact: bool| -> Vec<[i32; 3]> {
            let plan = match exact {
                false => FastPlan { grid_size: 0.05, anchor, ..FastPlan::default() }.build(scene),
                true => {
                    let sizes =
                        ExactPlan { sample_size: 0.025, grid_size: 0.05, ..ExactPlan::default() };
                    ExactPlan { anchor, ..sizes }.build(scene)
                }
            };
            let plan = plan.unwrap();
            let mut of_slot = vec![[0; 3]; plan.num_slots()];
            for input in plan.inputs() {
                let input = input.unwrap();
                assert!(input.grid_coord.iter().flatten().all(|c| *c >= 0));
                for (slot, cell) in input.slots.iter().zip(&input.grid_coord) {
                    of_slot[*slot as usize] = *cell;
                }
            }
            plan.inverse.iter().map(|slot| of_slot[*slot as usize]).collect()
        };
        for exact in [false, true] {
            for (anchor, same) in [(Anchor::World, true), (Anchor::Box, false)] {
                let (before, after) = (cells(&scene, anchor, exact), cells(&hurt, anchor, exact));
                let moved = |i: usize| -> [i32; 3] {
                    std::array::from_fn(|a| after[i][a] - before[kept[i]][a])
                };
                let all_same = (0..kept.len()).all(|i| moved(i) == moved(0));
                let by_whole_cells = moved(0).iter().all(|m| m % 64 == 0);
                assert_eq!(all_same && by_whole_cells, same, "{anchor:?} {exact} {:?}", moved(0));
            }
        }
    }

    #[test]
    fn the_fast_plan_reads_each_voxel_once() {
        let scene = room(20_000);
        let plan = FastPlan::default().build(&scene).unwrap();
        assert_eq!(plan.num_inputs(), 1);
        let input = plan.input(0).unwrap();
        input.check().unwrap();
        assert_eq!(input.channels, 11);
        assert_eq!(input.len(), plan.num_slots());
        let mut cells = input.grid_coord.clone();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(cells.len(), input.len());
        assert!(cells.iter().flatten().all(|&c| c >= 0));
        // Every Gaussian is in the voxel whose output it receives.
        assert_eq!(plan.inverse.len(), scene.len());
        let coord = center_shift(&scene.coord);
        let far = |a: [f32; 3], b: [f32; 3]| (0..3).any(|i| (a[i] - b[i]).abs() > 0.0201);
        for (row, &slot) in plan.inverse.iter().enumerate() {
            assert!(!far(coord[row], coord[plan.sampled[slot as usize] as usize]));
        }
        // A representative receives its own output.
        for (slot, &row) in plan.sampled.iter().enumerate() {
            assert_eq!(plan.inverse[row as usize] as usize, slot);
        }
    }

    #[test]
    fn the_exact_plan_reads_every_sample() {
        let scene = room(20_000);
        for representative in [Representative::First, Representative::Drawn { seed: 3 }] {
            let plan = ExactPlan { representative, ..ExactPlan::default() }.build(&scene).unwrap();
            let mut reads = vec![0; plan.num_slots()];
            let mut sums = SlotMean::new(plan.num_slots(), 1);
            for input in plan.inputs() {
                let input = input.unwrap();
                input.check().unwrap();
                assert_eq!(input.len(), plan.num_voxels());
                for (&slot, &row) in input.slots.iter().zip(&input.rows) {
                    reads[slot as usize] += 1;
                    assert_eq!(plan.sampled[slot as usize], row);
                }
                let values: Vec<f32> = input.rows.iter().map(|&r| r as f32).collect();
                sums.add(&input.slots, &values).unwrap();
            }
            assert!(plan.num_inputs() > 1 && reads.iter().all(|&r| r > 0));
            let mean = sums.into_mean();
            for (slot, &row) in plan.sampled.iter().enumerate() {
                assert!((mean[slot] - row as f32).abs() <= 1e-3 * row as f32);
            }
            for (slot, &row) in plan.sampled.iter().enumerate() {
                assert_eq!(plan.inverse[row as usize] as usize, slot);
            }
        }
    }

    #[test]
    fn some_passes_are_the_first_ones_of_all() {
        let scene = room(20_000);
        // Voxels that hold several.
        let rule = ExactPlan { sample_size: 0.05, grid_size: 0.1, ..ExactPlan::default() };
        let all = rule.build(&scene).unwrap();
        assert!(all.num_inputs() > 3, "{}", all.num_inputs());
        let coord = center_shift(&scene.coord);
        for passes in [1, 2, 3] {
            let some = ExactPlan { passes: Some(passes), ..rule.clone() }.build(&scene).unwrap();
            assert_eq!((some.num_inputs(), some.num_voxels()), (passes, all.num_voxels()));
            let mut read = vec![false; scene.len()];
            for pass in 0..passes {
                let (ours, theirs) = (some.input(pass).unwrap(), all.input(pass).unwrap());
                assert_eq!((&ours.rows, &ours.grid_coord), (&theirs.rows, &theirs.grid_coord));
                assert_eq!(ours.feat, theirs.feat);
                for (&slot, &row) in ours.slots.iter().zip(&ours.rows) {
                    assert_eq!(some.sampled[slot as usize], row);
                    read[row as usize] = true;
                }
            }
            // Each slot is read; who is read has its own, the others one of their voxel.
            assert_eq!(read.iter().filter(|r| **r).count(), some.num_slots());
            let cell = |row: usize| coord[row].map(|v| (f64::from(v) / 0.1).floor());
            for (row, &slot) in some.inverse.iter().enumerate() {
                let from = some.sampled[slot as usize] as usize;
                assert!(read[from] && (!read[row] || from == row));
                let own = all.sampled[all.inverse[row] as usize] as usize;
                assert_eq!(cell(from), cell(own), "{row}");
            }
        }
        let most = ExactPlan { passes: Some(all.num_inputs() + 1), ..rule.clone() };
        assert_eq!(most.build(&scene).unwrap().sampled, all.sampled);
        assert!(ExactPlan { passes: Some(0), ..most }.build(&scene).is_err());
    }

    #[test]
    fn draws_follow_their_seed() {
        let scene = at((0..4000).map(|i| [(i % 40) as f32 * 0.004, 0.0, 0.0]).collect());
        let sampled = |seed| {
            let representative = Representative::Drawn { seed };
            let plan = ExactPlan { representative, ..ExactPlan::default() };
            plan.build(&scene).unwrap().sampled
        };
        assert_eq!(sampled(1), sampled(1));
        assert_ne!(sampled(1), sampled(2));
    }

    #[test]
    fn tiny_scenes() {
        for coord in [vec![], vec![[3.0; 3]], vec![[3.0; 3]; 50]] {
            let scene = at(coord);
            let passes = usize::from(!scene.is_empty());
            let fast = FastPlan::default().build(&scene).unwrap();
            let exact = ExactPlan::default().build(&scene).unwrap();
            for plan in [fast, exact] {
                assert_eq!(plan.num_inputs(), passes);
                assert_eq!(plan.num_slots(), passes);
                assert_eq!(plan.inverse, vec![0; scene.len()]);
                for input in plan.inputs() {
                    assert_eq!(input.unwrap().grid_coord, [[0; 3]]);
                }
                assert!(plan.input(passes).is_err());
            }
        }
    }

    #[test]
    fn errors_show_the_coordinate_of_the_file() {
        let mut coord = vec![[10.0, 20.0, 30.0]; 9];
        coord[4][1] = 1e7;
        let error = FastPlan::default().build(&at(coord.clone())).unwrap_err();
        assert!(
            matches!(
                error,
                DataError::Grid(GridSampleError::TooWide { row: 4, axis: 'y', value: 1e7, .. })
            ),
            "{error}"
        );
        coord[4][1] = f32::MAX;
        coord[5][1] = f32::MIN;
        assert!(ExactPlan::default().build(&at(coord.clone())).is_err());
        coord[4][1] = f32::NAN;
        let error = FastPlan::default().build(&at(coord)).unwrap_err();
        assert!(matches!(error, DataError::NotFinite { row: 4, field: "coord", .. }), "{error}");
    }

    #[test]
    fn slots_refuse_what_does_not_fit() {
        let mut mean = SlotMean::new(2, 3);
        assert!(mean.add(&[0], &[1.0, 2.0]).is_err());
        assert!(mean.add(&[2], &[1.0, 2.0, 3.0]).is_err());
        mean.add(&[1, 1], &[1.0, 2.0, 3.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!(mean.into_mean(), [0.0, 0.0, 0.0, 2.0, 3.0, 4.0]);
    }
}
