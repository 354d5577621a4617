//! Whether a checkpoint holds a network of this shape.

use super::{PointTransformerV3Config, Version};
use crate::stages::{LINEAR_STEM, STEM, has, has_scales};
use crate::weights::Shapes;

impl PointTransformerV3Config {
    /// Whether first layer, stages, blocks and mask token are those of this network. What weights
    /// do not show (heads, patches, curves, pooling) is not asked.
    pub(super) fn has_shapes(&self, shapes: &Shapes) -> bool {
        let channels = [self.enc_channels.as_slice(), &self.dec_channels];
        let (first, inputs) = (self.enc_channels[0], self.in_channels);
        let (convolution, linear) = ([first, 5, 5, 5, inputs], [first, inputs]);
        let stem: (&str, &[usize]) = match self.version {
            Version::M1 => (STEM, &convolution),
            Version::M2 => (LINEAR_STEM, &linear),
        };
        let scales = has_scales(shapes, stem, channels, |half, s| {
            let (depth, c) = match half {
                "enc" => (self.enc_depths[s], self.enc_channels[s]),
                _ => (self.dec_depths[s], self.dec_channels[s]),
            };
            let qkv = |block: usize| format!("{half}.{half}{s}.block{block}.attn.qkv.weight");
            (0..depth).all(|block| has(shapes, &qkv(block), &[3 * c, c]))
                && !shapes.contains_key(&qkv(depth))
        });
        scales && shapes.contains_key(self.version.mask_token()) == self.mask_token
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
