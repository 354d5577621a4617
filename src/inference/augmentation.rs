//! Test-time augmentation: the mean over turned and scaled copies of a scene.

use super::{
    EncodeError, EncodeProgress, EncodeSummary, ProgressFn, SceneEncoder, SceneFeatures,
    scene_bytes,
};
use crate::alignment::turned_and_scaled;
use scenesplat_models::ops::normalize_rows;
use scenesplat_scene::frame::Matrix3;
use scenesplat_scene::{Floors, GaussianScene};

/// The most copies: four quarter turns in each of three sizes.
pub const MAX_COPIES: usize = 12;

/// Sizes of copies, in the order in which they are taken.
const SIZES: [f64; MAX_COPIES / 4] = [1.0, 0.95, 1.05];

/// Quarter turns about the vertical. Their rows have one ±1 and two zeros, so nothing is rounded.
const TURNS: [Matrix3; 4] = [
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
];

/// Rows of a copy that are added at a time.
const BLOCK: usize = 2048;

/// Copy number `index`, and the heights of its floors. Copy 0 is the scene itself.
fn copy(scene: &GaussianScene, floors: &Floors, index: usize) -> (GaussianScene, Floors) {
    let size = SIZES[index / TURNS.len()];
    let heights = floors.heights.iter().map(|height| size * height).collect();
    let turn = &TURNS[index % TURNS.len()];
    (turned_and_scaled(scene, turn, size), Floors { heights, ..floors.clone() })
}

impl SceneEncoder<'_> {
    /// Adds the other copies to the features of the scene as it lies. A Gaussian that a row was read from has a row in
    /// each copy; the mean of these is the new row (of features: at unit length).
    pub(super) fn add_copies(
        &self,
        scene: &GaussianScene,
        floors: &Floors,
        beside: u64,
        features: &mut SceneFeatures,
        progress: &mut ProgressFn<'_>,
    ) -> Result<(), EncodeError> {
        let width = features.width();
        for index in 1..self.tta {
            let (turned, floors) = copy(scene, floors, index);
            let there = beside + scene_bytes(&turned) + features.slots.bytes();
            let progress = &mut |at: EncodeProgress| progress(at.of_copy(index, self.tta));
            let more = self.encode_copy(&turned, &floors, there, progress)?;
            for start in (0..features.num_slots()).step_by(BLOCK) {
                let slots = start..(start + BLOCK).min(features.num_slots());
                let read = &features.sampled[slots.clone()];
                let from: Vec<u32> = read.iter().map(|&row| more.inverse[row as usize]).collect();
                let rows = more.slots.gather(&from)?;
                let to: Vec<u32> = slots.map(|slot| slot as u32).collect();
                features.slots.add(&to, &rows, None)?;
            }
            features.summary = features.summary.and(&more.summary);
        }
        if self.network.is_classifier() {
            let share = 1.0 / self.tta as f32;
            features.slots.finish(|row, _| row.iter_mut().for_each(|v| *v *= share))
        } else {
            features.slots.finish(|row, _| normalize_rows(row, width))
        }
    }

    /// That there are so many copies.
    pub(super) fn check_copies(&self) -> Result<(), EncodeError> {
        if (1..=MAX_COPIES).contains(&self.tta) {
            return Ok(());
        }
        let why = format!("tta: {} copies; 1 to {MAX_COPIES} are expected", self.tta);
        Err(EncodeError::Setting(why))
    }
}

impl EncodeSummary {
    /// This and what another copy took.
    fn and(self, other: &Self) -> Self {
        Self {
            passes: self.passes + other.passes,
            tiles: self.tiles + other.tiles,
            voxels_computed: self.voxels_computed + other.voxels_computed,
            smallest_halo: self.smallest_halo.min(other.smallest_halo),
            shrunk_halos: self.shrunk_halos + other.shrunk_halos,
            spilled: self.spilled || other.spilled,
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> (GaussianScene, Floors) {
        let scene = GaussianScene {
            coord: vec![[1.0, 2.0, 3.0], [-4.0, 0.5, 1.0]],
            log_scale: vec![[0.0, -1.0, -2.0]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacity_logit: vec![0.5; 2],
            sh_dc: vec![[0.1, 0.2, 0.3]; 2],
            normal: Some(vec![[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
            ..GaussianScene::default()
        };
        let floors =
            Floors { heights: vec![0.5, 3.0], cover: 1.0, score: 1.0, below: 0.0, given: true };
        (scene, floors)
    }

    #[test]
    fn copies_are_quarter_turns_in_three_sizes() {
        let (scene, floors) = corner();
        assert_eq!(copy(&scene, &floors, 0).0.coord, scene.coord);
        let places = [[1.0, 2.0], [-2.0, 1.0], [-1.0, -2.0], [2.0, -1.0]];
        for index in 0..MAX_COPIES {
            let (turned, above) = copy(&scene, &floors, index);
            let size = [1.0, 0.95, 1.05][index / 4];
            let [x, y] = places[index % 4];
            assert_eq!(turned.coord[0], [x, y, 3.0].map(|v: f64| (size * v) as f32), "{index}");
            assert_eq!(above.heights, [size * 0.5, size * 3.0]);
            let grown = f64::from(turned.log_scale[1][1]) + 1.0;
            assert!((grown - size.ln()).abs() < 1e-6, "{index}: {grown}");
            // A normal turns and does not grow.
            let normal = turned.normal.unwrap();
            let [x, y] = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][index % 4];
            assert_eq!(normal[0], [x, y, 0.0]);
            assert_eq!(normal[1], [0.0, 0.0, 1.0]);
        }
    }
}
