//! Sizes of SAM 2 networks.

use crate::VisionError;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// The sizes of a SAM 2 network in image mode; the same for 2.0 and 2.1.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sam2Config {
    /// Side of the square that pictures are squashed to, pixels; a multiple of 32.
    pub image_size: usize,
    /// Channels of the first stage; doubled at each further one.
    pub embed_dim: usize,
    /// Heads of the first stage; doubled at each further one.
    pub num_heads: usize,
    /// Blocks of each stage.
    pub stages: [usize; 4],
    /// Blocks that see the whole picture.
    pub global_att_blocks: Vec<usize>,
    /// Side of the windows of each stage, tokens.
    pub window_spec: [usize; 4],
    /// Height and width of the coarse position embedding.
    pub window_pos_embed_bkg_spatial_size: [usize; 2],
    /// Channels of the decoder.
    pub d_model: usize,
    /// Layers of the two-way transformer.
    pub decoder_depth: usize,
    /// Its heads.
    pub decoder_heads: usize,
    /// Hidden channels of its perceptrons.
    pub decoder_mlp: usize,
    /// Hidden channels of the head that predicts a mask's IoU.
    pub iou_hidden: usize,
}

impl Sam2Config {
    fn of(
        embed_dim: usize,
        num_heads: usize,
        stages: [usize; 4],
        global: [usize; 3],
        window_spec: [usize; 4],
        background: usize,
    ) -> Self {
        Self {
            image_size: 1024,
            embed_dim,
            num_heads,
            stages,
            global_att_blocks: global.to_vec(),
            window_spec,
            window_pos_embed_bkg_spatial_size: [background; 2],
            d_model: 256,
            decoder_depth: 2,
            decoder_heads: 8,
            decoder_mlp: 2048,
            iou_hidden: 256,
        }
    }

    /// `sam2_hiera_tiny`, `sam2.1_hiera_tiny`
    pub fn tiny() -> Self {
        Self::of(96, 1, [1, 2, 7, 2], [5, 7, 9], [8, 4, 14, 7], 7)
    }

    /// `sam2_hiera_small`, `sam2.1_hiera_small`
    pub fn small() -> Self {
        Self::of(96, 1, [1, 2, 11, 2], [7, 10, 13], [8, 4, 14, 7], 7)
    }

    /// `sam2_hiera_base_plus`, `sam2.1_hiera_base_plus`
    pub fn base_plus() -> Self {
        Self::of(112, 2, [2, 3, 16, 3], [12, 16, 20], [8, 4, 14, 7], 14)
    }

    /// `sam2_hiera_large`, `sam2.1_hiera_large`: what SceneSplat's labels were made with.
    pub fn large() -> Self {
        Self::of(144, 2, [2, 6, 36, 4], [23, 33, 43], [8, 4, 16, 8], 7)
    }

    /// The authors' network of this width and so many blocks.
    pub(crate) fn known(width: Option<usize>, blocks: usize) -> Option<Self> {
        [Self::tiny(), Self::small(), Self::base_plus(), Self::large()].into_iter().find(|config| {
            Some(config.embed_dim) == width && config.stages.iter().sum::<usize>() == blocks
        })
    }

    /// Side of the first stage, tokens.
    pub(crate) fn side(&self) -> usize {
        self.image_size / 4
    }

    /// Side of the picture's rows in the decoder, tokens.
    pub(crate) fn decoder_side(&self) -> usize {
        self.image_size / 16
    }

    /// Checks that the sizes make a network.
    ///
    /// # Errors
    /// If they do not; the message names the field.
    pub fn check(&self) -> Result<(), VisionError> {
        let require = |holds: bool, field: &'static str, value: &dyn Debug, help: &'static str| {
            if holds {
                return Ok(());
            }
            Err(VisionError::config(field, format!("{value:?}"), help))
        };
        let size = self.image_size;
        let fits = size.is_multiple_of(32) && (32..=4096).contains(&size);
        require(fits, "image_size", &size, "a multiple of 32 up to 4096")?;
        for (field, value, most) in [
            ("embed_dim", self.embed_dim, 1024),
            ("num_heads", self.num_heads, 64),
            ("d_model", self.d_model, 2048),
            ("decoder_depth", self.decoder_depth, 16),
            ("decoder_heads", self.decoder_heads, 64),
            ("decoder_mlp", self.decoder_mlp, 1 << 15),
            ("iou_hidden", self.iou_hidden, 1 << 12),
        ] {
            let help = "too small or larger than any known network";
            require((1..=most).contains(&value), field, &value, help)?;
        }
        let fits = self.embed_dim.is_multiple_of(self.num_heads);
        require(fits, "embed_dim", &self.embed_dim, "a multiple of num_heads")?;
        let width = self.d_model;
        let fits = width.is_multiple_of(8) && (width / 2).is_multiple_of(self.decoder_heads);
        require(fits, "d_model", &width, "a multiple of 8 and of twice decoder_heads")?;
        let fits = !self.stages.contains(&0) && self.stages.iter().sum::<usize>() <= 1000;
        require(fits, "stages", &self.stages, "1 to 1000 blocks in all")?;
        let (side, windows) = (self.side(), &self.window_spec);
        let fits = windows[..3].iter().all(|w| w.is_multiple_of(2))
            && windows.iter().all(|w| (1..=side).contains(w));
        require(fits, "window_spec", windows, "even sides of windows inside the picture")?;
        let help = "its first side must divide a quarter of image_size";
        require(side.is_multiple_of(windows[0]), "window_spec", windows, help)?;
        let coarse = &self.window_pos_embed_bkg_spatial_size;
        let fits = coarse.iter().all(|s| (1..=256).contains(s));
        require(fits, "window_pos_embed_bkg_spatial_size", coarse, "1 to 256 each")?;
        let first = |stage: usize| self.stages[..stage].iter().sum::<usize>();
        for block in &self.global_att_blocks {
            let fits = *block < first(4) && (1..4).all(|stage| first(stage) != *block);
            let help = "blocks that exist and begin no stage";
            require(fits, "global_att_blocks", block, help)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_authors_sizes_are_networks() {
        for config in
            [Sam2Config::tiny(), Sam2Config::small(), Sam2Config::base_plus(), Sam2Config::large()]
        {
            config.check().unwrap();
        }
    }

    #[test]
    fn what_is_no_network_is_refused_by_name() {
        for (change, message) in [
            ((|c| c.image_size = 1000) as fn(&mut Sam2Config), "image_size is 1000"),
            (|c| c.global_att_blocks = vec![44], "global_att_blocks is 44"),
            (|c| c.window_spec = [8, 3, 16, 8], "window_spec is [8, 3, 16, 8]"),
            (|c| c.stages = [2, 0, 36, 4], "stages is [2, 0, 36, 4]"),
        ] {
            let mut config = Sam2Config::large();
            change(&mut config);
            let error = config.check().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    #[test]
    fn the_authors_networks_are_known_by_width_and_blocks() {
        for (width, blocks, config) in [
            (96, 12, Some(Sam2Config::tiny())),
            (96, 16, Some(Sam2Config::small())),
            (112, 24, Some(Sam2Config::base_plus())),
            (144, 48, Some(Sam2Config::large())),
            (96, 13, None),
            (144, 12, None),
        ] {
            assert_eq!(Sam2Config::known(Some(width), blocks), config, "{width} {blocks}");
        }
        assert_eq!(Sam2Config::known(None, 12), None);
    }

    #[test]
    fn windows_and_blocks_with_all_tokens_are_the_published_ones() {
        // From the configuration files of the authors: window_spec, global_att_blocks, stages.
        for (config, windows, global, stages) in [
            (Sam2Config::tiny(), [8, 4, 14, 7], [5, 7, 9], [1, 2, 7, 2]),
            (Sam2Config::small(), [8, 4, 14, 7], [7, 10, 13], [1, 2, 11, 2]),
            (Sam2Config::base_plus(), [8, 4, 14, 7], [12, 16, 20], [2, 3, 16, 3]),
            (Sam2Config::large(), [8, 4, 16, 8], [23, 33, 43], [2, 6, 36, 4]),
        ] {
            assert_eq!((config.window_spec, config.stages), (windows, stages));
            assert_eq!(config.global_att_blocks, global);
        }
    }

    #[test]
    fn the_authors_sizes_are_the_published_ones() {
        // Channels and heads of the first stage, and the side of the coarse embedding; the rest is common.
        for (config, embed_dim, num_heads, coarse) in [
            (Sam2Config::tiny(), 96, 1, 7),
            (Sam2Config::small(), 96, 1, 7),
            (Sam2Config::base_plus(), 112, 2, 14),
            (Sam2Config::large(), 144, 2, 7),
        ] {
            assert_eq!((config.embed_dim, config.num_heads), (embed_dim, num_heads));
            assert_eq!(config.window_pos_embed_bkg_spatial_size, [coarse; 2]);
            assert_eq!((config.image_size, config.d_model, config.iou_hidden), (1024, 256, 256));
            let decoder = (config.decoder_depth, config.decoder_heads, config.decoder_mlp);
            assert_eq!(decoder, (2, 8, 2048));
            assert_eq!((config.side(), config.decoder_side()), (256, 64));
        }
    }

    #[test]
    fn sizes_are_possible_up_to_their_limits() {
        type Change = fn(&mut Sam2Config);
        let good: [Change; 9] = [
            |c| c.image_size = 4096,
            |c| (c.image_size, c.window_spec) = (32, [8, 4, 8, 3]),
            |c| (c.embed_dim, c.num_heads) = (1024, 64),
            |c| (c.d_model, c.decoder_heads) = (2048, 64),
            |c| (c.decoder_depth, c.decoder_mlp, c.iou_hidden) = (16, 1 << 15, 1 << 12),
            |c| (c.decoder_depth, c.decoder_mlp, c.iou_hidden, c.decoder_heads) = (1, 1, 1, 1),
            |c| c.stages = [1, 1, 997, 1],
            |c| c.window_pos_embed_bkg_spatial_size = [1, 256],
            // The last block, and none that begins a stage.
            |c| c.global_att_blocks = vec![0, 47],
        ];
        for (i, change) in good.iter().enumerate() {
            let mut config = Sam2Config::large();
            change(&mut config);
            config.check().unwrap_or_else(|error| panic!("{i}: {error}"));
        }
        let bad: [(Change, &str); 24] = [
            (|c| c.image_size = 0, "image_size is 0: a multiple of 32 up to 4096"),
            (|c| c.image_size = 4128, "image_size is 4128"),
            (|c| c.image_size = 1040, "image_size is 1040"),
            (|c| c.embed_dim = 1026, "embed_dim is 1026: too small or larger"),
            (|c| c.num_heads = 0, "num_heads is 0"),
            (|c| c.num_heads = 65, "num_heads is 65"),
            (|c| c.num_heads = 5, "embed_dim is 144: a multiple of num_heads"),
            (|c| c.d_model = 2056, "d_model is 2056"),
            (|c| c.d_model = 252, "d_model is 252: a multiple of 8"),
            (|c| c.d_model = 24, "d_model is 24: a multiple of 8 and of twice decoder_heads"),
            (|c| c.decoder_depth = 17, "decoder_depth is 17"),
            (|c| c.decoder_heads = 65, "decoder_heads is 65"),
            (|c| c.decoder_mlp = (1 << 15) + 1, "decoder_mlp is 32769"),
            (|c| c.iou_hidden = 4097, "iou_hidden is 4097"),
            (|c| c.stages = [1, 1, 998, 1], "stages is [1, 1, 998, 1]: 1 to 1000"),
            (|c| c.window_spec = [8, 4, 258, 8], "window_spec is [8, 4, 258, 8]: even sides"),
            (|c| c.window_spec = [8, 4, 16, 0], "window_spec is [8, 4, 16, 0]"),
            (|c| c.window_spec = [6, 4, 16, 8], "its first side must divide a quarter"),
            (|c| c.window_pos_embed_bkg_spatial_size = [7, 257], "spatial_size is [7, 257]"),
            (|c| c.window_pos_embed_bkg_spatial_size = [0, 7], "spatial_size is [0, 7]: 1 to 256"),
            // Stages of 2, 6, 36 and 4 blocks begin at 0, 2, 8 and 44.
            (|c| c.global_att_blocks = vec![23, 2], "global_att_blocks is 2: blocks that exist"),
            (|c| c.global_att_blocks = vec![8], "global_att_blocks is 8"),
            (|c| c.global_att_blocks = vec![44], "global_att_blocks is 44"),
            (|c| c.global_att_blocks = vec![48], "global_att_blocks is 48"),
        ];
        for (change, message) in bad {
            let mut config = Sam2Config::large();
            change(&mut config);
            let error = config.check().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
