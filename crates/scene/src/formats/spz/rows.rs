//! Decoding a block into an array, without ever holding the block.

use super::header::{Block, Header};
use super::source::Source;
use crate::formats::memory::in_large_pages;

/// Bytes decompressed at a time: they are still in the cache when they are decoded.
const BLOCK_BYTES: usize = 128 << 10;

/// Rows are decoded in multiples of this, so that patterns of signs stay in step.
pub(super) const ROW_STEP: usize = 16;

/// Decompressed bytes per compressed one for which memory is reserved at once. Real blocks are
/// below 4; where a stream claims more, memory grows with what it delivers.
const HONEST_RATIO: usize = 8;

/// Below this number of rows, threads cost more than they bring.
const PARALLEL_ROWS: usize = 4096;

/// Buffers for [`read_block`], reused from block to block.
#[derive(Default)]
pub(super) struct Buffers {
    full: Vec<u8>,
    next: Vec<u8>,
}

/// Both results, computed side by side if there are enough rows for that.
pub(super) fn both<A: Send, B: Send>(
    header: &Header,
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    if header.rows >= PARALLEL_ROWS { rayon::join(a, b) } else { (a(), b()) }
}

/// Reads one block: `decode` gets whole rows and as many places for `per_row` values each.
///
/// The array that comes back has exactly `header.rows · per_row` values. While a part is decoded,
/// an idle thread may decompress the next one. At no time is more than four times the memory
/// reserved that either the stream has filled already or a stream of that length can honestly fill.
pub(super) fn read_block<T: Copy + Default + Send>(
    source: &mut Source<'_>,
    buffers: &mut Buffers,
    header: &Header,
    block: Block,
    per_row: usize,
    decode: impl Fn(&[u8], &mut [T]) + Sync,
) -> Result<Vec<T>, String> {
    let row_bytes = block.row_bytes(header);
    let fail = |problem: String| format!("its {} {problem}", block.name());
    let too_large = || fail(format!("of {} Gaussians do not fit into memory", header.rows));
    let total = header.rows.checked_mul(per_row).ok_or_else(too_large)?;
    let rows_at_once = (BLOCK_BYTES / row_bytes / ROW_STEP * ROW_STEP).min(header.rows);
    for buffer in [&mut buffers.full, &mut buffers.next] {
        buffer.resize(rows_at_once * row_bytes, 0);
    }
    let honest = source.left().saturating_mul(HONEST_RATIO) / row_bytes * per_row;
    let mut out: Vec<T> = Vec::new();
    // Rows in `full`, not decoded yet, and rows decoded.
    let (mut ready, mut done) = (0, 0);
    while done < header.rows {
        let rows = rows_at_once.min(header.rows - done - ready);
        let Buffers { full, next } = buffers;
        let next = &mut next[..rows * row_bytes];
        let full = &full[..ready * row_bytes];
        let places = &mut out[done * per_row..(done + ready) * per_row];
        let (got, ()) = both(header, || source.fill(next), || decode(full, places));
        let got = got.map_err(fail)?;
        done += ready;
        if got < rows * row_bytes {
            let whole = done + got / row_bytes;
            return Err(fail(format!("end after {whole} of {} Gaussians", header.rows)));
        }
        ready = rows;
        std::mem::swap(&mut buffers.full, &mut buffers.next);
        let need = (done + ready) * per_row;
        if out.len() < need {
            let size = next_size(total, need, honest.max(done.saturating_mul(4 * per_row)));
            grow(&mut out, size).ok_or_else(too_large)?;
        }
    }
    Ok(out)
}

/// Makes an array longer; `None` if there is not enough memory.
fn grow<T: Copy + Default>(out: &mut Vec<T>, size: usize) -> Option<()> {
    let mut room: Vec<T> = Vec::new();
    room.try_reserve_exact(size).ok()?;
    if out.is_empty() {
        // Zeros from the system are not touched before they are written to; a vector that is
        // filled up with them would be.
        drop(room);
        *out = in_large_pages(vec![T::default(); size]);
    } else {
        room.extend_from_slice(out);
        room.resize(size, T::default());
        *out = room;
    }
    Some(())
}

/// The size for now of an array of `total` values in the end that needs `need` now: at most `allowed`
/// or four times `need`.
///
/// It is `total` divided by a power of four, so that an array is no longer than a quarter of
/// its end when it is moved to its last place, and is there twice for a moment.
fn next_size(total: usize, need: usize, allowed: usize) -> usize {
    let mut size = total;
    while size > allowed && size / 4 >= need {
        size /= 4;
    }
    size.max(need)
}

/// Decompresses a block and forgets it.
pub(super) fn skip_block(
    source: &mut Source<'_>,
    buffers: &mut Buffers,
    header: &Header,
    block: Block,
) -> Result<(), String> {
    read_block::<()>(source, buffers, header, block, 0, |_, _| ()).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_grow_in_quarters_of_the_total() {
        assert_eq!(next_size(1000, 10, 1000), 1000);
        assert_eq!(next_size(1000, 10, 999), 250);
        assert_eq!(next_size(1000, 10, 0), 15);
        assert_eq!(next_size(1000, 10, 62), 62);
        assert_eq!(next_size(1000, 300, 0), 1000);
        assert_eq!(next_size(1, 1, 0), 1);
        for total in [7usize, 4096, 1_000_003, usize::MAX] {
            for need in [1, 5, total / 5, total].into_iter().filter(|&n| n > 0 && n <= total) {
                for allowed in [0, need, total / 3, total] {
                    let got = next_size(total, need, allowed);
                    assert!((need..=total).contains(&got));
                    assert!(got <= allowed.max(need) || got / 4 < need, "{total} {need} {allowed}");
                }
            }
        }
    }
}
