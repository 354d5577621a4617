//! Running sums of whole numbers.

use super::kernels;
use crate::launch::{Items::PerBlock, Launcher, Scalar::U64};

kernels! { "scan":
    /// Sums inside blocks.
    SCAN_BLOCKS = scan_blocks, 256, PerBlock(2048);
    /// Adds the sums before each block.
    SCAN_ADD = scan_add, 256, PerBlock(2048);
}

/// Sums of the values before each.
#[derive(Debug)]
pub struct RunningSums<B> {
    /// `[N]` of `u32`
    pub before: B,
    /// Sum of all values, one `u32`.
    pub total: B,
}

/// `before[i] = values[0] + … + values[i − 1]`, in 32 bits.
///
/// # Shapes
/// `values`: `[N]` of `u32`
///
/// # Errors
/// Those of the launcher.
pub fn running_sums<L: Launcher>(
    l: &L,
    values: &L::Buffer,
    n: u64,
) -> Result<RunningSums<L::Buffer>, L::Error> {
    l.expect::<u32>("values to add up", values, n);
    let blocks = n.div_ceil(SCAN_BLOCKS.items_per_block());
    let mut before = l.alloc_values::<u32>(n as usize)?;
    if blocks == 0 {
        return Ok(RunningSums { before, total: l.upload_values(&[0u32])? });
    }
    let mut totals = l.alloc_values::<u32>(blocks as usize)?;
    l.run(&SCAN_BLOCKS, n, &[values], &mut [&mut before, &mut totals], &[U64(n)])?;
    if blocks == 1 {
        return Ok(RunningSums { before, total: totals });
    }
    let above = running_sums(l, &totals, blocks)?;
    l.run(&SCAN_ADD, n, &[&above.before], &mut [&mut before], &[U64(n)])?;
    Ok(RunningSums { before, total: above.total })
}
