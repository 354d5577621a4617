//! Lists of numbers: of rows, of slots, of groups.

use super::{groups_of_256, number};
use crate::error::Result;
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};

const TEXT: &str = include_str!("../../wgsl/lists.wgsl");

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    len: u32,
    pad: [u32; 3],
}

/// 0, 1, 2, …. `[len]`
///
/// # Errors
/// If the device has no room.
pub fn count_up(commands: &mut Commands, len: usize) -> Result<Array<u32>> {
    let out = commands.array("a list", len)?;
    run(commands, "COUNT", &[(1, &out)], len)?;
    Ok(out)
}

/// `out[list[i]] = i` for a list with each of `0..N` once. `[N] → [N]`
///
/// # Errors
/// If the device has no room.
pub fn invert(commands: &mut Commands, list: &Array<u32>) -> Result<Array<u32>> {
    let out = commands.array("a list", list.len())?;
    run(commands, "INVERT", &[(1, &out), (2, list)], list.len())?;
    Ok(out)
}

/// `out[i] = values[list[i]]`. The entries of the list must be below M. `values`: `[M]` · `list`: `[N]` → `[N]`
///
/// # Errors
/// If the device has no room.
pub fn compose(
    commands: &mut Commands,
    values: &Array<u32>,
    list: &Array<u32>,
) -> Result<Array<u32>> {
    let out = commands.array("a list", list.len())?;
    run(commands, "COMPOSE", &[(1, &out), (2, list), (3, values)], list.len())?;
    Ok(out)
}

fn run(
    commands: &mut Commands,
    flag: &str,
    arrays: &[(u32, &dyn Bound)],
    len: usize,
) -> Result<()> {
    let kernel = commands.gpu().kernel("lists", TEXT, &[flag], &[]);
    let params = Params { len: number(len)?, pad: [0; 3] };
    commands.run(&kernel, &params, arrays, groups_of_256(len))
}
