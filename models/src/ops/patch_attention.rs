//! Attention inside patches of a serialized order.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make, read,
};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
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

impl PatchAttention {
    fn check(&self, l: &Layout) -> Result<(usize, usize)> {
        let (n, c3) = l.shape().dims2()?;
        let c = self.heads.channels();
        if c3 != 3 * c || n != self.order.len() || n != self.patches.num_positions() {
            bail!(
                "patch_attention: expected [{}, {}] in patches of {} positions, got {:?}",
                self.order.len(),
                3 * c,
                self.patches.num_positions(),
                l.shape()
            );
        }
        Ok((n, c))
    }

    fn pass(&self, [qkv]: [&Layout; 1]) -> Result<Option<launches::PatchAttention<'_>>> {
        self.check(qkv)?;
        Ok(launches::PatchAttention::fits(self.heads).then(|| self.launches()))
    }

    fn launches(&self) -> launches::PatchAttention<'_> {
        launches::PatchAttention { heads: self.heads, patches: &self.patches, order: &self.order }
    }
}

impl CustomOp1 for PatchAttention {
    fn name(&self) -> &'static str {
        "patch_attention"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        let (n, c) = self.check(l)?;
        let qkv = cpu_slice("patch_attention", s, l)?;
        let mut out = vec![0f32; n * c];
        forward_with(self.precision, qkv, self.heads, &self.patches, &self.order, &mut out);
        Ok((CpuStorage::F32(out), (n, c).into()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, qkv: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        if launches::PatchAttention::fits(self.heads) {
            let pass = launches::PatchAttentionBackward(self.launches());
            if let Some(mut made) = launched([qkv, grad], &pass)? {
                return Ok(made.pop());
            }
        }
        let (shape, device) = (qkv.shape().clone(), here("patch_attention", Pass::Backward, qkv));
        read("patch_attention", qkv, |qkv| {
            read("patch_attention", grad, |grad| {
                make(device, shape, |out| {
                    backward(qkv, self.heads, &self.patches, &self.order, grad, out);
                })
            })
        })
        .map(Some)
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
    let attention = PatchAttention { precision, heads, patches, order };
    if composed::here("patch_attention", qkv.device()) {
        attention.check(qkv.layout())?;
        return composed::patch_attention(qkv, heads, &attention.patches, &attention.order);
    }
    qkv.contiguous()?.apply_op1(attention)
}
