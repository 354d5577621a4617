//! Whether a checkpoint holds a network of this shape.

use super::config::LitePtConfig;
use crate::stages::{STEM, has, has_scales};
use crate::weights::Shapes;

impl LitePtConfig {
    /// Whether first layer, stages, and what each block is made of are those of this network. What
    /// weights do not show (heads, patches, curves, angles) is not asked.
    pub(super) fn has_shapes(&self, shapes: &Shapes) -> bool {
        let (encoder, decoder) = (self.encoder_blocks(), self.decoder_blocks());
        let channels = [self.enc_channels.as_slice(), &self.dec_channels];
        let stem = [self.enc_channels[0], 5, 5, 5, self.in_channels];
        let scales = has_scales(shapes, (STEM, &stem), channels, |half, s| {
            let blocks = if half == "enc" { &encoder[s] } else { &decoder[s] };
            let parts = |block: usize| {
                ["conv.0", "attn.qkv"]
                    .map(|part| format!("{half}.{half}{s}.block{block}.{part}.weight"))
            };
            let same = blocks.iter().enumerate().all(|(i, shape)| {
                let (c, [conv, qkv]) = (shape.attention.channels, parts(i));
                let fits = |name: &str, there: bool, dims: &[usize]| {
                    if there { has(shapes, name, dims) } else { !shapes.contains_key(name) }
                };
                fits(&conv, shape.kind.has_convolution(), &[c, 3, 3, 3, c])
                    && fits(&qkv, shape.kind.has_attention(), &[3 * c, c])
            });
            same && !parts(blocks.len()).iter().any(|name| shapes.contains_key(name))
        });
        scales && !shapes.contains_key("mask_token")
    }
}
