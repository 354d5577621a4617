//! A scene of which the network reads a part.

use super::{EncodeError, ProgressFn, SceneEncoder, SceneFeatures, scene_bytes};
use crate::alignment::Alignment;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::GaussianScene;

impl SceneEncoder<'_> {
    /// As [`encode_aligned`](Self::encode_aligned), but the network reads the Gaussians `kept` alone (rows, ascending):
    /// the others are in no voxel and move none. Each of them takes the feature of the nearest that was read, the
    /// first row of equally near ones, and has no say in votes ([`SceneFeatures::voters`]).
    ///
    /// If all are kept, it is [`encode_aligned`](Self::encode_aligned), bit for bit.
    ///
    /// # Errors
    /// As [`encode`](Self::encode); also if rows are not ascending or not in the scene.
    pub fn encode_kept(
        &self,
        scene: &GaussianScene,
        alignment: Alignment,
        kept: &[usize],
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        let in_scene = kept.last().is_none_or(|&last| last < scene.len());
        if !in_scene || !kept.is_sorted_by(|a, b| a < b) {
            let why = format!("kept: ascending rows below {} are expected", scene.len());
            return Err(EncodeError::Setting(why));
        }
        if kept.len() == scene.len() {
            return self.encode_aligned(scene, alignment, progress);
        }
        let part = scene.select_rows(kept).map_err(scenesplat_datasets::DataError::from)?;
        let aligned = alignment.apply(&part);
        let copy = if alignment.is_identity() { 0 } else { scene_bytes(&part) };
        let beside = scene_bytes(scene) + copy;
        let mut features = self.encode_as_is(&aligned, &alignment.floors, beside, progress)?;
        features.alignment = Some(alignment);
        features.spread(&scene.coord, kept)
    }
}

impl SceneFeatures {
    /// Features of the rows `kept` as those of the whole scene. `coord`: `[N, 3]`
    fn spread(mut self, coord: &[[f32; 3]], kept: &[usize]) -> Result<Self, EncodeError> {
        let wrong = |what: String| EncodeError::Setting(what);
        let tree = KdTree::of_rows(coord, kept.iter().copied())
            .map_err(|error| wrong(format!("Gaussians that are read: {error}")))?;
        let mut slots = vec![None; coord.len()];
        kept.iter().zip(&self.inverse).for_each(|(&row, &slot)| slots[row] = Some(slot));
        let others: Vec<usize> = (0..coord.len()).filter(|&row| slots[row].is_none()).collect();
        let places: Vec<[f32; 3]> = others.iter().map(|&row| coord[row]).collect();
        let nearest = tree.map_nearest(
            &places,
            1,
            || (),
            |(), _, near| near.first().map(|neighbor| neighbor.row),
        );
        self.voters = Some(slots.iter().map(Option::is_some).collect());
        for (&row, near) in others.iter().zip(nearest) {
            let lost = || wrong(format!("Gaussian {row} is nowhere: no other one is nearest"));
            slots[row] = slots[near.ok_or_else(lost)? as usize];
        }
        self.inverse = slots.into_iter().flatten().collect();
        self.sampled.iter_mut().for_each(|row| *row = kept[*row as usize] as u32);
        Ok(self)
    }

    /// Whose labels count in votes: Gaussians that a network read, or whose voxel it did. `None`: all. `[N]`
    pub fn voters(&self) -> Option<&[bool]> {
        self.voters.as_deref()
    }
}
