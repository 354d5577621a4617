//! Networks on candle tensors: Point Transformer V3 for Gaussians, the two before it, and weights.
//!
//! A network is a plain struct built from a [`candle_nn::VarBuilder`]. Built from a
//! [`ParamStore`] that holds variables it trains: every operation has a gradient. Built from frozen
//! weights it is packed for inference: weights are rearranged once, neighboring operations are
//! fused, and asking for a gradient is an error rather than a silent zero.
//!
//! Mode, randomness and curve orders are arguments ([`Forward`]); nothing is hidden state.

#![allow(
    clippy::needless_pass_by_value,
    reason = "constructors take a VarBuilder by value, as candle's do"
)]

mod architecture;
pub mod autoencoder;
mod backbone;
mod compute;
pub mod convert;
mod device;
#[cfg(feature = "wgpu")]
pub mod gpu;
mod head;
pub mod layers;
mod levels;
pub mod litept;
mod lpips;
mod model_config;
mod multiply_adds;
mod neighborhood;
pub mod ops;
pub mod params;
pub mod peers;
mod point_cloud;
pub mod point_transformer_v1;
pub mod point_transformer_v2;
pub mod point_transformer_v3;
mod recompute;
mod row_order;
mod scoped;
pub mod self_supervised_heads;
mod shortcuts;
mod stages;
pub mod weights;

pub use architecture::{Architecture, BackboneConfig};
pub use backbone::{
    Backbone, BackboneCost, Calibrated, Forward, FrozenStatistics, Mode, Observer, Orders,
};
pub use compute::Compute;
#[cfg(feature = "emulation")]
pub use device::emulated::{is_emulated, on_emulated_device};
pub use device::{DeviceChoice, DeviceError, GpuName, OpenDevice, missing_kernels};
pub use head::Head;
pub use levels::{Level, LevelOptions, Levels, scene_means};
pub use litept::{LitePt, LitePtConfig, LitePtSize};
pub use lpips::{Lpips, LpipsNet};
pub use model_config::{ModelConfig, UniqueKeys};
pub use multiply_adds::MultiplyAdds;
pub use params::{LoadPolicy, LoadReport, MAX_VALUES, ParamStore};
pub use point_cloud::PointCloud;
pub use point_transformer_v1::{PointTransformerV1, PointTransformerV1Config};
pub use point_transformer_v2::{PointTransformerV2, PointTransformerV2Config};
pub use point_transformer_v3::{PointTransformerV3, PointTransformerV3Config};
pub use recompute::Recompute;
pub use shortcuts::{LastStage, Shortcuts};
