//! Reading compressed PLY files.

use super::code::{
    STEPS_8, STEPS_11_10_11, lerp, split_11_10_11, split_8888, unpack_coefficient, unpack_quat,
};
use super::{BOUNDS, CHUNK, CHUNK_ROWS, COLOR_BOUNDS, PACKED, SH, VERTEX};
use crate::formats::inria_ply::{rest_names, sh_degree};
use crate::formats::label_column::{read_instance, read_segment, segment_name};
use crate::formats::packed_values::{alpha_logits, dc_of};
use crate::formats::ply::{ByteRows, PlyElement, PlyFile};
use crate::formats::scene_blocks::{SceneBlock, fill_scene};
use crate::formats::{LoadedScene, ReadOptions, SceneFormat, semantics};
use crate::value_policy::Rule;
use crate::{ExtraColumn, RepairReport, SceneError, UnreadColumn};
use rayon::prelude::*;

/// Whether the vertices are packed.
pub fn is_compressed(file: &PlyFile) -> bool {
    file.element(VERTEX).is_some_and(|vertex| vertex.has("packed_position"))
}

/// Reads a scene from an open compressed PLY file.
///
/// Properties that were added to the vertices, `segment` or `label` and `instance`, are read too,
/// and so are the labels beside the file if there are any. Alpha 0 and 255 become the logits ±inf,
/// which is what they say.
///
/// # Errors
/// As [`open_scene`](crate::open_scene); also if chunks or coefficients do not match the vertices
/// in number.
pub fn read_compressed_ply(
    file: &PlyFile,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let (vertex, chunk) = elements(file)?;
    let mut report = RepairReport::default();
    file.report_trailing(vertex.count, &mut report);
    let segment = read_segment(file, vertex, options.segment.as_deref(), &mut report)?;
    let instance = read_instance(file, vertex, &mut report)?;

    let bounds = file.rows_f32(CHUNK, BOUNDS)?;
    let color_bounds = if COLOR_BOUNDS.iter().any(|name| chunk.has(name)) {
        file.rows_f32(CHUNK, COLOR_BOUNDS)?
    } else {
        vec![[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]; chunk.count]
    };
    let words = file.word_rows(VERTEX, PACKED)?;
    let rest = Rest::find(file, vertex.count, options.sh_rest)?;
    let width = rest.as_ref().map_or(0, |rest| rest.width);
    let logits = alpha_logits();
    let coefficients: [f32; 256] = std::array::from_fn(|byte| unpack_coefficient(byte as f32));
    let degree = rest.as_ref().map_or(0, |rest| rest.degree);
    let mut scene = fill_scene(vertex.count, degree, |block: SceneBlock<'_>| {
        for i in 0..block.coord.len() {
            let row = block.first_row + i;
            let [position, rotation, scale, color] = words.get(row);
            let bounds = &bounds[row / CHUNK_ROWS];
            block.coord[i] = within(bounds, 0, position);
            block.log_scale[i] = within(bounds, 6, scale);
            block.quat[i] = unpack_quat(rotation);
            let bounds = &color_bounds[row / CHUNK_ROWS];
            let [r, g, b, alpha] = split_8888(color);
            let t = [r, g, b].map(|code| f64::from(code) / STEPS_8);
            block.sh_dc[i] = [0, 1, 2].map(|i| dc_of(lerp(bounds[i], bounds[3 + i], t[i])));
            block.opacity_logit[i] = logits[alpha as usize];
            if let Some(Rest { bytes: Some(bytes), .. }) = &rest {
                let values = &mut block.sh_rest[i * width..(i + 1) * width];
                for (value, byte) in values.iter_mut().zip(bytes.get(row)) {
                    *value = coefficients[usize::from(byte)];
                }
            }
        }
    });
    if let Some(Rest { bytes: None, width, .. }) = rest {
        let names = rest_names(width);
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        scene.sh_rest = file.table_f32(SH, &names)?;
        scene.sh_rest.par_iter_mut().for_each(|value| *value = unpack_coefficient(*value));
    }
    scene.segment = segment;
    scene.instance = instance;
    let remarks = file.remarks(&mut report);
    scene.antialiased = remarks.antialiased.unwrap_or(false);
    let (extra, unread) = unknown(file, vertex, options)?;
    scene.extra = extra;
    if let Some(bytes) = file.file_bytes() {
        let (path, policy) = (file.path(), options.policy);
        semantics::read_sidecar(path, bytes, vertex.count, policy, &mut scene, &mut report)?;
    }
    let (policy, kind) = (options.policy, SceneFormat::CompressedPly);
    let loaded = LoadedScene::finish(scene, report, policy, file.path(), kind)?;
    Ok(LoadedScene { unread, ..loaded.with_remarks(&remarks) })
}

/// Columns beside the packed ones, kept or named.
fn unknown(
    file: &PlyFile,
    vertex: &PlyElement,
    options: &ReadOptions,
) -> Result<(Vec<ExtraColumn>, Vec<UnreadColumn>), SceneError> {
    let labels = segment_name(vertex, options.segment.as_deref());
    let is_read = |name: &str| PACKED.contains(&name) || Some(name) == labels || name == "instance";
    file.unknown(vertex, is_read, &[CHUNK, SH], options.extra)
}

fn bad(file: &PlyFile, problem: impl Into<String>) -> SceneError {
    SceneError::format(file.path(), problem, "export the scene again")
}

/// The vertices and the chunks, which fit each other in number.
fn elements(file: &PlyFile) -> Result<(&PlyElement, &PlyElement), SceneError> {
    let Some(vertex) = file.element(VERTEX) else {
        return Err(bad(file, "has no element vertex"));
    };
    let Some(chunk) = file.element(CHUNK) else {
        return Err(bad(file, "has packed vertices but no element chunk"));
    };
    if chunk.count < vertex.count.div_ceil(CHUNK_ROWS) {
        let problem = format!("has {} chunks for {} vertices", chunk.count, vertex.count);
        return Err(bad(file, problem));
    }
    Ok((vertex, chunk))
}

fn within(bounds: &[f32; 12], first: usize, word: u32) -> [f32; 3] {
    let codes = split_11_10_11(word);
    std::array::from_fn(|i| {
        let t = f64::from(codes[i]) / STEPS_11_10_11[i];
        lerp(bounds[first + i], bounds[first + 3 + i], t) as f32
    })
}

/// Where the coefficients beyond DC are.
struct Rest<'a> {
    degree: u8,
    /// Coefficients of a row, all channels.
    width: usize,
    /// `None` if they are not all stored as bytes.
    bytes: Option<ByteRows<'a>>,
}

impl<'a> Rest<'a> {
    /// `None` if there are none, or they are not wanted.
    fn find(file: &'a PlyFile, rows: usize, wanted: bool) -> Result<Option<Self>, SceneError> {
        let Some(sh) = file.element(SH) else { return Ok(None) };
        if sh.count != rows {
            let problem = format!("has {} rows of coefficients for {rows} vertices", sh.count);
            return Err(bad(file, problem));
        }
        let count = sh.properties.len();
        let Some(degree) = sh_degree(count) else {
            let rule = Rule::RestCount.about().bad_value;
            return Err(bad(file, format!("has {count} coefficients: {rule}")));
        };
        if degree == 0 || !wanted {
            return Ok(None);
        }
        let names = rest_names(count);
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let bytes = file.byte_rows(SH, &names)?;
        Ok(Some(Self { degree, width: count, bytes }))
    }
}
