//! Numbers within the bounds of a chunk, as codes that do not change when a file is read and
//! written again.

use super::code::{STEPS_8, STEPS_11_10_11, lerp};
use crate::formats::packed_values::{color_of, dc_of, settle};

/// One number of every Gaussian of a chunk: a coordinate, a log-scale or a color.
#[derive(Clone, Copy)]
pub(super) struct Channel {
    /// The largest code.
    steps: f64,
    /// Whether the file holds a color where the scene has its DC term.
    is_color: bool,
}

const fn plain(steps: f64) -> Channel {
    Channel { steps, is_color: false }
}

/// The coordinates, each with its number of bits.
pub(super) const POSITION: [Channel; 3] =
    [plain(STEPS_11_10_11[0]), plain(STEPS_11_10_11[1]), plain(STEPS_11_10_11[2])];
/// The logarithms of the scales.
pub(super) const SCALE: [Channel; 3] = POSITION;
/// Red, green and blue.
pub(super) const COLOR: [Channel; 3] = [Channel { steps: STEPS_8, is_color: true }; 3];

/// Bounds and codes of a channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Packed {
    pub(super) min: f32,
    pub(super) max: f32,
    pub(super) codes: Vec<u32>,
}

impl Channel {
    /// Bounds and codes whose values, packed again, give the same bounds and codes.
    ///
    /// `values` are finite numbers of the scene, at least one. However close the bounds are, codes
    /// use their whole range; the reference gives up below 1e-5, but reads such chunks as well.
    pub(super) fn pack(self, values: &[f32]) -> Packed {
        let least = values.iter().copied().fold(f32::INFINITY, f32::min);
        let greatest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let (min, max) = (self.bound(least), self.bound(greatest));
        let last = self.steps as u32;
        let ends = [0, last].map(|code| self.value(min, max, code));
        if min >= max || ends[0] >= ends[1] {
            return Packed { min, max: min, codes: vec![0; values.len()] };
        }
        // What is read as an end gets the code of the end, and both ends occur, so the same bounds
        // are found in what is read.
        let snap = |code| match self.value(min, max, code) {
            value if value <= ends[0] => 0,
            value if value >= ends[1] => last,
            _ => code,
        };
        let step = |code| self.nearest(min, max, self.value(min, max, code));
        let code = |&value: &f32| match value {
            value if value == least => 0,
            value if value == greatest => last,
            value => snap(settle(self.nearest(min, max, value), step)),
        };
        let codes = values.iter().map(code).collect();
        Packed { min, max, codes }
    }

    /// What the reader makes of a code.
    pub(super) fn value(self, min: f32, max: f32, code: u32) -> f32 {
        let value = lerp(min, max, f64::from(code) / self.steps);
        if self.is_color { dc_of(value) } else { value as f32 }
    }

    /// What the file holds for a value of the scene.
    fn stored(self, value: f32) -> f64 {
        if self.is_color { color_of(value) } else { f64::from(value) }
    }

    fn nearest(self, min: f32, max: f32, value: f32) -> u32 {
        let (min, max) = (f64::from(min), f64::from(max));
        let t = (self.stored(value) - min) / (max - min);
        // The cast cuts off, and saturates at 0.
        ((t * self.steps + 0.5) as u32).min(self.steps as u32)
    }

    /// The bound for an extreme value; one that was read gives the bound it was read from.
    fn bound(self, value: f32) -> f32 {
        // Interpolation turns -0 into 0.
        let nearest = |value: f32| self.stored(value) as f32 + 0.0;
        if !self.is_color {
            return nearest(value);
        }
        let step = |key| ordered(nearest(dc_of(f64::from(of_ordered(key)))));
        of_ordered(settle(ordered(nearest(value)), step))
    }
}

/// A whole number that is in the order of the float.
fn ordered(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { bits ^ i32::MAX } else { bits }
}

fn of_ordered(key: i32) -> f32 {
    f32::from_bits(if key < 0 { key ^ i32::MAX } else { key } as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_floats() {
        let values = [f32::MIN, -1.0, -1e-40, 0.0, 1e-40, 1.0, f32::MAX];
        assert!(values.is_sorted_by_key(|&v| ordered(v)));
        assert!(values.iter().all(|&v| of_ordered(ordered(v)) == v));
    }

    fn check(channel: Channel, values: &[f32], what: &str) {
        let packed = channel.pack(values);
        let read: Vec<f32> =
            packed.codes.iter().map(|&c| channel.value(packed.min, packed.max, c)).collect();
        let again = channel.pack(&read);
        assert_eq!(again, packed, "{what}: {values:?}");
        let bits = |p: &Packed| (p.min.to_bits(), p.max.to_bits());
        assert_eq!(bits(&again), bits(&packed), "{what}");
        let extent = f64::from(packed.max) - f64::from(packed.min);
        for (&value, &read) in values.iter().zip(&read) {
            let rounding = channel.stored(value).abs() * 2e-7 + f64::from(value).abs() * 1e-7;
            let error = (channel.stored(value) - channel.stored(read)).abs();
            let allowed = extent / channel.steps * 0.5001 + rounding + 1e-7;
            let fine = error <= allowed || (!channel.is_color && error <= rounding);
            assert!(fine, "{what}: {value} came back as {read}");
        }
    }

    #[test]
    fn packing_what_was_read_changes_nothing() {
        let mut bits = 5u32;
        let mut next = || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        };
        for round in 0..400 {
            for channel in [POSITION[0], POSITION[1], COLOR[0]] {
                let count = [1, 2, 3, 255, 256][round % 5];
                // Ranges from many to a fraction of the last bit, about 0 and far from it.
                let width = [1e30f32, 1e4, 1.0, 1e-3, 1e-5, 1e-6, 1e-7, 1e-30][round % 8];
                let middle = [0.0, 1.0, -3.0, 1.7725, -1.7725, 1e5][round / 8 % 6];
                let values: Vec<f32> = (0..count).map(|_| middle + next() * width).collect();
                check(channel, &values, "random");
            }
        }
        for channel in [POSITION[0], COLOR[0]] {
            for values in [&[-0.0f32, 0.0][..], &[-0.0, -1.0], &[-0.0, 1.0], &[1e-45, 0.0, -1e-45]]
            {
                check(channel, values, "zeros");
            }
            let mut near = vec![0.3f32];
            for _ in 0..6 {
                near.push(near[near.len() - 1].next_up());
                check(channel, &near, "neighbours");
            }
        }
        check(POSITION[0], &[f32::MIN, f32::MAX, 1.0, -1e38], "largest");
    }
}
