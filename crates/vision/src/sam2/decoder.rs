//! From prompt tokens and a picture's rows to masks.

use super::config::Sam2Config;
use super::prompt::PromptEncoder;
use crate::VisionError;
use crate::cross_attention::Attention;
use crate::layers::{Linear, Norm, ReluMlp, add, gelu};
use crate::weights::Weights;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};

/// ε of the norms of the transformer, and of the one between the upscaling steps.
const EPS: f32 = 1e-5;
const EPS_UPSCALING: f32 = 1e-6;
/// Masks of a prompt: one for when there is one answer, and three from part to whole.
pub const MASKS: usize = 4;

pub(super) struct Decoder {
    width: usize,
    side: usize,
    layers: Vec<TwoWay>,
    last: Attention,
    last_norm: Norm,
    /// Of object score, IoU and masks. `[2 + MASKS, width]`
    tokens: Vec<f32>,
    up: [Linear; 2],
    up_norm: Norm,
    /// What makes of a mask's token the weights of its picture.
    hyper: Vec<ReluMlp>,
    iou: ReluMlp,
    score: ReluMlp,
    high: [Linear; 2],
    /// Where the rows are. `[side², width]`
    grid: Vec<f32>,
}

struct TwoWay {
    among: Attention,
    norms: [Norm; 4],
    to_rows: Attention,
    mlp: ReluMlp,
    to_tokens: Attention,
}

/// What the decoder reads of one picture, made once.
pub(super) struct DecoderPicture {
    /// With the picture's constant added. `[side², width]`
    pub rows: Vec<f32>,
    /// Twice as fine, `width / 4` channels, in the order that [`Decoder::masks`] makes pixels.
    middle: Vec<f32>,
    /// Four times as fine, `width / 8` channels.
    fine: Vec<f32>,
}

/// What the network says of one prompt.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskPrediction {
    /// Above 0 where the object is, for each of the masks: single answer, part, larger part, whole.
    /// `[4, side, side]` with `side` = [`Sam2::mask_side`](super::Sam2::mask_side).
    pub logits: Vec<f32>,
    /// The IoU that each mask is expected to have, 0 to 1.
    pub iou: [f32; MASKS],
    /// Above 0 if there is an object.
    pub object_score: f32,
}

impl Decoder {
    pub fn take(
        weights: &mut Weights,
        config: &Sam2Config,
        prompt: &PromptEncoder,
    ) -> Result<Self, VisionError> {
        let (width, heads) = (config.d_model, config.decoder_heads);
        let name = |part: &str| format!("sam_mask_decoder.{part}");
        let mut tokens = weights.take(&name("obj_score_token.weight"), &[1, width])?;
        tokens.extend(weights.take(&name("iou_token.weight"), &[1, width])?);
        tokens.extend(weights.take(&name("mask_tokens.weight"), &[MASKS, width])?);
        let transformer = |part: &str| name(&format!("transformer.{part}"));
        let layers = (0..config.decoder_depth)
            .map(|i| TwoWay::take(weights, &transformer(&format!("layers.{i}")), config))
            .collect::<Result<_, _>>()?;
        let last = transformer("final_attn_token_to_image");
        let side = config.decoder_side();
        Ok(Self {
            width,
            side,
            layers,
            last: Attention::take(weights, &last, width, width / 2, heads)?,
            last_norm: weights.norm(&transformer("norm_final_attn"), width, EPS)?,
            tokens,
            up: [
                transposed(weights, &name("output_upscaling.0"), width, width / 4)?,
                transposed(weights, &name("output_upscaling.3"), width / 4, width / 8)?,
            ],
            up_norm: weights.norm(&name("output_upscaling.1"), width / 4, EPS_UPSCALING)?,
            hyper: (0..MASKS)
                .map(|i| {
                    let name = name(&format!("output_hypernetworks_mlps.{i}"));
                    perceptron(weights, &name, [width, width, width, width / 8])
                })
                .collect::<Result<_, _>>()?,
            iou: {
                let hidden = config.iou_hidden;
                let sizes = [width, hidden, hidden, MASKS];
                perceptron(weights, &name("iou_prediction_head"), sizes)?
            },
            score: perceptron(weights, &name("pred_obj_score_head"), [width, width, width, 1])?,
            high: [
                weights.linear_of(&name("conv_s0"), width, width / 8, &[width / 8, width, 1, 1])?,
                weights.linear_of(&name("conv_s1"), width, width / 4, &[width / 4, width, 1, 1])?,
            ],
            grid: prompt.grid(side),
        })
    }

    /// Prepares a picture. `coarse`: its rows, ready; `middle` and `fine`: those of the pyramid.
    pub fn picture(&self, coarse: Vec<f32>, middle: &[f32], fine: &[f32]) -> DecoderPicture {
        let fine = in_steps(&self.high[0].forward(fine), self.side, 2, self.width / 8);
        let middle = in_steps(&self.high[1].forward(middle), self.side, 1, self.width / 4);
        DecoderPicture { rows: coarse, middle, fine }
    }

    /// `[T, width]` tokens of a prompt → its masks.
    pub fn masks(&self, picture: &DecoderPicture, prompt: &[f32]) -> MaskPrediction {
        let width = self.width;
        let places = [&self.tokens, prompt].concat();
        let mut tokens = places.clone();
        let mut rows = std::borrow::Cow::Borrowed(&picture.rows);
        for (index, layer) in self.layers.iter().enumerate() {
            let next = layer.forward(&mut tokens, &rows, &places, &self.grid, index == 0);
            rows = std::borrow::Cow::Owned(next);
        }
        let placed = sum(&rows, &self.grid);
        let seen = self.last.tokens_to_rows(&sum(&tokens, &places), &placed, &rows);
        drop(placed);
        add(&mut tokens, &seen);
        let tokens = self.last_norm.forward(&tokens);
        let token = |i: usize| &tokens[i * width..(i + 1) * width];

        let (wide, narrow) = (width / 4, width / 8);
        let mut x = self.up[0].plus(&rows, &picture.middle);
        x = self.up_norm.forward(&x);
        gelu(&mut x);
        // A row of four pixels is four rows of one.
        let mut pixels = self.up[1].plus(&x, &picture.fine);
        debug_assert_eq!(x.len() / wide * 4, pixels.len() / narrow);
        drop(x);
        gelu(&mut pixels);
        let hyper: Vec<f32> =
            self.hyper.iter().enumerate().flat_map(|(i, h)| h.forward(token(2 + i))).collect();
        let packed = PackedMatrix::from_strided(&hyper, narrow, MASKS, 1, narrow);
        let mut stepped = vec![0.0; pixels.len() / narrow * MASKS];
        gemm(&pixels, &packed, Epilogue::default(), &mut stepped);

        let score = self.iou.forward(token(1));
        MaskPrediction {
            logits: raster(&stepped, self.side),
            iou: std::array::from_fn(|i| 1.0 / (1.0 + (-score[i]).exp())),
            object_score: self.score.forward(token(0))[0],
        }
    }
}

impl TwoWay {
    fn take(weights: &mut Weights, prefix: &str, config: &Sam2Config) -> Result<Self, VisionError> {
        let (width, heads) = (config.d_model, config.decoder_heads);
        let name = |part: &str| format!("{prefix}.{part}");
        let mut norm = |i: usize| weights.norm(&name(&format!("norm{i}")), width, EPS);
        let norms = [norm(1)?, norm(2)?, norm(3)?, norm(4)?];
        let half = width / 2;
        let mut attention =
            |part: &str, inner| Attention::take(weights, &name(part), width, inner, heads);
        Ok(Self {
            norms,
            among: attention("self_attn", width)?,
            to_rows: attention("cross_attn_token_to_image", half)?,
            to_tokens: attention("cross_attn_image_to_token", half)?,
            mlp: ReluMlp(vec![
                weights.linear(&name("mlp.layers.0"), width, config.decoder_mlp)?,
                weights.linear(&name("mlp.layers.1"), config.decoder_mlp, width)?,
            ]),
        })
    }

    /// Changes the tokens; returns the rows that follow.
    fn forward(
        &self,
        tokens: &mut Vec<f32>,
        rows: &[f32],
        places: &[f32],
        grid: &[f32],
        first: bool,
    ) -> Vec<f32> {
        let [norm1, norm2, norm3, norm4] = &self.norms;
        if first {
            // The first layer's tokens are their places already: no places, and no residual.
            *tokens = self.among.among(tokens, tokens, tokens);
        } else {
            let placed = sum(tokens, places);
            let seen = self.among.among(&placed, &placed, tokens);
            add(tokens, &seen);
        }
        *tokens = norm1.forward(tokens);
        let placed_rows = sum(rows, grid);
        let seen = self.to_rows.tokens_to_rows(&sum(tokens, places), &placed_rows, rows);
        add(tokens, &seen);
        *tokens = norm2.forward(tokens);
        let next = self.mlp.forward(tokens);
        add(tokens, &next);
        *tokens = norm3.forward(tokens);
        let placed = sum(tokens, places);
        norm4.forward(&self.to_tokens.rows_to_tokens(&placed_rows, rows, &placed, tokens))
    }
}

fn sum(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

fn perceptron<const N: usize>(
    weights: &mut Weights,
    prefix: &str,
    sizes: [usize; N],
) -> Result<ReluMlp, VisionError> {
    let layers = sizes.windows(2).enumerate();
    let layers =
        layers.map(|(i, pair)| weights.linear(&format!("{prefix}.layers.{i}"), pair[0], pair[1]));
    layers.collect::<Result<_, _>>().map(ReluMlp)
}

/// A transposed convolution of 2 × 2 pixels without overlap: each row becomes four, `[dy, dx, cout]`.
fn transposed(
    weights: &mut Weights,
    name: &str,
    cin: usize,
    cout: usize,
) -> Result<Linear, VisionError> {
    let stored = weights.take(&format!("{name}.weight"), &[cin, cout, 2, 2])?;
    let bias = weights.take(&format!("{name}.bias"), &[cout])?;
    let mut weight = vec![0.0; stored.len()];
    for (i, value) in stored.iter().enumerate() {
        let (input, output, step) = (i / 4 / cout, i / 4 % cout, i % 4);
        weight[(step * cout + output) * cin + input] = *value;
    }
    Ok(weights.pack(&weight, cin, 4 * cout, bias.repeat(4)))
}

/// Pixel of the raster at a place in steps: `place` counts pixels of the coarse square, then of each halving the four
/// within. Returns row and column.
fn pixel(place: usize, side: usize, steps: usize) -> [usize; 2] {
    let token = place >> (2 * steps);
    let (mut y, mut x) = (token / side, token % side);
    for step in (0..steps).rev() {
        let quarter = place >> (2 * step) & 3;
        (y, x) = (2 * y + quarter / 2, 2 * x + quarter % 2);
    }
    [y, x]
}

/// Rows of a raster `2^steps` times as fine as the decoder's, in the order of [`pixel`].
fn in_steps(raster: &[f32], side: usize, steps: usize, width: usize) -> Vec<f32> {
    let wide = side << steps;
    let mut out = vec![0.0; raster.len()];
    for (place, out) in out.chunks_exact_mut(width).enumerate() {
        let [y, x] = pixel(place, side, steps);
        out.copy_from_slice(&raster[(y * wide + x) * width..][..width]);
    }
    out
}

/// `[pixels in steps, MASKS] → [MASKS, 4 side, 4 side]`
fn raster(stepped: &[f32], side: usize) -> Vec<f32> {
    let wide = 4 * side;
    let mut out = vec![0.0; stepped.len()];
    for (place, values) in stepped.chunks_exact(MASKS).enumerate() {
        let [y, x] = pixel(place, side, 2);
        for (mask, value) in values.iter().enumerate() {
            out[(mask * wide + y) * wide + x] = *value;
        }
    }
    out
}
