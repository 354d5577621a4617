//! Submanifold sparse convolution, forward and backward.

use super::kernel_map::{self, KernelMap};
use super::kernels;
use crate::launch::{
    Items::{PerBlock, PerThread},
    Launcher,
    Scalar::{U32, U64},
};

kernels! { "sparse_conv":
    /// All taps in one launch, a tile of 64 rows and 64 channels a block.
    CONV_FUSED = conv_fused, 256, PerBlock(1);
    /// Fills rows with the bias.
    CONV_BEGIN = conv_begin, 256, PerThread;
    /// The pairs of one tap.
    CONV_TAP = conv_tap, 256, PerBlock(1);
    /// Gradient of the input where rows share voxels.
    CONV_EXCHANGED = conv_exchanged, 256, PerThread;
    /// Parts of the gradient of the weight.
    CONV_WEIGHT = conv_weight, 256, PerBlock(1);
    /// Sums of these parts.
    CONV_WEIGHT_SUM = conv_weight_sum, 256, PerThread;
}

/// Rows, or output channels, of a block.
const TILE: u32 = 64;
/// Output and input channels of a block of the weight's gradient.
const WEIGHT_TILE: u32 = 32;
/// Channels up to which all taps go in one launch: one tile holds them all, so that a row is gathered once. Above, each
/// row of a tap would be gathered again for every tile of channels whether it has a neighbor or not.
const FUSED_CHANNELS: u32 = 64;
/// Largest gradient of a weight of which there are several partial sums, bytes.
const PARTIAL_BYTES: u64 = 2 << 20;
/// Stretches of pairs with a partial sum of their own. Fixed, so that the order of summation is.
const STRETCHES: u32 = 16;

/// Which way a convolution is computed; all give the sums of the same products.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Fused for 64 channels and fewer, tap by tap above.
    #[default]
    ByWidth,
    /// One launch for all taps.
    Fused,
    /// One launch for each tap, over the pairs without gaps.
    TapByTap,
}

impl Method {
    fn is_fused(self, cout: u32) -> bool {
        match self {
            Self::ByWidth => cout <= FUSED_CHANNELS,
            Self::Fused => true,
            Self::TapByTap => false,
        }
    }
}

/// How weights `[cout, taps, cin]` are read.
#[derive(Debug, Clone, Copy)]
struct Strides {
    out: u64,
    tap: u64,
    input: u64,
    mirrored: bool,
}

/// `out[p] = bias + Σ_tap W[:, tap, :] · x[p + tap − centre]` over occupied voxels, taps in order.
///
/// # Shapes
/// `x`: `[N, cin]` · `weight`: `[cout, k, k, k, cin]` · `bias`: `[cout]` · `out`: `[N, cout]`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn forward<L: Launcher>(
    l: &L,
    method: Method,
    map: &KernelMap<L::Buffer>,
    x: &L::Buffer,
    weight: &L::Buffer,
    bias: Option<&L::Buffer>,
    cin: u32,
    cout: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let row = u64::from(map.taps()) * u64::from(cin);
    let strides = Strides { out: row, tap: cin.into(), input: 1, mirrored: false };
    l.expect::<f32>("weight of the convolution", weight, row * u64::from(cout));
    convolve(l, method, map, x, weight, strides, bias, cin, cout, out)
}

#[allow(clippy::too_many_arguments)]
fn convolve<L: Launcher>(
    l: &L,
    method: Method,
    map: &KernelMap<L::Buffer>,
    x: &L::Buffer,
    weight: &L::Buffer,
    strides: Strides,
    bias: Option<&L::Buffer>,
    cin: u32,
    cout: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    let (n, taps) = (map.rows, map.taps());
    // A tap has as many pairs as there are rows, at most.
    let blocks = u64::from(n.div_ceil(TILE)) * u64::from(cout.div_ceil(TILE));
    let rows = u64::from(n) * u64::from(cout);
    l.expect::<f32>("input of the convolution", x, u64::from(n) * u64::from(cin));
    l.expect::<f32>("output of the convolution", out, rows);
    let has_bias = u32::from(bias.is_some());
    let bias = bias.unwrap_or(weight);
    if method.is_fused(cout) {
        return l.run(
            &CONV_FUSED,
            blocks,
            &[x, &map.neighbors, weight, bias],
            &mut [out],
            &[
                U32(n),
                U32(taps),
                U32(cin),
                U32(cout),
                U64(strides.out),
                U64(strides.tap),
                U64(strides.input),
                U32(strides.mirrored.into()),
                U32(has_bias),
            ],
        );
    }
    l.run(&CONV_BEGIN, rows, &[bias], &mut [out], &[U32(n), U32(cout), U32(has_bias)])?;
    for tap in 0..taps {
        let weight_tap = if strides.mirrored { taps - 1 - tap } else { tap };
        l.run(
            &CONV_TAP,
            blocks,
            &[x, &map.starts, &map.input, &map.output, weight],
            &mut [out],
            &[
                U32(tap),
                U32(weight_tap),
                U32(cin),
                U32(cout),
                U64(strides.out),
                U64(strides.tap),
                U64(strides.input),
            ],
        )?;
    }
    Ok(())
}

/// Gradient of the input.
///
/// # Shapes
/// `grad`: `[N, cout]` · `weight`: `[cout, k, k, k, cin]` · `dx`: `[N, cin]`
///
/// # Errors
/// Those of the launcher.
#[allow(clippy::too_many_arguments)]
pub fn backward_input<L: Launcher>(
    l: &L,
    method: Method,
    map: &KernelMap<L::Buffer>,
    grad: &L::Buffer,
    weight: &L::Buffer,
    cin: u32,
    cout: u32,
    dx: &mut L::Buffer,
) -> Result<(), L::Error> {
    let row = u64::from(map.taps()) * u64::from(cin);
    l.expect::<f32>("weight of the convolution", weight, row * u64::from(cout));
    if !map.duplicates {
        // Without shared voxels the pairs of a tap are those of the mirrored tap, exchanged.
        let strides = Strides { out: 1, tap: cin.into(), input: row, mirrored: true };
        return convolve(l, method, map, grad, weight, strides, None, cout, cin, dx);
    }
    let count = u64::from(map.rows) * u64::from(cin);
    l.expect::<f32>("gradient of the input", dx, count);
    l.expect::<f32>("gradient of the output", grad, u64::from(map.rows) * u64::from(cout));
    let pairs = kernel_map::exchanged(l, map)?;
    l.run(
        &CONV_EXCHANGED,
        count,
        &[grad, &pairs.keys, &pairs.output, weight],
        &mut [dx],
        &[U32(map.rows), U32(map.pairs), U32(map.taps()), U32(cin), U32(cout)],
    )
}

/// Gradient of the weight. That of the bias is [`super::columns::column_sums`] of `grad`.
///
/// # Shapes
/// `x`: `[N, cin]` · `grad`: `[N, cout]` · `dw`: `[cout, k, k, k, cin]`
///
/// # Errors
/// Those of the launcher.
pub fn backward_weight<L: Launcher>(
    l: &L,
    map: &KernelMap<L::Buffer>,
    x: &L::Buffer,
    grad: &L::Buffer,
    cin: u32,
    cout: u32,
    dw: &mut L::Buffer,
) -> Result<(), L::Error> {
    let taps = map.taps();
    let weights = u64::from(cout) * u64::from(taps) * u64::from(cin);
    l.expect::<f32>("input of the convolution", x, u64::from(map.rows) * u64::from(cin));
    l.expect::<f32>("gradient of the output", grad, u64::from(map.rows) * u64::from(cout));
    l.expect::<f32>("gradient of the weight", dw, weights);
    let stretches = if weights * 4 <= PARTIAL_BYTES { STRETCHES } else { 1 };
    let tiles = u64::from(cout.div_ceil(WEIGHT_TILE)) * u64::from(cin.div_ceil(WEIGHT_TILE));
    let mut parts = l.alloc_values::<f32>(weights as usize * stretches as usize)?;
    l.run(
        &CONV_WEIGHT,
        tiles * u64::from(taps) * u64::from(stretches),
        &[x, grad, &map.starts, &map.input, &map.output],
        &mut [&mut parts],
        &[U32(taps), U32(cin), U32(cout), U32(stretches)],
    )?;
    l.run(&CONV_WEIGHT_SUM, weights, &[&parts], &mut [dw], &[U64(weights), U32(stretches)])
}
