//! The operations of networks, each a kernel and what starts it.
//!
//! | module | what |
//! |---|---|
//! | [`product`] | linear layers and submanifold convolutions, with bias, GELU, residual, and lists of rows |
//! | [`layer_norm`] | normalization over channels |
//! | [`patch_attention`] | attention inside patches of slots |
//! | [`point_rope`] | queries and keys that turn with their voxel |
//! | [`pool`] | rows of groups |
//! | [`rows`] | copies of rows by a list |
//! | [`unit_rows`] | rows of unit length |
//! | [`scan`] | running sums |
//! | [`radix_sort`] | keys and their rows in ascending order |
//! | [`lists`] | lists of numbers: counted up, inverted, composed |
//! | [`scenes`] | which rows belong to which scene |
//! | [`curves`] | codes of space-filling curves, and orders |
//! | [`kernel_map`] | which voxel feeds which in a convolution |
//! | [`grid_sample`] | which points share a voxel |
//! | [`cloud`] | the scales of a scene |

pub mod cloud;
pub mod curves;
pub mod grid_sample;
mod grouping;
pub mod kernel_map;
pub mod layer_norm;
pub mod lists;
pub mod patch_attention;
pub mod point_rope;
pub mod pool;
pub mod product;
pub mod radix_sort;
pub mod rows;
pub mod scan;
pub mod scenes;
pub mod unit_rows;

use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use half::f16;

/// How numbers of rows are stored. All sums are f32.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Stored {
    /// 4 bytes.
    #[default]
    F32,
    /// 2 bytes.
    F16,
}

impl Stored {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }

    /// The flags with the one that says so to a kernel.
    pub(crate) fn with<'a>(self, flags: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
        let own = (self == Self::F16).then_some("F16");
        own.into_iter().chain(flags).collect()
    }
}

/// Values of rows, of either size.
#[derive(Debug, Clone)]
enum Values {
    F32(Array<f32>),
    F16(Array<f16>),
}

/// Rows of channels on the device. Clones share them.
#[derive(Debug, Clone)]
pub struct Rows {
    values: Values,
    rows: usize,
    channels: usize,
}

impl Bound for Rows {
    fn buffer(&self) -> Option<&wgpu::Buffer> {
        match &self.values {
            Values::F32(array) => array.buffer(),
            Values::F16(array) => array.buffer(),
        }
    }
}

impl Rows {
    /// Values from the host. `[rows, channels]`
    ///
    /// # Errors
    /// If their number is not `rows · channels`, or they are too large for the device.
    pub fn upload(gpu: &Gpu, values: &[f32], channels: usize, stored: Stored) -> Result<Self> {
        let rows = values.len().checked_div(channels).unwrap_or(0);
        if rows * channels != values.len() {
            return shape(format!("{} values are no rows of {channels}", values.len()));
        }
        let values = match stored {
            Stored::F32 => Values::F32(gpu.upload("rows", values)?),
            Stored::F16 => Values::F16(gpu.upload("rows", &halves("rows", values)?)?),
        };
        Ok(Self { values, rows, channels })
    }

    /// Rows for kernels to fill; their values are anything until then.
    ///
    /// # Errors
    /// If they are too large for the device.
    pub fn new(
        commands: &mut Commands,
        what: &str,
        rows: usize,
        channels: usize,
        stored: Stored,
    ) -> Result<Self> {
        let len = rows.saturating_mul(channels);
        let values = match stored {
            Stored::F32 => Values::F32(commands.array(what, len)?),
            Stored::F16 => Values::F16(commands.array(what, len)?),
        };
        Ok(Self { values, rows, channels })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Their width.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// How they are stored.
    pub fn stored(&self) -> Stored {
        match self.values {
            Values::F32(_) => Stored::F32,
            Values::F16(_) => Stored::F16,
        }
    }

    /// Runs all commands so far and gives the values. `[rows, channels]`
    ///
    /// # Errors
    /// As [`Commands::read`].
    pub fn read(&self, commands: &mut Commands) -> Result<Vec<f32>> {
        match &self.values {
            Values::F32(array) => commands.read(array),
            Values::F16(array) => Ok(commands.read(array)?.into_iter().map(f16::to_f32).collect()),
        }
    }
}

/// Values rounded to 16 bits.
///
/// # Errors
/// If a number is too large for 16 bits.
fn halves(what: &str, values: &[f32]) -> Result<Vec<f16>> {
    let half = |v: &f32| match f16::from_f32(*v) {
        half if half.is_infinite() && v.is_finite() => {
            shape(format!("{what}: {v} is too large for 16 bits; use --precision f32"))
        }
        half => Ok(half),
    };
    values.iter().map(half).collect()
}

/// A number of rows or channels as kernels take it.
pub(crate) fn number(n: usize) -> Result<u32> {
    match u32::try_from(n) {
        Ok(n) => Ok(n),
        Err(_) => shape(format!("{n} is more than 2³²")),
    }
}

/// Workgroups of 256 invocations for so many of them.
pub(crate) fn groups_of_256(n: usize) -> u64 {
    (n as u64).div_ceil(256)
}
