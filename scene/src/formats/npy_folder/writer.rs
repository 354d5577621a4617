//! Writing the preprocessed scene.

use crate::formats::npy_writer::write_npy;
use crate::gaussian_scene::{probability_to_logit, sigmoid};
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;
use std::path::Path;

/// Stems of the files this format knows, but for labels.
const STEMS: [&str; 15] = [
    "coord",
    "color",
    "opacity",
    "scale",
    "quat",
    "normal",
    "lang_feat",
    "valid_feat_mask",
    "instance",
    "score",
    "lang_code",
    "lang_codebook_mean",
    "lang_codebook_axes",
    "pc_coord",
    "pc_instance",
];
/// Writes a scene as a folder of `.npy` files, with the names and types of the original
/// preprocessing; spherical harmonics beyond the DC term are not part of the format.
///
/// All files are written beside the folder first and then moved into it. With `overwrite`, files of
/// this format that an earlier scene left in the folder are replaced or removed; others are kept.
///
/// # Errors
/// If the arrays do not match, if the folder holds a scene and `overwrite` is false, or if a file
/// cannot be written.
pub fn write_npy_folder(
    scene: &GaussianScene,
    folder: &Path,
    overwrite: bool,
) -> Result<(), SceneError> {
    scene.check_rows()?;
    let stale = known_files(folder)?;
    if let (false, Some(file)) = (overwrite, stale.first()) {
        let problem = format!("already holds a scene ({})", file.to_string_lossy());
        return Err(SceneError::format(folder, problem, "choose an empty folder or overwrite it"));
    }
    let Some(name) = folder.file_name() else {
        return Err(SceneError::format(folder, "is not a folder name", ""));
    };
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.part", std::process::id()));
    let part = folder.with_file_name(hidden);
    let failed = || SceneError::io(folder, "cannot write the folder");
    std::fs::create_dir_all(&part).map_err(failed())?;
    let result = write_files(scene, &part).and_then(|()| {
        std::fs::create_dir_all(folder).map_err(failed())?;
        for file in &stale {
            std::fs::remove_file(folder.join(file)).map_err(failed())?;
        }
        for entry in std::fs::read_dir(&part).map_err(failed())? {
            let entry = entry.map_err(failed())?;
            std::fs::rename(entry.path(), folder.join(entry.file_name())).map_err(failed())?;
        }
        Ok(())
    });
    // Empty after success; after a failure nothing in it is of use.
    let _ = std::fs::remove_dir_all(&part);
    result
}

/// Files of this format in a folder, sorted; none if there is no such folder.
fn known_files(folder: &Path) -> Result<Vec<std::ffi::OsString>, SceneError> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let failed = || SceneError::io(folder, "cannot list the folder");
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed())? {
        let name = entry.map_err(failed())?.file_name();
        let stem = name.to_str().and_then(|name| name.strip_suffix(".npy")).unwrap_or_default();
        let labels = stem.starts_with("segment") || stem.starts_with("pc_segment");
        if labels || STEMS.contains(&stem) {
            found.push(name);
        }
    }
    found.sort();
    Ok(found)
}

fn write_files(scene: &GaussianScene, folder: &Path) -> Result<(), SceneError> {
    let n = scene.len();
    let file = |stem: &str| folder.join(format!("{stem}.npy"));
    write_npy(&file("coord"), &[n, 3], scene.coord.as_flattened())?;
    let color: Vec<[u8; 3]> = (0..n).into_par_iter().map(|row| scene.color_u8(row)).collect();
    write_npy(&file("color"), &[n, 3], color.as_flattened())?;
    let opacity = |row| settled(scene.opacity(row), |p| sigmoid(probability_to_logit(p)));
    let opacity: Vec<f32> = (0..n).into_par_iter().map(opacity).collect();
    write_npy(&file("opacity"), &[n], &opacity)?;
    let again = |s: f32| (f64::from(s).ln() as f32).exp();
    let scale = |row| scene.scale(row).map(|s| settled(s, again));
    let scale: Vec<[f32; 3]> = (0..n).into_par_iter().map(scale).collect();
    write_npy(&file("scale"), &[n, 3], scale.as_flattened())?;
    write_npy(&file("quat"), &[n, 4], scene.quat.as_flattened())?;
    if let Some(normal) = &scene.normal {
        write_npy(&file("normal"), &[n, 3], normal.as_flattened())?;
    }
    if let Some(segment) = &scene.segment {
        write_npy(&file("segment"), &[n], segment)?;
    }
    if let Some(instance) = &scene.instance {
        write_npy(&file("instance"), &[n], instance)?;
    }
    if let Some(score) = &scene.segment_score {
        write_npy(&file("score"), &[n], score)?;
    }
    if let Some(code) = &scene.lang_code {
        let (k, width) = (code.width(), code.codebook.feature_width());
        write_npy(&file("lang_code"), &[n, k], &code.values)?;
        write_npy(&file("lang_codebook_mean"), &[width], &code.codebook.mean)?;
        write_npy(&file("lang_codebook_axes"), &[k, width], &code.codebook.axes)?;
    }
    if let Some(feat) = &scene.lang_feat {
        write_npy(&file("lang_feat"), &[n, feat.dim], &feat.values)?;
    }
    if let Some(mask) = &scene.valid_feat_mask {
        let mask: Vec<i64> = mask.iter().map(|&v| i64::from(v)).collect();
        write_npy(&file("valid_feat_mask"), &[n], &mask)?;
    }
    if let Some(points) = &scene.labelled_points {
        let m = points.coord.len();
        write_npy(&file("pc_coord"), &[m, 3], points.coord.as_flattened())?;
        if let Some(segment) = &points.segment {
            write_npy(&file("pc_segment"), &[m], segment)?;
        }
        if let Some(instance) = &points.instance {
            write_npy(&file("pc_instance"), &[m], instance)?;
        }
    }
    Ok(())
}

/// A value that reading and writing leave as it is: `start` after as many rounds of `again` as it
/// takes, usually none.
///
/// Activated values and those before activation lie on different grids of f32, so the first round
/// trip may move a value by a unit in the last place; a file written from what was read must not.
fn settled(start: f32, again: impl Fn(f32) -> f32) -> f32 {
    let mut value = start;
    for _ in 0..32 {
        let next = again(value);
        if next == value || next.is_nan() {
            return value;
        }
        if again(next) == value {
            return value.min(next);
        }
        value = next;
    }
    value
}
