//! Numbers and names in the text files of benchmarks.

use super::frame::SkipReason;
use super::lens::{Lens, Pose, pose_of};
use crate::DataError;
use crate::files::{bad_file, entries, name_of};
use scenesplat_scene::input_file::read_text_file;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

const DAMAGED: &str = "the file is damaged or of another layout: fetch it again";

/// A number; what C libraries write for NaN and infinity is one, too.
fn number(word: &str) -> Option<f64> {
    let lower = word.to_ascii_lowercase();
    let special = ["nan", "inf", "#in", "#qnan"].iter().any(|part| lower.contains(part));
    word.parse().ok().or(special.then_some(f64::NAN))
}

/// All numbers of a text; the error is the word that is none.
pub(super) fn numbers_of(text: &str) -> Result<Vec<f64>, String> {
    let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
    words.map(|word| number(word).ok_or_else(|| word.chars().take(40).collect())).collect()
}

/// The numbers of a file.
pub(super) fn numbers(path: &Path) -> Result<Vec<f64>, DataError> {
    let text = read_text_file(path)?;
    numbers_of(&text).map_err(|word| bad_file(path, format!("{word:?} is no number"), DAMAGED))
}

/// The camera-to-world matrix in a file, if the file is there.
pub(super) fn pose_file(path: &Path) -> Result<Result<Pose, SkipReason>, DataError> {
    if !path.is_file() {
        return Ok(Err(SkipReason::NoPose));
    }
    let values = numbers(path)?;
    match pose_of(&values) {
        Some(pose) => Ok(Ok(pose)),
        None => {
            let problem = format!("has {} numbers, a pose has 16", values.len());
            Err(bad_file(path, problem, DAMAGED))
        }
    }
}

/// The lens in a file of a matrix of 3 × 3 or 4 × 4 numbers.
pub(super) fn lens_file(path: &Path) -> Result<Lens, DataError> {
    let values = numbers(path)?;
    Lens::of_matrix(&values, None).ok_or_else(|| {
        let problem = format!("has {} numbers, a matrix of a lens has 9 or 16", values.len());
        bad_file(path, problem, DAMAGED)
    })
}

/// A file that a list names, which must be below a folder: lists come from elsewhere.
pub(super) fn below(folder: &Path, name: &str, list: &Path) -> Result<PathBuf, DataError> {
    let inside = |part| matches!(part, Component::Normal(_) | Component::CurDir);
    if name.is_empty() || !Path::new(name).components().all(inside) {
        let problem = format!("names the file {name:?}, which is not below its folder");
        return Err(bad_file(list, problem, "names of files are relative and without \"..\""));
    }
    Ok(folder.join(name))
}

/// Numbers sort as numbers, other names behind them.
pub(super) type Key = (u64, String);

/// Files of a folder by what is between a prefix and one of the endings in their names; the first ending wins.
pub(super) fn keyed(
    folder: &Path,
    prefix: &str,
    endings: &[&str],
) -> Result<BTreeMap<Key, PathBuf>, DataError> {
    let mut out = BTreeMap::new();
    let files = entries(folder)?;
    for ending in endings {
        for path in &files {
            let name = name_of(path);
            let Some(key) = name.strip_prefix(prefix).and_then(|n| n.strip_suffix(ending)) else {
                continue;
            };
            let key = (key.parse().unwrap_or(u64::MAX), key.to_owned());
            out.entry(key).or_insert_with(|| path.clone());
        }
    }
    Ok(out)
}

/// The name of a file without its ending.
pub(super) fn stem(name: &str) -> String {
    let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}
