//! Damage as it happens, and as somebody would do it on purpose.

use crate::common::SplitMix;

/// Numbers that readers trip over.
#[rustfmt::skip]
const WORDS: [u64; 14] = [
    0, 1, 2, 0x7f, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 1 << 40,
    i64::MAX as u64, 1 << 63, u64::MAX,
];

/// A damaged copy of `bytes`.
pub fn mutated(bytes: &[u8], rng: &mut SplitMix) -> Vec<u8> {
    let mut out = bytes.to_vec();
    // Headers are where the sizes are, so half of all damage goes to the first bytes, or to those of
    // a later block, for headers of sections begin at multiples of 1024.
    let focus = if rng.below(2) == 0 { out.len().min(64) } else { out.len() };
    let block = if rng.below(4) == 0 { rng.below(out.len().max(1)) / 1024 * 1024 } else { 0 };
    for _ in 0..1 + rng.below(3) {
        if out.is_empty() {
            return out;
        }
        let at = (block + rng.below(focus)).min(out.len() - 1);
        match rng.below(8) {
            0 => out[at] ^= 1 << rng.below(8),
            1 => out[at] = [0, 1, 0x7f, 0x80, 0xff, b'9', b'-', b'"'][rng.below(8)],
            2 => out.truncate(at),
            3 => {
                let extra = rng.below(200);
                out.extend((0..extra).map(|_| rng.next() as u8));
            }
            4 | 5 => {
                let width = [2, 4, 8][rng.below(3)];
                let word = WORDS[rng.below(WORDS.len())].to_le_bytes();
                let end = (at + width).min(out.len());
                out[at..end].copy_from_slice(&word[..end - at]);
            }
            6 => {
                // A piece of the file over another piece.
                let length = 1 + rng.below(16).min(out.len() - at - 1).min(out.len() - 1);
                let from = rng.below(out.len() - length + 1);
                let piece = out[from..from + length].to_vec();
                let end = (at + length).min(out.len());
                out[at..end].copy_from_slice(&piece[..end - at]);
            }
            _ => {
                // A digit of a text: counts, offsets, versions.
                let digits: Vec<usize> =
                    (0..out.len()).filter(|&i| out[i].is_ascii_digit()).collect();
                if !digits.is_empty() {
                    out[digits[rng.below(digits.len())]] = b"0123456789-.e"[rng.below(13)];
                }
            }
        }
    }
    out
}
