//! Codes of space-filling curves, and the orders they make.

use super::radix_sort::{Keys, sort, sort_words};
use super::scenes::Scenes;
use super::{groups_of_256, lists, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::serialization::{Curve, MAX_DEPTH};

const TEXT: &str = concat!(
    include_str!("../../wgsl/curves.wgsl"),
    include_str!("../../wgsl/curve_code.wgsl"),
    include_str!("../../wgsl/scene_of.wgsl")
);

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    scenes: u32,
    pad: [u32; 2],
}

/// Codes of cells along a curve, with so many bits an axis in each scene; higher bits are cut off.
///
/// # Shapes
/// `cells`: `[N, 3]` · `depths`: `[B]`, at most [`MAX_DEPTH`] → `[N]`
///
/// # Errors
/// If sizes do not fit together, a depth is too large, or the device has no room.
pub fn codes(
    commands: &mut Commands,
    curve: Curve,
    cells: &Array<[i32; 3]>,
    scenes: &Scenes,
    depths: &[u32],
) -> Result<Keys> {
    let rows = cells.len();
    if scenes.rows() != rows || depths.len() != scenes.len() {
        let (of_scenes, scenes) = (scenes.rows(), scenes.len());
        let depths = depths.len();
        return shape(format!(
            "curve codes: {rows} cells, {scenes} scenes of {of_scenes} rows, {depths} depths"
        ));
    }
    if let Some(depth) = depths.iter().find(|depth| **depth > MAX_DEPTH) {
        return shape(format!("curve codes of {depth} bits an axis, at most {MAX_DEPTH}"));
    }
    let out = Keys::new(commands, rows)?;
    let depths = commands.gpu().upload("depths", depths)?;
    let flags: &[&str] = match curve {
        Curve::Z => &[],
        Curve::ZTrans => &["EXCHANGED"],
        Curve::Hilbert => &["HILBERT"],
        Curve::HilbertTrans => &["HILBERT", "EXCHANGED"],
    };
    let kernel = commands.gpu().kernel("curves", TEXT, flags, &[]);
    let params = Params { rows: number(rows)?, scenes: number(scenes.len())?, pad: [0; 2] };
    let arrays: [(u32, &dyn Bound); 5] =
        [(1, scenes.on_device()), (2, &depths), (3, cells), (4, &out.low), (5, &out.high)];
    commands.run(&kernel, &params, &arrays, groups_of_256(rows))?;
    Ok(out)
}

/// An order of the rows in which each scene's rows stay together.
#[derive(Debug, Clone)]
pub struct DeviceOrder {
    /// `order[position] = row`. `[N]`
    pub order: Array<u32>,
    /// `inverse[row] = position`. `[N]`
    pub inverse: Array<u32>,
}

/// Rows of each scene by ascending code; equal codes stay in the order of rows.
///
/// # Shapes
/// `codes`: `[N]`, each below 2^`bits`
///
/// # Errors
/// If sizes do not fit together, or the device has no room.
pub fn order(
    commands: &mut Commands,
    codes: &Keys,
    scenes: &Scenes,
    bits: u32,
) -> Result<DeviceOrder> {
    if codes.len() != scenes.rows() {
        return shape(format!("curve order: {} codes of {} rows", codes.len(), scenes.rows()));
    }
    let mut order = sort(commands, codes, None, bits)?.rows;
    if scenes.occupied() > 1 {
        // Sorting is stable: inside a scene the rows stay as they are.
        let of_rows = scenes.of_rows(commands, &order)?;
        let scene_bits = usize::BITS - (scenes.len() - 1).leading_zeros();
        order = sort_words(commands, &of_rows, Some(&order), scene_bits)?.1;
    }
    let inverse = lists::invert(commands, &order)?;
    Ok(DeviceOrder { order, inverse })
}
