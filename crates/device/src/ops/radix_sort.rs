//! Stable sorting of 64-bit codes with their rows.

use super::{kernels, rows, scan};
use crate::launch::{Items::PerBlock, Launcher, Scalar::U32};

kernels! { "radix_sort":
    /// Digits of each block's stretch.
    SORT_COUNT = sort_count, 256, PerBlock(4096);
    /// Entries to their places.
    SORT_MOVE = sort_move, 256, PerBlock(4096);
}

const DIGIT_BITS: u32 = 8;

/// Codes in ascending order.
#[derive(Debug)]
pub struct Sorted<B> {
    /// `[N]` of `u64`
    pub codes: B,
    /// Row of each. `[N]` of `u32`
    pub rows: B,
}

/// Sorts rows by the lowest `bits` of their codes; equal ones stay in the order of rows.
///
/// # Shapes
/// `codes`: `[N]` of `u64`
///
/// # Errors
/// Those of the launcher.
pub fn sort<L: Launcher>(
    l: &L,
    codes: L::Buffer,
    n: u32,
    bits: u32,
) -> Result<Sorted<L::Buffer>, L::Error> {
    let rows = rows::count_up(l, n)?;
    sort_further(l, Sorted { codes, rows }, n, 0, bits)
}

/// Sorts entries by `bits` bits of their codes from bit `first` on; equal ones stay as they are.
///
/// # Errors
/// Those of the launcher.
pub fn sort_further<L: Launcher>(
    l: &L,
    entries: Sorted<L::Buffer>,
    n: u32,
    first: u32,
    bits: u32,
) -> Result<Sorted<L::Buffer>, L::Error> {
    l.expect::<u64>("codes", &entries.codes, n.into());
    l.expect::<u32>("rows", &entries.rows, n.into());
    if n < 2 || bits == 0 {
        return Ok(entries);
    }
    let blocks = u64::from(n).div_ceil(SORT_COUNT.items_per_block());
    let mut from = entries;
    let mut to = Sorted {
        codes: l.alloc_values::<u64>(n as usize)?,
        rows: l.alloc_values::<u32>(n as usize)?,
    };
    let mut counts = l.alloc_values::<u32>(blocks as usize * (1 << DIGIT_BITS))?;
    let mut shift = first;
    while shift < (first + bits).min(u64::BITS) {
        l.run(&SORT_COUNT, n.into(), &[&from.codes], &mut [&mut counts], &[U32(n), U32(shift)])?;
        let starts = scan::running_sums(l, &counts, blocks << DIGIT_BITS)?.before;
        l.run(
            &SORT_MOVE,
            n.into(),
            &[&from.codes, &from.rows, &starts],
            &mut [&mut to.codes, &mut to.rows],
            &[U32(n), U32(shift)],
        )?;
        std::mem::swap(&mut from, &mut to);
        shift += DIGIT_BITS;
    }
    Ok(from)
}
