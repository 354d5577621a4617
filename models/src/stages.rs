//! What networks of several scales have in common.

use candle_core::{Result, bail};
use scenesplat_kernels::serialization::Curve;

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

/// Checks the number of stages, and that lists have as many entries as they should.
pub(crate) fn check_lengths(stages: usize, lists: &[(&str, usize, usize)]) -> Result<()> {
    if stages == 0 {
        bail!("enc_depths: at least one stage is needed");
    }
    if stages > MOST_STAGES {
        bail!("enc_depths: {stages} entries, at most {MOST_STAGES} are possible");
    }
    match lists.iter().find(|(_, got, want)| got != want) {
        Some((field, got, want)) => {
            bail!("{field}: expected {want} entries for {stages} encoder stages, got {got}")
        }
        None => Ok(()),
    }
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

/// The largest width, count or size that a network may have: a file may come from anybody, and this is
/// far beyond any network that is known.
pub(crate) const LARGEST: usize = 1 << 14;

/// Fields with their values, the least and the most that each may be.
pub(crate) type Sizes<'a> = [(&'a str, &'a [usize], usize, usize)];

/// Checks that sizes are neither too small nor absurd.
pub(crate) fn check_sizes(sizes: &Sizes<'_>) -> Result<()> {
    for (field, values, least, most) in sizes {
        let bad = values.iter().enumerate().find(|(_, v)| !(least..=most).contains(v));
        let Some((i, value)) = bad else { continue };
        let place = if values.len() > 1 { format!("{field}[{i}]") } else { (*field).to_owned() };
        bail!("{place}: {value} is not in {least} to {most}");
    }
    Ok(())
}

/// Most blocks of a stage.
pub(crate) const DEEPEST: usize = 256;
