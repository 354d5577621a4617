//! Running sums of whole numbers.

use super::number;
use crate::error::Result;
use crate::gpu::{Array, Commands};
use bytemuck::{Pod, Zeroable};

const TEXT: &str = include_str!("../../wgsl/scan.wgsl");
/// Values of a workgroup.
const BLOCK: usize = 2048;

/// Sums of the values before each.
#[derive(Debug, Clone)]
pub struct Sums {
    /// `before[i] = values[0] + … + values[i − 1]`. `[N]`
    pub before: Array<u32>,
    /// Sum of all. `[1]`
    pub total: Array<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    len: u32,
    pad: [u32; 3],
}

/// Running sums, which wrap around beyond 2³². `values`: `[N]`
///
/// # Errors
/// If the device has no room.
pub fn running_sums(commands: &mut Commands, values: &Array<u32>) -> Result<Sums> {
    let len = values.len();
    let before = commands.array("running sums", len)?;
    let blocks = len.div_ceil(BLOCK);
    let totals = commands.array("sums", blocks.max(1))?;
    if blocks == 0 {
        commands.clear(&totals);
        return Ok(Sums { before, total: totals });
    }
    let params = Params { len: number(len)?, pad: [0; 3] };
    let sum = commands.gpu().kernel("scan", TEXT, &[], &[]);
    commands.run(&sum, &params, &[(1, values), (2, &before), (3, &totals)], blocks as u64)?;
    if blocks == 1 {
        return Ok(Sums { before, total: totals });
    }
    let above = running_sums(commands, &totals)?;
    let add = commands.gpu().kernel("scan", TEXT, &["ADD"], &[]);
    commands.run(&add, &params, &[(1, &above.before), (2, &before)], blocks as u64)?;
    Ok(Sums { before, total: above.total })
}
