//! From scenes to network input: where scenes come from ([`source`], [`sources`], [`from_points`]),
//! what the network reads of them ([`input_features`]), in which voxels ([`plan`]) and in which
//! pieces ([`tiles`]).
//!
//! What captures do to scenes can be simulated ([`effects`]).
//!
//! For training: a [`dataset`] makes a [`sample`] of each scene, and a [`loader`] joins samples to
//! batches ([`train_batch`]), some of them mixed ([`mix3d`]), or seen in several [`views`]. Augmentation is made of [`transforms`]; a
//! [`teacher`] may say what is to be learned.
//!
//! Plain arrays: no tensor library, no device. Everything is a function of its arguments and a
//! seed; the number of threads never changes a result.

pub mod chunking;
pub mod dataset;
pub mod effects;
pub mod error;
mod files;
pub mod from_points;
pub mod full_scene;
pub mod input_features;
pub mod left_out;
pub mod limits;
pub mod loader;
pub mod masking;
pub mod mix3d;
pub mod plan;
pub mod prepare;
pub mod rng;
pub mod sample;
pub mod shard;
pub mod source;
pub mod sources;
pub mod teacher;
pub mod tiles;
pub mod train_batch;
pub mod transforms;
pub mod views;
pub mod weighted_mix;

pub use dataset::{Dataset, SceneDataset};
pub use effects::{Effect, EffectSet, Simulated, simulate};
pub use error::DataError;
pub use from_points::{PointSettings, SurfacePoints, estimate_normals, gaussians_from_points};
pub use full_scene::FullScene;
pub use input_features::{InputChannel, InputFeatures, Orientation};
pub use left_out::{LeftOut, RepairedScene};
pub use limits::{Amount, LimitedLoader, SomeScenes};
pub use loader::{BatchLoader, BatchPart, BrokenScenes, LoaderSettings, SceneLoader, SkippedScene};
pub use masking::{MaskShape, MaskWeight, Masked, Masking};
pub use mix3d::mix_pairs;
pub use plan::{
    Anchor, ExactPlan, FastPlan, InferencePlan, NetworkInput, Representative, SlotMean,
};
pub use rng::{SampleRng, sample_rng};
pub use sample::{Sample, Transform};
pub use shard::{Shard, ShardError};
pub use source::{DataSource, SourceScene};
pub use sources::{Benchmark, SceneFolders, SourceConfig, Split, SyntheticRooms};
pub use teacher::{SceneTeacher, TeacherRows, TeacherView};
pub use tiles::{Tile, TileSettings, Tiling, split_into_tiles};
pub use train_batch::{TrainBatch, collate_samples};
pub use transforms::{TransformConfig, build_transforms};
pub use views::{View, ViewKind, ViewSample};
pub use weighted_mix::{MixRule, WeightedMix};
