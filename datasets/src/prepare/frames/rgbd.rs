//! Plain RGB-D sequences, as the tools of 3DMatch and of TSDF fusion read them.

use super::files::{DepthOf, Kind, PICTURES, SeparateFiles, paired};
use super::frame::Listed;
use super::text::lens_file;
use crate::DataError;
use std::path::Path;

pub(super) fn open(folder: &Path) -> Result<Listed, DataError> {
    let lens = lens_file(&folder.join("camera-intrinsics.txt"))?;
    let endings = PICTURES.map(|ending| format!(".color{ending}"));
    let endings: Vec<&str> = endings.iter().map(String::as_str).collect();
    let kinds = [&endings[..], &[".depth.png"], &[".pose.txt"]];
    let kinds = kinds.map(|endings| Kind(folder.to_owned(), "frame-", endings));
    let list = paired(kinds, |key| format!("frame-{key}"), lens)?;
    // Depth and color are registered, or nothing says how they are not.
    let files = SeparateFiles { list, depth: DepthOf::Png(1000.0), depth_lens: None };
    Ok(Listed { files: Box::new(files), notes: Vec::new() })
}
