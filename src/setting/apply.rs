//! A setting on a network and on an encoder.

use super::{Passes, Setting, SettingError};
use crate::inference::{Fidelity, SceneEncoder};
use crate::network::NetworkConfig;
use scenesplat_models::{Compute, LastStage};

impl Setting {
    /// The network with this precision, patch size and last stage; with all passes its layers are
    /// not joined. Weights are not asked for: the same ones fit.
    ///
    /// # Errors
    /// If the network's architecture has no such thing.
    pub fn apply_to_network(&self, config: NetworkConfig) -> Result<NetworkConfig, SettingError> {
        let mut config = config;
        let backbone = config.model.backbone.get_mut();
        let mut compute = backbone.compute();
        if let Some(precision) = self.precision {
            compute.precision = precision;
        }
        if self.passes == Some(Passes::All) {
            compute = Compute { fold: false, ..compute };
        }
        backbone.set_compute(compute);
        if let Some(patch) = self.patch {
            let name = |why: &str| SettingError::not_here("patch", &patch, why);
            backbone.set_patch_size(patch).map_err(|why| name(&why))?;
        }
        if self.stage == Some(LastStage::Coarse) {
            let name = |why: String| SettingError::not_here("stage", &LastStage::Coarse, &why);
            backbone.set_last_stage(LastStage::Coarse).map_err(name)?;
        }
        if let Some(rank) = self.rank {
            let name = |why: String| SettingError::not_here("rank", &rank, &why);
            backbone.set_rank(rank).map_err(name)?;
        }
        let width = config.model.out_channels();
        match self.codes {
            Some(codes) if config.model.num_classes().is_some() => {
                let why = "the network gives probabilities of classes, no features";
                return Err(SettingError::not_here("codes", &codes, why));
            }
            Some(codes) if codes >= width => {
                let why = format!("the network's features have {width} numbers, no more");
                return Err(SettingError::not_here("codes", &codes, &why));
            }
            _ => {}
        }
        Ok(config)
    }

    /// The encoder with this voxel size, number of passes and copies, and width of features.
    #[must_use]
    pub fn apply_to_encoder<'a>(&self, encoder: SceneEncoder<'a>) -> SceneEncoder<'a> {
        let mut encoder = encoder;
        if let Some(voxel) = self.voxel {
            encoder.grid_size = voxel;
        }
        encoder.anchor = self.anchor.unwrap_or(encoder.anchor);
        encoder.tta = self.tta.unwrap_or(encoder.tta);
        encoder.codes = self.codes.or(encoder.codes);
        match self.passes {
            None => {}
            Some(Passes::Count(1)) => encoder.fidelity = Fidelity::Fast,
            Some(Passes::Count(count)) => encoder.fidelity = Fidelity::Passes(count),
            Some(Passes::All) => encoder.fidelity = Fidelity::Exact,
        }
        encoder
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::NetworkChoice;
    use crate::{Network, WeightOptions, Weights};
    use scenesplat_datasets::Anchor;
    use scenesplat_kernels::Precision;
    use scenesplat_models::{ModelConfig, PointTransformerV1Config, PointTransformerV2Config};

    fn set(text: &str, name: &str) -> NetworkConfig {
        let config = name.parse::<NetworkChoice>().unwrap().resolve().unwrap();
        text.parse::<Setting>().unwrap().apply_to_network(config).unwrap()
    }

    #[test]
    fn parts_that_are_not_named_stay() {
        for (name, choice) in NetworkChoice::NAMED {
            assert_eq!(set("", name), choice.resolve().unwrap());
            assert_eq!(set("voxel=0.1,k=3,stage=fine,passes=1", name), choice.resolve().unwrap());
            let compute = |text: &str| set(text, name).model.backbone.get().compute();
            assert_eq!(compute("precision=bf16").precision, Precision::Bf16);
            assert_eq!(compute("precision=int8").precision, Precision::Int8);
            assert!(compute("precision=bf16").fold && !compute("passes=all").fold);
            assert_ne!(set("patch=64", name), choice.resolve().unwrap());
            set("patch=64", name).check().unwrap();
        }
    }

    #[test]
    fn networks_without_patches_say_so() {
        let setting: Setting = "patch=64".parse().unwrap();
        for model in [
            ModelConfig::new(PointTransformerV1Config::default()),
            ModelConfig::new(PointTransformerV2Config::default()),
        ] {
            let config = NetworkConfig { model, ..NetworkConfig::language() };
            let error = setting.apply_to_network(config).unwrap_err();
            assert!(matches!(error, SettingError::NotHere { key: "patch", .. }), "{error}");
            assert!(error.to_string().contains("patch=64 cannot be used"), "{error}");
        }
    }

    #[test]
    fn parts_of_a_setting_reach_the_encoder() {
        let config = "tiny".parse::<NetworkChoice>().unwrap().resolve().unwrap();
        let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default()).unwrap();
        let of = |text: &str| {
            let setting: Setting = text.parse().unwrap();
            let encoder = setting.apply_to_encoder(SceneEncoder::new(&network));
            (encoder.grid_size, encoder.fidelity, encoder.codes)
        };
        let plain = of("");
        assert_eq!(plain, (network.grid_size(), Fidelity::Fast, None));
        assert_eq!(of("voxel=0.37"), (0.37, plain.1, plain.2));
        assert_eq!(of("passes=1"), plain);
        assert_eq!(of("passes=3"), (plain.0, Fidelity::Passes(3), plain.2));
        assert_eq!(of("passes=all"), (plain.0, Fidelity::Exact, plain.2));
        assert_eq!(of("codes=5"), (plain.0, plain.1, Some(5)));
        let tta = |text: &str| {
            let setting: Setting = text.parse().unwrap();
            let encoder = SceneEncoder { tta: 3, ..SceneEncoder::new(&network) };
            setting.apply_to_encoder(encoder).tta
        };
        assert_eq!([tta(""), tta("tta=8"), tta("tta=1")], [3, 8, 1]);
        let anchor = |text: &str| {
            let setting: Setting = text.parse().unwrap();
            setting.apply_to_encoder(SceneEncoder::new(&network)).anchor
        };
        assert_eq!([anchor(""), anchor("anchor=world")], [Anchor::Box, Anchor::World]);
        // What an encoder has and a setting does not name stays.
        let mut encoder = SceneEncoder::new(&network);
        (encoder.grid_size, encoder.fidelity, encoder.codes) = (0.5, Fidelity::Exact, Some(7));
        let after = Setting::default().apply_to_encoder(encoder);
        assert_eq!((after.grid_size, after.fidelity, after.codes), (0.5, Fidelity::Exact, Some(7)));
    }
}
