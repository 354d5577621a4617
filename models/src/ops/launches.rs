//! Passes of operations as launches on a device, whatever runs them: CUDA, or the emulated grid of the tests.
//!
//! Index tables lie on the host and go to the device with each pass.

#![cfg_attr(
    not(any(feature = "cuda", feature = "emulation")),
    allow(dead_code, reason = "nothing launches them")
)]

use super::batch_norm::scale_shift;
use candle_core::Shape;
use scenesplat_device::ops as device;
use scenesplat_device::ops::rows::Width;
use scenesplat_device::{Launcher, TooManyItems};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::Patches;
use scenesplat_kernels::point_rope::Rotations;
use scenesplat_kernels::segment::{Groups, Reduce};
use std::sync::Arc;

/// What a pass makes: arrays of f32, each with its shape.
pub(crate) type Arrays<B> = Vec<(B, Shape)>;

/// A pass of an operation; `N` arrays of f32 without gaps go in. Shapes were checked before.
pub(crate) trait Launches<const N: usize> {
    /// Starts it. `inputs`: arrays with their dimensions.
    fn launch<L: Launcher>(
        &self,
        l: &L,
        inputs: [(&L::Buffer, &[usize]); N],
    ) -> Result<Arrays<L::Buffer>, L::Error>;
}

/// A number of rows or channels as kernels take it.
fn narrow<L: Launcher>(n: usize) -> Result<u32, L::Error> {
    let too_many = || TooManyItems { kernel: "rows", items: n as u64, blocks: n as u64 };
    u32::try_from(n).map_err(|_| too_many().into())
}

/// Rows and channels.
fn matrix<L: Launcher>(dims: &[usize]) -> Result<(u32, u32), L::Error> {
    let [n, c] = *dims else { return Ok((0, 0)) };
    Ok((narrow::<L>(n)?, narrow::<L>(c)?))
}

fn count(dims: &[usize]) -> usize {
    dims.iter().product()
}

/// The exact GELU.
pub(crate) struct Gelu;

impl Launches<1> for Gelu {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let mut out = l.alloc_values::<f32>(count(dims))?;
        device::activation::gelu(l, x, count(dims) as u64, &mut out)?;
        Ok(vec![(out, dims.into())])
    }
}

/// Its gradient, of `x` and the gradient of the output.
pub(crate) struct GeluBackward;

impl Launches<2> for GeluBackward {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (grad, _)]: [(&L::Buffer, &[usize]); 2],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let mut dx = l.alloc_values::<f32>(count(dims))?;
        device::activation::gelu_backward(l, x, grad, count(dims) as u64, &mut dx)?;
        Ok(vec![(dx, dims.into())])
    }
}

/// Layer normalisation of `x` with weight and bias.
pub(crate) struct LayerNorm {
    pub eps: f32,
}

impl Launches<3> for LayerNorm {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (weight, _), (bias, _)]: [(&L::Buffer, &[usize]); 3],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let mut out = l.alloc_values::<f32>(count(dims))?;
        device::layer_norm::forward(l, x, None, weight, bias, n, c, self.eps, &mut out)?;
        Ok(vec![(out, dims.into())])
    }
}

/// Its gradients, of `x`, the weight and the gradient of the output: of `x`, and of weight and bias, `[2, C]`.
pub(crate) struct LayerNormBackward {
    pub eps: f32,
}

impl Launches<3> for LayerNormBackward {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (weight, _), (grad, _)]: [(&L::Buffer, &[usize]); 3],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let mut dx = l.alloc_values::<f32>(count(dims))?;
        let both = device::layer_norm::backward(l, x, grad, weight, n, c, self.eps, &mut dx)?;
        Ok(vec![(dx, dims.into()), (both, (2, c as usize).into())])
    }
}

/// `x · scale + shift` of batch normalisation, from weight, bias and statistics that are on the host.
pub(crate) struct BatchNorm<'a> {
    pub weight: &'a [f32],
    pub bias: &'a [f32],
    pub mean: &'a [f64],
    pub inverse: &'a [f64],
}

impl Launches<1> for BatchNorm<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let (scale, shift) = scale_shift(self.weight, self.bias, self.mean, self.inverse);
        let (scale, shift) = (l.upload_values(&scale)?, l.upload_values(&shift)?);
        let mut out = l.alloc_values::<f32>(count(dims))?;
        device::batch_norm::apply(l, x, &scale, &shift, n, c, false, &mut out)?;
        Ok(vec![(out, dims.into())])
    }
}

/// Mean and biased variance of each channel of `x`, for the host. `[C]` each
pub(crate) fn batch_statistics<L: Launcher>(
    l: &L,
    (x, dims): (&L::Buffer, &[usize]),
) -> Result<(Vec<f64>, Vec<f64>), L::Error> {
    let (n, c) = matrix::<L>(dims)?;
    let statistics = device::batch_norm::statistics(l, x, n, c)?;
    let mut mean = l.download_values::<f64>(&statistics, 2 * c as usize)?;
    let var = mean.split_off(c as usize);
    Ok((mean, var))
}

/// Its gradients, of `x`, the weight and the gradient of the output: of `x`, weight and bias.
pub(crate) struct BatchNormBackward<'a> {
    pub mean: &'a [f64],
    pub inverse: &'a [f64],
    pub from_batch: bool,
}

impl Launches<3> for BatchNormBackward<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (weight, _), (grad, _)]: [(&L::Buffer, &[usize]); 3],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let (mean, inverse) = (l.upload_values(self.mean)?, l.upload_values(self.inverse)?);
        let mut dx = l.alloc_values::<f32>(count(dims))?;
        let of = device::batch_norm::backward(
            l,
            x,
            grad,
            weight,
            &mean,
            &inverse,
            n,
            c,
            self.from_batch,
            &mut dx,
        )?;
        let c = c as usize;
        Ok(vec![(dx, dims.into()), (of.weight, c.into()), (of.bias, c.into())])
    }
}

/// Rows with a bias each.
pub(crate) struct AddBias;

impl Launches<2> for AddBias {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (bias, _)]: [(&L::Buffer, &[usize]); 2],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let ones = l.upload_values(&vec![1_f32; c as usize])?;
        let mut out = l.alloc_values::<f32>(count(dims))?;
        device::batch_norm::apply(l, x, &ones, bias, n, c, false, &mut out)?;
        Ok(vec![(out, dims.into())])
    }
}

/// Sums over the rows. `[C]`
pub(crate) struct ColumnSums;

impl Launches<1> for ColumnSums {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let mut out = l.alloc_values::<f32>(c as usize)?;
        device::columns::column_sums(l, x, n, c, &mut out)?;
        Ok(vec![(out, (c as usize).into())])
    }
}

/// `out[i] = x[rows[i]]`, for permutations and for rows of groups.
pub(crate) struct Gather<'a> {
    pub rows: &'a [u32],
}

impl Launches<1> for Gather<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (_, c) = matrix::<L>(dims)?;
        let (rows, n) = (l.upload_values(self.rows)?, narrow::<L>(self.rows.len())?);
        let mut out = l.alloc_values::<f32>(self.rows.len() * c as usize)?;
        device::rows::gather_rows(l, x, Width::Four, c, &rows, n, &mut out)?;
        Ok(vec![(out, (self.rows.len(), c as usize).into())])
    }
}

/// Groups on the device.
struct Uploaded<B> {
    rows: B,
    offsets: B,
    inverse: B,
    num_rows: u32,
    num_groups: u32,
}

impl<B> Uploaded<B> {
    fn new<L: Launcher<Buffer = B>>(l: &L, groups: &Groups) -> Result<Self, L::Error> {
        Ok(Self {
            rows: l.upload_values(groups.rows())?,
            offsets: l.upload_values(groups.offsets())?,
            inverse: l.upload_values(groups.inverse())?,
            num_rows: narrow::<L>(groups.rows().len())?,
            num_groups: narrow::<L>(groups.len())?,
        })
    }

    fn view(&self) -> device::segment::Groups<'_, B> {
        device::segment::Groups {
            rows: &self.rows,
            offsets: &self.offsets,
            inverse: &self.inverse,
            num_rows: self.num_rows,
            num_groups: self.num_groups,
        }
    }
}

fn way(how: Reduce) -> device::segment::Reduce {
    match how {
        Reduce::Sum => device::segment::Reduce::Sum,
        Reduce::Mean => device::segment::Reduce::Mean,
        Reduce::Max => device::segment::Reduce::Max,
    }
}

/// Reduces each group of rows to one.
pub(crate) struct SegmentReduce<'a> {
    pub groups: &'a Groups,
    pub how: Reduce,
}

impl Launches<1> for SegmentReduce<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (_, c) = matrix::<L>(dims)?;
        let groups = Uploaded::new(l, self.groups)?;
        let shape = (self.groups.len(), c as usize);
        let mut out = l.alloc_values::<f32>(shape.0 * shape.1)?;
        device::segment::reduce(l, x, c, groups.view(), way(self.how), &mut out)?;
        Ok(vec![(out, shape.into())])
    }
}

/// Its gradient, of `x` and the gradient of the output.
pub(crate) struct SegmentReduceBackward<'a> {
    pub groups: &'a Groups,
    pub how: Reduce,
}

impl Launches<2> for SegmentReduceBackward<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (grad, _)]: [(&L::Buffer, &[usize]); 2],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (_, c) = matrix::<L>(dims)?;
        let groups = Uploaded::new(l, self.groups)?;
        let mut dx = l.alloc_values::<f32>(count(dims))?;
        device::segment::reduce_backward(l, x, c, groups.view(), way(self.how), grad, &mut dx)?;
        Ok(vec![(dx, dims.into())])
    }
}

/// Softmax attention of rows to the rows of their patch.
pub(crate) struct PatchAttention<'a> {
    pub heads: Heads,
    pub patches: &'a Patches,
    pub order: &'a [u32],
}

/// Patches and order on the device.
struct Sequence<B> {
    patches: device::patch_attention::Patches<B>,
    order: B,
}

impl PatchAttention<'_> {
    fn sequence<L: Launcher>(&self, l: &L) -> Result<Sequence<L::Buffer>, L::Error> {
        let mut all = Vec::with_capacity(self.patches.patches().len());
        for patch in self.patches.patches() {
            all.push(device::patch_attention::Patch {
                start: narrow::<L>(patch.start)?,
                len: narrow::<L>(patch.len)?,
                own: narrow::<L>(patch.own)?,
            });
        }
        Ok(Sequence {
            patches: device::patch_attention::Patches::upload(l, &all, self.patches.pad())?,
            order: l.upload_values(self.order)?,
        })
    }

    fn heads<L: Launcher>(&self) -> Result<device::patch_attention::Heads, L::Error> {
        let Heads { count, dim } = self.heads;
        Ok(device::patch_attention::Heads { count: narrow::<L>(count)?, dim: narrow::<L>(dim)? })
    }

    /// Whether there is a kernel for heads of this width.
    pub(crate) fn fits(heads: Heads) -> bool {
        heads.dim <= device::patch_attention::MOST_DIM as usize
    }
}

impl Launches<1> for PatchAttention<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(qkv, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let s = self.sequence(l)?;
        let heads = self.heads::<L>()?;
        let attended = device::patch_attention::forward(l, qkv, heads, &s.patches, &s.order)?;
        Ok(vec![(attended.out, (dims[0], self.heads.channels()).into())])
    }
}

/// Its gradient, of `qkv` and the gradient of the output; what the forward pass knew is computed again.
pub(crate) struct PatchAttentionBackward<'a>(pub PatchAttention<'a>);

impl Launches<2> for PatchAttentionBackward<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(qkv, dims), (grad, _)]: [(&L::Buffer, &[usize]); 2],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let s = self.0.sequence(l)?;
        let heads = self.0.heads::<L>()?;
        let attended = device::patch_attention::forward(l, qkv, heads, &s.patches, &s.order)?;
        let mut dqkv = l.alloc_values::<f32>(count(dims))?;
        let order = &s.order;
        device::patch_attention::backward(
            l, qkv, heads, &s.patches, order, &attended, grad, &mut dqkv,
        )?;
        Ok(vec![(dqkv, dims.into())])
    }
}

/// Queries and keys turned by the angles of their voxels.
pub(crate) struct PointRope<'a> {
    pub rotations: &'a Rotations,
    pub heads: Heads,
    pub back: bool,
}

impl Launches<1> for PointRope<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(qkv, dims)]: [(&L::Buffer, &[usize]); 1],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (n, c) = matrix::<L>(dims)?;
        let Heads { count: heads, dim } = self.heads;
        let pairs = l.upload_values(self.rotations.pairs())?;
        let mut out = l.alloc_values::<f32>(count(dims))?;
        let rows = device::rows::count_up(l, n)?;
        device::rows::gather_rows(l, qkv, Width::Four, c, &rows, n, &mut out)?;
        let (heads, dim) = (narrow::<L>(heads)?, narrow::<L>(dim)?);
        device::point_rope::turn(l, &mut out, &pairs, n, heads, dim, self.back)?;
        Ok(vec![(out, dims.into())])
    }
}

/// Submanifold convolution of `x` with the weight and, if there is one, the bias.
pub(crate) struct SparseConv<'a> {
    pub map: &'a Arc<KernelMap>,
    pub cout: usize,
}

impl SparseConv<'_> {
    fn map<L: Launcher>(
        &self,
        l: &L,
    ) -> Result<device::kernel_map::KernelMap<L::Buffer>, L::Error> {
        let (n, taps) = (self.map.rows(), self.map.taps());
        let mut neighbors = vec![u32::MAX; n * taps];
        let (mut starts, mut input, mut output) = (vec![0], Vec::new(), Vec::new());
        for (tap, row) in (0..taps).zip(neighbors.chunks_exact_mut(n.max(1))) {
            let (from, to) = self.map.tap_pairs(tap);
            from.iter().zip(&to).for_each(|(from, to)| row[*to as usize] = *from);
            input.extend(from);
            output.extend(to);
            starts.push(narrow::<L>(input.len())?);
        }
        starts.resize(taps + 1, 0);
        Ok(device::kernel_map::KernelMap {
            kernel_size: narrow::<L>(self.map.kernel_size())?,
            rows: narrow::<L>(n)?,
            pairs: narrow::<L>(input.len())?,
            duplicates: self.map.has_duplicates(),
            neighbors: l.upload_values(&neighbors)?,
            starts: l.upload_values(&starts)?,
            input: l.upload_values(&input)?,
            output: l.upload_values(&output)?,
        })
    }

    fn forward<L: Launcher>(
        &self,
        l: &L,
        (x, dims): (&L::Buffer, &[usize]),
        weight: &L::Buffer,
        bias: Option<&L::Buffer>,
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (map, (n, cin), cout) = (self.map(l)?, matrix::<L>(dims)?, narrow::<L>(self.cout)?);
        let mut out = l.alloc_values::<f32>(n as usize * self.cout)?;
        let method = device::sparse_conv::Method::ByWidth;
        device::sparse_conv::forward(l, method, &map, x, weight, bias, cin, cout, &mut out)?;
        Ok(vec![(out, (dims[0], self.cout).into())])
    }
}

impl Launches<2> for SparseConv<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [x, (weight, _)]: [(&L::Buffer, &[usize]); 2],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        self.forward(l, x, weight, None)
    }
}

impl Launches<3> for SparseConv<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [x, (weight, _), (bias, _)]: [(&L::Buffer, &[usize]); 3],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        self.forward(l, x, weight, Some(bias))
    }
}

/// Its gradients, of `x`, the weight and the gradient of the output: of `x`, weight and bias.
pub(crate) struct SparseConvBackward<'a>(pub SparseConv<'a>);

impl Launches<3> for SparseConvBackward<'_> {
    fn launch<L: Launcher>(
        &self,
        l: &L,
        [(x, dims), (weight, of_weight), (grad, _)]: [(&L::Buffer, &[usize]); 3],
    ) -> Result<Arrays<L::Buffer>, L::Error> {
        let (map, (n, cin), cout) = (self.0.map(l)?, matrix::<L>(dims)?, narrow::<L>(self.0.cout)?);
        let mut dx = l.alloc_values::<f32>(count(dims))?;
        let mut dw = l.alloc_values::<f32>(count(of_weight))?;
        let mut db = l.alloc_values::<f32>(self.0.cout)?;
        let method = device::sparse_conv::Method::ByWidth;
        device::sparse_conv::backward_input(l, method, &map, grad, weight, cin, cout, &mut dx)?;
        device::sparse_conv::backward_weight(l, &map, x, grad, cin, cout, &mut dw)?;
        device::columns::column_sums(l, grad, n, cout, &mut db)?;
        Ok(vec![(dx, dims.into()), (dw, of_weight.into()), (db, self.0.cout.into())])
    }
}
