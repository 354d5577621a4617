//! SAM 2 and 2.1 on single pictures: a click or a box in, masks out.
//!
//! What only videos need (memory, object pointers) is not read. Weights are those of the authors, `.pt` as they
//! published them or the same names in a `.safetensors` file.

mod config;
mod decoder;
mod neck;
mod prompt;
mod trunk;
mod windows;

pub use config::Sam2Config;
pub use decoder::{MASKS, MaskPrediction};
pub use prompt::{PointLabel, PromptPoint};

use crate::VisionError;
use crate::resize::{Filter, resize_planes, standardize};
use crate::weights::Weights;
use decoder::{Decoder, DecoderPicture};
use neck::Neck;
use prompt::PromptEncoder;
use rayon::prelude::*;
use scenesplat_kernels::Precision;
use scenesplat_scene::picture::RgbPicture;
use std::path::Path;
use trunk::Trunk;

pub(crate) const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
pub(crate) const STD: [f32; 3] = [0.229, 0.224, 0.225];
const HELP: &str = "give the weights of SAM 2 or 2.1 as the authors publish them, such as sam2.1_hiera_large.pt, or the \
                    same names as .safetensors";

/// Parts of the published files that pictures alone do not need.
const UNUSED: &[&str] = &[
    "memory_attention.",
    "memory_encoder.",
    "maskmem_tpos_enc",
    "no_mem_pos_enc",
    "no_obj_ptr",
    "no_obj_embed_spatial",
    "mask_downsample.",
    "obj_ptr_proj.",
    "obj_ptr_tpos_proj.",
    "sam_prompt_encoder.mask_downscaling.",
];

/// A SAM 2 network with its weights.
///
/// Attention runs in blocks of queries, so nothing of the size tokens × tokens is ever in memory.
pub struct Sam2 {
    config: Sam2Config,
    trunk: Trunk,
    neck: Neck,
    prompt: PromptEncoder,
    decoder: Decoder,
    /// Added to the picture's rows where no video came before.
    no_memory: Vec<f32>,
}

impl std::fmt::Debug for Sam2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sam2").field("config", &self.config).finish_non_exhaustive()
    }
}

/// What the network knows of one picture: the larger part of the work, done once.
pub struct Sam2Picture {
    width: u32,
    height: u32,
    inner: DecoderPicture,
}

impl std::fmt::Debug for Sam2Picture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (width, height) = (self.width, self.height);
        f.debug_struct("Sam2Picture").field("width", &width).field("height", &height).finish()
    }
}

impl Sam2Picture {
    /// Width and height of the picture it was made of, pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }
}

impl Sam2 {
    /// Reads a network of these sizes from a `.pt` or `.safetensors` file.
    ///
    /// # Errors
    /// If the sizes make no network, the file cannot be read, a tensor is missing, has another shape or a value that is
    /// not finite, or the file is of another network. The message names file and tensor.
    pub fn load(path: &Path, config: Sam2Config) -> Result<Self, VisionError> {
        Self::load_with(path, config, Precision::F32)
    }

    /// [`load`](Self::load) with the picture encoder's products in another precision. The decoder computes in f32.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_with(
        path: &Path,
        config: Sam2Config,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        config.check()?;
        let mut weights = Weights::open(path, precision, HELP)?;
        let network = Self::take(&mut weights, config, precision)?;
        weights.ignore(|name| UNUSED.iter().any(|part| name.starts_with(part)));
        weights.finish()?;
        Ok(network)
    }

    /// Reads one of the authors' networks, told apart by its shapes.
    ///
    /// # Errors
    /// As [`load`](Self::load); if its shapes are those of none.
    pub fn open(path: &Path, precision: Precision) -> Result<Self, VisionError> {
        let weights = Weights::open(path, precision, HELP)?;
        let patch = weights.entry("image_encoder.trunk.patch_embed.proj.weight");
        let width = patch.and_then(|entry| entry.shape.first().copied());
        let block = |i: usize| {
            weights.entry(&format!("image_encoder.trunk.blocks.{i}.norm1.weight")).is_some()
        };
        let blocks = (0..).take_while(|i| block(*i)).count();
        let Some(config) = Sam2Config::known(width, blocks) else {
            let width = width.map_or("no".to_owned(), |width| width.to_string());
            return Err(weights.bad(format!(
                "{width} channels in {blocks} blocks are none of SAM 2 tiny, small, base_plus and large"
            )));
        };
        drop(weights);
        Self::load_with(path, config, precision)
    }

    /// A network of these sizes with values from a seed: for tests and benchmarks, without meaning.
    ///
    /// # Errors
    /// If the sizes make no network.
    pub fn seeded(
        config: Sam2Config,
        seed: u64,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        config.check()?;
        Self::take(&mut Weights::seeded(seed, precision), config, precision)
    }

    fn take(
        weights: &mut Weights,
        config: Sam2Config,
        precision: Precision,
    ) -> Result<Self, VisionError> {
        let trunk = Trunk::take(weights, &config, precision)?;
        let neck = Neck::take(weights, &config)?;
        weights.use_precision(Precision::F32);
        let prompt = PromptEncoder::take(weights, &config)?;
        let decoder = Decoder::take(weights, &config, &prompt)?;
        let no_memory = weights.take("no_mem_embed", &[1, 1, config.d_model])?;
        Ok(Self { config, trunk, neck, prompt, decoder, no_memory })
    }

    /// The sizes.
    pub fn config(&self) -> &Sam2Config {
        &self.config
    }

    /// Side of a mask's logits, pixels.
    pub fn mask_side(&self) -> usize {
        4 * self.config.decoder_side()
    }

    /// Bytes of the picture encoder's weights as they are held.
    pub fn encoder_bytes(&self) -> usize {
        self.trunk.bytes()
    }

    /// Looks at a picture of any size: squashed to a square, its aspect is not kept.
    ///
    /// # Errors
    /// If the picture has no pixels.
    pub fn encode(&self, picture: &RgbPicture) -> Result<Sam2Picture, VisionError> {
        let size = self.config.image_size as u32;
        let mut planes = resize_planes(picture, size, size, Filter::Bilinear)?;
        standardize(&mut planes, MEAN, STD);
        let inner = self.encode_planes(&planes);
        Ok(Sam2Picture { width: picture.width(), height: picture.height(), inner })
    }

    fn encode_planes(&self, planes: &[f32]) -> DecoderPicture {
        let stages = self.trunk.forward(planes);
        let pyramid = self.neck.forward(&stages, self.config.side());
        drop(stages);
        let mut rows = pyramid.coarse;
        let width = self.config.d_model;
        for row in rows.chunks_exact_mut(width) {
            // Memory that is not there, and the mask that is not given.
            for (i, v) in row.iter_mut().enumerate() {
                *v = *v + self.no_memory[i] + self.prompt.no_mask[i];
            }
        }
        self.decoder.picture(rows, &pyramid.middle, &pyramid.fine)
    }

    /// The masks of some prompts, each a list of points.
    ///
    /// # Errors
    /// If a prompt has no point, or a point is not finite.
    pub fn predict(
        &self,
        picture: &Sam2Picture,
        prompts: &[Vec<PromptPoint>],
    ) -> Result<Vec<MaskPrediction>, VisionError> {
        let scale =
            [picture.width, picture.height].map(|s| self.config.image_size as f32 / s as f32);
        let square = |points: &Vec<PromptPoint>| {
            if points.is_empty() {
                return Err(VisionError::input("prompt", "has no point"));
            }
            let into = |p: &PromptPoint| {
                if p.at.iter().any(|v| !v.is_finite()) {
                    return Err(VisionError::input("prompt", format!("has a point at {:?}", p.at)));
                }
                Ok(PromptPoint { at: [p.at[0] * scale[0], p.at[1] * scale[1]], label: p.label })
            };
            points.iter().map(into).collect::<Result<Vec<_>, _>>()
        };
        let prompts = prompts.iter().map(square).collect::<Result<Vec<_>, _>>()?;
        let one = |points: &Vec<PromptPoint>| {
            self.decoder.masks(&picture.inner, &self.prompt.tokens(points))
        };
        Ok(prompts.par_iter().map(one).collect())
    }
}

#[cfg(test)]
mod tests;
