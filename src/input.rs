//! What the commands read: a scene, or a labelled point cloud that becomes one.

use crate::outputs::OpenedScene;
use anyhow::Result;
use scenesplat_datasets::{PointSettings, SurfacePoints, gaussians_from_points};
use scenesplat_scene::formats::labelled_ply::{LABEL_NAMES, read_labelled_ply};
use scenesplat_scene::formats::ply::{PlyFile, is_ply};
use scenesplat_scene::{LoadedScene, ReadOptions, SceneFormat, open_scene};
use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;

/// Reads a scene in any format. The points of a labelled point cloud become discs as wide as their
/// spacing, and the text says so.
///
/// # Errors
/// As [`open_scene`]; also if the points cannot be turned into Gaussians.
pub fn open_input(path: &Path, options: &ReadOptions) -> Result<(OpenedScene, Option<String>)> {
    let label = options.segment.as_deref();
    if !labelled_cloud(path, label) {
        return Ok((OpenedScene { loaded: open_scene(path, options)?, converted: false }, None));
    }
    let (cloud, report) = read_labelled_ply(path, options.policy, label)?;
    let points = SurfacePoints {
        coord: cloud.coord,
        color: cloud.color,
        normal: cloud.normal,
        segment: Some(cloud.segment),
        instance: cloud.instance,
    };
    let converted = gaussians_from_points(&points, &PointSettings::default())?;
    let text = format!(
        "{}: a point cloud; its {} points became discs as wide as their spacing ({} normals \
         estimated, {} balls)",
        path.display(),
        points.coord.len(),
        converted.num_estimated_normals,
        converted.num_balls
    );
    let loaded = LoadedScene {
        scene: converted.scene,
        report,
        kept_rows: cloud.kept_rows,
        path: path.to_owned(),
        kind: SceneFormat::Ply,
    };
    Ok((OpenedScene { loaded, converted: true }, Some(text)))
}

/// What to call a scene: its file or folder; one that is described by a `meta.json` or
/// `lod-meta.json` goes by the folder.
pub fn scene_name(path: &Path) -> Option<&OsStr> {
    let name = path.file_name()?;
    let described = name == "meta.json" || name == "lod-meta.json";
    if described { path.parent()?.file_name().or(Some(name)) } else { Some(name) }
}

/// Whether a file is a labelled point cloud rather than splats. What cannot be read is none: it is
/// refused later, with everything that can be read.
fn labelled_cloud(path: &Path, label: Option<&str>) -> bool {
    // Asked before opening: to open a pipe would wait for someone to write into it.
    if !path.metadata().is_ok_and(|about| about.is_file()) {
        return false;
    }
    let mut head = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(16).read_to_end(&mut head));
    if read.is_err() || !is_ply(&head) {
        return false;
    }
    let Ok(ply) = PlyFile::open(path) else { return false };
    let Some(vertex) = ply.element("vertex") else { return false };
    let has = |names: &[&str]| names.iter().any(|n| vertex.has(n));
    vertex.has("x")
        && (has(&LABEL_NAMES) || label.is_some_and(|l| vertex.has(l)))
        && !has(&["scale_0", "f_dc_0", "opacity", "packed_position"])
}
