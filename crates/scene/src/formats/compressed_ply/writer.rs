//! Writing compressed PLY files.

use super::chunk::{COLOR, Channel, POSITION, Packed, SCALE};
use super::code::{join_11_10_11, join_8888, pack_coefficient, pack_quat};
use super::order::{Tick, chunk_order};
use super::{BOUNDS, CHUNK, CHUNK_ROWS, COLOR_BOUNDS, PACKED, SH, VERTEX};
use crate::AtomicFile;
use crate::disk::write_all_at;
use crate::formats::inria_ply::comments;
use crate::formats::limit_tally::{LimitTally, Limits};
use crate::formats::packed_values::{ALPHA_ENDS, alpha, nearest_byte, tally_alpha};
use crate::formats::{WriteOptions, WriteProgress, WriteReport};
use crate::gaussian_scene::sh_rest_len;
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;

/// Logarithms of scales beyond ± this are cut, as in the reference.
const MAX_LOG_SCALE: f32 = 20.0;
/// DC terms beyond ± this are cut; their colors would not be numbers of f32 after rounding.
const MAX_DC: f32 = 1e30;
/// Coefficients beyond ± this are cut.
const MAX_REST: f32 = 4.0;
/// The highest degree that programs reading this format know.
const MAX_DEGREE: u8 = 3;

/// Bytes of the bounds of a chunk.
const CHUNK_BYTES: usize = (BOUNDS.len() + COLOR_BOUNDS.len()) * 4;
/// Bytes of a vertex.
const VERTEX_BYTES: usize = PACKED.len() * 4;
/// Chunks packed before they are handed to the file: a few ms of work.
const CHUNKS_PER_WRITE: usize = 128;

/// What the format cannot hold, as it is reported.
const LIMITS: [(&str, &str); 4] = [
    ("log_scale", "beyond ±20 (sizes of e±20 m), cut"),
    ("opacity_logit", ALPHA_ENDS),
    ("sh_dc", "beyond ±1e30, cut"),
    ("sh_rest", "coefficients beyond ±4 are cut"),
];

/// Writes a scene as a compressed PLY file.
///
/// Rows keep their order if those of a chunk are close together, else they are sorted along a
/// Morton curve; [`WriteReport::order`] then says how. A file that was written here comes back byte
/// for byte when it is read and written again.
///
/// Reported are logarithms of scales beyond ±20 (cut, −inf too), coefficients beyond ±4 (cut) or of
/// degree 4, which programs that read the format do not know (left out), and alphas that become 0
/// or 1.
///
/// # Errors
/// As [`write_scene`](crate::write_scene), which also looks for an old file; if a position, size,
/// rotation, opacity or color is not a number, or there are more than 2³² − 1 rows.
pub(in crate::formats) fn write_compressed_ply(
    scene: &GaussianScene,
    file: &AtomicFile,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let (rows, path) = (scene.len(), file.target());
    if u32::try_from(rows).is_err() {
        let problem = format!("would have {rows} rows, more than {}", u32::MAX);
        return Err(SceneError::format(path, problem, "split the scene"));
    }
    let mut tick = || if progress(0.0) { Ok(()) } else { Err(SceneError::Stopped) };
    let rounded =
        |order: Option<&[u32]>, tick: Tick<'_>| rounded_positions(&scene.coord, order, tick);
    let order = chunk_order(&scene.coord, rounded, &mut tick)?;
    let limits = Packer::new(scene, order.as_deref(), options).write(file, progress)?;
    report.limits(LIMITS, limits);
    if scene.sh_degree > MAX_DEGREE {
        report.left_out("sh_rest", "degree 4 has no place in this format, degree 3 is kept");
    }
    report.order = order;
    Ok(())
}

/// The row of the scene for a row of the file.
fn scene_row(order: Option<&[u32]>, row: usize) -> usize {
    order.map_or(row, |order| order[row] as usize)
}

/// Positions as they will be read from the file, in its order.
fn rounded_positions(
    coord: &[[f32; 3]],
    order: Option<&[u32]>,
    tick: Tick<'_>,
) -> Result<Vec<[f32; 3]>, SceneError> {
    const ROWS_PER_TICK: usize = CHUNKS_PER_WRITE * CHUNK_ROWS;
    let mut out = vec![[0.0; 3]; coord.len()];
    for (part, out) in out.chunks_mut(ROWS_PER_TICK).enumerate() {
        out.par_chunks_mut(CHUNK_ROWS).enumerate().for_each(|(chunk, out)| {
            let first = part * ROWS_PER_TICK + chunk * CHUNK_ROWS;
            for (axis, channel) in POSITION.into_iter().enumerate() {
                let value = |i| coord[scene_row(order, first + i)][axis];
                let values: Vec<f32> = (0..out.len()).map(value).collect();
                let packed = channel.pack(&values);
                for (out, code) in out.iter_mut().zip(packed.codes) {
                    out[axis] = channel.value(packed.min, packed.max, code);
                }
            }
        });
        tick()?;
    }
    Ok(out)
}

struct Packer<'a> {
    scene: &'a GaussianScene,
    comments: Vec<String>,
    order: Option<&'a [u32]>,
    /// Coefficients per channel in the file and in the scene.
    rest: usize,
    scene_rest: usize,
}

/// The parts of a chunk in the three elements of the file.
struct PackedChunk {
    bounds: [u8; CHUNK_BYTES],
    vertices: Vec<u8>,
    rest: Vec<u8>,
    limits: Limits<4>,
}

impl<'a> Packer<'a> {
    fn new(scene: &'a GaussianScene, order: Option<&'a [u32]>, options: &WriteOptions) -> Self {
        let rest = sh_rest_len(scene.sh_degree.min(MAX_DEGREE));
        let comments = comments(scene, options);
        Self { scene, comments, order, rest, scene_rest: scene.sh_rest_len() }
    }

    fn header(&self) -> String {
        let rows = self.scene.len();
        let mut text = "ply\nformat binary_little_endian 1.0\n".to_owned();
        self.comments.iter().for_each(|comment| text += &format!("comment {comment}\n"));
        let mut element = |name: &str, count: usize, ty: &str, properties: &[String]| {
            text += &format!("element {name} {count}\n");
            properties.iter().for_each(|name| text += &format!("property {ty} {name}\n"));
        };
        let owned = |names: &[&str]| names.iter().map(|&n| n.to_owned()).collect::<Vec<_>>();
        let bounds = [owned(&BOUNDS), owned(&COLOR_BOUNDS)].concat();
        element(CHUNK, rows.div_ceil(CHUNK_ROWS), "float", &bounds);
        element(VERTEX, rows, "uint", &owned(&PACKED));
        if self.rest > 0 {
            let names: Vec<String> = (0..3 * self.rest).map(|i| format!("f_rest_{i}")).collect();
            element(SH, rows, "uchar", &names);
        }
        text + "end_header\n"
    }

    fn write(
        &self,
        file: &AtomicFile,
        progress: WriteProgress<'_>,
    ) -> Result<Limits<4>, SceneError> {
        let rows = self.scene.len();
        let chunks = rows.div_ceil(CHUNK_ROWS);
        let header = self.header();
        let put = |bytes: &[u8], at: usize| {
            write_all_at(file.file(), bytes, at as u64)
                .map_err(SceneError::io(file.target(), "cannot write the scene"))
        };
        put(header.as_bytes(), 0)?;
        let vertices_at = header.len() + chunks * CHUNK_BYTES;
        let rest_at = vertices_at + rows * VERTEX_BYTES;
        let mut limits = Limits::default();
        let [mut bounds, mut vertices, mut rest] = [const { Vec::new() }; 3];
        for first in (0..chunks).step_by(CHUNKS_PER_WRITE) {
            let end = chunks.min(first + CHUNKS_PER_WRITE);
            let packed: Vec<PackedChunk> =
                (first..end).into_par_iter().map(|chunk| self.pack(chunk)).collect();
            for buffer in [&mut bounds, &mut vertices, &mut rest] {
                buffer.clear();
            }
            for chunk in packed {
                bounds.extend_from_slice(&chunk.bounds);
                vertices.extend_from_slice(&chunk.vertices);
                rest.extend_from_slice(&chunk.rest);
                limits = limits.merge(chunk.limits);
            }
            put(&bounds, header.len() + first * CHUNK_BYTES)?;
            put(&vertices, vertices_at + first * CHUNK_ROWS * VERTEX_BYTES)?;
            put(&rest, rest_at + first * CHUNK_ROWS * 3 * self.rest)?;
            if !progress(end as f64 / chunks as f64) {
                return Err(SceneError::Stopped);
            }
        }
        Ok(limits)
    }

    fn pack(&self, chunk: usize) -> PackedChunk {
        let scene = self.scene;
        let rows = chunk * CHUNK_ROWS..scene.len().min((chunk + 1) * CHUNK_ROWS);
        let rows: Vec<usize> = rows.map(|row| scene_row(self.order, row)).collect();
        let Limits([mut log_scale_cut, mut ends, mut color_cut, mut rest_cut]) = Limits::default();
        let coord: Vec<_> = rows.iter().map(|&row| scene.coord[row]).collect();
        let log_scale: Vec<_> = rows
            .iter()
            .map(|&row| cut(scene.log_scale[row], MAX_LOG_SCALE, row, &mut log_scale_cut))
            .collect();
        let sh_dc: Vec<_> =
            rows.iter().map(|&row| cut(scene.sh_dc[row], MAX_DC, row, &mut color_cut)).collect();
        let parts = [(POSITION, coord), (SCALE, log_scale), (COLOR, sh_dc)]
            .map(|(channels, values)| pack_channels(channels, &values));

        let mut bounds = [0; CHUNK_BYTES];
        let all = parts.iter().flat_map(|part| {
            part.iter().map(|packed| packed.min).chain(part.iter().map(|packed| packed.max))
        });
        for (bytes, bound) in bounds.as_chunks_mut::<4>().0.iter_mut().zip(all) {
            *bytes = bound.to_le_bytes();
        }
        let mut vertices = Vec::with_capacity(rows.len() * VERTEX_BYTES);
        let mut rest = Vec::with_capacity(rows.len() * 3 * self.rest);
        for (i, &row) in rows.iter().enumerate() {
            let [position, scale, [r, g, b]] =
                parts.each_ref().map(|part| part.each_ref().map(|packed| packed.codes[i]));
            let logit = scene.opacity_logit[row];
            let byte = nearest_byte(alpha(logit));
            tally_alpha(row, logit, matches!(byte, 0 | 255), &mut ends);
            for word in [
                join_11_10_11(position),
                pack_quat(scene.quat[row]),
                join_11_10_11(scale),
                join_8888([r, g, b, u32::from(byte)]),
            ] {
                vertices.extend_from_slice(&word.to_le_bytes());
            }
            self.pack_rest(row, &mut rest, &mut rest_cut);
        }
        let limits = Limits([log_scale_cut, ends, color_cut, rest_cut]);
        PackedChunk { bounds, vertices, rest, limits }
    }

    /// Appends the coefficients of a row, channel by channel.
    fn pack_rest(&self, row: usize, out: &mut Vec<u8>, limit: &mut LimitTally) {
        let width = 3 * self.scene_rest;
        let values = &self.scene.sh_rest[row * width..(row + 1) * width];
        let mut beyond = 0.0f32;
        for channel in 0..3 {
            for k in 0..self.rest {
                let value = values[3 * k + channel];
                beyond = beyond.max(value.abs() - MAX_REST);
                out.push(pack_coefficient(value));
            }
        }
        if beyond > 0.0 {
            limit.add(row, f64::from(beyond));
        }
    }
}

fn pack_channels(channels: [Channel; 3], values: &[[f32; 3]]) -> [Packed; 3] {
    std::array::from_fn(|i| {
        let values: Vec<f32> = values.iter().map(|v| v[i]).collect();
        channels[i].pack(&values)
    })
}

/// The values within ± `limit`; counts the row if one was not.
fn cut(values: [f32; 3], limit: f32, row: usize, tally: &mut LimitTally) -> [f32; 3] {
    let beyond = values.iter().map(|v| f64::from(v.abs()) - f64::from(limit)).fold(0.0, f64::max);
    if beyond > 0.0 {
        tally.add(row, beyond);
    }
    values.map(|v| v.clamp(-limit, limit))
}
