//! Writing text layers.

use super::{
    ANTIALIASED, CODEBOOK_AXES, CODEBOOK_MEAN, DEGREE, HARMONICS, INSTANCE, LANG_CODE, SEGMENT,
    SEGMENT_SCORE, TYPE,
};
use crate::bounds::bounding_box;
use crate::formats::limit_tally::Limits;
use crate::formats::packed_values::{
    ALPHA_ENDS, SIZE_CUT, SIZE_VANISHES, alpha_code, canonical_quat, scale_code, tally_alpha,
    tally_sizes,
};
use crate::formats::{WriteOptions, WriteProgress, WriteReport};
use crate::frame::{Frame, Matrix3};
use crate::spherical_harmonics::ShRotation;
use crate::{AtomicFile, GaussianScene, SceneError, Similarity};
use rayon::prelude::*;
use std::fmt::Write as _;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Rows that one task makes text of.
const ROWS_PER_TASK: usize = 4096;
/// Tasks whose text is in memory at a time.
const TASKS_PER_WRITE: usize = 64;

/// Writes the text of a row.
type RowText<'a> = Box<dyn Fn(usize, &mut String) + Sync + 'a>;

/// An array of the prim.
struct Array<'a> {
    /// Type and name.
    name: String,
    /// What stands in parentheses behind it.
    about: String,
    rows: usize,
    text: RowText<'a>,
}

/// Writes a scene as a `.usda` file.
///
/// One prim, `/Scene`, in meters with y up ([`Frame::RUB`]): standard deviations, quaternions of norm 1, opacities 0 to 1 and
/// every band of harmonics, each number with as many digits as bring it back bit for bit; sizes and opacities pass through an
/// exponential of 32 bits. Classes, objects, scores and language codes are primvars. The origin of a scene that has one is the
/// translation of the prim. Written again, a file that was written here is the same.
///
/// # Errors
/// As [`write_scene`](super::super::write_scene).
pub(in crate::formats) fn write_usda(
    scene: &GaussianScene,
    file: &AtomicFile,
    _options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let mut out = BufWriter::new(file.file());
    write_layer(scene, &mut out, file.target(), progress)?;
    out.flush().map_err(SceneError::io(file.target(), "cannot write the scene"))?;
    note_limits(scene, report);
    Ok(())
}

/// Writes the text of a layer.
pub(super) fn write_layer(
    scene: &GaussianScene,
    out: &mut dyn Write,
    path: &Path,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let failed = |e| SceneError::io(path, "cannot write the scene")(e);
    let turn = Frame::CANONICAL.matrix_to(Frame::RUB);
    out.write_all(head(scene, &turn).as_bytes()).map_err(failed)?;
    let arrays = arrays(scene, &turn);
    let all: usize = arrays.iter().map(|array| array.rows).sum();
    let mut written = 0;
    for array in &arrays {
        write!(out, "    {} = [", array.name).map_err(failed)?;
        let firsts: Vec<usize> = (0..array.rows).step_by(ROWS_PER_TASK).collect();
        for firsts in firsts.chunks(TASKS_PER_WRITE) {
            let parts: Vec<String> = firsts
                .par_iter()
                .map(|&first| {
                    let mut text = String::new();
                    for row in first..(first + ROWS_PER_TASK).min(array.rows) {
                        text.push_str(if row == 0 { "" } else { ", " });
                        (array.text)(row, &mut text);
                    }
                    text
                })
                .collect();
            for part in parts {
                out.write_all(part.as_bytes()).map_err(failed)?;
            }
            written += (firsts.len() * ROWS_PER_TASK).min(array.rows);
            if !progress((written as f64 / all as f64).min(0.99)) {
                return Err(SceneError::Stopped);
            }
        }
        writeln!(out, "]{}", array.about).map_err(failed)?;
    }
    out.write_all(b"}\n").map_err(failed)
}

/// All that comes before the arrays.
fn head(scene: &GaussianScene, turn: &Matrix3) -> String {
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"Scene\"\n    doc = \"Gaussians, written by scenesplat\"\n    \
         metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef {TYPE} \"Scene\"\n{{\n"
    );
    let (low, high) = extent(scene, turn);
    text.push_str("    float3[] extent = [");
    tuple(&mut text, &low);
    text.push_str(", ");
    tuple(&mut text, &high);
    text.push_str("]\n");
    // Writing into a string does not fail.
    let _ = writeln!(text, "    uniform int {DEGREE} = {}", scene.sh_degree);
    if scene.antialiased {
        let _ = writeln!(text, "    custom uniform bool {ANTIALIASED} = 1");
    }
    if scene.has_origin() {
        let [x, y, z] = Similarity::between(Frame::CANONICAL, Frame::RUB).apply(scene.origin);
        let _ = writeln!(text, "    double3 xformOp:translate = ({x}, {y}, {z})");
        text.push_str("    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n");
    }
    text
}

/// The box around the Gaussians out to three standard deviations.
fn extent(scene: &GaussianScene, turn: &Matrix3) -> ([f32; 3], [f32; 3]) {
    let signs = [0, 1, 2].map(|i| turn[i][i] as f32);
    let end = |row: usize, side: f32| {
        let reach = scene.log_scale[row].map(scale_code).into_iter().fold(0.0, f32::max) * 3.0;
        let center = scene.coord[row];
        [0, 1, 2].map(|i| (signs[i] * center[i] + side * reach).clamp(f32::MIN, f32::MAX))
    };
    bounding_box((0..scene.len()).flat_map(|row| [end(row, -1.0), end(row, 1.0)]))
}

/// The arrays in the order of the file. Both frames differ by signs only.
fn arrays<'a>(scene: &'a GaussianScene, turn: &Matrix3) -> Vec<Array<'a>> {
    let mut all = shapes(scene, turn);
    all.extend(labels(scene));
    all
}

/// Where Gaussians lie and how they look.
fn shapes<'a>(scene: &'a GaussianScene, turn: &Matrix3) -> Vec<Array<'a>> {
    let rows = scene.len();
    let [x, y, z] = [0, 1, 2].map(|i| turn[i][i] as f32);
    let bands = scene.sh_rest_len();
    let mut signs = vec![1.0f32; bands * 3];
    ShRotation::new(turn).apply(&mut signs);
    let positions: RowText<'a> = Box::new(move |row, text| {
        let [a, b, c] = scene.coord[row];
        tuple(text, &[x * a, y * b, z * c]);
    });
    let orientations: RowText<'a> = Box::new(move |row, text| {
        let [w, a, b, c] = canonical_quat(scene.quat[row]);
        tuple(text, &[w, y * z * a, x * z * b, x * y * c]);
    });
    let scales: RowText<'a> =
        Box::new(|row, text| tuple(text, &scene.log_scale[row].map(scale_code)));
    let opacities: RowText<'a> =
        Box::new(|row, text| number(text, alpha_code(scene.opacity_logit[row])));
    let harmonics: RowText<'a> = Box::new(move |at, text| {
        let (row, k) = (at / (1 + bands), at % (1 + bands));
        match k.checked_sub(1) {
            None => tuple(text, &scene.sh_dc[row]),
            Some(k) => {
                let first = (row * bands + k) * 3;
                tuple(text, &[0, 1, 2].map(|i| signs[3 * k] * scene.sh_rest[first + i]));
            }
        }
    });
    let array =
        |name: &str, rows, text| Array { name: name.to_owned(), about: String::new(), rows, text };
    vec![
        array("point3f[] positions", rows, positions),
        array("quatf[] orientations", rows, orientations),
        array("float3[] scales", rows, scales),
        array("float[] opacities", rows, opacities),
        array(&format!("float3[] {HARMONICS}"), rows * (1 + bands), harmonics),
    ]
}

/// Classes, objects, scores and language codes, as far as there are any.
fn labels(scene: &GaussianScene) -> Vec<Array<'_>> {
    let rows = scene.len();
    let each = || " (\n        interpolation = \"vertex\"\n    )".to_owned();
    let mut all = Vec::new();
    for (name, values) in [(SEGMENT, &scene.segment), (INSTANCE, &scene.instance)] {
        if let Some(values) = values {
            let text: RowText<'_> = Box::new(|row, text| {
                // Negative means none, whichever negative it is.
                let _ = write!(text, "{}", values[row].max(-1));
            });
            all.push(Array { name: format!("int[] {name}"), about: each(), rows, text });
        }
    }
    if let Some(values) = &scene.segment_score {
        let text: RowText<'_> = Box::new(|row, text| number(text, values[row]));
        all.push(Array { name: format!("float[] {SEGMENT_SCORE}"), about: each(), rows, text });
    }
    if let Some(code) = &scene.lang_code {
        let k = code.width();
        let about =
            format!(" (\n        elementSize = {k}\n        interpolation = \"vertex\"\n    )");
        let text: RowText<'_> = Box::new(|at, text| number(text, code.values[at].to_f32()));
        let name = format!("half[] {LANG_CODE}");
        all.push(Array { name, about, rows: code.values.len(), text });
        for (name, values) in
            [(CODEBOOK_MEAN, &code.codebook.mean), (CODEBOOK_AXES, &code.codebook.axes)]
        {
            let text: RowText<'_> = Box::new(|at, text| number(text, values[at]));
            let name = format!("custom float[] {name}");
            all.push(Array { name, about: String::new(), rows: values.len(), text });
        }
    }
    all
}

fn tuple(text: &mut String, values: &[f32]) {
    for (i, value) in values.iter().enumerate() {
        text.push_str(if i == 0 { "(" } else { ", " });
        number(text, *value);
    }
    text.push(')');
}

/// A number that is read as itself.
fn number(text: &mut String, value: f32) {
    let size = value.abs();
    // Without an exponent, very small and very large ones would be long.
    let _ = match size == 0.0 || (1e-4..1e8).contains(&size) || !size.is_finite() {
        true => write!(text, "{value}"),
        false => write!(text, "{value:e}"),
    };
}

pub(super) fn note_limits(scene: &GaussianScene, report: &mut WriteReport) {
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
