//! What the files beside the weights say.

use crate::VisionError;
use crate::resize::{Filter, resize, resize_planes, standardize};
use scenesplat_scene::input_file::read_text_file;
use scenesplat_scene::picture::RgbPicture;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::Path;

const HELP: &str = "give the folder of a SigLIP or SigLIP 2 model of fixed resolution, such as siglip2-base-patch16-512";

/// `config.json`: published files leave out what is the class's default.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Config {
    #[serde(default = "siglip")]
    model_type: String,
    #[serde(default)]
    pub text_config: Tower,
    #[serde(default)]
    pub vision_config: Tower,
}

/// Sizes of one tower. Keys of the other tower, and those that change nothing here, are passed over.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub(super) struct Tower {
    pub hidden_size: usize,
    pub intermediate_size: usize,
    pub num_hidden_layers: usize,
    pub num_attention_heads: usize,
    pub layer_norm_eps: f32,
    pub hidden_act: String,
    pub image_size: usize,
    pub patch_size: usize,
    pub num_channels: usize,
    pub vision_use_head: bool,
    pub vocab_size: usize,
    pub max_position_embeddings: usize,
    /// Width of a text's vector; `hidden_size` where it is not said.
    pub projection_size: Option<usize>,
}

impl Default for Tower {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            intermediate_size: 3072,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            layer_norm_eps: 1e-6,
            hidden_act: "gelu_pytorch_tanh".to_owned(),
            image_size: 224,
            patch_size: 16,
            num_channels: 3,
            vision_use_head: true,
            vocab_size: 32000,
            max_position_embeddings: 64,
            projection_size: None,
        }
    }
}

fn siglip() -> String {
    "siglip".to_owned()
}

impl Config {
    /// Reads and checks `config.json`.
    pub fn read(folder: &Path) -> Result<Self, VisionError> {
        let path = folder.join("config.json");
        let config: Self = json(&path)?;
        let bad =
            |problem: String| Err(VisionError::Model { path: path.clone(), problem, help: HELP });
        if config.model_type != "siglip" {
            let found = &config.model_type;
            return bad(format!(
                "model_type is {found:?}, only \"siglip\" is known (\"siglip2\" is the kind with pictures of any size)"
            ));
        }
        for (tower, t) in
            [("text_config", &config.text_config), ("vision_config", &config.vision_config)]
        {
            let sizes = [
                ("hidden_size", t.hidden_size, 1 << 13),
                ("intermediate_size", t.intermediate_size, 1 << 15),
                ("num_hidden_layers", t.num_hidden_layers, 1 << 8),
                ("num_attention_heads", t.num_attention_heads, 1 << 8),
                ("vocab_size", t.vocab_size, 1 << 21),
                ("max_position_embeddings", t.max_position_embeddings, 1 << 13),
                ("patch_size", t.patch_size, 1 << 8),
                ("image_size", t.image_size, 1 << 12),
            ];
            if let Some((name, value, most)) = sizes.iter().find(|(_, v, most)| *v == 0 || v > most)
            {
                return bad(format!("{tower}.{name} is {value}, 1 to {most} are possible"));
            }
            if !t.hidden_size.is_multiple_of(t.num_attention_heads) {
                let (width, heads) = (t.hidden_size, t.num_attention_heads);
                return bad(format!(
                    "{tower}.hidden_size {width} is no multiple of num_attention_heads {heads}"
                ));
            }
            if t.hidden_act != "gelu_pytorch_tanh" {
                let act = &t.hidden_act;
                return bad(format!(
                    "{tower}.hidden_act is {act:?}, only \"gelu_pytorch_tanh\" is known"
                ));
            }
            if !(t.layer_norm_eps >= 0.0 && t.layer_norm_eps < 1.0) {
                return bad(format!("{tower}.layer_norm_eps is {}", t.layer_norm_eps));
            }
        }
        let vision = &config.vision_config;
        if vision.num_channels != 3
            || !vision.vision_use_head
            || vision.image_size < vision.patch_size
        {
            return bad(format!(
                "vision_config has num_channels {}, vision_use_head {}, image_size {}: three channels, a head and at \
                 least one patch are needed",
                vision.num_channels, vision.vision_use_head, vision.image_size
            ));
        }
        Ok(config)
    }
}

/// `preprocessor_config.json`: how pictures are brought to the network's size.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub(crate) struct Preprocessor {
    do_resize: bool,
    do_rescale: bool,
    do_normalize: bool,
    resample: u32,
    rescale_factor: f64,
    image_mean: [f32; 3],
    image_std: [f32; 3],
    size: Option<Size>,
}

#[derive(Debug, Clone, Deserialize)]
struct Size {
    height: usize,
    width: usize,
}

impl Default for Preprocessor {
    fn default() -> Self {
        Self {
            do_resize: true,
            do_rescale: true,
            do_normalize: true,
            resample: BILINEAR,
            rescale_factor: 1.0 / 255.0,
            image_mean: [0.5; 3],
            image_std: [0.5; 3],
            size: None,
        }
    }
}

/// Pillow's numbers.
const BILINEAR: u32 = 2;
const BICUBIC: u32 = 3;

impl Preprocessor {
    /// Reads the file, if there is one, for pictures of this side.
    pub fn read(folder: &Path, side: usize) -> Result<Self, VisionError> {
        let path = folder.join("preprocessor_config.json");
        if !path.exists() {
            return Ok(Self::default());
        }
        let found: Self = json(&path)?;
        let bad =
            |problem: String| Err(VisionError::Model { path: path.clone(), problem, help: HELP });
        if !(found.do_resize && found.do_rescale && found.do_normalize) {
            return bad("leaves out one of resizing, rescaling and normalizing".to_owned());
        }
        if !matches!(found.resample, BILINEAR | BICUBIC) {
            return bad(format!(
                "resample is {}, 2 (bilinear) and 3 (bicubic) are known",
                found.resample
            ));
        }
        if (found.rescale_factor * 255.0 - 1.0).abs() > 1e-6 {
            return bad(format!("rescale_factor is {}, 1/255 is known", found.rescale_factor));
        }
        if !found.image_mean.iter().all(|v| v.is_finite())
            || !found.image_std.iter().all(|v| v.is_finite() && *v > 0.0)
        {
            return bad("image_mean or image_std is no color and its spread".to_owned());
        }
        if let Some(size) = found.size.as_ref().filter(|s| s.width != side || s.height != side) {
            return bad(format!(
                "size is {} × {}, the network's pictures are {side} × {side}",
                size.width, size.height
            ));
        }
        Ok(found)
    }

    /// What is beside a network of another kind, and the side of its pictures: `fixed` where that is not 0, else what the file
    /// says, else `otherwise`.
    #[cfg(feature = "onnx")]
    pub fn beside(
        folder: &Path,
        fixed: usize,
        otherwise: usize,
    ) -> Result<(Self, usize), VisionError> {
        let path = folder.join("preprocessor_config.json");
        let side = match fixed {
            0 if path.exists() => json::<Self>(&path)?.size.map_or(otherwise, |size| size.height),
            0 => otherwise,
            fixed => fixed,
        };
        if !(16..=4096).contains(&side) {
            let problem = format!("size is {side}, 16 to 4096 are possible");
            return Err(VisionError::Model { path, problem, help: HELP });
        }
        Ok((Self::read(folder, side)?, side))
    }

    /// A picture as the network reads it, resized as Pillow does, or not rounded. `[3, side, side]`
    pub fn planes(
        &self,
        picture: &RgbPicture,
        side: usize,
        rounded: bool,
    ) -> Result<Vec<f32>, VisionError> {
        let (side, bicubic) = (side as u32, self.resample == BICUBIC);
        let filter = if bicubic { Filter::Bicubic } else { Filter::Bilinear };
        let mut planes = if rounded {
            let small = resize(picture, side, side, filter)?;
            let plane = |c: usize| small.pixels().iter().map(move |p| f32::from(p[c]) / 255.0);
            (0..3).flat_map(plane).collect()
        } else {
            resize_planes(picture, side, side, filter)?
        };
        standardize(&mut planes, self.image_mean, self.image_std);
        Ok(planes)
    }
}

fn json<T: DeserializeOwned>(path: &Path) -> Result<T, VisionError> {
    serde_json::from_str(&read_text_file(path)?).map_err(|error| VisionError::Model {
        path: path.to_owned(),
        problem: format!("is not what SigLIP's folders hold: {error}"),
        help: HELP,
    })
}
