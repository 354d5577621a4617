//! Pictures as vectors.

use super::config::{Config, Preprocessor, Tower};
use super::tower::{Layers, Mlp};
use super::{HELP, is_text};
use crate::VisionError;
use crate::cross_attention::Attention;
use crate::layers::{Linear, Norm, add, to_directions};
use crate::weights::Weights;
use rayon::prelude::*;
use scenesplat_kernels::Precision;
use scenesplat_scene::picture::RgbPicture;
use std::path::Path;

/// Pictures that go through the layers together; more go one lot after the other, with the same bits.
const AT_ONCE: usize = 8;

/// Which program's resizing is followed, where they differ by rounding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Resizing {
    /// Pillow's: two passes, each rounded to 8 bits. What the published processor does.
    #[default]
    Pillow,
    /// torchvision's on tensors, not rounded: what the processor does where `use_fast` is asked for.
    Torchvision,
}

/// SigLIP's picture tower: any picture to a vector of unit length.
///
/// A picture is squashed to the network's square (its aspect is not kept), cut into patches, and a learned query attends
/// over them in the end.
///
/// # Source
/// `SiglipVisionModel` of transformers; of `get_image_features` this is the direction.
pub struct SiglipImageEncoder {
    tower: Tower,
    preprocessor: Preprocessor,
    resizing: Resizing,
    patch: Linear,
    /// `[tokens, width]`
    position: Vec<f32>,
    layers: Layers,
    last_norm: Norm,
    /// `[1, width]`
    probe: Vec<f32>,
    pool: Attention,
    pool_norm: Norm,
    pool_mlp: Mlp,
}

impl std::fmt::Debug for SiglipImageEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SiglipImageEncoder").field("tower", &self.tower).finish_non_exhaustive()
    }
}

impl SiglipImageEncoder {
    /// Reads the picture tower of a folder as the Hugging Face hub lays it out: `config.json`, weights as `.safetensors` or
    /// `.bin`, and `preprocessor_config.json` if it is there. The text tower may be missing and is not read.
    ///
    /// `precision` is that of the layers' products; [`Precision::Bf16`] is faster only on CPUs that have such products.
    ///
    /// # Errors
    /// If a file is missing or damaged, a tensor is missing, has another shape, is not finite or belongs to no part of the
    /// network, or the folder is of another kind of model; the message names file and tensor.
    pub fn load(folder: &Path, precision: Precision) -> Result<Self, VisionError> {
        let config = Config::read(folder)?;
        let preprocessor = Preprocessor::read(folder, config.vision_config.image_size)?;
        let mut weights = Weights::open(folder, precision, HELP)?;
        let encoder = Self::take(&mut weights, config.vision_config, preprocessor, precision)?;
        weights.ignore(|name| is_text(name) || name.ends_with("position_ids"));
        weights.finish()?;
        Ok(encoder)
    }

    /// The tower of siglip2-base-patch16-512 with values from a seed: for tests and benchmarks, without meaning.
    ///
    /// # Errors
    /// Never, unless memory for it cannot be had.
    pub fn seeded_base_512(seed: u64, precision: Precision) -> Result<Self, VisionError> {
        let tower = Tower { image_size: 512, ..Tower::default() };
        let mut weights = Weights::seeded(seed, precision);
        Self::take(&mut weights, tower, Preprocessor::default(), precision)
    }

    fn take(
        weights: &mut Weights,
        tower: Tower,
        preprocessor: Preprocessor,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        let name = |part: &str| format!("vision_model.{part}");
        let (width, patch, eps) = (tower.hidden_size, tower.patch_size, tower.layer_norm_eps);
        let tokens = (tower.image_size / patch).pow(2);
        let pool = name("head.attention");
        let mut joined = weights.take(&format!("{pool}.in_proj_weight"), &[3 * width, width])?;
        let mut bias = weights.take(&format!("{pool}.in_proj_bias"), &[3 * width])?;
        let value = (joined.split_off(2 * width * width), bias.split_off(2 * width));
        let key = (joined.split_off(width * width), bias.split_off(width));
        let out = (
            weights.take(&format!("{pool}.out_proj.weight"), &[width, width])?,
            weights.take(&format!("{pool}.out_proj.bias"), &[width])?,
        );
        let parts = [(joined, bias), key, value, out];
        Ok(Self {
            patch: weights.linear_of(
                &name("embeddings.patch_embedding"),
                3 * patch * patch,
                width,
                &[width, 3, patch, patch],
            )?,
            position: weights
                .take(&name("embeddings.position_embedding.weight"), &[tokens, width])?,
            layers: Layers::take(weights, &name("encoder"), &tower, precision)?,
            last_norm: weights.norm(&name("post_layernorm"), width, eps)?,
            probe: weights.take(&name("head.probe"), &[1, 1, width])?,
            pool: Attention::of(parts, width, width, tower.num_attention_heads),
            pool_norm: weights.norm(&name("head.layernorm"), width, eps)?,
            pool_mlp: Mlp::take(weights, &name("head.mlp"), &tower)?,
            resizing: Resizing::Pillow,
            tower,
            preprocessor,
        })
    }

    /// The same encoder with another way of resizing.
    pub fn with_resizing(mut self, resizing: Resizing) -> Self {
        self.resizing = resizing;
        self
    }

    /// Length of a vector.
    pub fn width(&self) -> usize {
        self.tower.hidden_size
    }

    /// Side of the square that pictures are squashed to, pixels.
    pub fn image_size(&self) -> usize {
        self.tower.image_size
    }

    /// The vectors of some pictures, of unit length. `[pictures, width]`
    ///
    /// A picture's bits do not depend on its batch mates nor on threads.
    ///
    /// # Errors
    /// If a picture has no pixels, or the weights give it no direction; the message counts from 0.
    pub fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, VisionError> {
        let mut rows = self.encode_unscaled(pictures)?;
        to_directions(&mut rows, self.width()).map_err(|index| {
            let problem = "has no vector: the weights of the encoder give it no direction";
            VisionError::input("picture", format!("number {index} {problem}"))
        })?;
        Ok(rows)
    }

    /// The vectors as the network gives them, of any length. `[pictures, width]`
    ///
    /// # Errors
    /// If a picture has no pixels.
    pub fn encode_unscaled(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, VisionError> {
        let (side, rounded) = (self.image_size(), self.resizing == Resizing::Pillow);
        let mut rows = Vec::with_capacity(pictures.len() * self.width());
        for (lot, pictures) in pictures.chunks(AT_ONCE).enumerate() {
            let planes = pictures.par_iter().enumerate().map(|(i, picture)| {
                self.preprocessor.planes(picture, side, rounded).map_err(|error| {
                    let number = lot * AT_ONCE + i;
                    VisionError::input("picture", format!("number {number}: {error}"))
                })
            });
            let planes: Vec<Vec<f32>> = planes.collect::<Result<_, _>>()?;
            rows.extend(self.forward(&planes));
        }
        Ok(rows)
    }

    /// Planes of pictures → rows.
    pub(super) fn forward(&self, pictures: &[Vec<f32>]) -> Vec<f32> {
        let width = self.width();
        let patches: Vec<f32> = pictures.iter().flat_map(|planes| self.patches(planes)).collect();
        let mut x = self.patch.forward(&patches);
        drop(patches);
        x.chunks_exact_mut(self.position.len()).for_each(|x| add(x, &self.position));
        let tokens = self.position.len() / width;
        let x = self.last_norm.forward(&self.layers.forward(x, tokens));
        let pooled = x.par_chunks_exact(tokens * width).map(|x| {
            let seen = self.pool.tokens_to_rows(&self.probe, x, x);
            self.pool_mlp.plus(&self.pool_norm.forward(&seen), &seen)
        });
        pooled.collect::<Vec<_>>().concat()
    }

    /// Pixels of each patch, channel by channel. `[3, side, side] → [tokens, 3 · patch²]`
    fn patches(&self, planes: &[f32]) -> Vec<f32> {
        let (side, patch) = (self.tower.image_size, self.tower.patch_size);
        // What is left at the right and the bottom belongs to no patch.
        let across = side / patch;
        let mut out = Vec::with_capacity(across * across * 3 * patch * patch);
        for token in 0..across * across {
            let (top, left) = (token / across * patch, token % across * patch);
            for channel in 0..3 {
                for y in top..top + patch {
                    out.extend(&planes[(channel * side + y) * side + left..][..patch]);
                }
            }
        }
        out
    }
}
