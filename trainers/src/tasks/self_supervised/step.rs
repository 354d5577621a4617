//! What the terms of a step read, and what each gives.

use candle_core::{Device, Result, Tensor, bail};
use scenesplat_datasets::{Masked, View};
use scenesplat_models::{Levels, scene_means};

/// A network's features of a view.
pub(super) struct Seen {
    pub levels: Levels,
    /// Rows of the finest scale, in the caller's order, if they are read. `[N, C]`
    pub rows: Option<Tensor>,
}

impl Seen {
    /// No gradient reaches the parameters through these.
    pub fn detached(self) -> Self {
        Self { levels: self.levels.detached(), rows: self.rows.map(|rows| rows.detach()) }
    }

    /// A vector for each scene: the mean over its coarsest rows. `[B, C]`
    pub fn scenes(&self) -> Result<Tensor> {
        let level = self.levels.coarsest()?;
        scene_means(&level.feat, &level.offsets)
    }

    /// Chosen rows of the finest scale.
    pub fn rows_at(&self, rows: &Tensor) -> Result<Tensor> {
        let all = self.all_rows()?;
        all.index_select(&rows.to_device(all.device())?, 0)
    }

    pub fn all_rows(&self) -> Result<&Tensor> {
        match &self.rows {
            Some(rows) => Ok(rows),
            None => bail!("the rows of this view were not asked for"),
        }
    }

    /// Rows that a collapse would show in, detached.
    pub fn features(&self) -> Result<Tensor> {
        match &self.rows {
            Some(rows) => Ok(rows.detach()),
            None => Ok(self.levels.coarsest()?.feat.detach()),
        }
    }
}

/// What a term gives. By default it is off.
#[derive(Default)]
pub(super) struct TermOutput {
    /// Scalar; `None` if nothing counts.
    pub value: Option<Tensor>,
    /// For the log.
    pub notes: Vec<(String, f64)>,
    /// Rows (or scenes) that count.
    pub rows: usize,
}

impl TermOutput {
    pub fn new(value: Option<Tensor>, notes: &[(&str, f64)], rows: usize) -> Self {
        let notes = notes.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        Self { value, notes, rows }
    }
}

/// Input of all terms.
pub(super) struct Step<'a> {
    pub views: &'a [View],
    pub masks: &'a [Option<Masked>],
    pub student: &'a [Seen],
    pub teacher: &'a [Seen],
    pub step: u64,
    pub total: u64,
}

impl Step<'_> {
    /// Views with masked rows: number, rows, weights.
    pub fn masked(&self) -> Result<Vec<(usize, Tensor, Vec<f64>)>> {
        let mut all = Vec::new();
        for (view, masked) in self.masks.iter().enumerate() {
            let Some(masked) = masked else { continue };
            let rows = indices(&masked.hidden);
            let weights: Vec<f64> = rows.iter().map(|&row| masked.weights[row as usize]).collect();
            if !rows.is_empty() {
                all.push((view, Tensor::new(rows, &Device::Cpu)?, weights));
            }
        }
        Ok(all)
    }
}

/// Indices of what is true, ascending.
pub(super) fn indices(chosen: &[bool]) -> Vec<u32> {
    (0_u32..).zip(chosen).filter(|(_, chosen)| **chosen).map(|(row, _)| row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masked_rows_have_their_own_weights() {
        let masks = [
            None,
            Some(Masked {
                hidden: vec![false, true, false, true],
                weights: vec![0.0, 0.25, 0.0, 0.75],
            }),
            Some(Masked { hidden: vec![false; 4], weights: vec![0.0; 4] }),
        ];
        let step =
            Step { views: &[], masks: &masks, student: &[], teacher: &[], step: 0, total: 1 };
        let found = step.masked().unwrap();
        assert_eq!(found.len(), 1, "views without a masked row are left out");
        let (view, rows, weights) = &found[0];
        assert_eq!((*view, rows.to_vec1::<u32>().unwrap()), (1, vec![1, 3]));
        assert_eq!(*weights, [0.25, 0.75]);
    }
}
