//! Rows of every scale of a network, for what learns from more than its result.

use crate::ops;
use crate::row_order::{SortedRows, leave};
use candle_core::{Result, Tensor, bail};
use scenesplat_kernels::segment::Groups;
use std::sync::Arc;

/// What a pass over all scales is asked for.
#[derive(Debug, Clone, Copy, Default)]
pub struct LevelOptions<'a> {
    /// Input rows that the network must not see: what the stem makes of them is replaced by the mask
    /// token. `[N]`
    pub mask: Option<&'a [bool]>,
    /// Whether the decoder runs, if there is one.
    pub decoder: bool,
}

/// One scale of the encoder.
#[derive(Debug, Clone)]
pub struct Level {
    /// What its last block gives, rows in the network's own order, which is that of the curve this pass
    /// drew first where it shuffles them: another pass over the same points may number them otherwise.
    /// `[M, C]`
    pub feat: Tensor,
    /// Rows of scene `i` are `offsets[i]..offsets[i + 1]`. `[B + 1]`
    pub offsets: Vec<usize>,
    /// Which of its rows make a row of the next coarser scale; `None` for the coarsest.
    pub parents: Option<Arc<Groups>>,
}

/// All scales of a network on one batch.
#[derive(Debug)]
pub struct Levels {
    /// Fine to coarse, at least one.
    pub(crate) encoder: Vec<Level>,
    /// Decoder rows in the caller's order.
    pub(crate) decoder: Option<Tensor>,
    pub(crate) sorted: Option<SortedRows>,
}

impl Levels {
    /// Scales of the encoder, fine to coarse.
    pub fn encoder(&self) -> &[Level] {
        &self.encoder
    }

    /// The coarsest scale.
    ///
    /// # Errors
    /// If there is no scale, which no network gives.
    pub fn coarsest(&self) -> Result<&Level> {
        match self.encoder.last() {
            Some(level) => Ok(level),
            None => bail!("levels: there is no scale"),
        }
    }

    /// What the decoder gives, in the caller's order, if it ran. `[N, C]`
    pub fn decoder(&self) -> Option<&Tensor> {
        self.decoder.as_ref()
    }

    /// Without the way back to parameters.
    #[must_use]
    pub fn detached(mut self) -> Self {
        for level in &mut self.encoder {
            level.feat = level.feat.detach();
        }
        self.decoder = self.decoder.map(|rows| rows.detach());
        self
    }

    /// Rows of scale `to` beside those of all coarser scales: each row is followed by what the scales
    /// above hold at its place. Without parameters; `to = 0` gives all scales at every input voxel.
    ///
    /// # Shapes
    /// `[M, Σ C]`, M the rows of that scale: for scale 0 in the caller's order, else in the network's
    ///
    /// # Errors
    /// If there is no such scale.
    ///
    /// # Source
    /// The up-cast of Sonata (arXiv:2503.16429): concat(parent, child\[inverse\]).
    pub fn up_cast(&self, to: usize) -> Result<Tensor> {
        let Some(levels) = self.encoder.get(to..).filter(|levels| !levels.is_empty()) else {
            bail!("levels: scale {to} of {}", self.encoder.len());
        };
        let mut above: Option<Tensor> = None;
        for level in levels.iter().rev() {
            above = Some(match (above, &level.parents) {
                (Some(above), Some(parents)) => {
                    let here = ops::expand_groups(&above, Arc::clone(parents))?;
                    Tensor::cat(&[&level.feat, &here], 1)?
                }
                _ => level.feat.clone(),
            });
        }
        match above {
            Some(rows) => leave(self.sorted.as_ref().filter(|_| to == 0), rows),
            None => bail!("levels: there is no scale"),
        }
    }

    /// The row of scale `to` that each of the caller's rows is part of, as [`up_cast`](Self::up_cast)
    /// numbers them in this pass. `[N]`
    ///
    /// # Errors
    /// If there is no such scale.
    pub fn rows_at(&self, to: usize) -> Result<Vec<u32>> {
        if to >= self.encoder.len() {
            bail!("levels: scale {to} of {}", self.encoder.len());
        }
        let n = self.encoder[0].feat.dim(0)?;
        if to == 0 {
            return Ok((0..n as u32).collect());
        }
        // Of the network's rows first.
        let mut at: Vec<u32> = (0..n as u32).collect();
        for level in &self.encoder[..to] {
            if let Some(parents) = &level.parents {
                at.iter_mut().for_each(|row| *row = parents.inverse()[*row as usize]);
            }
        }
        Ok(match &self.sorted {
            None => at,
            Some(sorted) => {
                let mut out = vec![0; n];
                sorted.order().iter().zip(&at).for_each(|(&own, &row)| out[own as usize] = row);
                out
            }
        })
    }
}

/// Mean of the rows of each scene. `[M, C] → [B, C]`
///
/// A scene without rows has a mean of zeros.
///
/// # Errors
/// If offsets do not lead from 0 to the number of rows.
pub fn scene_means(rows: &Tensor, offsets: &[usize]) -> Result<Tensor> {
    let n = rows.dim(0)?;
    let groups = Groups::new(
        (0..n as u32).collect(),
        offsets.iter().map(|&o| u32::try_from(o).unwrap_or(u32::MAX)).collect(),
    );
    let groups = groups.map_err(candle_core::Error::wrap)?;
    ops::segment_reduce(rows, Arc::new(groups), scenesplat_kernels::segment::Reduce::Mean)
}
