//! Networks on graphics processors of any maker, for inference: `Point Transformer V3` and `LitePT` with the kernels of
//! `scenesplat-gpu`.
//!
//! Configurations, parameters and results are those of the networks on the CPU; features agree with theirs to rounding.
//! Batch norms, and the linear layers behind convolutions where [`Compute::fold`](crate::Compute::fold) says so, are folded into the layer in
//! front. Weights are uploaded once; the commands of a scene are one buffer, whose result is read at its end. Attention and
//! MLPs run piece by piece, so that the widest rows never exist for a whole scene.

mod head;
mod layers;
mod litept;
mod point_transformer_v3;
mod scale;

use crate::{Backbone, BackboneConfig, ModelConfig};
use candle_core::{Result, bail};
use candle_nn::VarBuilder;
use head::Head;
use layers::Place;
use scenesplat_gpu::Gpu;
pub use scenesplat_gpu::ops::Stored;
use scenesplat_kernels::Precision;

/// An error of the device as candle's.
fn wrap(error: scenesplat_gpu::GpuError) -> candle_core::Error {
    candle_core::Error::wrap(error)
}

impl ModelConfig {
    /// Builds the network with its head on a graphics processor. It has no [observer](crate::Forward::observer): nothing is
    /// read before the end. `vb` gives frozen values on the CPU; rows and weights are
    /// stored as `stored` says, sums are f32.
    ///
    /// # Errors
    /// As [`build`](Self::build), if the architecture has no form for graphics processors, if the network is shortened in its
    /// last stage, or if the device has no room.
    pub fn build_on_gpu(
        &self,
        vb: VarBuilder<'_>,
        gpu: &Gpu,
        stored: Stored,
    ) -> Result<Box<dyn Backbone>> {
        self.check()?;
        let width = self.backbone.get().out_channels();
        let head = |place: &Place, vb: &VarBuilder<'_>| Head::new(place, self.head, width, vb);
        build(&self.backbone, head, vb, gpu, stored)
    }
}

impl BackboneConfig {
    /// As [`ModelConfig::build_on_gpu`], without anything behind the backbone.
    ///
    /// # Errors
    /// As there.
    pub fn build_on_gpu(
        &self,
        vb: VarBuilder<'_>,
        gpu: &Gpu,
        stored: Stored,
    ) -> Result<Box<dyn Backbone>> {
        self.get().check()?;
        let width = self.get().out_channels();
        build(self, |_, _| Ok(Head::none(width)), vb, gpu, stored)
    }
}

fn build(
    config: &BackboneConfig,
    head: impl FnOnce(&Place, &VarBuilder<'_>) -> Result<Head>,
    vb: VarBuilder<'_>,
    gpu: &Gpu,
    stored: Stored,
) -> Result<Box<dyn Backbone>> {
    if stored == Stored::F16 && !gpu.has_f16() {
        return Err(wrap(scenesplat_gpu::GpuError::NoF16(gpu.info().name.clone())));
    }
    let compute = config.get().compute();
    let asked = match stored {
        Stored::F32 => Precision::F32,
        Stored::F16 => Precision::F16,
    };
    if compute.precision != asked && compute.precision != Precision::F32 {
        bail!("precision {}: graphics processors compute in f32 and f16", compute.precision);
    }
    let place = Place { gpu: gpu.clone(), stored, compute };
    let head = head(&place, &vb)?;
    match config {
        BackboneConfig::PointTransformerV3(config) => {
            Ok(Box::new(point_transformer_v3::Network::new(config, place, head, vb)?))
        }
        BackboneConfig::LitePt(config) => {
            Ok(Box::new(litept::Network::new(config, place, head, vb)?))
        }
        other => bail!(
            "{} has no form for graphics processors; point_transformer_v3 and litept have",
            other.name()
        ),
    }
}
