//! Attention inside patches of a serialized order.

use super::{Array, Operation, apply};
use crate::device::launches::{Input, Launched, Uploaded, narrow, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::{Launcher, ops::patch_attention as device};
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::{Heads, backward, forward_with};
use scenesplat_kernels::patches::Patches;
use std::sync::Arc;

struct PatchAttention {
    precision: Precision,
    heads: Heads,
    patches: Arc<Patches>,
    order: Arc<Vec<u32>>,
}

/// What a kernel needs beside `qkv`.
struct Sequence<B> {
    heads: device::Heads,
    patches: device::Patches<B>,
    order: B,
}

impl PatchAttention {
    /// `None` if there is no kernel for heads of this width.
    fn upload<L: Launcher>(&self, l: &L) -> Uploaded<L, Option<Sequence<L::Buffer>>> {
        let Heads { count, dim } = self.heads;
        if dim > device::MOST_DIM as usize {
            return Ok(None);
        }
        let mut all = Vec::with_capacity(self.patches.patches().len());
        for patch in self.patches.patches() {
            let (start, len) = (narrow::<L>(patch.start)?, narrow::<L>(patch.len)?);
            all.push(device::Patch { start, len, own: narrow::<L>(patch.own)? });
        }
        Ok(Some(Sequence {
            heads: device::Heads { count: narrow::<L>(count)?, dim: narrow::<L>(dim)? },
            patches: device::Patches::upload(l, &all, self.patches.pad())?,
            order: l.upload_values(&self.order)?,
        }))
    }
}

impl Operation for PatchAttention {
    const NAME: &'static str = "patch_attention";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (n, c3) = inputs[0].dims2()?;
        let c = self.heads.channels();
        if c3 != 3 * c || n != self.order.len() || n != self.patches.num_positions() {
            bail!(
                "patch_attention: expected [{}, {}] in patches of {} positions, got {:?}",
                self.order.len(),
                3 * c,
                self.patches.num_positions(),
                inputs[0]
            );
        }
        Ok((n, c).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let mut out = vec![0.0; inputs[0].0.len() / 3];
        let (heads, order) = (self.heads, &self.order);
        forward_with(self.precision, inputs[0].0, heads, &self.patches, order, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let mut dqkv = vec![0.0; inputs[0].0.len()];
        backward(inputs[0].0, self.heads, &self.patches, &self.order, grad, &mut dqkv);
        Ok(vec![dqkv])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let (qkv, dims) = inputs[0];
        let Some(Sequence { heads, patches, order }) = self.upload(l)? else { return Ok(None) };
        let attended = device::forward(l, qkv, heads, &patches, &order)?;
        Ok(Some(vec![(attended.out, (dims[0], self.heads.channels()).into())]))
    }
    /// What the forward pass knew is computed again.
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((qkv, dims), (grad, _)) = (inputs[0], inputs[1]);
        let Some(Sequence { heads, patches, order }) = self.upload(l)? else { return Ok(None) };
        let attended = device::forward(l, qkv, heads, &patches, &order)?;
        let mut dqkv = room(l, dims)?;
        device::backward(l, qkv, heads, &patches, &order, &attended, grad, &mut dqkv)?;
        Ok(Some(vec![(dqkv, dims.into())]))
    }
}

/// Softmax attention of every row to the rows of its patch. The gradient is computed in f32 in every
/// precision.
///
/// # Shapes
/// `qkv`: `[N, 3·C]`, the channels being q, k, v, each `[heads, dim]` · `order`: `[N]`, row at each
/// position of the sequence · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or the tensor is not f32.
pub fn patch_attention(
    precision: Precision,
    qkv: &Tensor,
    heads: Heads,
    patches: Arc<Patches>,
    order: Arc<Vec<u32>>,
) -> Result<Tensor> {
    apply(PatchAttention { precision, heads, patches, order }, &[qkv])
}
