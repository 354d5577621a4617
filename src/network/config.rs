//! Everything that a network is, as a file says it.

use super::error::NetworkError;
use candle_core::Result;
use scenesplat_datasets::{InputChannel, InputFeatures};
use scenesplat_models::weights::Shapes;
use scenesplat_models::{Compute, ModelConfig, PointTransformerV3Config, UniqueKeys};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use std::path::Path;

/// What a network reads of a Gaussian, and what it makes of that: `config.json` of a model folder.
///
/// The file has the fields of [`ModelConfig`], and `input` with those of [`InputFeatures`]. Without
/// `input`, as in folders of the original, networks with 11, 12 or 14 inputs get
/// [`documented_input`]; others are refused.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NetworkConfig {
    /// Backbone, head and voxel size.
    #[serde(flatten)]
    pub model: ModelConfig,
    /// Input channels in their order, with all their settings.
    pub input: InputFeatures,
}

/// What networks of so many inputs read where their file does not say: color, opacity, quat and
/// scale (11), those and the height above the ground (12), or those and the normal (14); position, color in 0 to 1 and
/// normal (9), as Sonata and Concerto. `None` for other numbers.
pub fn documented_input(in_channels: usize) -> Option<InputFeatures> {
    use InputChannel::{Color, Height, Normal, Opacity, Position, Quat, Scale, UnitColor};
    let channels = match in_channels {
        9 => vec![Position, UnitColor, Normal],
        11 => vec![Color, Opacity, Quat, Scale],
        12 => vec![Color, Opacity, Quat, Scale, Height],
        14 => vec![Color, Opacity, Quat, Scale, Normal],
        _ => return None,
    };
    Some(InputFeatures { channels, ..InputFeatures::default() })
}

impl NetworkConfig {
    /// A network whose file does not say what it reads.
    ///
    /// # Errors
    /// If it has another number of inputs than those of [`documented_input`].
    pub fn with_documented_input(model: ModelConfig) -> Result<Self> {
        let count = model.in_channels();
        let Some(input) = documented_input(count) else {
            candle_core::bail!(
                "input: the file does not say what the {count} inputs of the network are \
                 (in_channels), and they are none of the documented sets (9: position, unit_color, \
                 normal; 11: color, opacity, quat, scale; 12: those and height; 14: those and normal); add `input` with its `channels`"
            );
        };
        Ok(Self { model, input })
    }

    /// The language network.
    pub fn language() -> Self {
        Self { model: ModelConfig::language(), input: InputFeatures::default() }
    }

    /// The supervised segmentation network, 20 classes; reads normals.
    pub fn semseg() -> Self {
        let mut config = Self { model: ModelConfig::semseg(), ..Self::language() };
        config.input.channels.push(InputChannel::Normal);
        config
    }

    /// The self-supervised network.
    pub fn ssl() -> Self {
        Self { model: ModelConfig::ssl(), ..Self::language() }
    }

    /// A small language network for trying things out.
    pub fn tiny() -> Self {
        Self { model: ModelConfig::tiny(), ..Self::language() }
    }

    /// An encoder of Sonata or Concerto, or one with the decoder of their probes, with what those read.
    pub fn second(backbone: PointTransformerV3Config) -> Self {
        let input = documented_input(backbone.in_channels).unwrap_or_default();
        Self { model: ModelConfig::new(backbone), input }
    }

    /// This network with the number of inputs and classes that a checkpoint has.
    ///
    /// # Errors
    /// If it is unknown what so many inputs are.
    pub fn adapted_to(self, shapes: &Shapes) -> Result<Self> {
        let model = self.model.adapted_to(shapes);
        if model.in_channels() == self.input.width() {
            return Ok(Self { model, input: self.input });
        }
        Self::with_documented_input(model)
    }

    /// With another way to compute.
    #[must_use]
    pub fn with_compute(self, compute: Compute) -> Self {
        Self { model: self.model.with_compute(compute), ..self }
    }

    /// Reads a TOML or JSON file.
    ///
    /// # Errors
    /// If it cannot be read, has unknown or wrong fields, or its fields do not fit together.
    pub fn read(path: &Path) -> std::result::Result<Self, NetworkError> {
        let text = scenesplat_scene::input_file::read_text_file(path)?;
        let config: Self = if path.extension().is_some_and(|e| e == "json") {
            serde_json::from_str(&text).map_err(NetworkError::config(path))?
        } else {
            toml::from_str(&text).map_err(NetworkError::config(path))?
        };
        config.check().map_err(NetworkError::config(path))?;
        Ok(config)
    }

    /// Checks that the fields fit together.
    ///
    /// # Errors
    /// Names the first field that does not.
    pub fn check(&self) -> Result<()> {
        self.model.check()?;
        let (takes, reads) = (self.model.in_channels(), self.input.width());
        if takes != reads {
            candle_core::bail!(
                "in_channels is {takes}, but the channels of `input` are {reads} together"
            );
        }
        Ok(())
    }
}

impl<'de> Deserialize<'de> for NetworkConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let UniqueKeys(mut fields) = UniqueKeys::deserialize(deserializer)?;
        let input = fields.remove("input");
        let model = ModelConfig::from_fields(fields).map_err(D::Error::custom)?;
        match input {
            None => Self::with_documented_input(model).map_err(D::Error::custom),
            Some(input) => {
                let wrong = |e| D::Error::custom(format!("input: {e}"));
                Ok(Self { model, input: serde_json::from_value(input).map_err(wrong)? })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_say_what_is_read() {
        let mut config = NetworkConfig::tiny();
        config.input.channels.reverse();
        config.input.scale_clip = Some([0.01, 0.3]);
        let json = serde_json::to_string_pretty(&config).unwrap();
        assert_eq!(serde_json::from_str::<NetworkConfig>(&json).unwrap(), config, "{json}");
        let toml = toml::to_string_pretty(&config).unwrap();
        assert_eq!(toml::from_str::<NetworkConfig>(&toml).unwrap(), config, "{toml}");
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(
            value["input"]["channels"],
            serde_json::json!(["scale", "quat", "opacity", "color"])
        );
        for field in ["architecture", "in_channels", "order", "stride", "enc_depths", "grid_size"] {
            assert!(!value[field].is_null(), "{field}");
        }
        // No limit is a setting too.
        config.input.scale_clip = None;
        let json = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<NetworkConfig>(&json).unwrap(), config, "{json}");
    }

    #[test]
    fn folders_without_input_get_what_is_documented_or_an_error() {
        let read =
            |n: usize| serde_json::from_str::<NetworkConfig>(&format!(r#"{{"in_channels": {n}}}"#));
        for (n, last) in [
            (9, InputChannel::Normal),
            (11, InputChannel::Scale),
            (12, InputChannel::Height),
            (14, InputChannel::Normal),
        ] {
            let config = read(n).unwrap();
            config.check().unwrap();
            assert_eq!(config.input.channels.last(), Some(&last));
        }
        let error = read(6).unwrap_err().to_string();
        assert!(error.contains("6 inputs") && error.contains("in_channels"), "{error}");
        let text = r#"{"in_channels": 6, "input": {"channels": ["color", "normal"]}}"#;
        serde_json::from_str::<NetworkConfig>(text).unwrap().check().unwrap();
        let text = r#"{"in_channels": 7, "input": {"channels": ["color", "normal"]}}"#;
        let error = serde_json::from_str::<NetworkConfig>(text).unwrap().check().unwrap_err();
        assert!(error.to_string().contains("in_channels is 7"), "{error}");
        let error = serde_json::from_str::<NetworkConfig>(r#"{"input": {"channel": []}}"#);
        assert!(error.unwrap_err().to_string().contains("channel"));
    }
}
