//! Rows times a matrix: linear layers, and submanifold convolutions as one product over all taps.

use super::{Rows, Stored, halves, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

const TEXT: &str = include_str!("../../wgsl/product.wgsl");
/// Result rows of a workgroup.
const ROWS: u64 = 64;
/// No row, in tables of source rows.
pub const NONE: u32 = u32::MAX;

/// Weights of a layer on the device: `[taps, inputs, outputs]`, the last in fours, and a bias.
#[derive(Debug, Clone)]
pub struct Weights {
    values: Rows,
    bias: Option<Array<f32>>,
    inputs: usize,
    outputs: usize,
    taps: usize,
}

impl Weights {
    /// Weights in the layout of PyTorch.
    ///
    /// # Shapes
    /// `weight`: `[outputs, taps, inputs]`, a linear layer with one tap · `bias`: `[outputs]`
    ///
    /// # Errors
    /// If lengths do not fit, or the device has no room.
    pub fn upload(
        gpu: &Gpu,
        weight: &[f32],
        bias: Option<&[f32]>,
        [outputs, taps, inputs]: [usize; 3],
        stored: Stored,
    ) -> Result<Self> {
        if weight.len() != outputs * taps * inputs || bias.is_some_and(|b| b.len() != outputs) {
            let (w, b) = (weight.len(), bias.map_or(0, <[f32]>::len));
            return shape(format!(
                "weights of {outputs} x {taps} x {inputs}: {w} values, and {b} of the bias"
            ));
        }
        let columns = outputs.next_multiple_of(4);
        let mut packed = vec![0f32; taps * inputs * columns];
        for (o, of_output) in weight.chunks_exact((taps * inputs).max(1)).enumerate() {
            for (at, value) in of_output.iter().enumerate() {
                packed[at * columns + o] = *value;
            }
        }
        let values = match stored {
            Stored::F32 => super::Values::F32(gpu.upload("weights", &packed)?),
            Stored::F16 => super::Values::F16(gpu.upload("weights", &halves("weights", &packed)?)?),
        };
        let values = Rows { values, rows: taps * inputs, channels: columns };
        let bias = bias.map(|bias| gpu.upload("bias", bias)).transpose()?;
        Ok(Self { values, bias, inputs, outputs, taps })
    }

    /// Width of the rows that it reads.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Width of the rows that it makes.
    pub fn outputs(&self) -> usize {
        self.outputs
    }
}

/// Which rows a product reads, and where its results go.
#[derive(Debug, Clone, Default)]
pub struct Product<'a> {
    /// The source rows of a plain product, the result rows of a convolution, or the part of the lists that counts; all by
    /// default.
    pub range: Option<Range<usize>>,
    /// Where the first result row goes; by default where the range begins.
    pub at: Option<usize>,
    /// Source row of each result row, counted from `base`.
    pub gather: Option<&'a Array<u32>>,
    /// The number in that list that means row 0.
    pub base: usize,
    /// Source row of each tap and result row of the range, or [`NONE`]. `[taps, range]`
    pub table: Option<&'a Array<u32>>,
    /// The row of `into` where each result row goes.
    pub scatter: Option<&'a Array<u32>>,
    /// Rows that exist already and are written to.
    pub into: Option<&'a Rows>,
    /// Whether a GELU follows.
    pub gelu: bool,
    /// Rows that are added behind it, each at the place where the result goes.
    pub residual: Option<&'a Rows>,
    /// Instead: the row of the residual for each place.
    pub residual_rows: Option<&'a Array<u32>>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    first: u32,
    at: u32,
    inputs: u32,
    outputs: u32,
    columns: u32,
    taps: u32,
    base: u32,
}

/// `ending(x · weight + bias)`.
///
/// # Shapes
/// `x`: `[N, inputs]` → `[N, outputs]`, or as many rows as a list has
///
/// # Errors
/// If sizes do not fit together, or the device has no room.
pub fn product(
    commands: &mut Commands,
    x: &Rows,
    weights: &Weights,
    how: &Product<'_>,
) -> Result<Rows> {
    let stored = x.stored();
    if x.channels != weights.inputs || weights.values.stored() != stored {
        return shape(format!(
            "product: rows of {} ({stored:?}), weights for {} ({:?})",
            x.channels,
            weights.inputs,
            weights.values.stored()
        ));
    }
    let range = match (&how.range, how.gather) {
        (Some(range), _) => range.clone(),
        (None, Some(list)) => 0..list.len(),
        (None, None) => 0..x.rows,
    };
    let rows = range.len();
    let at = how.at.unwrap_or(range.start);
    let lists = usize::from(how.gather.is_some()) + usize::from(how.table.is_some());
    if lists > 1
        || (weights.taps > 1 && how.table.is_none())
        || how.table.is_some_and(|table| table.len() != rows * weights.taps)
        || how.gather.is_some_and(|list| list.len() < range.end)
        || (lists == 0 && range.end > x.rows)
        || how.scatter.is_some_and(|list| list.len() < range.end || how.into.is_none())
    {
        return shape(format!(
            "product: lists that do not fit {rows} rows of {} taps",
            weights.taps
        ));
    }
    let into = match how.into {
        Some(into) => into.clone(),
        None => Rows::new(commands, "a product", at + rows, weights.outputs, stored)?,
    };
    let fits = |rows: &Rows| rows.channels == weights.outputs && rows.stored() == stored;
    if !fits(&into)
        || how.residual.is_some_and(|residual| !fits(residual))
        || (how.scatter.is_none() && into.rows < at + rows)
        || (how.residual_rows.is_none() && how.residual.is_some_and(|r| r.rows < into.rows))
        || (how.residual_rows.is_some() && how.residual.is_none())
    {
        return shape("product: results or residual do not fit");
    }
    let columns = if weights.outputs <= 32 { 32 } else { 64 };
    let mut flags = vec![];
    let mut arrays: Vec<(u32, &dyn Bound)> = vec![(1, x), (2, &weights.values), (3, &into)];
    if let Some(bias) = &weights.bias {
        flags.push("BIAS");
        arrays.push((4, bias));
    }
    match (how.table, how.gather) {
        (Some(table), _) => {
            flags.push("TAPS");
            arrays.push((5, table));
        }
        (None, Some(list)) => {
            flags.push("GATHER");
            arrays.push((5, list));
        }
        (None, None) => flags.push("PLAIN"),
    }
    if let Some(residual) = how.residual {
        flags.push("RESIDUAL");
        arrays.push((6, residual));
    }
    if let Some(list) = how.residual_rows {
        flags.push("RESIDUAL_ROWS");
        arrays.push((7, list));
    }
    if let Some(list) = how.scatter {
        flags.push("SCATTER");
        arrays.push((8, list));
    }
    if how.gelu {
        flags.push("GELU");
    }
    let constants = [("COLUMNS", columns), ("THREADS", columns)];
    let kernel = commands.gpu().kernel("product", TEXT, &stored.with(flags), &constants);
    let params = Params {
        rows: number(rows)?,
        first: number(range.start)?,
        at: number(at)?,
        inputs: number(weights.inputs)?,
        outputs: number(weights.outputs)?,
        columns: number(weights.values.channels / 4)?,
        taps: number(weights.taps)?,
        base: number(how.base)?,
    };
    let across = (weights.outputs as u64).div_ceil(columns.into());
    commands.run(&kernel, &params, &arrays, (rows as u64).div_ceil(ROWS) * across)?;
    Ok(into)
}
