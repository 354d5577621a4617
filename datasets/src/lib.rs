//! From scenes to network input: where scenes come from ([`source`], [`generated_room`],
//! [`from_points`]), what the network reads of them ([`input_features`]), in which voxels
//! ([`plan`]), in which pieces ([`tiles`]) and how pieces are joined ([`batch`]).
//!
//! Plain arrays: no tensor library, no device. Everything is a function of its arguments and a
//! seed; the number of threads never changes a result.

pub mod batch;
pub mod error;
pub mod from_points;
pub mod generated_room;
pub mod input_features;
pub mod plan;
pub mod rng;
pub mod source;
pub mod synthetic;
pub mod tiles;

pub use batch::{Batch, collate};
pub use error::DataError;
pub use from_points::{PointCloud, PointSettings, estimate_normals, gaussians_from_points};
pub use generated_room::{GeneratedRoom, RoomSettings, generate_room};
pub use input_features::{InputChannel, InputFeatures};
pub use plan::{ExactPlan, FastPlan, InferencePlan, NetworkInput, Representative, SlotMean};
pub use rng::{SampleRng, sample_rng};
pub use source::{DataSource, GeneratedRooms, SceneFolder, SourceScene};
pub use synthetic::{SyntheticObject, SyntheticRoom, SyntheticRoomSettings, SyntheticRooms};
pub use tiles::{Tile, TileSettings, Tiling, split_into_tiles};
