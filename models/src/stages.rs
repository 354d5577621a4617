//! What networks of several scales have in common.

use crate::weights::Shapes;
use candle_core::{Result, bail};
use scenesplat_kernels::serialization::Curve;
use std::ops::RangeInclusive;

/// `n` values from 0 to `high`.
fn linspace(high: f64, n: usize) -> Vec<f64> {
    (0..n).map(|i| if n > 1 { high * i as f64 / (n - 1) as f64 } else { 0.0 }).collect()
}

/// Values of each stage's blocks.
fn split(depths: &[usize], values: Vec<f64>) -> Vec<Vec<f64>> {
    let mut rest = values.into_iter();
    depths.iter().map(|&d| rest.by_ref().take(d).collect()).collect()
}

/// Edge of the coarsest cells in voxels. Edges beyond the grid are as wide as it: every voxel falls
/// into one cell then, wherever a tile begins.
pub(crate) fn edge(strides: &[usize]) -> u32 {
    let product = strides
        .iter()
        .try_fold(1u32, |edge, &stride| edge.checked_mul(u32::try_from(stride).ok()?));
    product.map_or(1 << 21, |edge| edge.min(1 << 21))
}

/// Most scales.
const MOST_STAGES: usize = 16;

/// A field of a configuration: its name, its values, how many there should be, and what each may be. A field that
/// is no list has one value.
pub(crate) type Field<'a> = (&'a str, &'a [usize], usize, RangeInclusive<usize>);

/// Checks the number of stages, that lists have as many entries as they should, and that sizes are neither too
/// small nor absurd.
pub(crate) fn check_fields(stages: usize, fields: &[Field<'_>]) -> Result<()> {
    if stages == 0 {
        bail!("enc_depths: at least one stage is needed");
    }
    if stages > MOST_STAGES {
        bail!("enc_depths: {stages} entries, at most {MOST_STAGES} are possible");
    }
    for (field, values, count, _) in fields {
        check_length(field, values.len(), *count, stages)?;
    }
    for (field, values, _, range) in fields {
        let Some(i) = values.iter().position(|v| !range.contains(v)) else { continue };
        let place = if values.len() > 1 { format!("{field}[{i}]") } else { (*field).to_owned() };
        bail!("{place}: {} is not in {} to {}", values[i], range.start(), range.end());
    }
    Ok(())
}

/// Checks that a list has as many entries as it should.
pub(crate) fn check_length(field: &str, got: usize, want: usize, stages: usize) -> Result<()> {
    if got != want {
        bail!("{field}: expected {want} entries for {stages} encoder stages, got {got}");
    }
    Ok(())
}

/// Checks pooling factors of space-filling curves, and the largest drop rate.
pub(crate) fn check_rates(strides: &[usize], drop_path: f64) -> Result<()> {
    if let Some(i) = strides.iter().position(|s| !s.is_power_of_two()) {
        bail!("stride[{i}]: {} is not a power of two", strides[i]);
    }
    check_drop_path(drop_path)
}

/// Checks the largest drop rate.
pub(crate) fn check_drop_path(drop_path: f64) -> Result<()> {
    if !(0.0..1.0).contains(&drop_path) {
        bail!("drop_path: {drop_path} is not in 0..1");
    }
    Ok(())
}

/// The most entries in a list of curves; there are four.
const MAX_ORDERS: usize = 64;
/// The widest hidden layer of a block, in channels.
pub(crate) const MAX_MLP_RATIO: usize = 64;

/// The curves of these names.
///
/// # Errors
/// If there are none or too many; names one that is unknown.
pub(crate) fn curves(order: &[String]) -> Result<Vec<Curve>> {
    match order.len() {
        0 => bail!("order: at least one curve is needed"),
        1..=MAX_ORDERS => {}
        n => bail!("order: {n} entries, at most {MAX_ORDERS} are possible"),
    }
    let find = |name: &String| match Curve::from_name(name) {
        Some(curve) => Ok(curve),
        None => bail!("order: {name:?} is not one of z, z-trans, hilbert, hilbert-trans"),
    };
    order.iter().map(find).collect()
}

/// Drop rates of the blocks, stage by stage, rising from 0 to `high`.
pub(crate) fn drop_rates(depths: &[usize], high: f64) -> Vec<Vec<f64>> {
    split(depths, linspace(high, depths.iter().sum()))
}

/// As [`drop_rates`] of a decoder, whose coarsest stage runs first and has the highest: each stage is reversed.
pub(crate) fn falling_drop_rates(depths: &[usize], high: f64) -> Vec<Vec<f64>> {
    let mut rates = drop_rates(depths, high);
    rates.iter_mut().for_each(|stage| stage.reverse());
    rates
}

/// Shapes of all blocks, made of the number of the stage, the number of the block in it, and its drop rate.
pub(crate) fn each_block<T>(
    rates: &[Vec<f64>],
    block: impl Fn(usize, usize, f64) -> T,
) -> Vec<Vec<T>> {
    let stage = |(stage, rates): (usize, &Vec<f64>)| {
        rates.iter().enumerate().map(|(i, &rate)| block(stage, i, rate)).collect()
    };
    rates.iter().enumerate().map(stage).collect()
}

/// The largest width, count or size that a network may have: a file may come from anybody, and this is
/// far beyond any network that is known.
pub(crate) const LARGEST: usize = 1 << 14;

/// Most blocks of a stage.
pub(crate) const DEEPEST: usize = 256;

/// The weight of the first layer of a network of voxels, where that is a convolution.
pub(crate) const STEM: &str = "embedding.stem.conv.weight";
/// The same, where it is a linear layer.
pub(crate) const LINEAR_STEM: &str = "embedding.stem.linear.weight";

/// How many inputs the first layer of a checkpoint has, if it has one.
pub(crate) fn stem_inputs(shapes: &Shapes) -> Option<usize> {
    match shapes.get(STEM).or_else(|| shapes.get(LINEAR_STEM))?.as_slice() {
        [_, _, _, _, inputs] | [_, inputs] => Some(*inputs),
        _ => None,
    }
}

/// Whether a checkpoint has a tensor of this name and shape.
pub(crate) fn has(shapes: &Shapes, name: &str, shape: &[usize]) -> bool {
    shapes.get(name).is_some_and(|s| s == shape)
}

/// Channels of the rows that come up to a decoder stage, of the channels of both halves.
pub(crate) fn channels_below(enc: &[usize], dec: &[usize], stage: usize) -> usize {
    dec.get(stage + 1).or(enc.last()).copied().unwrap_or(0)
}

/// Whether the first layer, the pooling and the unpooling of a checkpoint are those of scales with these channels,
/// those of the encoder and of the decoder, and there are no more; and its blocks, as `blocks` says of a half
/// (`"enc"` or `"dec"`) and the number of a stage.
pub(crate) fn has_scales(
    shapes: &Shapes,
    (stem, stem_shape): (&str, &[usize]),
    [enc, dec]: [&[usize]; 2],
    blocks: impl Fn(&str, usize) -> bool,
) -> bool {
    let down = |s: usize| format!("enc.enc{s}.down.proj.weight");
    let up = |s: usize, part: &str| format!("dec.dec{s}.up.{part}.0.weight");
    let encoder = (0..enc.len())
        .all(|s| blocks("enc", s) && (s == 0 || has(shapes, &down(s), &[enc[s], enc[s - 1]])));
    let decoder = (0..dec.len()).all(|s| {
        blocks("dec", s)
            && has(shapes, &up(s, "proj_skip"), &[dec[s], enc[s]])
            && has(shapes, &up(s, "proj"), &[dec[s], channels_below(enc, dec, s)])
    });
    let more =
        shapes.contains_key(&down(enc.len())) || shapes.contains_key(&up(dec.len(), "proj_skip"));
    has(shapes, stem, stem_shape) && encoder && decoder && !more
}
