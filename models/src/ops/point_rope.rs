//! Rotary embedding of voxel coordinates.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, read,
};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::point_rope::{Rotations, Turn};
use std::sync::Arc;

struct PointRope {
    rotations: Arc<Rotations>,
    heads: Heads,
}

impl PointRope {
    fn check(&self, l: &Layout) -> Result<()> {
        let shape = l.shape();
        let (n, c3) = shape.dims2()?;
        let (rows, c) = (self.rotations.len(), self.heads.channels());
        if (n, c3) != (rows, 3 * c) || self.heads.dim != self.rotations.dim() {
            bail!(
                "point_rope: expected [{rows}, {}] of heads of {}, got {shape:?} of {}",
                3 * c,
                self.rotations.dim(),
                self.heads.dim
            );
        }
        Ok(())
    }

    fn launches(&self, back: bool) -> launches::PointRope<'_> {
        launches::PointRope { rotations: &self.rotations, heads: self.heads, back }
    }

    fn pass(&self, [qkv]: [&Layout; 1]) -> Result<Option<launches::PointRope<'_>>> {
        self.check(qkv)?;
        Ok(Some(self.launches(false)))
    }

    fn turned(&self, values: &[f32], turn: Turn) -> Vec<f32> {
        let mut out = values.to_vec();
        self.rotations.apply(&mut out, self.heads, turn);
        out
    }
}

impl CustomOp1 for PointRope {
    fn name(&self) -> &'static str {
        "point_rope"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        self.check(l)?;
        let out = self.turned(cpu_slice("point_rope", s, l)?, Turn::Forward);
        Ok((CpuStorage::F32(out), l.shape().clone()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, qkv: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        if let Some(mut made) = launched([grad], &self.launches(true))? {
            return Ok(made.pop());
        }
        let device = here("point_rope", Pass::Backward, qkv);
        let dqkv = read("point_rope", grad, |grad| Ok(self.turned(grad, Turn::Back)))?;
        Tensor::from_vec(dqkv, qkv.shape(), device).map(Some)
    }
}

/// Queries and keys turned by the angles of their voxels, values as they are; f32 in every
/// precision.
///
/// # Shapes
/// `qkv`: `[N, 3·C]`, the channels being q, k, v, each `[heads, dim]` · returns `[N, 3·C]`
///
/// # Errors
/// If shapes do not fit or the tensor is not f32.
pub fn point_rope(qkv: &Tensor, heads: Heads, rotations: Arc<Rotations>) -> Result<Tensor> {
    let rope = PointRope { rotations, heads };
    if composed::here("point_rope", qkv.device()) {
        rope.check(qkv.layout())?;
        return composed::point_rope(qkv, heads, &rope.rotations);
    }
    qkv.contiguous()?.apply_op1(rope)
}
