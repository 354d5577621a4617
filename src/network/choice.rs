//! A network by name or file, with or without its weights.

use super::config::NetworkConfig;
use super::{NetworkError, WeightOptions, Weights};
use scenesplat_models::weights::{Shapes, resolve};
use scenesplat_models::{LitePtSize, ModelConfig, PointTransformerV3Config};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Which network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NetworkChoice {
    /// 768-d language features.
    Language,
    /// Class scores; as many classes as the weights have, 20 without weights; reads normals.
    Semseg,
    /// 64-d features of self-supervised training.
    Ssl,
    /// 64-d features, small and fast, for trying things out.
    Tiny,
    /// A LitePT by its name; 768-d language features unless weights have another head.
    LitePt(LitePtSize),
    /// The encoder of Sonata, of Concerto's base size and of Chorus, 1232-d features; reads position, color and normal
    /// unless weights have another number of inputs.
    Sonata,
    /// The same with the decoder of its probes and fine-tuned networks, 64-d features or class scores.
    SonataWithDecoder,
    /// The encoder of Concerto's large size, 1728-d features.
    ConcertoLarge,
    /// A TOML or JSON file of a [`NetworkConfig`].
    File(PathBuf),
}

impl NetworkChoice {
    /// The names, with what they stand for.
    pub const NAMED: [(&'static str, Self); 11] = [
        ("language", Self::Language),
        ("semseg", Self::Semseg),
        ("ssl", Self::Ssl),
        ("tiny", Self::Tiny),
        ("litept-s", Self::LitePt(LitePtSize::Small)),
        ("litept-s-decoder", Self::LitePt(LitePtSize::SmallWithDecoder)),
        ("litept-b", Self::LitePt(LitePtSize::Base)),
        ("litept-l", Self::LitePt(LitePtSize::Large)),
        ("sonata", Self::Sonata),
        ("sonata-decoder", Self::SonataWithDecoder),
        ("concerto-large", Self::ConcertoLarge),
    ];

    /// The configuration, read if it is a file.
    ///
    /// # Errors
    /// If the file cannot be read or has unknown or wrong fields.
    pub fn resolve(&self) -> Result<NetworkConfig, NetworkError> {
        Ok(match self {
            Self::Language => NetworkConfig::language(),
            Self::Semseg => NetworkConfig::semseg(),
            Self::Ssl => NetworkConfig::ssl(),
            Self::Tiny => NetworkConfig::tiny(),
            Self::LitePt(size) => {
                let wide = ModelConfig::language().out_channels();
                let model = ModelConfig::new(size.config()).with_projection(wide);
                NetworkConfig { model, ..NetworkConfig::language() }
            }
            Self::Sonata => NetworkConfig::second(PointTransformerV3Config::sonata()),
            Self::SonataWithDecoder => {
                NetworkConfig::second(PointTransformerV3Config::sonata_with_decoder())
            }
            Self::ConcertoLarge => {
                NetworkConfig::second(PointTransformerV3Config::concerto_large())
            }
            Self::File(path) => return NetworkConfig::read(path),
        })
    }

    /// As [`resolve`](Self::resolve); a network given by its name takes the number of inputs
    /// and classes from weights of these shapes, a LitePT and the encoders of Sonata and Concerto their whole head.
    ///
    /// # Errors
    /// As [`resolve`](Self::resolve), and if it is unknown what so many inputs are.
    pub fn resolve_for(&self, shapes: &Shapes) -> Result<NetworkConfig, NetworkError> {
        match self {
            Self::File(path) => NetworkConfig::read(path),
            // Published with classes, trained here with features: any head is as good as another.
            Self::LitePt(_) | Self::Sonata | Self::SonataWithDecoder | Self::ConcertoLarge => {
                let NetworkConfig { model, input } = self.resolve()?;
                let model = model.with_head_of(shapes);
                Ok(NetworkConfig { model, input }.adapted_to(shapes)?)
            }
            named => Ok(named.resolve()?.adapted_to(shapes)?),
        }
    }
}

impl FromStr for NetworkChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some((_, named)) = Self::NAMED.into_iter().find(|(name, _)| *name == text) {
            return Ok(named);
        }
        if text.ends_with(".toml") || text.ends_with(".json") {
            return Ok(Self::File(text.into()));
        }
        let names = Self::NAMED.map(|(name, _)| name).join(", ");
        Err(format!("{text:?} is no configuration; use {names} or a .toml file"))
    }
}

impl std::fmt::Display for NetworkChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match Self::NAMED.iter().find(|(_, named)| named == self) {
            Some((name, _)) => f.write_str(name),
            None => match self {
                Self::File(path) => write!(f, "{}", path.display()),
                named => write!(f, "{named:?}"),
            },
        }
    }
}

/// The network that weights belong to: what is chosen, else what the model folder says, else the
/// released network whose shapes the weights have, else the language network.
///
/// # Errors
/// If a file cannot be read or says wrong things.
pub fn network_of(
    weights: &Weights,
    choice: Option<&NetworkChoice>,
    options: &WeightOptions,
) -> Result<NetworkConfig, NetworkError> {
    let path = match weights {
        Weights::Embedded => return crate::embedded::config(),
        Weights::Seeded(_) => return choice.unwrap_or(&NetworkChoice::Language).resolve(),
        Weights::File(path) => path,
    };
    if let Some(NetworkChoice::File(path)) = choice {
        return NetworkConfig::read(path);
    }
    let folder = resolve(path)?;
    if let (None, Some(config)) = (choice, &folder.config) {
        return NetworkConfig::read(config);
    }
    let is_network = |shapes: &Shapes| match choice {
        Some(choice) => choice.resolve_for(shapes).is_ok_and(|config| config.model.fits(shapes)),
        None => ModelConfig::recognize(shapes).is_some(),
    };
    let shapes = options.clone().source(folder.files, is_network)?.shapes();
    match choice {
        Some(choice) => choice.resolve_for(&shapes),
        None => match ModelConfig::recognize(&shapes) {
            Some(model) => Ok(NetworkConfig::with_documented_input(model)?),
            // What does not fit is said best by name and shape.
            None => Ok(NetworkConfig::language()),
        },
    }
}

/// Reads a configuration that lies beside the weights of a model folder, if there is one.
///
/// # Errors
/// If it is there and cannot be read.
pub fn config_beside(weights: &Path) -> Result<Option<NetworkConfig>, NetworkError> {
    if !weights.is_dir() {
        return Ok(None);
    }
    resolve(weights)?.config.map(|path| NetworkConfig::read(&path)).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_models::Head;

    #[test]
    fn names_are_read_as_they_are_written() {
        for (name, choice) in NetworkChoice::NAMED {
            assert_eq!(name.parse::<NetworkChoice>().unwrap(), choice);
            assert_eq!(choice.to_string(), name);
            choice.resolve().unwrap().check().unwrap();
        }
        let error = "pointnet".parse::<NetworkChoice>().unwrap_err();
        assert!(error.contains("ssl") && error.contains("litept-b"), "{error}");
    }

    #[test]
    fn a_named_litept_takes_its_head_from_the_weights() {
        let choice = NetworkChoice::LitePt(LitePtSize::Small);
        assert_eq!(choice.resolve().unwrap().model.out_channels(), 768);
        let shapes = |name: &str, rows: usize| Shapes::from([(name.to_owned(), vec![rows, 72])]);
        let head = |shapes: &Shapes| choice.resolve_for(shapes).unwrap().model.head;
        assert_eq!(head(&shapes("seg_head.weight", 20)), Head::Classes(20));
        let projection = |width| Head::Features { projection: width };
        assert_eq!(head(&shapes("projection.weight", 512)), projection(Some(512)));
        assert_eq!(head(&Shapes::new()), projection(None));
        // Inputs of the published weights are not ours to guess.
        let stem = ("embedding.stem.conv.weight".to_owned(), vec![36, 5, 5, 5, 6]);
        let error = choice.resolve_for(&Shapes::from([stem])).unwrap_err().to_string();
        assert!(error.contains("6 inputs"), "{error}");
    }
}
