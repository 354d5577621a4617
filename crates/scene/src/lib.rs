//! What a scene of 3D Gaussians is, and its files.
//!
//! Plain arrays and structs: no tensor library, no network, no randomness without a seed. The
//! central type is [`GaussianScene`]; [`formats`] reads and writes it, [`edit`] changes it,
//! [`value_policy`] says what happens to bad values on the way in, [`label_set`] holds class names
//! and their text vectors.
//!
//! Not for: rendering, training, searching for neighbors.

mod asset;
pub mod atomic_file;
pub mod bounds;
pub mod camera;
pub mod class_map;
mod class_names;
mod disk;
pub mod edit;
pub mod error;
pub mod extra_columns;
pub mod floor;
pub mod folder_lock;
pub mod formats;
pub mod frame;
pub mod frame_files;
pub mod gaussian_scene;
pub mod input_file;
pub mod label_ids;
pub mod label_set;
pub mod language_code;
pub mod linear_light;
mod look_at;
pub mod picture;
mod place;
pub mod printable;
pub mod quantile;
pub mod quaternion;
pub mod similarity;
mod singular_values;
pub mod spherical_harmonics;
pub mod staged_folder;
pub mod text_table;
pub mod up;
pub mod value_policy;
pub mod vector;
pub mod whole_folder;

pub use asset::Asset;
pub use atomic_file::{AtomicFile, WriteError};
pub use bounds::{Bounds, raw_bounds, robust_bounds};
pub use camera::{Camera, Distortion};
pub use class_map::ClassMap;
pub use error::SceneError;
pub use extra_columns::{ExtraColumn, NumberType, UnreadColumn, label_names};
pub use floor::{FloorRow, Floors};
pub use folder_lock::FolderLock;
pub use formats::cameras::{CameraKind, CameraSet, SparsePoints, open_cameras};
pub use formats::{
    LoadedScene, ReadOptions, SceneFormat, SpzFrame, WriteOptions, WriteReport, open_scene,
    open_scene_bytes, write_scene,
};
pub use frame::Frame;
pub use gaussian_scene::{GaussianScene, LabelledPoints, LanguageFeatures};
pub use label_ids::{LabelBase, LabelIds, NumberedLabels};
pub use label_set::LabelSet;
pub use language_code::{LanguageCode, LanguageCodebook};
pub use look_at::LookAt;
pub use printable::{printable, printable_text};
pub use similarity::Similarity;
pub use staged_folder::StagedFolder;
pub use text_table::TextTable;
pub use up::{StatedUp, Up, UpEvidence, UpGuess, Walls, guess_up, squareness, up_of_cameras};
pub use value_policy::{Policy, RepairReport};
pub use whole_folder::WholeFolder;
