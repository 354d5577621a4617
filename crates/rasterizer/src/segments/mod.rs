//! Segments of pictures and their features, from files that any segmenter can write.
//!
//! Two layouts of a folder, told apart by its names; `<frame>` is the picture's file name without
//! its ending, found by the rule of [all files of cameras](scenesplat_scene::frame_files):
//!
//! | files | what they hold |
//! |---|---|
//! | `<frame>_s.npy`, `<frame>_f.npy` | ids `[L, H, W]` or `[H, W]` of any number type, −1 = none, L ≤ 4 granularities; features `[S, D]`, f16 to f64, of all of them together (LangSplat, Occam's LGS) |
//! | `<frame>.png` and `<frame>.npy` or `<frame>.safetensors`, or `features.npy` or `features.safetensors` for all | ids in a gray PNG, or the indices of one with a palette; 255, or of 16 bits 65535, = none; features `[S, D]` |
//!
//! An id is a row of the feature table, counted from 0. Where a map is smaller or larger than its
//! camera's picture but of its shape, each pixel of the picture takes the id its center falls on.

mod feature_table;
mod folder;
mod id_map;
mod langsplat;

pub use folder::{CameraMatches, FrameSegments, SegmentFolder, SegmentLayout, SegmentOptions};
pub use id_map::read_ids;
