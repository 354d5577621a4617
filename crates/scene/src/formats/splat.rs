//! `.splat` files: 32 bytes a Gaussian, without any header.
//!
//! A record is the position (3 × f32), the standard deviations (3 × f32, meters), red, green, blue
//! and alpha (4 × u8, 255 = 1), and the rotation `w, x, y, z` (4 × u8, `(byte − 128) / 128`, any
//! norm); all little-endian. No harmonics beyond the color.

mod writer;

pub(super) use writer::write_splat;

use super::packed_values::{alpha_logits, color_terms, log_of_scale};
use super::scene_blocks::{SceneBlock, fill_scene};
use super::{LoadedScene, ReadOptions, SceneFormat, semantics};
use crate::{RepairReport, SceneError};
use std::path::Path;

/// Bytes of a Gaussian.
pub(crate) const RECORD_BYTES: usize = 32;

/// Records that are looked at to recognize a file.
const MAX_SAMPLES: usize = 256;

/// Coordinates beyond this, meters, are unusual: larger than the Earth, georeferenced or not.
const MAX_COORD: f32 = 1e9;
/// Standard deviations beyond this, meters, are unusual too.
const MAX_SCALE: f32 = 1e7;

/// Whether these bytes, a whole file, are records of Gaussians.
///
/// There is no magic number, so up to 256 records, evenly spaced and with the first, are looked at:
/// nine in ten must have a finite position, finite sizes and a rotation of about unit norm, and half
/// of them a position within ±1e9 m and sizes up to 1e7 m. A few bad values do not matter; a file of
/// zeros and text are not recognized.
pub fn is_splat(bytes: &[u8]) -> bool {
    splat_problem(bytes).is_none()
}

/// Why these bytes, a whole file, are not a `.splat` file; `None` if they are.
pub fn splat_problem(bytes: &[u8]) -> Option<String> {
    if let Some(problem) = length_problem(bytes) {
        return Some(problem);
    }
    let records = bytes.len() / RECORD_BYTES;
    let samples = records.min(MAX_SAMPLES);
    let sample = |i: usize| {
        // Evenly spaced; the product of a length in memory and 256 fits.
        let row = (i as u128 * records as u128 / samples as u128) as usize;
        &bytes[row * RECORD_BYTES..][..RECORD_BYTES]
    };
    let is_text = |b: &u8| matches!(b, b'\t' | b'\n' | b'\r' | b' '..=b'~');
    if (0..samples).all(|i| sample(i).iter().all(is_text)) {
        return Some("is text, not a .splat file".to_owned());
    }
    let count = |want: Plausible| (0..samples).filter(|&i| plausible(sample(i)) >= want).count();
    let good = count(Plausible::Possible);
    // One bad record is nothing in a file of any length.
    if good == 0 || samples - good > (samples / 10).max(1) {
        return Some(format!(
            "is not made of Gaussians as a .splat file is: of {samples} records looked at {good} \
             have a finite position, finite sizes and a rotation"
        ));
    }
    let usual = count(Plausible::Usual);
    if 2 * usual < samples {
        return Some(format!(
            "is not made of Gaussians of a scene: of {samples} records looked at {usual} have a \
             position within ±{MAX_COORD:e} m and sizes up to {MAX_SCALE:e} m"
        ));
    }
    None
}

fn length_problem(bytes: &[u8]) -> Option<String> {
    if bytes.is_empty() {
        return Some("is empty".to_owned());
    }
    let (records, left) = (bytes.len() / RECORD_BYTES, bytes.len() % RECORD_BYTES);
    (left != 0).then(|| {
        format!(
            "has {} bytes, which is {records} records of {RECORD_BYTES} and {left} bytes more",
            bytes.len()
        )
    })
}

/// How much a record is like one of a Gaussian.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Plausible {
    /// Not at all.
    No,
    /// It is one that can be read, if of a strange scene.
    Possible,
    /// As those of real scenes.
    Usual,
}

fn plausible(record: &[u8]) -> Plausible {
    let coord: [f32; 3] = floats(record, 0);
    let scale: [f32; 3] = floats(record, 12);
    // The norm is off by rounding of the bytes only: at most 4 · 1/128 in this measure.
    let squared: f32 = rotation(record).iter().map(|v| v * v).sum();
    let within = |max_coord: f32, max_scale: f32| {
        coord.iter().all(|v| v.abs() <= max_coord)
            && scale.iter().all(|v| (0.0..=max_scale).contains(v))
    };
    match (0.8..1.2).contains(&squared) && within(f32::MAX, f32::MAX) {
        false => Plausible::No,
        true if within(MAX_COORD, MAX_SCALE) => Plausible::Usual,
        true => Plausible::Possible,
    }
}

/// The floats at `offset` of a record, which must hold them.
fn floats<const W: usize>(record: &[u8], offset: usize) -> [f32; W] {
    std::array::from_fn(|i| {
        let mut bytes = [0; 4];
        bytes.copy_from_slice(&record[offset + 4 * i..][..4]);
        f32::from_le_bytes(bytes)
    })
}

/// `w, x, y, z`, of any norm.
fn rotation(record: &[u8]) -> [f32; 4] {
    [28, 29, 30, 31].map(|at| rotation_part(record[at]))
}

fn rotation_part(byte: u8) -> f32 {
    (f32::from(byte) - 128.0) / 128.0
}

/// Reads a scene from the bytes of a `.splat` file, and the labels beside it if there are any.
///
/// The order of the file is kept. Alpha 0 and 255 become the logits ±inf and a size of 0 the
/// logarithm −inf, which is what they say; a negative size becomes NaN, which the value policy
/// leaves out.
///
/// # Errors
/// As [`super::open_scene`]; also if the length is no multiple of 32.
pub fn read_splat(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    if let Some(problem) = length_problem(bytes) {
        let help = "the file is cut short, or is no .splat file; export the scene again";
        return Err(SceneError::format(path, problem, help));
    }
    let rows = bytes.len() / RECORD_BYTES;
    let (logits, terms) = (alpha_logits(), color_terms());
    let mut scene = fill_scene(rows, 0, |block: SceneBlock<'_>| {
        let records = bytes[block.first_row * RECORD_BYTES..].chunks_exact(RECORD_BYTES);
        for (i, record) in records.take(block.coord.len()).enumerate() {
            block.coord[i] = floats(record, 0);
            block.log_scale[i] = floats(record, 12).map(log_of_scale);
            block.sh_dc[i] = [24, 25, 26].map(|at| terms[usize::from(record[at])]);
            block.opacity_logit[i] = logits[usize::from(record[27])];
            block.quat[i] = rotation(record);
        }
    });
    let mut report = RepairReport::default();
    semantics::read_sidecar(path, bytes, rows, options.policy, &mut scene, &mut report)?;
    LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Splat)
}
