//! Rotary embedding of voxel coordinates.

use super::{Array, Operation, apply};
use crate::device::launches::{Input, Launched, matrix, narrow, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::ops::rows::Width;
use scenesplat_device::{Launcher, ops};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::point_rope::{Rotations, Turn};
use std::sync::Arc;

struct PointRope {
    rotations: Arc<Rotations>,
    heads: Heads,
}

impl PointRope {
    fn turned(&self, values: &[f32], turn: Turn) -> Vec<f32> {
        let mut out = values.to_vec();
        self.rotations.apply(&mut out, self.heads, turn);
        out
    }

    fn turn<L: Launcher>(&self, l: &L, (x, dims): Input<'_, L>, turn: Turn) -> Launched<L> {
        let (n, c) = matrix::<L>(dims)?;
        let pairs = l.upload_values(self.rotations.pairs())?;
        let mut out = room(l, dims)?;
        let rows = ops::rows::count_up(l, n)?;
        ops::rows::gather_rows(l, x, Width::Four, c, &rows, n, &mut out)?;
        let (heads, dim) = (narrow::<L>(self.heads.count)?, narrow::<L>(self.heads.dim)?);
        let back = matches!(turn, Turn::Back);
        ops::point_rope::turn(l, &mut out, &pairs, n, heads, dim, back)?;
        Ok(Some(vec![(out, dims.into())]))
    }
}

impl Operation for PointRope {
    const NAME: &'static str = "point_rope";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let shape = inputs[0];
        let (rows, width) = (self.rotations.len(), 3 * self.heads.channels());
        if shape.dims2()? != (rows, width) || self.heads.dim != self.rotations.dim() {
            bail!(
                "point_rope: expected [{rows}, {width}] of heads of {}, got {shape:?} of {}",
                self.rotations.dim(),
                self.heads.dim
            );
        }
        Ok(shape.clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        Ok(self.turned(inputs[0].0, Turn::Forward))
    }
    fn backward(&self, _: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        Ok(vec![self.turned(grad, Turn::Back)])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        self.turn(l, inputs[0], Turn::Forward)
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        self.turn(l, inputs[1], Turn::Back)
    }
}

/// Queries and keys turned by the angles of their voxels, values as they are; f32 in every precision.
///
/// # Shapes
/// `qkv`: `[N, 3·C]`, the channels being q, k, v, each `[heads, dim]` · returns `[N, 3·C]`
///
/// # Errors
/// If shapes do not fit or the tensor is not f32.
pub fn point_rope(qkv: &Tensor, heads: Heads, rotations: Arc<Rotations>) -> Result<Tensor> {
    apply(PointRope { rotations, heads }, &[qkv])
}
