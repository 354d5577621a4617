//! Whether a checkpoint holds a network of this shape.

use super::PointTransformerV3Config;
use crate::weights::Shapes;

const STEM: &str = "embedding.stem.conv.weight";

impl PointTransformerV3Config {
    /// Takes the number of inputs from the first layer of a checkpoint, if it has one.
    pub(super) fn take_inputs(&mut self, shapes: &Shapes) {
        if let Some([_, _, _, _, inputs]) = shapes.get(STEM).map(Vec::as_slice) {
            self.in_channels = *inputs;
        }
    }

    /// Whether first layer, stages, blocks and mask token are those of this network. What weights
    /// do not show (heads, patches, curves, pooling) is not asked.
    pub(super) fn has_shapes(&self, shapes: &Shapes) -> bool {
        let is = |name: &str, shape: &[usize]| shapes.get(name).is_some_and(|s| s == shape);
        let blocks = |stage: String, depth: usize, c: usize| {
            let qkv = |block: usize| format!("{stage}.block{block}.attn.qkv.weight");
            (0..depth).all(|block| is(&qkv(block), &[3 * c, c]))
                && !shapes.contains_key(&qkv(depth))
        };
        let encoder = (0..self.num_stages()).all(|s| {
            let c = self.enc_channels[s];
            let down = format!("enc.enc{s}.down.proj.weight");
            blocks(format!("enc.enc{s}"), self.enc_depths[s], c)
                && (s == 0 || is(&down, &[c, self.enc_channels[s - 1]]))
        });
        let decoder = (0..self.dec_depths.len()).all(|s| {
            let c = self.dec_channels[s];
            let skip = format!("dec.dec{s}.up.proj_skip.0.weight");
            blocks(format!("dec.dec{s}"), self.dec_depths[s], c)
                && is(&skip, &[c, self.enc_channels[s]])
        });
        let (stages, scales) = (self.num_stages(), self.dec_depths.len());
        let more = shapes.contains_key(&format!("enc.enc{stages}.down.proj.weight"))
            || shapes.contains_key(&format!("dec.dec{scales}.up.proj_skip.0.weight"));
        is(STEM, &[self.enc_channels[0], 5, 5, 5, self.in_channels])
            && encoder
            && decoder
            && !more
            && shapes.contains_key("mask_token") == self.mask_token
    }
}
