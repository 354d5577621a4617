//! Files that belong to cameras: photos, depths, masks, maps of segments.
//!
//! The one place that says which file of a folder is whose:
//!
//! - A file fits a camera if its name is the camera's, or is that without its ending: `a.jpg` has `a.png`, `A.JPG` has
//!   `A.jpeg`, COLMAP's `a.jpg.png` is for `a.jpg`, Blender's `./train/r_0` has `train/r_0.png`. If several do, the
//!   name as it is comes first, then the order of the endings that are looked for. Where nothing else fits, `a.v2.jpg`
//!   also has `a.png`.
//! - Folders in a camera's name are folders below the folder that is searched, or those on the way to it. As many
//!   leading ones are left out of every name as give most cameras a file; of equal numbers the smallest. If the
//!   searched folder is called as what is left out of some names, cameras of other folders have no file in it.
//! - Folders that no camera names are searched only where nothing is found otherwise.
//! - A file that two cameras of different names mean, and a camera that two files in different folders fit, are
//!   errors: equal names in two folders are never confused.

mod listing;
mod matching;
mod names;

pub use listing::FrameFiles;
pub use matching::FoundFiles;
pub use names::{frame_name, frame_names, without_ending};

/// Endings of pictures, in the order in which they are looked for.
pub const PICTURES: &[&str] = &[".png", ".jpg", ".jpeg"];
/// Endings of depths.
pub const DEPTHS: &[&str] = &[".npy", ".png"];
/// Endings of pictures whose values are exact: maps of ids.
pub const EXACT_PICTURES: &[&str] = &[".png"];

#[cfg(test)]
mod tests;
