//! A network configuration with its weights.

use candle_core::Result;
use scenesplat_datasets::{InputChannel, InputFeatures};
use scenesplat_models::convert::{Branch, ConvLayout};
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{
    Backbone, LanguageModel, LoadPolicy, LoadReport, ParamStore, PointTransformerV3Config,
    SemanticSegmenter,
};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Which network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NetworkConfig {
    /// 768-d language features.
    Language,
    /// 20 classes, reads normals.
    Semseg,
    /// 64-d features, small and fast, for trying things out.
    Tiny,
    /// A TOML or JSON file with the fields of [`PointTransformerV3Config`].
    File(PathBuf),
}

impl FromStr for NetworkConfig {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        Ok(match text {
            "language" => Self::Language,
            "semseg" => Self::Semseg,
            "tiny" => Self::Tiny,
            path if path.ends_with(".toml") || path.ends_with(".json") => Self::File(path.into()),
            other => {
                return Err(format!(
                    "{other:?} is no configuration; use language, semseg, tiny or a .toml file"
                ));
            }
        })
    }
}

impl NetworkConfig {
    /// The configuration, read if it is a file.
    ///
    /// # Errors
    /// If the file cannot be read or has unknown or wrong fields.
    pub fn resolve(&self) -> anyhow::Result<PointTransformerV3Config> {
        use anyhow::Context;
        let path = match self {
            Self::Language => return Ok(PointTransformerV3Config::language()),
            Self::Semseg => return Ok(PointTransformerV3Config::semseg()),
            Self::Tiny => return Ok(PointTransformerV3Config::tiny()),
            Self::File(path) => path,
        };
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let config: PointTransformerV3Config = if path.extension().is_some_and(|e| e == "json") {
            serde_json::from_str(&text).with_context(|| path.display().to_string())?
        } else {
            toml::from_str(&text).with_context(|| path.display().to_string())?
        };
        config.check().with_context(|| path.display().to_string())?;
        Ok(config)
    }
}

/// Where the weights come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Weights {
    /// The network inside the program, see [`crate::embedded`].
    Embedded,
    /// A `.safetensors`, `.pth` or `.pt` file, or a model folder.
    File(PathBuf),
    /// Values from an integer hash: for tests and benchmarks, without any meaning.
    Seeded(u64),
}

impl FromStr for Weights {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        if text == crate::embedded::NAME {
            return Ok(Self::Embedded);
        }
        match text.strip_prefix("seeded:") {
            Some(seed) => seed
                .parse()
                .map(Self::Seeded)
                .map_err(|_| format!("{seed:?} is no seed; write seeded:0")),
            None => Ok(Self::File(text.into())),
        }
    }
}

/// Choices in loading weights.
#[derive(Debug, Clone, Copy, Default)]
pub struct WeightOptions {
    /// What may differ between network and file.
    pub policy: LoadPolicy,
    /// Which half of a self-supervised checkpoint.
    pub branch: Branch,
    /// How sparse convolutions are stored.
    pub conv_layout: ConvLayout,
}

/// A network ready for inference.
pub struct Network {
    config: PointTransformerV3Config,
    model: Box<dyn Backbone>,
    report: LoadReport,
    files: Vec<(PathBuf, String)>,
    meaningless: bool,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("config", &self.config).finish_non_exhaustive()
    }
}

impl Network {
    /// Builds a network and loads its weights.
    ///
    /// # Errors
    /// If the configuration does not fit together, or the weights do not fit it as far as the
    /// policy asks; the message lists matched, missing, unexpected and mis-shaped names.
    pub fn load(
        config: PointTransformerV3Config,
        weights: &Weights,
        options: WeightOptions,
    ) -> Result<Self> {
        let (source, files) = match weights {
            Weights::Seeded(seed) => (WeightSource::hashed(*seed, ""), Vec::new()),
            Weights::Embedded => {
                let tensors = crate::embedded::tensors();
                let tensors = tensors.map_err(|e| candle_core::Error::Msg(format!("{e:#}")))?;
                (WeightSource::tensors(tensors), Vec::new())
            }
            Weights::File(path) => {
                let folder = resolve(path)?;
                let files = folder
                    .files
                    .iter()
                    .map(|f| Ok((f.path().to_owned(), f.sha256()?)))
                    .collect::<Result<_>>()?;
                let source_options =
                    SourceOptions { branch: options.branch, conv_layout: options.conv_layout };
                (WeightSource::files(folder.files, source_options)?, files)
            }
        };
        let store = ParamStore::frozen(source);
        let model: Box<dyn Backbone> = match config.num_classes {
            Some(_) => Box::new(SemanticSegmenter::new(&config, store.builder())?),
            None => Box::new(LanguageModel::new(&config, store.builder())?),
        };
        let report = store.report();
        match weights {
            Weights::File(path) => report.check(options.policy, &path.display().to_string())?,
            Weights::Embedded => report.check(LoadPolicy::Strict, crate::embedded::NAME)?,
            Weights::Seeded(_) => {}
        }
        let meaningless = matches!(weights, Weights::Seeded(_));
        Ok(Self { config, model, report, files, meaningless })
    }

    /// The configuration.
    pub fn config(&self) -> &PointTransformerV3Config {
        &self.config
    }

    /// The network itself.
    pub fn model(&self) -> &dyn Backbone {
        self.model.as_ref()
    }

    /// How weights and network agreed.
    pub fn report(&self) -> &LoadReport {
        &self.report
    }

    /// The weight files with their SHA-256.
    pub fn files(&self) -> &[(PathBuf, String)] {
        &self.files
    }

    /// Whether the weights are seeded, so that no output means anything.
    pub fn is_meaningless(&self) -> bool {
        self.meaningless
    }

    /// Whether the output are class scores rather than language features.
    pub fn is_classifier(&self) -> bool {
        self.config.num_classes.is_some()
    }

    /// What the network reads of a Gaussian, by the number of its inputs.
    ///
    /// # Errors
    /// If no released network has that many inputs.
    pub fn input_features(&self) -> anyhow::Result<InputFeatures> {
        use InputChannel::{Color, Height, Normal, Opacity, Quat, Scale};
        let channels = match self.config.in_channels {
            11 => vec![Color, Opacity, Quat, Scale],
            12 => vec![Color, Opacity, Quat, Scale, Height],
            14 => vec![Color, Opacity, Quat, Scale, Normal],
            other => anyhow::bail!(
                "in_channels: {other} inputs are none of the known sets (11: colour, opacity, quat, \
                 scale; 12: those and the height; 14: those and the normal)"
            ),
        };
        Ok(InputFeatures { channels, ..InputFeatures::default() })
    }

    /// Bytes of the packed weights.
    pub fn weight_bytes(&self) -> usize {
        self.report.parameters * size_of::<f32>()
    }
}

/// Reads a configuration that lies beside the weights of a model folder, if there is one.
///
/// # Errors
/// If it is there and cannot be read.
pub fn config_beside(weights: &Path) -> anyhow::Result<Option<PointTransformerV3Config>> {
    if !weights.is_dir() {
        return Ok(None);
    }
    match resolve(weights)?.config {
        Some(path) => NetworkConfig::File(path).resolve().map(Some),
        None => Ok(None),
    }
}
