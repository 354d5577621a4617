//! PLY files with packed integers in chunks of 256 Gaussians, as SuperSplat writes them.
//!
//! Bounds of positions, logarithms of scales and colours are stored per chunk; a Gaussian is four
//! 32-bit integers within them. Reading only: results are added to a copy of the file
//! ([`super::ply::write_ply_with_columns`]) or written as a plain PLY.

use super::inria_ply::{rest_names, sh_degree};
use super::label_column::{read_instance, read_segment};
use super::ply::PlyFile;
use super::{LoadedScene, ReadOptions, SceneKind};
use crate::gaussian_scene::{GaussianScene, SH_C0, probability_to_logit};
use crate::value_policy::Rule;
use crate::{RepairReport, SceneError};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

const VERTEX: &str = "vertex";
const CHUNK: &str = "chunk";
const SH: &str = "sh";
const CHUNK_ROWS: usize = 256;

/// Bounds that every version of the format has.
const BOUNDS: [&str; 12] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
];
/// Bounds of colours; without them colours are 0 to 1.
const COLOR_BOUNDS: [&str; 6] = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Whether the vertices are packed.
pub fn is_compressed(file: &PlyFile) -> bool {
    file.element(VERTEX).is_some_and(|vertex| vertex.has("packed_position"))
}

/// Reads a scene from an open compressed PLY file.
///
/// Properties that were added to the vertices, `segment` or `label` and `instance`, are read too.
/// Alpha 0 and 255 become the logits ±inf, which is what they say.
///
/// # Errors
/// As [`super::open_scene`]; also if chunks or coefficients do not match the vertices in number.
pub fn read_compressed_ply(
    file: &PlyFile,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let bad = |problem: String| SceneError::format(file.path(), problem, "export the scene again");
    let Some(vertex) = file.element(VERTEX) else {
        return Err(bad("has no element vertex".to_owned()));
    };
    let Some(chunk) = file.element(CHUNK) else {
        return Err(bad("has packed vertices but no element chunk".to_owned()));
    };
    if chunk.count < vertex.count.div_ceil(CHUNK_ROWS) {
        return Err(bad(format!("has {} chunks for {} vertices", chunk.count, vertex.count)));
    }
    let mut report = RepairReport::default();
    if file.trailing_bytes() > 0 {
        let example = format!("{} bytes", file.trailing_bytes());
        report.add(Rule::FileTrailing, 1, vertex.count, &example);
    }
    let segment = read_segment(file, vertex, options.segment.as_deref(), &mut report)?;
    let instance = read_instance(file, vertex, &mut report)?;

    let bounds = file.rows_f32(CHUNK, BOUNDS)?;
    let color_bounds = if COLOR_BOUNDS.iter().any(|name| chunk.has(name)) {
        file.rows_f32(CHUNK, COLOR_BOUNDS)?
    } else {
        vec![[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]; chunk.count]
    };
    // A packed word is 32 bits whether the file calls it signed or not.
    let packed = |name| -> Result<Vec<u32>, SceneError> {
        Ok(file.column_i64(VERTEX, name)?.into_par_iter().map(|v| v as u32).collect())
    };
    let [position, rotation, scale, color] = PACKED.map(packed);
    let (position, rotation, scale, color) = (position?, rotation?, scale?, color?);
    let within = |packed: &[u32], first: usize| -> Vec<[f32; 3]> {
        let unpack = |(row, &word): (usize, &u32)| {
            let bounds = &bounds[row / CHUNK_ROWS];
            let t = unpack_11_10_11(word);
            [0, 1, 2].map(|i| lerp(bounds[first + i], bounds[first + 3 + i], t[i]))
        };
        packed.par_iter().enumerate().map(unpack).collect()
    };
    let coord = within(&position, 0);
    let log_scale = within(&scale, 6);
    let quat = rotation.par_iter().map(|&word| unpack_quat(word)).collect();
    let sh_dc = color
        .par_iter()
        .enumerate()
        .map(|(row, &word)| {
            let bounds = &color_bounds[row / CHUNK_ROWS];
            let t = [24, 16, 8].map(|shift| f64::from(word >> shift & 255) / 255.0);
            let color =
                |i: usize| f64::from(bounds[i]) * (1.0 - t[i]) + f64::from(bounds[3 + i]) * t[i];
            [0, 1, 2].map(|i| ((color(i) - 0.5) / f64::from(SH_C0)) as f32)
        })
        .collect();
    let alpha = |&word: &u32| probability_to_logit((word & 255) as f32 / 255.0);
    let opacity_logit = color.par_iter().map(alpha).collect();
    let (sh_degree, sh_rest) = read_rest(file, vertex.count, options.sh_rest)?;

    let scene = GaussianScene {
        coord,
        log_scale,
        quat,
        opacity_logit,
        sh_dc,
        sh_rest,
        sh_degree,
        segment,
        instance,
        ..GaussianScene::default()
    };
    LoadedScene::finish(scene, report, options.policy, file.path(), SceneKind::CompressedPly)
}

/// The degree and the coefficients, `[N, K, 3]` flattened.
fn read_rest(file: &PlyFile, rows: usize, wanted: bool) -> Result<(u8, Vec<f32>), SceneError> {
    let Some(sh) = file.element(SH) else { return Ok((0, Vec::new())) };
    let bad = |problem: String| SceneError::format(file.path(), problem, "export the scene again");
    if sh.count != rows {
        return Err(bad(format!("has {} rows of coefficients for {rows} vertices", sh.count)));
    }
    let count = sh.properties.len();
    let Some(degree) = sh_degree(count) else {
        return Err(bad(format!(
            "has {count} coefficients: {}",
            Rule::RestCount.about().bad_value
        )));
    };
    if degree == 0 || !wanted {
        return Ok((0, Vec::new()));
    }
    let names = rest_names(count);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut rest = file.table_f32(SH, &names)?;
    rest.par_iter_mut().for_each(|value| *value = unpack_coefficient(*value));
    Ok((degree, rest))
}

/// A byte to −4..4; the ends are exact, the others stand for the middle of their interval.
fn unpack_coefficient(byte: f32) -> f32 {
    let t = match byte {
        b if b <= 0.0 => 0.0,
        b if b >= 255.0 => 1.0,
        b => (b + 0.5) / 256.0,
    };
    (t - 0.5) * 8.0
}

fn unpack_11_10_11(word: u32) -> [f64; 3] {
    [
        f64::from(word >> 21) / 2047.0,
        f64::from(word >> 11 & 1023) / 1023.0,
        f64::from(word & 2047) / 2047.0,
    ]
}

fn lerp(min: f32, max: f32, t: f64) -> f32 {
    (f64::from(min) * (1.0 - t) + f64::from(max) * t) as f32
}

/// `w, x, y, z` from the index of the largest and the other three.
fn unpack_quat(word: u32) -> [f32; 4] {
    let largest = (word >> 30) as usize;
    let mut quat = [0.0f64; 4];
    let mut squared = 0.0;
    let mut shift = 20;
    for i in (0..4).filter(|&i| i != largest) {
        let value = (f64::from(word >> shift & 1023) / 1023.0 - 0.5) * SQRT_2;
        quat[i] = value;
        squared += value * value;
        shift = if shift == 20 { 10 } else { 0 };
    }
    quat[largest] = (1.0 - squared).max(0.0).sqrt();
    quat.map(|v| v as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_exact_at_both_ends() {
        assert_eq!(unpack_coefficient(0.0), -4.0);
        assert_eq!(unpack_coefficient(255.0), 4.0);
        assert_eq!(unpack_coefficient(128.0), (128.5 / 256.0 - 0.5) * 8.0);
    }

    #[test]
    fn the_largest_component_may_be_any() {
        // The other three at code 511 or 512 are within half a step of 0.
        for largest in 0..4u32 {
            let quat = unpack_quat(largest << 30 | 511 << 20 | 511 << 10 | 511);
            let expected = (1.0f64 - 3.0 * (SQRT_2 / 2046.0).powi(2)).sqrt() as f32;
            assert_eq!(quat[largest as usize], expected);
            assert!(quat.iter().filter(|v| v.abs() < 1e-3).count() == 3, "{quat:?}");
        }
    }
}
