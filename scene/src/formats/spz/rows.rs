//! Decoding a block into an array, without ever holding the block.

use super::header::{Block, Header};
use super::source::Source;

/// Bytes decompressed at a time: they are still in the cache when they are decoded.
const BLOCK_BYTES: usize = 128 << 10;

/// Rows are decoded in multiples of this, so that patterns of signs stay in step.
pub(super) const ROW_STEP: usize = 16;

/// Decompressed bytes per compressed one for which memory is reserved at once. Real blocks are
/// below 4; where a stream claims more, memory grows with what it delivers.
const HONEST_RATIO: usize = 8;

/// A buffer for [`read_block`], reused from block to block.
#[derive(Default)]
pub(super) struct Buffer(Vec<u8>);

/// Reads one block: `decode` gets whole rows and appends `per_row` values for each.
///
/// The array that comes back has exactly `header.rows · per_row` values. At no time is more than
/// four times the memory reserved that either the stream has filled already or a stream of that
/// length can honestly fill.
pub(super) fn read_block<T>(
    source: &mut Source<'_>,
    buffer: &mut Buffer,
    header: &Header,
    block: Block,
    per_row: usize,
    mut decode: impl FnMut(&[u8], &mut Vec<T>),
) -> Result<Vec<T>, String> {
    let row_bytes = block.row_bytes(header);
    let fail = |problem: String| format!("its {} {problem}", block.name());
    let too_large = || fail(format!("of {} Gaussians do not fit into memory", header.rows));
    let total = header.rows.checked_mul(per_row).ok_or_else(too_large)?;
    let rows_at_once = (BLOCK_BYTES / row_bytes / ROW_STEP * ROW_STEP).min(header.rows);
    buffer.0.resize(rows_at_once * row_bytes, 0);
    let honest = source.left().saturating_mul(HONEST_RATIO) / row_bytes * per_row;
    let mut out = Vec::new();
    let mut row = 0;
    while row < header.rows {
        let rows = rows_at_once.min(header.rows - row);
        let bytes = &mut buffer.0[..rows * row_bytes];
        let got = source.fill(bytes).map_err(fail)?;
        if got < bytes.len() {
            return Err(fail(format!(
                "end after {} of {} Gaussians",
                row + got / row_bytes,
                header.rows
            )));
        }
        if out.capacity() - out.len() < rows * per_row {
            let want = (out.len() * 4).max(honest).max(out.len() + rows * per_row).min(total);
            out.try_reserve_exact(want - out.len()).map_err(|_| too_large())?;
        }
        decode(bytes, &mut out);
        row += rows;
    }
    Ok(out)
}

/// Decompresses a block and forgets it.
pub(super) fn skip_block(
    source: &mut Source<'_>,
    buffer: &mut Buffer,
    header: &Header,
    block: Block,
) -> Result<(), String> {
    read_block::<()>(source, buffer, header, block, 0, |_, _| ()).map(|_| ())
}
