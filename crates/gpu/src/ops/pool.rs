//! Rows of groups.

use super::{Rows, groups_of_256, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::segment::Reduce;

const TEXT: &str = include_str!("../../wgsl/pool.wgsl");

/// Which rows belong together, on the device.
#[derive(Debug, Clone)]
pub struct DeviceGroups {
    /// Rows, group after group.
    pub rows: Array<u32>,
    /// First place of each group in that list, closed by its length. `[G + 1]`
    pub starts: Array<u32>,
    /// Group of each row.
    pub inverse: Array<u32>,
}

/// A factor and a summand for each channel. `[C]` each
#[derive(Debug, Clone)]
pub struct Affine {
    /// Multiplied with.
    pub factor: Array<f32>,
    /// Added then.
    pub summand: Array<f32>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    groups: u32,
    channels: u32,
    pad: [u32; 2],
}

/// A row for each group, with a factor and summand behind it, and GELU if asked for. `[N, C] → [G, C]`
///
/// # Errors
/// If sizes do not fit together, or the device has no room.
pub fn pool(
    commands: &mut Commands,
    x: &Rows,
    groups: &DeviceGroups,
    how: Reduce,
    affine: Option<&Affine>,
    gelu: bool,
) -> Result<Rows> {
    let (channels, stored) = (x.channels, x.stored());
    let fits = affine.is_none_or(|a| a.factor.len() == channels && a.summand.len() == channels);
    if groups.rows.len() != x.rows || groups.starts.is_empty() || !fits {
        return shape(format!(
            "pooling: groups of {} rows, {} rows of {channels}",
            groups.rows.len(),
            x.rows
        ));
    }
    let count = groups.starts.len() - 1;
    let out = Rows::new(commands, "pooled rows", count, channels, stored)?;
    let mut arrays: Vec<(u32, &dyn Bound)> =
        vec![(1, x), (2, &groups.rows), (3, &groups.starts), (4, &out)];
    let mut flags = vec![];
    match how {
        Reduce::Mean => flags.push("MEAN"),
        Reduce::Max => flags.push("MAX"),
        Reduce::Sum => {}
    }
    if let Some(affine) = affine {
        flags.push("AFFINE");
        arrays.push((5, &affine.factor));
        arrays.push((6, &affine.summand));
    }
    if gelu {
        flags.push("GELU");
    }
    let kernel = commands.gpu().kernel("pool", TEXT, &stored.with(flags), &[]);
    let params = Params { groups: number(count)?, channels: number(channels)?, pad: [0; 2] };
    commands.run(&kernel, &params, &arrays, groups_of_256(count * channels))?;
    Ok(out)
}
