//! Rotations in three or four bytes.
//!
//! A code that is decoded and encoded again need not be the same: where two components are nearly
//! equal, rounding may change which one is the largest. The encoders therefore go on until the
//! code comes back, so that a file read and written again has the same bytes.

use super::signs::Signs;
use crate::formats::packed_values::settle;
use std::f64::consts::FRAC_1_SQRT_2;

/// How rotations are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum QuatCoding {
    /// `x, y, z` with `w ≥ 0`, a byte each: versions 1 and 2.
    FirstThree,
    /// All but the largest component, ten bits each: from version 3 on.
    SmallestThree,
}

/// Largest magnitude of ten bits with a sign; stands for `√½`.
const MAX_MAGNITUDE: f64 = 511.0;

impl QuatCoding {
    pub(super) fn of(version: u32) -> Self {
        if version < 3 { Self::FirstThree } else { Self::SmallestThree }
    }

    /// Decodes rows of quaternions `w, x, y, z`, unit, `w ≥ 0`.
    pub(super) fn decode_rows(self, bytes: &[u8], signs: &Signs, out: &mut [[f32; 4]]) {
        match self {
            Self::FirstThree => {
                for (quat, &[x, y, z]) in out.iter_mut().zip(bytes.as_chunks::<3>().0) {
                    *quat = decode_first(u32::from_le_bytes([x, y, z, 0]), signs);
                }
            }
            Self::SmallestThree => {
                for (quat, &bytes) in out.iter_mut().zip(bytes.as_chunks::<4>().0) {
                    *quat = decode_smallest(u32::from_le_bytes(bytes), signs);
                }
            }
        }
    }

    fn decode(self, code: u32, signs: &Signs) -> [f32; 4] {
        match self {
            Self::FirstThree => decode_first(code, signs),
            Self::SmallestThree => decode_smallest(code, signs),
        }
    }

    /// The code of a quaternion of any norm, that decoding and encoding leaves as it is; `None` if
    /// it has no direction.
    pub(super) fn encode(self, quat: [f32; 4], signs: &Signs) -> Option<u32> {
        let encode = match self {
            Self::FirstThree => encode_first,
            Self::SmallestThree => encode_smallest,
        };
        let again = |code| encode(self.decode(code, signs), signs).unwrap_or(code);
        let code = encode(quat, signs)?;
        Some(settle(code, again))
    }
}

/// `x, y, z, w` in the frame of the file to `w, x, y, z` in memory.
fn to_memory(mut quat: [f64; 4], signs: &Signs) -> [f32; 4] {
    let squared: f64 = quat.iter().map(|v| v * v).sum();
    // Three components of codes that no encoder makes can be longer than 1 together.
    if squared > 1.0 + 1e-9 {
        let norm = squared.sqrt();
        quat = quat.map(|v| v / norm);
    }
    for (v, &sign) in quat.iter_mut().zip(&signs.quat) {
        // A zero keeps its sign, which is a bit of the code, in every frame.
        if *v != 0.0 {
            *v *= f64::from(sign);
        }
    }
    let [x, y, z, w] = quat;
    let quat = [w, x, y, z].map(|v| v as f32);
    if w < 0.0 { quat.map(|v| -v) } else { quat }
}

/// `w, x, y, z` in memory to unit `x, y, z, w` in the frame of the file; `None` if all are 0 or one
/// is not finite.
fn to_file(quat: [f32; 4], signs: &Signs) -> Option<[f64; 4]> {
    let [w, x, y, z] = quat.map(f64::from);
    let mut quat = [x, y, z, w];
    let squared: f64 = quat.iter().map(|v| v * v).sum();
    if squared == 0.0 || !squared.is_finite() {
        return None;
    }
    for (v, &sign) in quat.iter_mut().zip(&signs.quat) {
        if *v != 0.0 {
            *v *= f64::from(sign);
        }
    }
    let norm = squared.sqrt();
    Some(quat.map(|v| v / norm))
}

fn decode_first(code: u32, signs: &Signs) -> [f32; 4] {
    let [x, y, z] = [0, 8, 16].map(|shift| f64::from(code >> shift & 255) / 127.5 - 1.0);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    to_memory([x, y, z, w], signs)
}

fn encode_first(quat: [f32; 4], signs: &Signs) -> Option<u32> {
    let [x, y, z, w] = to_file(quat, signs)?;
    let half = if w < 0.0 { -127.5 } else { 127.5 };
    let byte = |v: f64| (v * half + 127.5).round().clamp(0.0, 255.0) as u8;
    Some(u32::from_le_bytes([byte(x), byte(y), byte(z), 0]))
}

fn decode_smallest(code: u32, signs: &Signs) -> [f32; 4] {
    let largest = (code >> 30) as usize;
    let mut quat = [0.0; 4];
    let mut squared = 0.0;
    let mut left = code << 2;
    for i in 0..4 {
        if i != largest {
            let magnitude = f64::from(left >> 22 & 511) * (FRAC_1_SQRT_2 / MAX_MAGNITUDE);
            quat[i] = if left >> 31 == 1 { -magnitude } else { magnitude };
            squared += magnitude * magnitude;
            left <<= 10;
        }
    }
    quat[largest] = (1.0 - squared).max(0.0).sqrt();
    to_memory(quat, signs)
}

fn encode_smallest(quat: [f32; 4], signs: &Signs) -> Option<u32> {
    let quat = to_file(quat, signs)?;
    let mut largest = 0;
    for i in 1..4 {
        if quat[i].abs() > quat[largest].abs() {
            largest = i;
        }
    }
    // The negative of a quaternion is the same rotation; the largest component has no sign bit.
    let negate = quat[largest].is_sign_negative();
    let mut code = largest as u32;
    for i in 0..4 {
        if i != largest {
            let magnitude = quat[i].abs() * (MAX_MAGNITUDE / FRAC_1_SQRT_2) + 0.5;
            let sign = u32::from(quat[i].is_sign_negative() != negate);
            code = code << 10 | sign << 9 | (magnitude.min(MAX_MAGNITUDE) as u32);
        }
    }
    Some(code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::SpzFrame;

    const BOTH: [QuatCoding; 2] = [QuatCoding::FirstThree, QuatCoding::SmallestThree];

    fn codes() -> impl Iterator<Item = u32> {
        // A multiplicative walk through all 32-bit numbers, and corners of the ten-bit fields.
        let walk = (0..200_000u32).map(|i| i.wrapping_mul(2_654_435_761));
        let field = [0, 1, 255, 256, 361, 362, 510, 511, 512, 513, 873, 1022, 1023];
        let corners = (0..4u32).flat_map(move |l| {
            field.into_iter().flat_map(move |a| {
                field.into_iter().flat_map(move |b| {
                    field.into_iter().map(move |c| l << 30 | a << 20 | b << 10 | c)
                })
            })
        });
        walk.chain(corners)
    }

    #[test]
    fn whatever_is_read_is_written_and_read_the_same() {
        for frame in [SpzFrame::Rub, SpzFrame::Raw] {
            let signs = Signs::assumed(frame);
            for coding in BOTH {
                let mask = if coding == QuatCoding::FirstThree { 0xff_ffff } else { u32::MAX };
                for code in codes() {
                    let quat = coding.decode(code & mask, &signs);
                    let norm: f64 = quat.iter().map(|&v| f64::from(v).powi(2)).sum();
                    // Within what cleaning leaves alone.
                    assert!((norm - 1.0).abs() < 4e-7 && quat[0] >= 0.0, "{code:#x}: {quat:?}");
                    let first = coding.encode(quat, &signs).unwrap();
                    let back = coding.decode(first, &signs);
                    assert_eq!(coding.encode(back, &signs), Some(first), "{coding:?} {code:#x}");
                }
            }
        }
    }

    #[test]
    fn codes_of_the_reference_are_kept() {
        // All but ties, where the largest component is another one after rounding.
        let signs = Signs::assumed(SpzFrame::Rub);
        let (mut all, mut other) = (0, 0);
        for code in codes() {
            let magnitudes = [0, 10, 20].map(|shift| f64::from(code >> shift & 511) / 511.0);
            // Codes whose largest component really is the largest.
            if magnitudes.iter().map(|m| m * m / 2.0).sum::<f64>() < 0.5 {
                all += 1;
                let quat = QuatCoding::SmallestThree.decode(code, &signs);
                other += u32::from(QuatCoding::SmallestThree.encode(quat, &signs) != Some(code));
            }
        }
        assert!(all > 50_000 && other == 0, "{other} of {all}");
    }

    #[test]
    fn the_error_is_within_the_step() {
        let mut state = 1u64;
        let mut float = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        let signs = Signs::assumed(SpzFrame::Rub);
        for _ in 0..20_000 {
            let quat = [(); 4].map(|()| float());
            for (coding, step) in BOTH.into_iter().zip([1.0 / 127.5, FRAC_1_SQRT_2 / 511.0]) {
                let back = coding.decode(coding.encode(quat, &signs).unwrap(), &signs);
                // A quaternion and its negative are the same rotation.
                let dot: f32 = quat.iter().zip(&back).map(|(a, b)| a * b).sum();
                let norm = quat.iter().map(|v| v * v).sum::<f32>().sqrt().copysign(dot);
                // Of three bytes w follows from the others, with any error where it is small.
                let first = usize::from(coding == QuatCoding::FirstThree);
                for i in first..4 {
                    let error = f64::from(quat[i] / norm - back[i]).abs();
                    assert!(error <= step * 1.6, "{coding:?} {quat:?} {back:?}");
                }
            }
        }
        assert_eq!(QuatCoding::SmallestThree.encode([0.0; 4], &signs), None);
        assert_eq!(QuatCoding::FirstThree.encode([f32::NAN; 4], &signs), None);
    }

    #[test]
    fn no_rotation_has_no_signs() {
        let signs = Signs::assumed(SpzFrame::Rub);
        let code = QuatCoding::SmallestThree.encode([1.0, 0.0, 0.0, 0.0], &signs);
        assert_eq!(code, Some(3 << 30));
    }
}
