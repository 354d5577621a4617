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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ModelConfig, ParamStore};

    fn shapes(model: &ModelConfig) -> Shapes {
        let store = ParamStore::trainable(0);
        model.build(store.builder()).unwrap();
        store.shapes()
    }

    #[test]
    fn a_network_is_known_by_its_shapes() {
        let tiny = PointTransformerV3Config::tiny();
        let own = shapes(&ModelConfig::tiny());
        assert!(tiny.has_shapes(&own));
        for other in [
            PointTransformerV3Config { in_channels: 14, ..tiny.clone() },
            PointTransformerV3Config { mask_token: true, ..tiny.clone() },
            PointTransformerV3Config { enc_depths: vec![1, 1, 1], ..tiny.clone() },
            PointTransformerV3Config { enc_depths: vec![1, 2, 2], ..tiny.clone() },
            PointTransformerV3Config { enc_channels: vec![16, 48, 64], ..tiny.clone() },
            PointTransformerV3Config { dec_channels: vec![48, 32], ..tiny.clone() },
            PointTransformerV3Config::language(),
            PointTransformerV3Config::semseg(),
            PointTransformerV3Config::ssl(),
        ] {
            assert!(!other.has_shapes(&own), "{other:?}");
        }
        assert_eq!(ModelConfig::recognize(&own), Some(ModelConfig::tiny()));
        assert_eq!(ModelConfig::recognize(&Shapes::new()), None);
        // A classifier on it is none of the released networks.
        assert_eq!(ModelConfig::recognize(&shapes(&ModelConfig::tiny().with_classes(3))), None);
        // Another number of inputs is still the same network.
        let wide = PointTransformerV3Config { in_channels: 14, ..tiny };
        let wide = ModelConfig::new(wide);
        assert_eq!(ModelConfig::recognize(&shapes(&wide)), Some(wide));
    }

    #[test]
    fn named_networks_take_classes_and_inputs_from_the_weights() {
        for classes in [20, 100, 200] {
            let shapes = Shapes::from([
                ("seg_head.weight".to_owned(), vec![classes, 64]),
                (STEM.to_owned(), vec![32, 5, 5, 5, 11]),
            ]);
            let model = ModelConfig::semseg().adapted_to(&shapes);
            assert_eq!((model.num_classes(), model.in_channels()), (Some(classes), 11));
            // A network without classifier gets none.
            assert_eq!(ModelConfig::ssl().adapted_to(&shapes).num_classes(), None);
        }
    }
}
