//! Writing `.splat` files.

use super::{RECORD_BYTES, rotation_part, splat_problem};
use crate::formats::limit_tally::Limits;
use crate::formats::packed_values::{
    ALPHA_ENDS, COLOR_CLIPPED, SIZE_CUT, SIZE_VANISHES, alpha, canonical_quat, color_of,
    nearest_byte, scale_code, settle, tally_alpha, tally_colors, tally_sizes, unit_f64,
};
use crate::formats::{WriteOptions, WriteProgress, WriteReport};
use crate::input_file::InputFile;
use crate::{AtomicFile, GaussianScene, SceneError};
use rayon::prelude::*;
use std::io::Write;

/// Rows that one task encodes.
const ROWS_PER_TASK: usize = 4096;
/// Rows encoded before they are handed to the file: a few ms of work, 1 MiB.
const ROWS_PER_WRITE: usize = 8 * ROWS_PER_TASK;

/// What the format cannot hold, as it is reported.
const LIMITS: [(&str, &str); 4] = [
    ("log_scale", SIZE_CUT),
    ("log_scale", SIZE_VANISHES),
    ("opacity_logit", ALPHA_ENDS),
    ("sh_dc", COLOR_CLIPPED),
];

/// Writes a scene as a `.splat` file.
///
/// Rows keep their order: programs that write this format commonly sort by size times alpha, for
/// viewers that show a file while it loads, but the order is not part of the format. Bytes are the
/// nearest ones, where the original converter cuts off. A file that was written here comes back
/// byte for byte when it is read and written again. Of other programs' files positions, colors and
/// alphas do; sizes pass through a logarithm of 32 bits (some 1e-6 of them), and rotations come out
/// with unit norm.
///
/// Reported are colors beyond 0 to 1 (clipped), harmonics (left out), alphas that become 0 or 1,
/// and sizes that f32 cannot hold.
///
/// # Errors
/// As [`write_scene`](super::super::write_scene), which also looks for an old file; if a position,
/// size, rotation, opacity or color is not a number; if most Gaussians are so far away or so large
/// that the file would not be recognized as one of this format, which has no mark of its own.
pub(in crate::formats) fn write_splat(
    scene: &GaussianScene,
    file: &AtomicFile,
    _options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let (rows, path) = (scene.len(), file.target());
    let mut limits = Limits::default();
    let mut buffer = vec![0u8; rows.min(ROWS_PER_WRITE) * RECORD_BYTES];
    for first in (0..rows).step_by(ROWS_PER_WRITE) {
        let count = ROWS_PER_WRITE.min(rows - first);
        let bytes = &mut buffer[..count * RECORD_BYTES];
        let found = bytes
            .par_chunks_mut(ROWS_PER_TASK * RECORD_BYTES)
            .enumerate()
            .map(|(task, bytes)| {
                let mut limits = Limits::default();
                let records = bytes.as_chunks_mut::<RECORD_BYTES>().0;
                for (i, record) in records.iter_mut().enumerate() {
                    encode(scene, first + task * ROWS_PER_TASK + i, record, &mut limits);
                }
                limits
            })
            .reduce(Limits::default, Limits::merge);
        limits = limits.merge(found);
        file.file().write_all(bytes).map_err(SceneError::io(path, "cannot write the scene"))?;
        if !progress((first + count) as f64 / rows as f64) {
            return Err(SceneError::Stopped);
        }
    }
    if let Some(problem) = splat_problem(InputFile::of_written(file)?.bytes()) {
        let problem = format!("would not be recognized as a .splat file: it {problem}");
        let help = "scale the scene to meters, or choose another format";
        return Err(SceneError::format(path, problem, help));
    }
    report.limits(LIMITS, limits);
    Ok(())
}

fn encode(
    scene: &GaussianScene,
    row: usize,
    record: &mut [u8; RECORD_BYTES],
    Limits([too_large, too_small, ends, clipped]): &mut Limits<4>,
) {
    let mut put = |at: usize, value: f32| {
        record[at..at + 4].copy_from_slice(&value.to_le_bytes());
    };
    for (i, &value) in scene.coord[row].iter().enumerate() {
        put(4 * i, value);
    }
    let scale = scene.log_scale[row].map(scale_code);
    scale.iter().enumerate().for_each(|(i, &scale)| put(12 + 4 * i, scale));
    tally_sizes(row, scene.log_scale[row], scale, too_large, too_small);

    for (i, &dc) in scene.sh_dc[row].iter().enumerate() {
        record[24 + i] = nearest_byte(color_of(dc));
    }
    tally_colors(row, scene.sh_dc[row], clipped);

    let logit = scene.opacity_logit[row];
    record[27] = nearest_byte(alpha(logit));
    tally_alpha(row, logit, matches!(record[27], 0 | 255), ends);
    record[28..].copy_from_slice(&rotation_code(scene.quat[row]));
}

/// The bytes of a rotation that come back as themselves.
fn rotation_code(quat: [f32; 4]) -> [u8; 4] {
    // The cast cuts off and saturates: 1 becomes 255.
    let nearest = |quat: [f32; 4]| unit_f64(quat).map(|v| (v * 128.0 + 128.5) as u8);
    settle(nearest(canonical_quat(quat)), |code| nearest(canonical_quat(code.map(rotation_part))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::packed_values::log_of_scale;

    #[test]
    fn codes_come_back_as_themselves() {
        let mut bits = 1u32;
        let mut next = || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for _ in 0..20_000 {
            let code = rotation_code([next(), next(), next(), next()]);
            assert_eq!(rotation_code(canonical_quat(code.map(rotation_part))), code);
            // All sizes of the exponent, and those near 1 where the logarithm is the finer one.
            for log in [next() * 110.0, next(), next() * 1e-3, next() * 1e-7] {
                let scale = scale_code(log);
                assert_eq!(scale_code(log_of_scale(scale)), scale, "{log}");
                let error = f64::from(log_of_scale(scale)) - f64::from(log);
                let fine = log.abs() < 85.0 && error.abs() < 2e-7 + f64::from(log.abs()) * 2e-7;
                assert!(fine || log.abs() >= 85.0, "{log} came back off by {error}");
            }
        }
        assert_eq!(scale_code(f32::NEG_INFINITY), 0.0);
        assert!(scale_code(1000.0) <= f32::MAX);
        assert_eq!(rotation_code([1.0, 0.0, 0.0, 0.0]), [255, 128, 128, 128]);
        assert_eq!(rotation_code([-0.5, 0.5, -0.5, 0.5]), [192, 64, 192, 64]);
    }
}
