//! Codes of a few bits that survive being read and written again, shared by the packed formats.

use super::limit_tally::LimitTally;
use crate::gaussian_scene::{SH_C0, probability_to_logit, u8_to_dc};
use crate::value_policy::unit;
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;
use std::path::Path;

/// Follows `code → step(code)` until it comes round, and gives the smallest code of that cycle.
///
/// With `step` = read the code, then write what was read, the result does not change when a file
/// is read and written again: another start on the same cycle leads to the same code.
pub(crate) fn settle<C: Copy + Ord>(code: C, step: impl Fn(C) -> C) -> C {
    let mut slow = step(code);
    if slow == code {
        return code;
    }
    let mut fast = step(slow);
    while slow != fast {
        slow = step(slow);
        fast = step(step(fast));
    }
    let (mut smallest, mut at) = (slow, step(slow));
    while at != slow {
        smallest = smallest.min(at);
        at = step(at);
    }
    smallest
}

/// As [`settle`] for floats that are not negative: their bits are in the order of their values.
pub(crate) fn settle_float(start: f32, step: impl Fn(f32) -> f32) -> f32 {
    f32::from_bits(settle(start.to_bits(), |bits| step(f32::from_bits(bits)).to_bits()))
}

/// The quaternion that the value policy makes of one as read: unit norm, `w ≥ 0`.
///
/// Bit for bit what cleaning does, so that writers can foresee it. Without a direction it is no rotation.
pub(crate) fn canonical_quat(raw: [f32; 4]) -> [f32; 4] {
    let unit = unit(raw).map_or([1.0, 0.0, 0.0, 0.0], |(unit, _)| unit);
    if unit[0] < 0.0 { unit.map(|v| -v) } else { unit }
}

/// The quaternion divided by its norm, in f64.
pub(crate) fn unit_f64(quat: [f32; 4]) -> [f64; 4] {
    let quat = quat.map(f64::from);
    let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    quat.map(|v| v / norm)
}

/// The logit of every alpha byte; ±inf at the ends.
pub(crate) fn alpha_logits() -> [f32; 256] {
    std::array::from_fn(|byte| probability_to_logit(byte as f32 / 255.0))
}

/// The DC term of every color byte.
pub(crate) fn color_terms() -> [f32; 256] {
    std::array::from_fn(|byte| u8_to_dc(byte as u8))
}

/// Alpha of a logit, in f64.
pub(crate) fn alpha(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// The nearest byte of a fraction; beyond 0 to 1 the byte of the nearer end.
pub(crate) fn nearest_byte(fraction: f64) -> u8 {
    // The cast cuts off and saturates.
    (fraction * 255.0 + 0.5) as u8
}

/// The color of a DC term, 0 to 1 where it can be shown.
pub(crate) fn color_of(dc: f32) -> f64 {
    f64::from(dc) * f64::from(SH_C0) + 0.5
}

/// The DC term of a color.
pub(crate) fn dc_of(color: f64) -> f32 {
    ((color - 0.5) / f64::from(SH_C0)) as f32
}

/// The natural logarithm of a standard deviation: −inf for 0, NaN for a negative one.
pub(crate) fn log_of_scale(scale: f32) -> f32 {
    f64::from(scale).ln() as f32
}

/// The standard deviation in meters that comes back as itself.
pub(crate) fn scale_code(log: f32) -> f32 {
    let nearest = |log: f32| (f64::from(log).exp() as f32).min(f32::MAX);
    settle_float(nearest(log), |scale| nearest(log_of_scale(scale)))
}

/// The opacity that comes back as itself.
pub(crate) fn alpha_code(logit: f32) -> f32 {
    let nearest = |logit: f32| alpha(logit) as f32;
    settle_float(nearest(logit), |alpha| nearest(probability_to_logit(alpha)))
}

/// What becomes of sizes that f32 cannot hold in meters.
pub(crate) const SIZE_CUT: &str = "larger than an f32 can hold in meters; cut";
/// What becomes of sizes below the smallest f32.
pub(crate) const SIZE_VANISHES: &str = "so small that the size in meters becomes 0";
/// What becomes of alphas next to 0 and 1.
pub(crate) const ALPHA_ENDS: &str = "alpha becomes 0 or 1; the change is that of alpha";
/// What becomes of colors that cannot be shown.
pub(crate) const COLOR_CLIPPED: &str = "colors beyond 0 to 1 are clipped";

/// Counts a row of logarithms of sizes whose meters, as they are `stored`, are not theirs.
pub(crate) fn tally_sizes(
    row: usize,
    log_scale: [f32; 3],
    stored: [f32; 3],
    too_large: &mut LimitTally,
    too_small: &mut LimitTally,
) {
    let (mut cut, mut vanished): (Option<f64>, _) = (None, false);
    for (log, scale) in log_scale.into_iter().zip(stored) {
        if scale == 0.0 {
            vanished |= log != f32::NEG_INFINITY;
        } else if log > log_of_scale(f32::MAX) {
            let change = f64::from(log) - f64::from(log_of_scale(scale));
            cut = Some(change.max(cut.unwrap_or(0.0)));
        }
    }
    cut.into_iter().for_each(|change| too_large.add(row, change));
    if vanished {
        too_small.add(row, f64::INFINITY);
    }
}

/// Counts a row whose alpha is stored as 0 or 1 though its logit is finite.
pub(crate) fn tally_alpha(row: usize, logit: f32, is_end: bool, ends: &mut LimitTally) {
    if is_end && logit.is_finite() {
        let alpha = alpha(logit);
        ends.add(row, alpha.min(1.0 - alpha));
    }
}

/// Counts a row of DC terms with a color that no byte is near.
pub(crate) fn tally_colors(row: usize, dc: [f32; 3], clipped: &mut LimitTally) {
    /// As far as rounding may move a color.
    const HALF_STEP: f64 = 0.5 / 255.0;
    let mut largest: Option<f64> = None;
    for dc in dc {
        let color = color_of(dc);
        if !(-HALF_STEP..=1.0 + HALF_STEP).contains(&color) {
            let beyond = f64::from(dc) - f64::from(dc_of(color.clamp(0.0, 1.0)));
            largest = Some(beyond.abs().max(largest.unwrap_or(0.0)));
        }
    }
    largest.into_iter().for_each(|change| clipped.add(row, change));
}

/// Refuses a scene with values that reading would drop or repair, so that it would not come back.
///
/// Not a number are no position, size, rotation, opacity or color; nor are infinities, but for a
/// logarithm of −inf (a size of 0) and logits of ±inf (alpha 0 and 1). A rotation of zeros has no
/// direction.
pub(crate) fn check_storable(scene: &GaussianScene, path: &Path) -> Result<(), SceneError> {
    const ROWS_PER_TASK: usize = 4096;
    fn find<T: Sync + std::fmt::Debug>(
        field: &str,
        rows: &[T],
        path: &Path,
        bad: impl Fn(&T) -> bool + Send + Sync,
    ) -> Result<(), SceneError> {
        let parts = rows.par_chunks(ROWS_PER_TASK);
        let Some(part) = parts.position_first(|rows| rows.iter().any(&bad)) else { return Ok(()) };
        let row = part * ROWS_PER_TASK;
        let row = row + rows[row..].iter().position(bad).unwrap_or_default();
        Err(SceneError::Value {
            path: path.to_owned(),
            element: row,
            field: field.to_owned(),
            value: format!("{:?}", rows[row]),
            help: "leave the Gaussian out, or give it a number".to_owned(),
        })
    }
    let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    find("coord", &scene.coord, path, |v| !finite(v))?;
    find("log_scale", &scene.log_scale, path, |v| {
        v.iter().any(|&v| v.is_nan() || v == f32::INFINITY)
    })?;
    find("quat", &scene.quat, path, |v| !finite(v) || *v == [0.0; 4])?;
    find("opacity_logit", &scene.opacity_logit, path, |v| v.is_nan())?;
    find("sh_dc", &scene.sh_dc, path, |v| !finite(v))?;
    find("sh_rest", &scene.sh_rest, path, |v| !v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::value_policy::clean_scene;
    use crate::{Policy, RepairReport};

    #[test]
    fn settling_finds_the_smallest_of_the_cycle_from_anywhere() {
        // 9 → 8 → 5 → 7 → 3 → 5, and 1 alone.
        let step = |code: u8| match code {
            9 => 8,
            8 | 3 => 5,
            5 => 7,
            7 => 3,
            other => other,
        };
        for start in [9, 8, 5, 7, 3] {
            assert_eq!(settle(start, step), 3);
        }
        assert_eq!(settle(1, step), 1);
    }

    #[test]
    fn quaternions_come_out_as_from_cleaning() {
        let mut quat = vec![[0.0; 4], [f32::NAN, 0.0, 0.0, 1.0], [0.0, -1.0, 0.0, 0.0]];
        let mut bits = 7u32;
        for row in 0..4000 {
            let mut q = [0.0f32; 4];
            for v in &mut q {
                bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *v = (bits >> 8) as f32 / 8_388_608.0 - 1.0;
            }
            // Some are unit but for rounding, where the tolerance decides.
            quat.push(if row % 2 == 0 { unit_f64(q).map(|v| v as f32) } else { q });
        }
        let rows = quat.len();
        let scene = GaussianScene {
            coord: vec![[0.0; 3]; rows],
            log_scale: vec![[0.0; 3]; rows],
            quat: quat.clone(),
            opacity_logit: vec![0.0; rows],
            sh_dc: vec![[0.0; 3]; rows],
            ..GaussianScene::default()
        };
        let mut report = RepairReport::default();
        let (clean, _) = clean_scene(scene, &mut report, Policy::Repair, Path::new("a")).unwrap();
        let bits = |q: [f32; 4]| q.map(f32::to_bits);
        for (raw, clean) in quat.into_iter().zip(clean.quat) {
            assert_eq!(bits(canonical_quat(raw)), bits(clean), "{raw:?}");
        }
    }

    #[test]
    fn every_byte_survives() {
        let (logits, terms) = (alpha_logits(), color_terms());
        for byte in 0..=255u8 {
            assert_eq!(nearest_byte(alpha(logits[usize::from(byte)])), byte);
            assert_eq!(nearest_byte(color_of(terms[usize::from(byte)])), byte);
        }
        assert_eq!((nearest_byte(-3.0), nearest_byte(7.0)), (0, 255));
    }
}
