//! The integers of a compressed PLY file and what they stand for.

use crate::formats::packed_values::{canonical_quat, settle, unit_f64};
use std::f64::consts::SQRT_2;

/// Largest code of each part of a position or scale.
pub(super) const STEPS_11_10_11: [f64; 3] = [2047.0, 1023.0, 2047.0];
/// Largest code of a color.
pub(super) const STEPS_8: f64 = 255.0;

/// The three parts of a word, 11, 10 and 11 bits.
pub(super) fn split_11_10_11(word: u32) -> [u32; 3] {
    [word >> 21, word >> 11 & 1023, word & 2047]
}

pub(super) fn join_11_10_11([x, y, z]: [u32; 3]) -> u32 {
    x << 21 | y << 11 | z
}

/// The four bytes of a word, the highest first.
pub(super) fn split_8888(word: u32) -> [u32; 4] {
    word.to_be_bytes().map(u32::from)
}

pub(super) fn join_8888(parts: [u32; 4]) -> u32 {
    parts.into_iter().fold(0, |word, part| word << 8 | part)
}

/// The value between the bounds at the fraction `t`.
pub(super) fn lerp(min: f32, max: f32, t: f64) -> f64 {
    f64::from(min) * (1.0 - t) + f64::from(max) * t
}

/// `w, x, y, z` from the index of the largest and the other three.
pub(super) fn unpack_quat(word: u32) -> [f32; 4] {
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

/// The word of a quaternion that comes back as itself.
pub(super) fn pack_quat(quat: [f32; 4]) -> u32 {
    let step = |word| nearest_quat(canonical_quat(unpack_quat(word)));
    settle(nearest_quat(canonical_quat(quat)), step)
}

fn nearest_quat(quat: [f32; 4]) -> u32 {
    let quat = unit_f64(quat);
    // The first of equals, as the reference has it.
    let mut largest = 0;
    for i in 1..4 {
        if quat[i].abs() > quat[largest].abs() {
            largest = i;
        }
    }
    // Only three are stored, so the largest must be the positive root.
    let sign = if quat[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut word = largest as u32;
    for i in (0..4).filter(|&i| i != largest) {
        // |v| ≤ √½, so the code is in range but for rounding; the cast cuts off, and saturates at 0.
        let code = (quat[i] * sign / SQRT_2 + 0.5) * 1023.0 + 0.5;
        word = word << 10 | (code as u32).min(1023);
    }
    word
}

/// A byte to −4..4; the ends are exact, the others stand for the middle of their interval.
pub(super) fn unpack_coefficient(byte: f32) -> f32 {
    let t = match byte {
        b if b <= 0.0 => 0.0,
        b if b >= 255.0 => 1.0,
        b => (b + 0.5) / 256.0,
    };
    (t - 0.5) * 8.0
}

/// The byte of a coefficient; beyond ±4 that of the nearer end.
pub(super) fn pack_coefficient(value: f32) -> u8 {
    // The cast cuts off and saturates.
    ((f64::from(value) / 8.0 + 0.5) * 256.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_exact_at_both_ends() {
        assert_eq!(unpack_coefficient(0.0), -4.0);
        assert_eq!(unpack_coefficient(255.0), 4.0);
        assert_eq!(unpack_coefficient(128.0), (128.5 / 256.0 - 0.5) * 8.0);
        for byte in 0..=255u8 {
            assert_eq!(pack_coefficient(unpack_coefficient(f32::from(byte))), byte);
        }
        assert_eq!((pack_coefficient(-9.0), pack_coefficient(9.0)), (0, 255));
    }

    #[test]
    fn words_are_split_and_joined() {
        assert_eq!(split_11_10_11(u32::MAX), [2047, 1023, 2047]);
        for word in [0xf8e7_f3d2, 0x9a78_9b58, 1, 0x8000_0000] {
            assert_eq!(join_11_10_11(split_11_10_11(word)), word);
            assert_eq!(join_8888(split_8888(word)), word);
        }
        assert_eq!(split_8888(0x0102_0304), [1, 2, 3, 4]);
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
