//! InteriorGS: a made interior as Gaussians, with boxes around its things; a Gaussian has the name of the smallest box
//! its center is in.

use super::super::scan::{Names, ScanPoints, items, read_json};
use super::boxes::{Box3, label};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::formats::{ReadOptions, open_scene};
use scenesplat_scene::vector::{cross, dot};
use serde_json::Value;
use std::path::Path;

/// What a box is grown by on each side, meters: it touches its thing, whose Gaussians lie about the surface.
const MARGIN: f64 = 0.01;
/// How far corners may be from those of a box, relative to its longest edge.
const SKEW: f64 = 1e-3;

pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let scene = open_scene(&folder.join("3dgs_compressed.ply"), &ReadOptions::default())?.scene;
    let path = folder.join("labels.json");
    let json = read_json(&path)?;
    let mut names = Names::default();
    let mut boxes = Vec::new();
    // A list, or an object with a list.
    let wrapped = Value::Object([("labels".to_owned(), json.clone())].into_iter().collect());
    let json = if json.is_array() { wrapped } else { json };
    for item in items(&path, &json, "labels")? {
        let name = item.text("label")?.trim().to_owned();
        let corners = corners(item.value).ok_or_else(|| {
            item.lacks("bounding_box of eight corners, each with finite numbers x, y and z")
        })?;
        let Some((center, half, axes)) = edges(&corners) else {
            let problem =
                format!("the corners of {name:?} ({}) are not those of a box", boxes.len());
            return Err(bad_file(&path, problem, "the file is damaged, fetch it again"));
        };
        let half = half.map(|h| h + MARGIN);
        boxes.push(Box3 { center, half, axes, name: names.number(&name) });
    }
    // Boxes are in the coordinates of the file.
    let place = |p: &[f32; 3]| [0, 1, 2].map(|k| (f64::from(p[k]) + scene.origin[k]) as f32);
    let coord: Vec<[f32; 3]> = scene.coord.iter().map(place).collect();
    let (raw, instance) = label(&coord, &boxes);
    Ok(ScanPoints { coord, normal: scene.normal, raw, names: names.list, instance })
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] - b[k])
}

/// The eight corners of `bounding_box`.
fn corners(item: &Value) -> Option<[[f64; 3]; 8]> {
    let list = item.get("bounding_box")?.as_array()?;
    let corner = |value: &Value| -> Option<[f64; 3]> {
        let [x, y, z] = ["x", "y", "z"].map(|axis| value.get(axis)?.as_f64());
        Some([x?, y?, z?]).filter(|p| p.iter().all(|v| v.is_finite()))
    };
    let all: Option<Vec<[f64; 3]>> = list.iter().map(corner).collect();
    all?.try_into().ok()
}

type Edges = ([f64; 3], [f64; 3], [[f64; 3]; 3]);

/// Center, half lengths and unit directions of a box whose corners are in any order; `None` if they are no box's.
///
/// Of all corners beside the first the nearest two end edges, and of the rest the nearest that is not across the face
/// of these two ends the third.
fn edges(corners: &[[f64; 3]; 8]) -> Option<Edges> {
    let mut away: Vec<[f64; 3]> = corners[1..].iter().map(|c| sub(*c, corners[0])).collect();
    away.sort_by(|a, b| dot(*a, *a).total_cmp(&dot(*b, *b)));
    let plus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] + b[k]);
    let apart = |a: [f64; 3], b: [f64; 3]| dot(sub(a, b), sub(a, b)).sqrt();
    let near = SKEW * dot(away[6], away[6]).sqrt();
    let (a, b) = (away[0], away[1]);
    let c = if apart(away[2], plus(a, b)) <= near { away[3] } else { away[2] };
    let mut want = [a, b, c, plus(a, b), plus(a, c), plus(b, c), plus(plus(a, b), c)].to_vec();
    for corner in &away {
        let at = want.iter().position(|w| apart(*w, *corner) <= near)?;
        want.swap_remove(at);
    }
    let edges = [a, b, c];
    let lengths = edges.map(|e| dot(e, e).sqrt());
    // Of a flat box one edge has no length: it lies across the other two, and a direction is needed for its margin.
    let mut axes = [0, 1, 2].map(|i| edges[i].map(|v| v / lengths[i]));
    let flat: Vec<usize> = (0..3).filter(|i| lengths[*i] <= near).collect();
    match flat[..] {
        [] => {}
        [i] => axes[i] = cross(axes[(i + 1) % 3], axes[(i + 2) % 3]),
        _ => return None,
    }
    let square = (0..3).all(|i| dot(axes[i], axes[(i + 1) % 3]).abs() <= 10.0 * SKEW);
    let center = [0, 1, 2].map(|k| corners[0][k] + (a[k] + b[k] + c[k]) / 2.0);
    square.then_some((center, lengths.map(|l| l / 2.0), axes))
}
