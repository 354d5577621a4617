//! Bytes to values and back, for everything but rotations.
//!
//! Encoding rounds as the reference does, in f32; a byte that is decoded and encoded again stays
//! what it is, which a test below checks for every byte.

use super::header::Header;
use super::rows::ROW_STEP;
use super::signs::Signs;
use crate::formats::packed_values::alpha_logits;
use crate::gaussian_scene::sigmoid;
use half::f16;

/// What colors are multiplied by before they become bytes: less than the DC basis function, so
/// that colors outside 0 to 1 fit, too.
const COLOR_SCALE: f32 = 0.15;
/// Largest magnitude of a position code. The lowest of 24 bits, −2²³, is not used: with it, a
/// scene could fit into one more fractional bit after it was rounded than before.
pub(super) const MAX_POSITION: f64 = 8_388_607.0;
/// Range of logarithms of scales.
pub(super) const SCALE_RANGE: [f32; 2] = [-10.0, 5.9375];
/// Step of logarithms of scales.
pub(super) const SCALE_STEP: f32 = 0.0625;
/// Range of harmonics.
pub(super) const REST_RANGE: [f32; 2] = [-1.0, 0.992_187_5];
/// Largest magnitude of a DC term: black or white, stretched by the scale.
pub(super) const COLOR_RANGE: f32 = 0.5 / COLOR_SCALE;
/// Step of DC terms.
pub(super) const COLOR_STEP: f32 = 1.0 / (255.0 * COLOR_SCALE);

/// Values of every byte.
pub(super) struct ByteTables {
    pub(super) logit: [f32; 256],
    pub(super) color: [f32; 256],
    pub(super) scale: [f32; 256],
}

impl ByteTables {
    pub(super) fn new() -> Self {
        let table = |value: fn(f32) -> f32| std::array::from_fn(|byte| value(byte as f32));
        Self {
            logit: alpha_logits(),
            color: table(|b| (b / 255.0 - 0.5) / COLOR_SCALE),
            scale: table(|b| b / 16.0 - 10.0),
        }
    }
}

/// Decodes values of a byte each.
pub(super) fn decode_bytes(bytes: &[u8], table: &[f32; 256], out: &mut [f32]) {
    for (value, &byte) in out.iter_mut().zip(bytes) {
        *value = table[usize::from(byte)];
    }
}

/// Decodes rows of three bytes each.
pub(super) fn decode_triples(bytes: &[u8], table: &[f32; 256], out: &mut [[f32; 3]]) {
    for (row, bytes) in out.iter_mut().zip(bytes.as_chunks::<3>().0) {
        *row = bytes.map(|byte| table[usize::from(byte)]);
    }
}

/// Decodes rows of positions.
pub(super) fn decode_positions(bytes: &[u8], header: &Header, signs: &Signs, out: &mut [[f32; 3]]) {
    // To add 0 turns -0 into 0.
    if header.version == 1 {
        for (row, bytes) in out.iter_mut().zip(bytes.as_chunks::<6>().0) {
            let value = |i: usize| f16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]);
            *row = [0, 1, 2].map(|i| value(i).to_f32() * signs.coord[i] + 0.0);
        }
        return;
    }
    let step = 1.0 / (1u64 << header.fractional_bits) as f32;
    let steps = signs.coord.map(|sign| sign * step);
    for (row, bytes) in out.iter_mut().zip(bytes.as_chunks::<9>().0) {
        let fixed = |i: usize| {
            let [low, middle, high] = [bytes[3 * i], bytes[3 * i + 1], bytes[3 * i + 2]];
            // The byte shifted out at the right brings the sign of the 24 bits to the top.
            i32::from_le_bytes([0, low, middle, high]) >> 8
        };
        *row = [0, 1, 2].map(|i| fixed(i) as f32 * steps[i] + 0.0);
    }
}

/// Factors of the harmonics of [`ROW_STEP`] rows, one after the other: with a pattern that long,
/// the loop over a block knows nothing of rows and becomes vector instructions.
pub(super) fn rest_factors(header: &Header, signs: &Signs) -> Vec<f32> {
    let row = signs.rest[..header.rest_len()].iter().flat_map(|&sign| [sign / 128.0; 3]);
    let row: Vec<f32> = row.collect();
    row.repeat(ROW_STEP)
}

/// Decodes harmonics; `bytes` begin where `factors` begin.
pub(super) fn decode_rest(bytes: &[u8], factors: &[f32], out: &mut [f32]) {
    for (values, bytes) in out.chunks_mut(factors.len()).zip(bytes.chunks(factors.len())) {
        for ((value, &byte), &factor) in values.iter_mut().zip(bytes).zip(factors) {
            *value = (f32::from(byte) - 128.0) * factor + 0.0;
        }
    }
}

/// The nearest byte, halves away from 0; NaN becomes 0.
fn to_byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// A logit as a byte of opacity.
pub(super) fn encode_alpha(logit: f32) -> u8 {
    to_byte(sigmoid(logit) * 255.0)
}

/// A DC term as a byte.
pub(super) fn encode_color(dc: f32) -> u8 {
    to_byte(dc * (COLOR_SCALE * 255.0) + 127.5)
}

/// The logarithm of a scale as a byte.
pub(super) fn encode_scale(log_scale: f32) -> u8 {
    to_byte((log_scale + 10.0) * 16.0)
}

/// A position on the grid of `2^-bits`, and whether it is within the range of 24 bits.
pub(super) fn encode_position(value: f32, bits: u8) -> (i32, bool) {
    let code = (f64::from(value) * f64::from(1u32 << bits)).round();
    (code.clamp(-MAX_POSITION, MAX_POSITION) as i32, code.abs() <= MAX_POSITION)
}

/// A harmonic as a byte, on the coarser grid of its band: 5 bits in the first, 4 in the others.
pub(super) fn encode_rest(value: f32, bucket: i32) -> u8 {
    // Far outside of the range the sum below must not overflow; NaN becomes 0.
    let code = (value * 128.0).round().clamp(-1024.0, 1024.0) as i32 + 128;
    // Division toward 0 is that of the reference; what it does below 0 is clipped anyway.
    let code = (code + bucket / 2) / bucket * bucket;
    code.clamp(0, 255) as u8
}

/// Distance of neighboring codes of coefficient `k`, 0-based from the first of band 1.
pub(super) fn rest_bucket(k: usize) -> i32 {
    if k < 3 { 1 << (8 - 5) } else { 1 << (8 - 4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::SpzFrame;

    #[test]
    fn every_byte_stays_what_it_is() {
        let tables = ByteTables::new();
        for byte in 0..=255u8 {
            let i = usize::from(byte);
            assert_eq!(encode_alpha(tables.logit[i]), byte);
            assert_eq!(encode_color(tables.color[i]), byte);
            assert_eq!(encode_scale(tables.scale[i]), byte);
        }
        assert_eq!(tables.logit[0], f32::NEG_INFINITY);
        assert_eq!(tables.logit[255], f32::INFINITY);
        assert_eq!([tables.scale[0], tables.scale[255]], SCALE_RANGE);
        assert_eq!([-tables.color[0], tables.color[255]], [COLOR_RANGE; 2]);
    }

    #[test]
    fn codes_of_harmonics_stay_what_they_are() {
        for bucket in [8, 16] {
            let codes: Vec<u8> = (0..256).step_by(bucket as usize).map(|c| c as u8).collect();
            for &code in codes.iter().chain([&255]) {
                assert_eq!(encode_rest((f32::from(code) - 128.0) / 128.0, bucket), code);
            }
            assert_eq!(encode_rest(-1e30, bucket), 0);
            assert_eq!(encode_rest(f32::INFINITY, bucket), 255);
            assert_eq!(encode_rest(f32::NAN, bucket), 128);
        }
        assert_eq!([0, 2, 3, 23].map(rest_bucket), [8, 8, 16, 16]);
    }

    #[test]
    fn positions_stay_what_they_are_at_every_precision() {
        for fractional_bits in 0..=12 {
            let header = Header { version: 3, rows: 1, degree: 0, fractional_bits, flags: 0 };
            let signs = Signs::assumed(SpzFrame::Rub);
            for code in [0, 1, -1, 77, -4_194_304, 8_388_607, -8_388_607] {
                let bytes = i32::to_le_bytes(code);
                let row = [&bytes[..3]; 3].concat();
                let mut out = [[f32::NAN; 3]];
                decode_positions(&row, &header, &signs, &mut out);
                let again = |i: usize| encode_position(out[0][i] * signs.coord[i], fractional_bits);
                assert_eq!([0, 1, 2].map(again), [(code, true); 3]);
                assert!(code != 0 || out[0].iter().all(|v| v.is_sign_positive()));
            }
        }
        assert_eq!(encode_position(-3e9, 0), (-8_388_607, false));
    }
}
