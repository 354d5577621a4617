//! Whether a checkpoint holds a network of this shape.

use super::block::BlockShape;
use super::config::LitePtConfig;
use crate::weights::Shapes;

const STEM: &str = "embedding.stem.conv.weight";

impl LitePtConfig {
    /// Takes the number of inputs from the first layer of a checkpoint, if it has one.
    pub(super) fn take_inputs(&mut self, shapes: &Shapes) {
        if let Some([_, _, _, _, inputs]) = shapes.get(STEM).map(Vec::as_slice) {
            self.in_channels = *inputs;
        }
    }

    /// Whether first layer, stages, and what each block is made of are those of this network. What
    /// weights do not show (heads, patches, curves, angles) is not asked.
    pub(super) fn has_shapes(&self, shapes: &Shapes) -> bool {
        let is = |name: String, shape: &[usize]| shapes.get(&name).is_some_and(|s| s == shape);
        let parts =
            |name: &str| [format!("{name}.conv.0.weight"), format!("{name}.attn.qkv.weight")];
        let has_blocks = |stage: &str, blocks: &[BlockShape]| {
            let same = blocks.iter().enumerate().all(|(i, shape)| {
                let c = shape.attention.channels;
                let [conv, qkv] = parts(&format!("{stage}.block{i}"));
                let has = |name: String, there: bool, dims: &[usize]| {
                    if there { is(name, dims) } else { !shapes.contains_key(&name) }
                };
                has(conv, shape.kind.has_convolution(), &[c, 3, 3, 3, c])
                    && has(qkv, shape.kind.has_attention(), &[3 * c, c])
            });
            let more = parts(&format!("{stage}.block{}", blocks.len()));
            same && !more.iter().any(|name| shapes.contains_key(name))
        };
        let (channels, stages) = (&self.enc_channels, self.num_stages());
        let encoder = self.encoder_blocks().iter().enumerate().all(|(s, blocks)| {
            let down = |s: usize| format!("enc.enc{s}.down.proj.weight");
            has_blocks(&format!("enc.enc{s}"), blocks)
                && (s == 0 || is(down(s), &[channels[s], channels[s - 1]]))
        });
        let decoder = self.decoder_blocks().iter().enumerate().all(|(s, blocks)| {
            let c = self.dec_channels[s];
            let up = |part: &str| format!("dec.dec{s}.up.{part}.0.weight");
            has_blocks(&format!("dec.dec{s}"), blocks)
                && is(up("proj_skip"), &[c, channels[s]])
                && is(up("proj"), &[c, self.channels_below(s)])
        });
        let more = shapes.contains_key(&format!("enc.enc{stages}.down.proj.weight"))
            || shapes.contains_key(&format!("dec.dec{}.up.proj_skip.0.weight", stages - 1));
        is(STEM.to_owned(), &[channels[0], 5, 5, 5, self.in_channels])
            && encoder
            && decoder
            && !more
            && !shapes.contains_key("mask_token")
    }
}
