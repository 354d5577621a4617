//! Copies of rows by a list.

use super::{Rows, groups_of_256, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};

const TEXT: &str = include_str!("../../wgsl/rows.wgsl");

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    channels: u32,
    pad: [u32; 2],
}

/// Row `list[r]` of `x` at place `r`. The entries of the list must be rows of `x`. `[N, C] → [list, C]`
///
/// # Errors
/// If the device has no room.
pub fn gather(commands: &mut Commands, x: &Rows, list: &Array<u32>) -> Result<Rows> {
    let out = Rows::new(commands, "copies of rows", list.len(), x.channels, x.stored())?;
    run(commands, &[(1, x), (2, list), (3, &out)], &out, None)?;
    Ok(out)
}

/// `x[r] + y[list[r]]`. `x`: `[N, C]` · `y`: `[M, C]` · `list`: `[N]`, below M
///
/// # Errors
/// If sizes do not fit together, or the device has no room.
pub fn add_gathered(
    commands: &mut Commands,
    x: &Rows,
    y: &Rows,
    list: &Array<u32>,
) -> Result<Rows> {
    if list.len() != x.rows || x.channels != y.channels || x.stored() != y.stored() {
        return shape(format!(
            "sums of rows: {} x {} and {} of {}",
            x.rows,
            x.channels,
            list.len(),
            y.channels
        ));
    }
    let out = Rows::new(commands, "sums of rows", x.rows, x.channels, x.stored())?;
    run(commands, &[(1, x), (2, list), (3, &out), (4, y)], &out, Some("ADD"))?;
    Ok(out)
}

fn run(
    commands: &mut Commands,
    arrays: &[(u32, &dyn Bound)],
    out: &Rows,
    flag: Option<&'static str>,
) -> Result<()> {
    let kernel = commands.gpu().kernel("rows", TEXT, &out.stored().with(flag), &[]);
    let (rows, channels) = (number(out.rows)?, number(out.channels)?);
    let params = Params { rows, channels, pad: [0; 2] };
    commands.run(&kernel, &params, arrays, groups_of_256(out.rows * out.channels))
}
