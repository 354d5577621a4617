//! The benchmarks that the original's preprocessing knows, and anybody's folder.
//!
//! [`Benchmark`] is the table of what differs: which files hold the labels, which folders make a
//! split, which classes there are, which limits the original puts on values. [`SceneFolders`] reads
//! the scenes; [`SourceConfig`] is both in a configuration file.

mod benchmark;
pub(crate) mod class_lists;
mod config;
mod scene_folders;
mod synthetic_rooms;

pub use benchmark::{Benchmark, Split};
pub use class_lists::{
    HOLICITY_IDS, KITTI360_IDS, MATTERPORT21_NYU40_IDS, SCANNET20_NYU40_IDS, SCANNET200_IDS,
};
pub use config::{FolderConfig, SourceConfig, SyntheticRoomsConfig};
pub use scene_folders::{SceneFolders, SceneFoldersOptions};
pub use synthetic_rooms::{MAX_ROOMS, SyntheticRooms};
