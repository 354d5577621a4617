//! `.spz` files: every number a byte or three, block by block, compressed.
//!
//! Versions 1 to 3 are a 16-byte header and the blocks positions, alphas, colors, scales, rotations
//! and harmonics, usually as one gzip stream; some programs put them into a zstd frame, or store
//! them as they are. Version 4 is a 32-byte header, a table of contents, and one zstd stream per
//! block. All are read; 2, 3 and 4 are written.
//!
//! # What a block holds
//! | block | bytes a row | value |
//! |---|---|---|
//! | positions | 9 (version 1: 6) | 24-bit fixed point, meters (version 1: f16) |
//! | alphas | 1 | `alpha = b / 255` |
//! | colors | 3 | `dc = (b / 255 − 0.5) / 0.15` |
//! | scales | 3 | `ln σ = b / 16 − 10` |
//! | rotations | 3, from version 3 on 4 | `x, y, z` in 8 bits, or the smaller three in 10 |
//! | harmonics | 3 K | `(b − 128) / 128`, coefficient by coefficient, channel inside |
//!
//! # Frame
//! The format prescribes right, up, back; some programs store the numbers of the PLY file as they
//! are, and only a rare extension record says which. See [`SpzFrame`](super::SpzFrame).
//!
//! # Source
//! <https://github.com/nianticlabs/spz>, the reference implementation, for layout and rounding.

mod attributes;
mod extensions;
mod header;
mod quaternion;
mod reader;
mod rows;
mod signs;
mod source;
mod writer;

pub use reader::read_spz;
pub(crate) use reader::{peek_spz, read_spz_as_stored};
pub(super) use writer::write_spz;

/// Whether a file is an SPZ file: it begins with the mark, or is a gzip or zstd stream that does.
///
/// A stream that is cut off or damaged before four bytes have come out of it is taken for one, too:
/// [`read_spz`] then says what is wrong with it. So the first bytes of a file will do.
pub fn is_spz(bytes: &[u8]) -> bool {
    if bytes.starts_with(&source::GZIP) || bytes.starts_with(&source::ZSTD) {
        return match source::Source::open(bytes) {
            Ok(stream) => stream.may_begin_with(header::MAGIC),
            Err(_) => true,
        };
    }
    bytes.starts_with(&header::MAGIC)
}
