//! Pictures of Gaussians, trainable.

use super::{Array, Operation, apply};
use candle_core::{Device, Error, Result, Shape, Tensor, bail};
use rayon::prelude::*;
use scenesplat_rasterizer::backward::{GradMask, Trace, TraceRequest, Upstream, backward, trace};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};
use std::sync::{Mutex, PoisonError};

/// Values per Gaussian that are not harmonics: mean, quaternion, scale, opacity.
const GEOMETRY: usize = 11;
/// Rows of one task.
const CHUNK: usize = 4096;

/// Gaussians with activated values, all f32 on the CPU.
///
/// What is stored as a logarithm or logit goes through `exp` and a sigmoid first, whose gradients
/// candle knows.
#[derive(Debug, Clone)]
pub struct GaussianTensors {
    /// Centers in the world. `[N, 3]`
    pub means: Tensor,
    /// `w, x, y, z`, any norm. `[N, 4]`
    pub quats: Tensor,
    /// Standard deviations, units of the world. `[N, 3]`
    pub scales: Tensor,
    /// In 0..=1. `[N]`
    pub opacities: Tensor,
    /// Spherical harmonics, `K` = 1, 4, 9 or 16. `[N, K, 3]`
    pub sh: Tensor,
}

impl GaussianTensors {
    /// Copies of these values, without gradients: of a scene by
    /// [`Gaussians::from_scene`](scenesplat_rasterizer::Gaussians::from_scene). To train some of them, put variables in their
    /// place.
    ///
    /// # Errors
    /// If arrays differ in length.
    pub fn of(gaussians: &Gaussians) -> Result<Self> {
        let Gaussians { means, quats, scales, opacities, sh, sh_degree } = gaussians;
        let (n, bands) = (means.len(), (usize::from(*sh_degree) + 1).pow(2));
        let cpu = &Device::Cpu;
        Ok(Self {
            means: Tensor::from_slice(means.as_flattened(), (n, 3), cpu)?,
            quats: Tensor::from_slice(quats.as_flattened(), (n, 4), cpu)?,
            scales: Tensor::from_slice(scales.as_flattened(), (n, 3), cpu)?,
            opacities: Tensor::from_slice(opacities, n, cpu)?,
            sh: Tensor::from_slice(sh, (n, bands, 3), cpu)?,
        })
    }
}

/// A depth beside color and alpha.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DepthChannel {
    /// None.
    #[default]
    None,
    /// `Σ w z`.
    Accumulated,
    /// `Σ w z / max(alpha, 1e-10)`.
    Expected,
}

/// Draws a view. `[H, W, C]`: red, green, blue (at least 0, no upper limit, over the background of
/// the settings), alpha, and depth if asked for.
///
/// Groups of parameters that require no gradient are frozen: what only they need is not computed. The
/// operation keeps a copy of the Gaussians and what the backward pass needs as long as the graph of the
/// result lives.
///
/// # Errors
/// Tensors of another shape, dtype or device, each named; what
/// [`project`](scenesplat_rasterizer::project) refuses; in the backward pass, a gradient of the
/// picture that is not finite, with its pixel.
pub fn rasterize(
    gaussians: &GaussianTensors,
    view: &View,
    settings: &RasterSettings,
    depth: DepthChannel,
) -> Result<Tensor> {
    let GaussianTensors { means, quats, scales, opacities, sh } = gaussians;
    let (n, bands) = match *sh.dims() {
        [n, bands @ (1 | 4 | 9 | 16), 3] => (n, bands),
        ref other => bail!("rasterize: sh: expected [N, 1 | 4 | 9 | 16, 3], got {other:?}"),
    };
    let wanted: [(&str, &Tensor, &[usize]); 4] = [
        ("means", means, &[n, 3]),
        ("quats", quats, &[n, 4]),
        ("scales", scales, &[n, 3]),
        ("opacities", opacities, &[n]),
    ];
    for (name, tensor, shape) in wanted.into_iter().chain([("sh", sh, &[n, bands, 3][..])]) {
        if tensor.dims() != shape {
            bail!("rasterize: {name}: expected {shape:?}, got {:?}", tensor.shape());
        }
        if tensor.dtype() != candle_core::DType::F32 {
            let dtype = tensor.dtype();
            bail!("rasterize: {name}: expected f32, got {dtype:?}; cast with to_dtype first");
        }
        if !tensor.device().same_device(means.device()) {
            bail!("rasterize: {name}: not on the device of means; move it with to_device");
        }
    }
    let mask = GradMask {
        means: means.track_op(),
        quats: quats.track_op(),
        scales: scales.track_op(),
        opacities: opacities.track_op(),
        sh: sh.track_op(),
        sh_direction: true,
    };
    let geometry = Tensor::cat(&[means, quats, scales, &opacities.unsqueeze(1)?], 1)?;
    let op = Rasterize { view: *view, settings: *settings, depth, mask, drawn: Mutex::default() };
    apply(op, &[&geometry, &sh.contiguous()?])
}

struct Rasterize {
    view: View,
    settings: RasterSettings,
    depth: DepthChannel,
    mask: GradMask,
    /// Kept by the forward pass for the backward pass.
    drawn: Mutex<Option<(Gaussians, Trace)>>,
}

impl Rasterize {
    fn channels(&self) -> usize {
        if self.depth == DepthChannel::None { 4 } else { 5 }
    }

    /// The picture, channels last.
    fn picture(&self, trace: &Trace) -> Vec<f32> {
        let picture = &trace.picture;
        let depth = match self.depth {
            DepthChannel::None => None,
            DepthChannel::Accumulated => picture.depth_accumulated.as_deref(),
            DepthChannel::Expected => picture.depth_expected.as_deref(),
        };
        let rgb = picture.rgb.as_deref().unwrap_or_default();
        let mut out = vec![0.0; picture.transmittance.len() * self.channels()];
        let pixels = out.chunks_exact_mut(self.channels()).zip(rgb.chunks_exact(3));
        for (i, (pixel, rgb)) in pixels.enumerate() {
            pixel[..3].copy_from_slice(rgb);
            pixel[3] = 1.0 - picture.transmittance[i];
            if let Some(depth) = depth {
                pixel[4] = depth[i];
            }
        }
        out
    }

    /// Gradients of `[N, 11]` and `[N, K, 3]` from that of the picture.
    fn gradients_of_rows(&self, grad: &[f32]) -> Result<(Vec<f32>, Vec<f32>)> {
        let drawn = self.drawn.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((gaussians, trace)) = &*drawn else {
            bail!("rasterize: a backward pass without a forward pass")
        };
        let c = self.channels();
        let plane = |k: usize| -> Vec<f32> { grad.iter().skip(k).step_by(c).copied().collect() };
        let rgb: Vec<f32> = grad.chunks_exact(c).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let (alpha, depth) = (plane(3), if c > 4 { plane(4) } else { Vec::new() });
        let given = |on: bool| on.then_some(&depth[..]);
        let upstream = Upstream {
            rgb: Some(&rgb),
            alpha: Some(&alpha),
            depth_accumulated: given(self.depth == DepthChannel::Accumulated),
            depth_expected: given(self.depth == DepthChannel::Expected),
            features: None,
        };
        let (view, settings) = (&self.view, &self.settings);
        let found =
            backward(gaussians, view, settings, trace, &upstream, self.mask).map_err(failed)?;
        let mut geometry = vec![0.0; found.means.len() * GEOMETRY];
        geometry.par_chunks_mut(GEOMETRY).enumerate().with_min_len(CHUNK).for_each(|(i, row)| {
            row[..3].copy_from_slice(&found.means[i]);
            row[3..7].copy_from_slice(&found.quats[i]);
            row[7..10].copy_from_slice(&found.scales[i]);
            row[10] = found.opacities[i];
        });
        Ok((geometry, found.sh))
    }
}

fn failed(error: impl std::fmt::Display) -> Error {
    Error::Msg(format!("rasterize: {error}"))
}

/// The rows of the operation's inputs as the rasterizer has them.
fn gaussians(geometry: &[f32], sh: &[f32], sh_degree: u8) -> Gaussians {
    let (rows, _) = geometry.as_chunks::<GEOMETRY>();
    let all = || rows.par_iter().with_min_len(CHUNK);
    Gaussians {
        means: all().map(|r| [r[0], r[1], r[2]]).collect(),
        quats: all().map(|r| [r[3], r[4], r[5], r[6]]).collect(),
        scales: all().map(|r| [r[7], r[8], r[9]]).collect(),
        opacities: all().map(|r| r[10]).collect(),
        sh: sh.to_vec(),
        sh_degree,
    }
}

impl Operation for Rasterize {
    const NAME: &'static str = "rasterize";

    fn shape(&self, _: &[&Shape]) -> Result<Shape> {
        Ok((self.view.height as usize, self.view.width as usize, self.channels()).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let ((geometry, _), (sh, dims)) = (inputs[0], inputs[1]);
        let gaussians = gaussians(geometry, sh, dims[1].isqrt() as u8 - 1);
        let depth = self.depth != DepthChannel::None;
        let request = TraceRequest { rgb: true, depth, sh_degree: None };
        let trace = trace(&gaussians, &self.view, &self.settings, request).map_err(failed)?;
        let out = self.picture(&trace);
        if self.mask != (GradMask { sh_direction: true, ..GradMask::none() }) {
            *self.drawn.lock().unwrap_or_else(PoisonError::into_inner) = Some((gaussians, trace));
        }
        Ok(out)
    }
    fn backward(&self, _: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let (geometry, sh) = self.gradients_of_rows(grad)?;
        Ok(vec![geometry, sh])
    }
}
