//! Folders that trainers write, with a PLY file of each iteration that was saved.
//!
//! The original trainer and those made from it: `point_cloud/iteration_30000/point_cloud.ply`. gsplat's:
//! `ply/point_cloud_29999.ply`.

use crate::SceneError;
use std::path::{Path, PathBuf};

/// A scene that was saved during training.
struct Saved {
    iteration: u64,
    /// Below the folder that was given.
    name: PathBuf,
}

/// The newest scene of a folder of training results, and which it is; `None` if there is none. The
/// folder may be the whole output, its `point_cloud`, or one iteration.
///
/// # Errors
/// If a folder cannot be listed.
pub(super) fn newest_scene(folder: &Path) -> Result<Option<(PathBuf, String)>, SceneError> {
    let one = Path::new("point_cloud.ply");
    if folder.join(one).is_file() {
        return Ok(Some((folder.join(one), format!("opened {}", one.display()))));
    }
    let mut saved = Vec::new();
    for below in ["point_cloud", ""] {
        let inside = |name: &str| Path::new(below).join(name).join(one);
        saved.extend(numbered(folder, below, "iteration_", "", inside)?);
    }
    saved.extend(numbered(folder, "ply", "point_cloud_", ".ply", |name| {
        Path::new("ply").join(name)
    })?);
    saved.sort_by_key(|scene| scene.iteration);
    let Some(newest) = saved.last() else { return Ok(None) };
    let name = newest.name.display();
    let note = match saved.as_slice() {
        [_] => format!("opened {name}, the only iteration"),
        all => {
            let list: Vec<String> = all.iter().map(|s| s.iteration.to_string()).collect();
            format!("opened {name}, the newest of the iterations {}", list.join(", "))
        }
    };
    Ok(Some((folder.join(&newest.name), note)))
}

/// The scenes of entries called `prefix`, a number and `suffix` in `folder/below`; of an entry of that
/// name, `scene` is the file.
fn numbered(
    folder: &Path,
    below: &str,
    prefix: &str,
    suffix: &str,
    scene: impl Fn(&str) -> PathBuf,
) -> Result<Vec<Saved>, SceneError> {
    let listed = folder.join(below);
    let mut saved = Vec::new();
    if !listed.is_dir() {
        return Ok(saved);
    }
    let failed = || SceneError::io(&listed, "cannot list the folder");
    for entry in std::fs::read_dir(&listed).map_err(failed())? {
        let entry = entry.map_err(failed())?.file_name();
        let Some(entry) = entry.to_str() else { continue };
        let number = entry.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(suffix));
        let Some(iteration) = number.and_then(|digits| digits.parse().ok()) else { continue };
        let name = scene(entry);
        // An iteration that was never saved to its end has no file.
        if folder.join(&name).is_file() {
            saved.push(Saved { iteration, name });
        }
    }
    Ok(saved)
}
