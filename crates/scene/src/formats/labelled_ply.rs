//! Labeled point clouds in PLY: what predictions are compared with.

use super::color_columns::{color_names, read_colors};
use super::label_column::{INSTANCE_RULES, SEGMENT_RULES, columns, read_labels};
use super::ply::{PlyElement, PlyFile};
use crate::extra_columns::{UnreadColumn, label_names};
use crate::gaussian_scene::retain_flagged;
use crate::place::{NO_ORIGIN, less, origin_note, plus};
use crate::value_policy::Rule;
use crate::{LabelledPoints, Policy, RepairReport, SceneError};
use rayon::prelude::*;
use std::path::Path;

const VERTEX: &str = "vertex";

/// Names a label column goes by, first come first served.
pub const LABEL_NAMES: [&str; 5] = ["label", "segment", "semantic", "class", "scalar_label"];
/// Names an instance column goes by.
const INSTANCE_NAMES: [&str; 3] = ["instance", "instance_id", "scalar_instance"];

/// Points with a class each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LabelledCloud {
    /// What was subtracted from all positions, in their units; zero for clouds near 0.
    pub origin: [f64; 3],
    /// Positions relative to `origin`, meters. `[M, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Normals as in the file. `[M, 3]`
    pub normal: Option<Vec<[f32; 3]>>,
    /// Red, green, blue. `[M, 3]`
    pub color: Option<Vec<[u8; 3]>>,
    /// Class index, `-1` = no label. `[M]`
    pub segment: Vec<i32>,
    /// Instance id, `-1` = none. `[M]`
    pub instance: Option<Vec<i32>>,
    /// Rows of the file that the points come from, ascending; `None` if all of them.
    pub kept_rows: Option<Vec<u32>>,
    /// What the file holds besides, which was not read.
    pub unread: Vec<UnreadColumn>,
}

impl LabelledCloud {
    /// The points as those of a scene with this origin.
    pub fn into_points(mut self, origin: [f64; 3]) -> LabelledPoints {
        if self.origin != origin {
            let moved = |p: &mut [f32; 3]| *p = less(plus(*p, self.origin), origin);
            self.coord.par_iter_mut().for_each(moved);
        }
        LabelledPoints { coord: self.coord, segment: Some(self.segment), instance: self.instance }
    }
}

/// Reads `x y z`, labels (the named column, or the first of [`LABEL_NAMES`]) and, if there, `nx ny nz`,
/// `red green blue` in any range, and `instance`.
///
/// Positions that are doubles far from 0 are kept relative to an origin. Negative labels and 65535 in 16-bit columns become -1. A
/// point without a finite position is left out and reported.
///
/// # Errors
/// If the file is no PLY file or lacks positions or labels, if it has no usable point, or, under
/// the strict policy, if anything had to be repaired.
pub fn read_labelled_ply(
    path: &Path,
    policy: Policy,
    label: Option<&str>,
) -> Result<(LabelledCloud, RepairReport), SceneError> {
    cloud_of(&PlyFile::open(path)?, policy, label)
}

/// As [`read_labelled_ply`], of a file that was opened already.
///
/// # Errors
/// As [`read_labelled_ply`].
pub fn cloud_of(
    file: &PlyFile,
    policy: Policy,
    label: Option<&str>,
) -> Result<(LabelledCloud, RepairReport), SceneError> {
    let path = file.path();
    let Some(vertex) = file.element(VERTEX) else {
        return Err(SceneError::format(path, "has no element vertex", ""));
    };
    let all = |names: [&str; 3]| names.iter().all(|name| vertex.has(name));
    if !all(["x", "y", "z"]) {
        return Err(SceneError::format(path, "its vertices have no position x, y, z", ""));
    }
    let named = label.filter(|name| vertex.has(name));
    let usual = || LABEL_NAMES.into_iter().find(|name| vertex.has(name));
    let Some(label) = (if label.is_some() { named } else { usual() }) else {
        let names = label.map_or_else(|| LABEL_NAMES.join(", "), str::to_owned);
        let problem = format!("its vertices have no labels ({names})");
        let help = match label_names(&columns(vertex)) {
            Some(names) => format!("those that look like labels: {names}"),
            None => "name the column of class indices `label`".to_owned(),
        };
        return Err(SceneError::format(path, problem, help));
    };
    let mut report = RepairReport { source_rows: vertex.count, ..RepairReport::default() };
    file.report_trailing(vertex.count, &mut report);
    let (coord, origin) = match file.far_positions(VERTEX)? {
        Some(far) => far,
        None => (file.rows_f32(VERTEX, ["x", "y", "z"])?, NO_ORIGIN),
    };
    report.notes.extend(origin_note(origin));
    let mut cloud = LabelledCloud {
        origin,
        coord,
        segment: read_labels(file, VERTEX, label, SEGMENT_RULES, &mut report)?,
        ..LabelledCloud::default()
    };
    if all(["nx", "ny", "nz"]) {
        cloud.normal = Some(file.rows_f32(VERTEX, ["nx", "ny", "nz"])?);
    }
    cloud.color = read_colors(file, vertex, &mut report)?.map(|colors| colors.bytes());
    if let Some(name) = INSTANCE_NAMES.into_iter().find(|name| vertex.has(name)) {
        let ids = read_labels(file, VERTEX, name, INSTANCE_RULES, &mut report)?;
        cloud.instance = Some(ids);
    }
    cloud.unread = unread(file, vertex, label)?;
    cloud.kept_rows = drop_unusable(&mut cloud, &mut report);
    report.enforce(policy, path)?;
    if cloud.coord.is_empty() {
        return Err(SceneError::format(path, "has no point with a position", ""));
    }
    Ok((cloud, report))
}

/// What the points have besides; the faces of a mesh go without saying.
fn unread(
    file: &PlyFile,
    vertex: &PlyElement,
    label: &str,
) -> Result<Vec<UnreadColumn>, SceneError> {
    let colors = color_names(vertex).unwrap_or_default();
    let instances = INSTANCE_NAMES.into_iter().find(|name| vertex.has(name));
    let is_read = |name: &str| {
        ["x", "y", "z", "nx", "ny", "nz"].contains(&name)
            || colors.contains(&name)
            || [Some(label), instances].contains(&Some(name))
    };
    Ok(file.unknown(vertex, is_read, &["face"], false)?.1)
}

/// Which points have a finite position; `None` if all have. Those without are reported.
pub(super) fn finite_points(coord: &[[f32; 3]], report: &mut RepairReport) -> Option<Vec<bool>> {
    let finite: Vec<bool> = coord.iter().map(|p| p.iter().all(|v| v.is_finite())).collect();
    let first = finite.iter().position(|&ok| !ok)?;
    let count = finite.iter().filter(|&&ok| !ok).count();
    report.add(Rule::PointNotFinite, count, first, &format!("{:?}", coord[first]));
    Some(finite)
}

/// Leaves out the points without a finite position; gives the rows that stay, if any was left out.
fn drop_unusable(cloud: &mut LabelledCloud, report: &mut RepairReport) -> Option<Vec<u32>> {
    let finite = finite_points(&cloud.coord, report)?;
    report.dropped_rows = finite.iter().filter(|&&ok| !ok).count();
    retain_flagged(&mut cloud.coord, &finite);
    retain_flagged(&mut cloud.segment, &finite);
    cloud.normal.iter_mut().for_each(|values| retain_flagged(values, &finite));
    cloud.color.iter_mut().for_each(|values| retain_flagged(values, &finite));
    cloud.instance.iter_mut().for_each(|values| retain_flagged(values, &finite));
    Some((0..finite.len() as u32).filter(|&row| finite[row as usize]).collect())
}
