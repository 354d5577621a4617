//! What networks of several scales have in common.

use candle_core::{Result, bail};

/// `n` values from 0 to `high`.
pub(crate) fn linspace(high: f64, n: usize) -> Vec<f64> {
    (0..n).map(|i| if n > 1 { high * i as f64 / (n - 1) as f64 } else { 0.0 }).collect()
}

/// Values of each stage's blocks.
pub(crate) fn split(depths: &[usize], values: Vec<f64>) -> Vec<Vec<f64>> {
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
pub(crate) const MOST_STAGES: usize = 16;

/// Checks that lists have an entry for each stage.
pub(crate) fn check_lengths(stages: usize, lists: &[(&str, usize)]) -> Result<()> {
    if stages > MOST_STAGES {
        bail!("enc_depths: {stages} stages are more than {MOST_STAGES}, the most that is allowed");
    }
    match lists.iter().find(|(_, length)| *length != stages) {
        Some((field, got)) => {
            bail!("{field}: expected {stages} entries, as many as enc_depths, got {got}")
        }
        None => Ok(()),
    }
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
