//! Rows of unit length.

use super::{Rows, number};
use crate::error::Result;
use crate::gpu::{Bound, Commands};
use bytemuck::{Pod, Zeroable};

const TEXT: &str = include_str!("../../wgsl/unit_rows.wgsl");

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    channels: u32,
    pad: [u32; 2],
}

/// Each row divided by its length; lengths below 1e-12 count as this. `[N, C] → [N, C]`
///
/// # Errors
/// If the device has no room.
pub fn unit_rows(commands: &mut Commands, x: &Rows) -> Result<Rows> {
    let out = Rows::new(commands, "unit rows", x.rows, x.channels, x.stored())?;
    let kernel = commands.gpu().kernel("unit_rows", TEXT, &x.stored().with(None), &[]);
    let params = Params { rows: number(x.rows)?, channels: number(x.channels)?, pad: [0; 2] };
    let arrays: [(u32, &dyn Bound); 2] = [(1, x), (2, &out)];
    commands.run(&kernel, &params, &arrays, x.rows as u64)?;
    Ok(out)
}
