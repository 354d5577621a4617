//! ScanNet: a `.sens` file, or what its tool exports of one.

use super::files::{DepthOf, Kind, PICTURES, SeparateFiles, paired};
use super::frame::Listed;
use super::lens::IDENTITY;
use super::sens::{self, not_aligned};
use super::text::{lens_file, numbers};
use crate::DataError;
use crate::files::{bad_file, entries};
use std::path::Path;

pub(super) fn open(path: &Path) -> Result<Listed, DataError> {
    if path.is_file() {
        return sens::open(path);
    }
    if path.join("color").is_dir() {
        return exported(path);
    }
    let is_sens = |path: &Path| path.extension().is_some_and(|e| e == "sens");
    let found: Vec<_> = entries(path)?.into_iter().filter(|path| is_sens(path)).collect();
    match found.as_slice() {
        [one] => sens::open(one),
        [] => {
            let problem = "holds neither a .sens file nor a folder color";
            Err(bad_file(path, problem, "give the scan's .sens, or the folder it was exported to"))
        }
        [_, second, ..] => {
            let problem = format!("holds {} .sens files", found.len());
            Err(bad_file(path, problem, format!("give one of them, such as {}", second.display())))
        }
    }
}

/// `color/N.jpg`, `depth/N.png`, `pose/N.txt` and `intrinsic`.
fn exported(folder: &Path) -> Result<Listed, DataError> {
    let lenses = folder.join("intrinsic");
    let lens = lens_file(&lenses.join("intrinsic_color.txt"))?;
    let of_depth = lenses.join("intrinsic_depth.txt");
    let depth_lens = of_depth.is_file().then(|| lens_file(&of_depth)).transpose()?;
    let mut notes = Vec::new();
    for name in ["extrinsic_color.txt", "extrinsic_depth.txt"] {
        let path = lenses.join(name);
        if path.is_file() && numbers(&path)? != IDENTITY.as_flattened() {
            notes.push(not_aligned(name));
        }
    }
    let kind = |name: &str, endings| Kind(folder.join(name), "", endings);
    let kinds = [kind("color", &PICTURES), kind("depth", &[".png"]), kind("pose", &[".txt"])];
    let list = paired(kinds, str::to_owned, lens)?;
    let files = SeparateFiles { list, depth: DepthOf::Png(1000.0), depth_lens };
    Ok(Listed { files: Box::new(files), notes })
}
