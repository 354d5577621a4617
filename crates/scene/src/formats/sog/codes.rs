//! Numbers as codes of one or two bytes, and back: positions, rotations, opacities.
//!
//! Every encoder here gives a code that stays the same when its own value is encoded again.

use crate::formats::packed_values::settle;
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// What a byte of a texture stands for.
pub(super) type ByteTable = [f32; 256];

/// Positions along one axis: 65,536 equal steps between two bounds in `sign(p) · ln(1 + |p|)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LogAxis {
    pub(super) min: f64,
    pub(super) max: f64,
}

impl LogAxis {
    /// The bounds of some positions. Without any, both are 0.
    pub(super) fn around(values: impl Iterator<Item = f32>) -> Self {
        let (min, max) =
            values.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        if min > max {
            return Self { min: 0.0, max: 0.0 };
        }
        // The sum turns −0 into 0, which would be written as another text.
        Self { min: to_log(min) + 0.0, max: to_log(max) + 0.0 }
    }

    /// The position of a code; exactly the bounds at both ends.
    pub(super) fn decode(&self, code: u16) -> f32 {
        let t = f64::from(code) / 65535.0;
        let n = self.min * (1.0 - t) + self.max * t;
        n.abs().exp_m1().copysign(n) as f32
    }

    /// The nearest code; the reference encoder takes the one below.
    fn encode(&self, value: f32) -> u16 {
        let range = self.max - self.min;
        if range > 0.0 { ((to_log(value) - self.min) / range * 65535.0).round() as u16 } else { 0 }
    }

    /// The code to write for a position: where steps are finer than an f32, several codes share a
    /// value, and one of them must stand for it.
    pub(super) fn code(&self, value: f32) -> u16 {
        self.settled(self.encode(value))
    }

    /// As [`code`](Self::code), with the table of all codes.
    pub(super) fn code_by_table(&self, value: f32, table: &[u16]) -> u16 {
        table[usize::from(self.encode(value))]
    }

    /// What each code becomes.
    pub(super) fn code_table(&self) -> Vec<u16> {
        (0..=u16::MAX).into_par_iter().map(|code| self.settled(code)).collect()
    }

    fn settled(&self, code: u16) -> u16 {
        settle(code, |c| self.encode(self.decode(c)))
    }
}

fn to_log(position: f32) -> f64 {
    let p = f64::from(position);
    p.abs().ln_1p().copysign(p)
}

/// The components of a rotation other than the largest: 256 steps over `−1/√2..=1/√2`.
const COMPONENTS: [f64; 256] = {
    let mut table = [0.0; 256];
    let mut byte = 0;
    while byte < 256 {
        table[byte] = (byte as f64 / 255.0 - 0.5) * SQRT_2;
        byte += 1;
    }
    table
};

/// For each place of the largest component, where `w, x, y, z` are in `[a, b, c, largest]`.
const PLACES: [[usize; 4]; 4] = [[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]];

/// The rotation `w, x, y, z` of a texel, unit norm, `w ≥ 0`.
///
/// The fourth byte says which component is the largest; the others follow in order. Any other
/// fourth byte means no rotation.
pub(super) fn decode_quat(texel: [u8; 4]) -> [f32; 4] {
    let Some(places) = PLACES.get(usize::from(texel[3].wrapping_sub(252))) else {
        return [1.0, 0.0, 0.0, 0.0];
    };
    let component = |i: usize| COMPONENTS[usize::from(texel[i])];
    let (a, b, c) = (component(0), component(1), component(2));
    let squared = a * a + b * b + c * c;
    let parts = [a, b, c, (1.0 - squared).max(0.0).sqrt()];
    let sign = if parts[places[0]] < 0.0 { -1.0 } else { 1.0 };
    // Only bytes that no rotation has leave another norm than 1.
    let factor = if squared > 1.0 { sign / squared.sqrt() } else { sign };
    let at = |i: usize| (parts[places[i]] * factor) as f32;
    [at(0), at(1), at(2), at(3)]
}

/// The texel of a unit rotation; each byte is the nearest, the reference encoder takes the one below.
pub(super) fn encode_quat(quat: [f32; 4]) -> [u8; 4] {
    settle(nearest_quat(quat), |code| nearest_quat(decode_quat(code)))
}

fn nearest_quat(quat: [f32; 4]) -> [u8; 4] {
    let mut largest = 0;
    for i in 1..4 {
        if quat[i].abs() > quat[largest].abs() {
            largest = i;
        }
    }
    let sign = 1f64.copysign(f64::from(quat[largest]));
    let mut texel = [0, 0, 0, 252 + largest as u8];
    for (byte, i) in texel.iter_mut().zip((0..4).filter(|&i| i != largest)) {
        // The conversion clips.
        *byte = ((f64::from(quat[i]) * sign / SQRT_2 + 0.5) * 255.0).round() as u8;
    }
    texel
}

/// The byte of an opacity logit.
pub(super) fn alpha_byte(logit: f32) -> u8 {
    (255.0 / (1.0 + (-f64::from(logit)).exp())).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_of_one_row_of_a_real_file() {
        let axes = [
            (-0.705_080_016_093_120_3, 0.706_151_908_158_946_8, 249, -1.013_185),
            (-0.732_573_815_727_477_6, 0.036_155_614_891_185_926, 17 + 256 * 236, -0.023_974),
            (-0.709_652_722_449_505, 0.709_472_422_290_589_8, 26 + 256 * 2, -1.009_734),
        ];
        for (min, max, code, expected) in axes {
            let got = LogAxis { min, max }.decode(code);
            assert!((got - expected).abs() < 1e-6, "{got} is not {expected}");
        }
        let quat = decode_quat([119, 180, 123, 252]);
        for (got, expected) in quat.iter().zip([0.955_186f32, -0.04714, 0.291_162, -0.024_957]) {
            assert!((got - expected).abs() < 1e-5, "{quat:?}");
        }
    }

    #[test]
    fn bounds_come_back_exactly_and_codes_stay() {
        for (min, max) in
            [(-1.0f32, 2.0f32), (-3e38, f32::MAX), (1000.0, 1000.01), (-1e-30, 1e-30), (7.0, 7.0)]
        {
            let axis = LogAxis::around([min, max].into_iter());
            assert_eq!(axis.decode(0), min);
            if min < max {
                assert_eq!(axis.decode(u16::MAX), max);
            }
            let table = axis.code_table();
            for code in 0..=u16::MAX {
                let value = axis.decode(code);
                let written = axis.code_by_table(value, &table);
                assert_eq!(axis.code(axis.decode(written)), written, "{min} {max}");
                assert_eq!(axis.code(value), written);
            }
        }
    }

    #[test]
    fn every_byte_of_a_rotation_settles() {
        for a in 0..=255u8 {
            for b in (0..=255).step_by(5) {
                for c in [0, 1, 127, 128, 200, 255] {
                    for largest in 252..=255 {
                        let quat = decode_quat([a, b, c, largest]);
                        let norm: f64 = quat.iter().map(|&v| f64::from(v).powi(2)).sum();
                        assert!((norm - 1.0).abs() < 4e-7 && quat[0] >= 0.0, "{quat:?}");
                        let code = encode_quat(quat);
                        assert_eq!(encode_quat(decode_quat(code)), code, "{quat:?}");
                    }
                }
            }
        }
        assert_eq!(decode_quat([9, 9, 9, 251]), [1.0, 0.0, 0.0, 0.0]);
    }
}
