//! Language features, labels and queries for scenes of 3D Gaussians, on a plain CPU.
//!
//! The crates behind this facade: [`scene`] (scenes and their files), [`kernels`] (algorithms on
//! slices), [`datasets`] (from scenes to network input), [`models`] (networks and weights),
//! [`metrics`] (labels, votes, evaluation, pictures), [`rasterizer`] (pictures of scenes), [`optimisation`] (scenes from pictures), [`collection`] (features of the segments of pictures), [`trainers`]
//! (optimizers and schedules), [`rooms`] (synthetic rooms), [`objects`] (instances and boxes), [`phrases`] (phrases as vectors and as classes). This crate adds
//! what joins them: [`Network`] (a configuration with its weights), [`SceneEncoder`] (a scene in,
//! features out), [`labels`], [`query`], [`evaluation`], [`experiment`], [`page`] (a scene to look at in a browser) and what the commands write.
//!
//! ```
//! use scenesplat::embedded;
//! use scenesplat::prelude::*;
//! use scenesplat::rooms::{SyntheticRoomSettings, generate};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let room = generate(&SyntheticRoomSettings::with_count(500, 1))?;
//! // The network that comes with the program: it knows furnished rooms.
//! let network = Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
//! let features = SceneEncoder::new(&network).encode(&room.scene, &mut |_| Ok(()))?;
//! assert_eq!(features.width(), embedded::vocabulary()?.dim());
//! assert_eq!(features.tensor(0..2)?.dims(), [2, features.width()]);
//! let first = features.gaussian_rows(0..1)?;
//! assert!((first.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
//! # Ok(())
//! # }
//! ```

#[cfg(not(target_family = "wasm"))]
pub mod adaptation;
pub mod alignment;
pub mod calibration;
mod cholesky;
pub mod device;
pub mod effect_costs;
pub mod embedded;
pub mod evaluation;
#[cfg(not(target_family = "wasm"))]
pub mod experiment;
pub mod familiarity;
#[cfg(not(target_family = "wasm"))]
pub mod feature_codes;
pub mod inference;
pub mod input;
pub mod inspect;
pub mod labels;
pub mod language_codes;
pub mod lifted;
pub mod machine;
pub mod memory;
pub mod network;
mod object_picture;
pub mod outputs;
pub mod page;
pub mod page_kit;
#[cfg(not(target_family = "wasm"))]
pub mod picture_networks;
pub mod preview;
pub mod principal;
#[cfg(not(target_family = "wasm"))]
pub mod probe;
pub mod query;
pub mod recognition;
#[cfg(not(target_family = "wasm"))]
pub mod reconstruction;
pub mod setting;
pub mod shipped;
pub mod taught;
pub mod text;
#[cfg(not(target_family = "wasm"))]
pub mod text_model;
pub mod yardsticks;

pub use alignment::{Alignment, AlignmentSettings};
pub use inference::{EncodeError, SceneEncoder, SceneFeatures};
pub use network::{Network, NetworkConfig, NetworkOutput, WeightOptions, Weights};
pub use object_picture::object_picture;
#[cfg(not(target_family = "wasm"))]
pub use scenesplat_collection as collection;
pub use scenesplat_datasets as datasets;
pub use scenesplat_kernels as kernels;
#[cfg(not(target_family = "wasm"))]
pub use scenesplat_losses as losses;
pub use scenesplat_metrics as metrics;
pub use scenesplat_models as models;
pub use scenesplat_objects as objects;
#[cfg(not(target_family = "wasm"))]
pub use scenesplat_optimisation as optimisation;
pub use scenesplat_rasterizer as rasterizer;
pub use scenesplat_rooms as rooms;
pub use scenesplat_scene as scene;
pub use scenesplat_text as phrases;
#[cfg(not(target_family = "wasm"))]
pub use scenesplat_trainers as trainers;
#[cfg(not(target_family = "wasm"))]
pub use scenesplat_vision as vision;
pub use setting::{Setting, SettingError};

/// The types that nearly every program needs.
pub mod prelude {
    pub use crate::datasets::{
        self, DataError, DataSource, SceneDataset, SceneLoader, SourceScene, build_transforms,
        transforms,
    };
    #[cfg(not(target_family = "wasm"))]
    pub use crate::losses::{self, CrossEntropy, Loss, LossInput, Objective};
    pub use crate::metrics::Measurement;
    #[cfg(not(target_family = "wasm"))]
    pub use crate::models::ops::{DepthChannel, GaussianTensors, rasterize};
    pub use crate::models::{Backbone, Forward, ModelConfig, ParamStore, PointTransformerV3Config};
    pub use crate::rasterizer::{Gaussians, RasterSettings, View};
    pub use crate::scene::{GaussianScene, LookAt, ReadOptions, RepairReport, Up, open_scene};
    pub use crate::text::read_text_table;
    #[cfg(not(target_family = "wasm"))]
    pub use crate::trainers::{
        self, AdamW, Callback, DataModule, Evaluator, Event, Flow, OneCycle, Progress, TrainError,
        Trainer, TrainerConfig, TrainingModule, group_by_keyword, tasks,
    };
    pub use crate::{
        Network, NetworkConfig, NetworkOutput, SceneEncoder, SceneFeatures, WeightOptions, Weights,
    };
    pub use candle_core::{Device, Tensor, Var};
}
