//! Hiera: the picture encoder, four stages of windowed attention.

use super::config::Sam2Config;
use super::windows::Windows;
use crate::VisionError;
use crate::layers::{Linear, Norm, add, mlp_gelu};
use crate::weights::Weights;
use rayon::prelude::*;
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::{Heads, forward_with};

const EPS: f32 = 1e-6;
/// Side, stride and padding of the first convolution.
const KERNEL: usize = 7;
const STRIDE: usize = 4;
const PADDING: usize = 3;

pub(super) struct Trunk {
    side: usize,
    pub patch: Linear,
    /// `[side², embed_dim]`
    pub position: Vec<f32>,
    blocks: Vec<Block>,
    /// Last block of each stage.
    ends: [usize; 4],
}

struct Block {
    norm_attention: Norm,
    qkv: Linear,
    out: Linear,
    norm_mlp: Norm,
    mlp: [Linear; 2],
    /// What brings the skip to another width, at the start of a stage.
    skip: Option<Linear>,
    heads: Heads,
    /// Side of the windows; `None` sees the whole picture.
    window: Option<usize>,
    precision: Precision,
}

impl Trunk {
    pub fn take(
        weights: &mut Weights,
        config: &Sam2Config,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        let name = |part: &str| format!("image_encoder.trunk.{part}");
        let (width, side) = (config.embed_dim, config.side());
        let shape = [width, 3, KERNEL, KERNEL];
        let patch =
            weights.linear_of(&name("patch_embed.proj"), 3 * KERNEL * KERNEL, width, &shape)?;
        let position = position(weights, config)?;
        let mut blocks = Vec::new();
        let mut ends = [0; 4];
        let (mut dim, mut heads) = (width, config.num_heads);
        for (stage, count) in config.stages.into_iter().enumerate() {
            for i in 0..count {
                let index = blocks.len();
                let starts = stage > 0 && i == 0;
                let before = dim;
                if starts {
                    (dim, heads) = (2 * dim, 2 * heads);
                }
                // The first block of a stage still has the windows of the one before.
                let window = config.window_spec[stage - usize::from(starts)];
                let global = config.global_att_blocks.contains(&index);
                blocks.push(Block::take(
                    weights,
                    &name(&format!("blocks.{index}")),
                    [before, dim],
                    heads,
                    (!global).then_some(window),
                    precision,
                )?);
            }
            ends[stage] = blocks.len() - 1;
        }
        Ok(Self { side, patch, position, blocks, ends })
    }

    /// The rows of the four stages, finest first.
    ///
    /// `planes`: `[3, 4 side, 4 side]` · returns `[side², embed_dim]`, `[side²/4, 2 embed_dim]`, …
    pub fn forward(&self, planes: &[f32]) -> [Vec<f32>; 4] {
        let mut x = self.patch.forward(&columns(planes, self.side));
        add(&mut x, &self.position);
        let mut side = self.side;
        let mut stages = [const { Vec::new() }; 4];
        let mut stage = 0;
        for (index, block) in self.blocks.iter().enumerate() {
            (x, side) = block.forward(&x, side);
            if index == self.ends[stage] {
                stages[stage].clone_from(&x);
                stage += 1;
            }
        }
        stages
    }

    pub fn bytes(&self) -> usize {
        let block = |b: &Block| {
            let mlp: usize = b.mlp.iter().map(Linear::bytes).sum();
            b.qkv.bytes() + b.out.bytes() + mlp + b.skip.as_ref().map_or(0, Linear::bytes)
        };
        self.blocks.iter().map(block).sum::<usize>() + self.patch.bytes() + 4 * self.position.len()
    }
}

/// What the first convolution sees of each token. `[side², 3 · 7 · 7]`
pub(super) fn columns(planes: &[f32], side: usize) -> Vec<f32> {
    let size = side * STRIDE;
    let row = 3 * KERNEL * KERNEL;
    let mut out = vec![0.0; side * side * row];
    out.par_chunks_mut(side * row).enumerate().for_each(|(y, out)| {
        for (x, out) in out.chunks_exact_mut(row).enumerate() {
            for (i, out) in out.chunks_exact_mut(KERNEL).enumerate() {
                let (channel, ky) = (i / KERNEL, i % KERNEL);
                let Some(v) = (y * STRIDE + ky).checked_sub(PADDING).filter(|v| *v < size) else {
                    continue;
                };
                for (kx, out) in out.iter_mut().enumerate() {
                    if let Some(u) = (x * STRIDE + kx).checked_sub(PADDING).filter(|u| *u < size) {
                        *out = planes[(channel * size + v) * size + u];
                    }
                }
            }
        }
    });
    out
}

/// The coarse embedding, stretched, and the window's, repeated. `[side², embed_dim]`
fn position(weights: &mut Weights, config: &Sam2Config) -> Result<Vec<f32>, VisionError> {
    let (width, side) = (config.embed_dim, config.side());
    let [high, wide] = config.window_pos_embed_bkg_spatial_size;
    let window = config.window_spec[0];
    let coarse = weights.take("image_encoder.trunk.pos_embed", &[1, width, high, wide])?;
    let tile = weights.take("image_encoder.trunk.pos_embed_window", &[1, width, window, window])?;
    let (down, across) = (cubic(high, side), cubic(wide, side));
    let mut out = vec![0.0; side * side * width];
    out.par_chunks_mut(width).enumerate().for_each(|(token, out)| {
        let (y, x) = (token / side, token % side);
        for (c, out) in out.iter_mut().enumerate() {
            let plane = &coarse[c * high * wide..][..high * wide];
            let mut sum = 0.0;
            for (v, weight_y) in &down[y] {
                let row: f64 =
                    across[x].iter().map(|(u, w)| w * f64::from(plane[v * wide + u])).sum();
                sum += weight_y * row;
            }
            let fine = tile[in_tile(c, window, [y, x])];
            *out = sum as f32 + fine;
        }
    });
    Ok(out)
}

/// Where a channel of the row and column of a token is in the window's embedding, `[C, window, window]`.
fn in_tile(channel: usize, window: usize, [row, column]: [usize; 2]) -> usize {
    (channel * window + row % window) * window + column % window
}

/// Bicubic interpolation as `torch.nn.functional.interpolate` does it: a = −0.75, no antialias, corners not aligned,
/// edges repeated. The four sources of each target with their weights.
fn cubic(from: usize, to: usize) -> Vec<[(usize, f64); 4]> {
    const A: f64 = -0.75;
    let near = |x: f64| ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0;
    let far = |x: f64| ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A;
    (0..to)
        .map(|i| {
            let at = (i as f64 + 0.5) * from as f64 / to as f64 - 0.5;
            let t = at - at.floor();
            let weights = [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)];
            std::array::from_fn(|k| {
                let source = (at.floor() + k as f64 - 1.0).clamp(0.0, (from - 1) as f64);
                (source as usize, weights[k])
            })
        })
        .collect()
}

impl Block {
    fn take(
        weights: &mut Weights,
        prefix: &str,
        [before, dim]: [usize; 2],
        heads: usize,
        window: Option<usize>,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        let name = |part: &str| format!("{prefix}.{part}");
        let skip = before != dim;
        Ok(Self {
            norm_attention: weights.norm(&name("norm1"), before, EPS)?,
            qkv: weights.linear(&name("attn.qkv"), before, 3 * dim)?,
            out: weights.linear(&name("attn.proj"), dim, dim)?,
            norm_mlp: weights.norm(&name("norm2"), dim, EPS)?,
            mlp: [
                weights.linear(&name("mlp.layers.0"), dim, 4 * dim)?,
                weights.linear(&name("mlp.layers.1"), 4 * dim, dim)?,
            ],
            skip: skip.then(|| weights.linear(&name("proj"), before, dim)).transpose()?,
            heads: Heads { count: heads, dim: dim / heads },
            window,
            precision,
        })
    }

    /// `[side², before] → [(side or side / 2)², dim]`
    fn forward(&self, x: &[f32], side: usize) -> (Vec<f32>, usize) {
        let mut y = self.norm_attention.forward(x);
        let dim = self.heads.channels();
        let windows = Windows::new(side, self.window.unwrap_or(side));
        let skip = self.skip.as_ref().map(|skip| halve(&skip.forward(&y), side, dim));
        // Tokens beyond the picture are zero before the product, so they are seen as its bias.
        y.resize(windows.rows() * (x.len() / (side * side)), 0.0);
        let mut qkv = self.qkv.forward(&y);
        drop(y);
        if skip.is_some() {
            windows.pool_queries(&mut qkv, dim);
        }
        let mut attended = vec![0.0; windows.rows() * dim];
        let (patches, order) = (windows.patches(), windows.order());
        forward_with(self.precision, &qkv, self.heads, patches, order, &mut attended);
        drop(qkv);
        let (x, side) = match skip {
            None => {
                attended.truncate(side * side * dim);
                (self.out.plus(&attended, x), side)
            }
            Some(skip) => {
                let attended = windows.pooled(&attended, dim);
                (self.out.plus(&attended, &skip), side / 2)
            }
        };
        let [first, second] = &self.mlp;
        (mlp_gelu(&self.norm_mlp.forward(&x), first, second, &x), side)
    }
}

/// The largest of each 2 × 2 tokens, channel by channel. `[side², dim] → [(side / 2)², dim]`
fn halve(x: &[f32], side: usize, dim: usize) -> Vec<f32> {
    let half = side / 2;
    let mut out = vec![0.0; half * half * dim];
    out.par_chunks_mut(dim).enumerate().for_each(|(token, out)| {
        let (y, u) = (token / half, token % half);
        let row = |dy: usize, dx: usize| &x[((2 * y + dy) * side + 2 * u + dx) * dim..][..dim];
        let rows = [row(0, 0), row(0, 1), row(1, 0), row(1, 1)];
        for (c, out) in out.iter_mut().enumerate() {
            *out = rows[0][c].max(rows[1][c]).max(rows[2][c].max(rows[3][c]));
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_weights_sum_to_one_and_keep_a_line() {
        for (from, to) in [(7, 256), (7, 32), (14, 256), (1, 8)] {
            for taps in cubic(from, to) {
                let sum: f64 = taps.iter().map(|t| t.1).sum();
                assert!((sum - 1.0).abs() < 1e-12);
            }
        }
        // Half way between two tokens, by hand: a/8 and (a + 2)/8 − (a + 3)/4 + 1 of each side.
        assert_eq!(cubic(2, 1)[0].map(|t| t.1), [-0.09375, 0.59375, 0.59375, -0.09375]);
        // On a token, that token alone.
        assert_eq!(cubic(4, 12)[4], [(0, 0.0), (1, 1.0), (2, 0.0), (3, 0.0)]);
    }

    #[test]
    fn the_embedding_of_a_window_repeats_in_rows_and_columns() {
        // A window of 4: channel 1 begins at 16, row 5 is its row 1, column 6 its column 2.
        assert_eq!(in_tile(1, 4, [5, 6]), 16 + 4 + 2);
        assert_eq!(in_tile(0, 8, [7, 0]), 7 * 8);
        assert_eq!(in_tile(2, 1, [3, 9]), 2);
    }
}
