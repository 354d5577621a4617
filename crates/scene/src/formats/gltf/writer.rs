//! Writing binary glTF with `KHR_gaussian_splatting`.

use super::container::glb_head;
use crate::AtomicFile;
use crate::bounds::bounding_box;
use crate::formats::limit_tally::Limits;
use crate::formats::packed_values::{
    ALPHA_ENDS, SIZE_CUT, SIZE_VANISHES, alpha_code, canonical_quat, scale_code, tally_alpha,
    tally_sizes,
};
use crate::formats::{WriteOptions, WriteProgress, WriteReport};
use crate::spherical_harmonics::ShRotation;
use crate::{Frame, GaussianScene, SceneError, Similarity};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::io::Write;

/// Numbers that are encoded before they are handed to the file: 4 MiB.
const NUMBERS_PER_WRITE: usize = 1 << 20;
/// Code of f32 in glTF.
const FLOAT: u32 = 5126;

/// Writes the numbers of a row of a scene.
type RowValues = Box<dyn Fn(&GaussianScene, usize, &mut [f32]) + Sync>;

/// What glTF calls vectors of one number and more.
const SHAPES: [&str; 4] = ["SCALAR", "VEC2", "VEC3", "VEC4"];

/// One attribute of the Gaussians.
struct Attribute {
    name: String,
    /// 1 to 4.
    width: usize,
    /// The numbers of a row, `width` of them.
    value: RowValues,
}

impl Attribute {
    /// One of the extension.
    fn of_splats(
        part: &str,
        width: usize,
        value: impl Fn(&GaussianScene, usize, &mut [f32]) + Sync + 'static,
    ) -> Self {
        let name = format!("KHR_gaussian_splatting:{part}");
        Self { name, width, value: Box::new(value) }
    }
}

/// Writes a scene as a `.glb` file.
///
/// One primitive of points with f32 attributes, in glTF's frame ([`Frame::LUF`]): standard
/// deviations, quaternions `x, y, z, w`, opacities 0 to 1, and every band of harmonics. Positions,
/// harmonics and the signs of rotations change by signs only, and come back bit for bit; sizes and
/// opacities pass through an exponential of 32 bits. The origin of a scene that has one is the
/// translation of the node. Written again, a file that was written here is
/// the same.
///
/// # Errors
/// As [`write_scene`](super::super::write_scene); also if the file would exceed 4 GiB, which the
/// container cannot hold.
pub(in crate::formats) fn write_glb(
    scene: &GaussianScene,
    file: &AtomicFile,
    _options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let path = file.target();
    let attributes = attributes(scene);
    let rows = scene.len() as u64;
    let binary: u64 = attributes.iter().map(|a| 4 * a.width as u64 * rows).sum();
    let Some(head) = glb_head(&document(scene, &attributes, binary), binary) else {
        let problem = format!("would hold {binary} bytes and more, too many for a .glb file");
        let help = "cut harmonics, split the scene or choose another format";
        return Err(SceneError::format(path, problem, help));
    };
    let failed = |e| SceneError::io(path, "cannot write the scene")(e);
    file.file().write_all(&head).map_err(failed)?;
    let mut written = 0u64;
    for attribute in &attributes {
        let rows_at_once = (NUMBERS_PER_WRITE / attribute.width).max(1);
        for first in (0..scene.len()).step_by(rows_at_once) {
            let count = rows_at_once.min(scene.len() - first);
            let bytes = encode(scene, attribute, first, count);
            file.file().write_all(&bytes).map_err(failed)?;
            written += bytes.len() as u64;
            if !progress(written as f64 / binary as f64) {
                return Err(SceneError::Stopped);
            }
        }
    }
    note_limits(scene, report);
    Ok(())
}

/// The attributes in the order of the file. Both frames differ by signs only.
fn attributes(scene: &GaussianScene) -> Vec<Attribute> {
    let turn = Frame::CANONICAL.matrix_to(Frame::LUF);
    let [x, y, z] = [0, 1, 2].map(|i| turn[i][i] as f32);
    let mut out = vec![
        Attribute {
            name: "POSITION".to_owned(),
            width: 3,
            value: Box::new(move |scene, row, out| {
                let [a, b, c] = scene.coord[row];
                out.copy_from_slice(&[x * a, y * b, z * c]);
            }),
        },
        Attribute::of_splats("ROTATION", 4, move |scene, row, out| {
            let [w, a, b, c] = canonical_quat(scene.quat[row]);
            out.copy_from_slice(&[y * z * a, x * z * b, x * y * c, w]);
        }),
        Attribute::of_splats("SCALE", 3, |scene, row, out| {
            out.copy_from_slice(&scene.log_scale[row].map(scale_code));
        }),
        Attribute::of_splats("OPACITY", 1, |scene, row, out| {
            out[0] = alpha_code(scene.opacity_logit[row]);
        }),
        Attribute::of_splats("SH_DEGREE_0_COEF_0", 3, |scene, row, out| {
            out.copy_from_slice(&scene.sh_dc[row]);
        }),
    ];
    let bands = scene.sh_rest_len();
    let mut signs = vec![1.0f32; bands * 3];
    ShRotation::new(&turn).apply(&mut signs);
    let mut k = 0;
    for degree in 1..=usize::from(scene.sh_degree) {
        for coefficient in 0..2 * degree + 1 {
            let (at, sign) = (3 * k, signs[3 * k]);
            let part = format!("SH_DEGREE_{degree}_COEF_{coefficient}");
            out.push(Attribute::of_splats(&part, 3, move |scene, row, out| {
                let first = row * bands * 3 + at;
                for (out, value) in out.iter_mut().zip(&scene.sh_rest[first..first + 3]) {
                    *out = sign * value;
                }
            }));
            k += 1;
        }
    }
    out
}

/// Some rows of an attribute as bytes.
fn encode(scene: &GaussianScene, attribute: &Attribute, first: usize, count: usize) -> Vec<u8> {
    let width = attribute.width;
    let mut bytes = vec![0u8; 4 * width * count];
    bytes.par_chunks_mut(4 * width * 4096).enumerate().for_each(|(task, bytes)| {
        let mut row = [0.0f32; 4];
        for (i, bytes) in bytes.chunks_exact_mut(4 * width).enumerate() {
            (attribute.value)(scene, first + task * 4096 + i, &mut row[..width]);
            for (bytes, value) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(&row) {
                *bytes = value.to_le_bytes();
            }
        }
    });
    bytes
}

fn document(scene: &GaussianScene, attributes: &[Attribute], binary: u64) -> Value {
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), Map::new());
    let mut offset = 0u64;
    for (index, attribute) in attributes.iter().enumerate() {
        let length = 4 * attribute.width as u64 * scene.len() as u64;
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
        let mut accessor = json!({
            "bufferView": index,
            "componentType": FLOAT,
            "count": scene.len(),
            "type": SHAPES[attribute.width - 1],
        });
        if attribute.name == "POSITION" {
            // Prescribed for positions.
            let (low, high) = bounds(scene, attribute);
            accessor["min"] = json!(low);
            accessor["max"] = json!(high);
        }
        accessors.push(accessor);
        names.insert(attribute.name.clone(), Value::from(index));
        offset += length;
    }
    json!({
        "asset": { "version": "2.0", "generator": "scenesplat" },
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node(scene)],
        "meshes": [{ "primitives": [{
            "mode": 0,
            "attributes": names,
            "extensions": { "KHR_gaussian_splatting": {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "sortingMethod": "cameraDistance",
                "projection": "perspective",
            } },
        }] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": binary }],
    })
}

/// The node that shows the Gaussians; it brings a scene with an origin to its place.
fn node(scene: &GaussianScene) -> Value {
    if !scene.has_origin() {
        return json!({ "mesh": 0 });
    }
    let to_file = Similarity::between(Frame::CANONICAL, Frame::LUF);
    json!({ "mesh": 0, "translation": to_file.apply(scene.origin) })
}

fn bounds(scene: &GaussianScene, position: &Attribute) -> ([f32; 3], [f32; 3]) {
    bounding_box((0..scene.len()).map(|row| {
        let mut p = [0.0; 3];
        (position.value)(scene, row, &mut p);
        p
    }))
}

fn note_limits(scene: &GaussianScene, report: &mut WriteReport) {
    let Limits([mut large, mut small, mut ends]) = Limits::default();
    for row in 0..scene.len() {
        let sizes = scene.log_scale[row];
        tally_sizes(row, sizes, sizes.map(scale_code), &mut large, &mut small);
        let logit = scene.opacity_logit[row];
        let code = alpha_code(logit);
        tally_alpha(row, logit, code == 0.0 || code == 1.0, &mut ends);
    }
    report.limit("log_scale", SIZE_CUT, large);
    report.limit("log_scale", SIZE_VANISHES, small);
    report.limit("opacity_logit", ALPHA_ENDS, ends);
}
