//! A network configuration with its weights.

mod choice;
pub(crate) mod config;
pub(crate) mod error;

pub use choice::{NetworkChoice, config_beside, network_of};
pub use config::{NetworkConfig, documented_input};
pub use error::NetworkError;

use scenesplat_datasets::{InputFeatures, Orientation};
#[cfg(feature = "wgpu")]
use scenesplat_kernels::Precision;
use scenesplat_kernels::grid_sample::is_grid_size;
use scenesplat_models::convert::{Branch, ConvLayout};
#[cfg(feature = "wgpu")]
use scenesplat_models::gpu::Stored;
use scenesplat_models::weights::{Shapes, SourceOptions, WeightFile, WeightSource, resolve};
use scenesplat_models::{Backbone, LoadPolicy, LoadReport, OpenDevice, ParamStore};
use std::path::PathBuf;
use std::str::FromStr;

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
#[derive(Debug, Clone, Default)]
pub struct WeightOptions {
    /// What may differ between network and file.
    pub policy: LoadPolicy,
    /// Which half of a self-supervised checkpoint.
    pub branch: Branch,
    /// How sparse convolutions are stored.
    pub conv_layout: ConvLayout,
    /// Which language head, of weights with several: `NAME` of `projection.NAME.weight`.
    pub head: Option<String>,
}

impl WeightOptions {
    /// Opened files by the names of the network among them, with the head that was chosen.
    ///
    /// # Errors
    /// As [`WeightSource::files`], [`WeightSource::unwrapped`] and [`WeightSource::with_head`].
    pub fn source(
        self,
        files: Vec<WeightFile>,
        is_network: impl Fn(&Shapes) -> bool,
    ) -> candle_core::Result<WeightSource> {
        let options = SourceOptions { branch: self.branch, conv_layout: self.conv_layout };
        WeightSource::files(files, options)?.unwrapped(is_network)?.with_head(self.head.as_deref())
    }
}

/// What the rows are that a network gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NetworkOutput {
    /// Features, whose direction counts.
    Features,
    /// Logits of classes.
    Logits,
}

/// A network ready for inference.
pub struct Network {
    config: Option<NetworkConfig>,
    input: InputFeatures,
    grid_size: f64,
    output: NetworkOutput,
    model: Box<dyn Backbone>,
    report: LoadReport,
    files: Vec<(PathBuf, String)>,
    random_weights: bool,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network")
            .field("config", &self.config)
            .field("input", &self.input)
            .field("grid_size", &self.grid_size)
            .finish_non_exhaustive()
    }
}

impl Network {
    /// Builds a network and loads its weights.
    ///
    /// # Errors
    /// If the configuration does not fit together, or the weights do not fit it as far as the
    /// policy asks; the message lists matched, missing, unexpected and mis-shaped names.
    pub fn load(
        config: NetworkConfig,
        weights: &Weights,
        options: WeightOptions,
    ) -> Result<Self, NetworkError> {
        Self::load_on(config, weights, options, &OpenDevice::default())
    }

    /// As [`load`](Self::load), with the weights on a device, which computes then.
    ///
    /// # Errors
    /// As [`load`](Self::load), or if the device does not compute in the configuration's precision.
    pub fn load_on(
        config: NetworkConfig,
        weights: &Weights,
        options: WeightOptions,
        device: &OpenDevice,
    ) -> Result<Self, NetworkError> {
        config.check()?;
        let precision = config.model.backbone.get().compute().precision;
        let possible = match device {
            #[cfg(feature = "wgpu")]
            OpenDevice { gpu: Some(_), .. } => "f32 and f16",
            device if device.is_cpu() => "f32, split, bf16 and int8",
            _ => "f32 and bf16",
        };
        if !possible.split([' ', ',']).any(|name| name == precision.name()) {
            let device = device.name.clone();
            return Err(NetworkError::Precision { precision, device, possible });
        }
        let policy = options.policy;
        let (source, files) = match weights {
            Weights::Seeded(seed) => (WeightSource::hashed(*seed, ""), Vec::new()),
            Weights::Embedded => (WeightSource::tensors(crate::embedded::tensors()?), Vec::new()),
            Weights::File(path) => {
                let folder = resolve(path)?;
                let files = folder
                    .files
                    .iter()
                    .map(|f| Ok((f.path().to_owned(), f.sha256()?)))
                    .collect::<Result<_, NetworkError>>()?;
                let fits = |shapes: &Shapes| config.model.fits(shapes);
                (options.source(folder.files, fits)?, files)
            }
        };
        let store = ParamStore::frozen(source).on(&device.device);
        let model = match device {
            #[cfg(feature = "wgpu")]
            OpenDevice { gpu: Some(gpu), .. } => {
                let stored = match precision {
                    Precision::F16 => Stored::F16,
                    _ => Stored::F32,
                };
                config.model.build_on_gpu(store.builder(), gpu, stored)?
            }
            _ => config.model.build(store.builder())?,
        };
        let report = store.report();
        match weights {
            Weights::File(path) => report.check(policy, &path.display().to_string())?,
            Weights::Embedded => report.check(LoadPolicy::Strict, crate::embedded::NAME)?,
            Weights::Seeded(_) => {}
        }
        Ok(Self {
            input: config.input.clone(),
            grid_size: config.model.grid_size,
            output: match config.model.num_classes() {
                Some(_) => NetworkOutput::Logits,
                None => NetworkOutput::Features,
            },
            random_weights: matches!(weights, Weights::Seeded(_)),
            config: Some(config),
            model,
            report,
            files,
        })
    }

    /// Any backbone with its weights, such as one of your own: `input` is what its rows are made of,
    /// `grid_size` the voxels that it was trained at, meters.
    ///
    /// Tiles need [`Backbone::alignment`], a memory limit needs [`Backbone::cost`].
    ///
    /// # Errors
    /// If the voxel size is not above 0 or too large, or nothing is read.
    pub fn from_backbone(
        model: impl Backbone + 'static,
        input: InputFeatures,
        grid_size: f64,
        output: NetworkOutput,
    ) -> Result<Self, NetworkError> {
        if !is_grid_size(grid_size) {
            return Err(NetworkError::GridSize(grid_size));
        }
        if input.width() == 0 {
            return Err(NetworkError::NoChannels);
        }
        Ok(Self {
            config: None,
            input,
            grid_size,
            output,
            model: Box::new(model),
            report: LoadReport::default(),
            files: Vec::new(),
            random_weights: false,
        })
    }

    /// The configuration; `None` for a network [from a backbone](Self::from_backbone).
    pub fn config(&self) -> Option<&NetworkConfig> {
        self.config.as_ref()
    }

    /// What it reads of a Gaussian.
    pub fn input(&self) -> &InputFeatures {
        &self.input
    }

    /// Whether it knows rooms with their walls along the axes, so that others are better read turned.
    pub fn is_square(&self) -> bool {
        self.input.orientation == Orientation::Drawn
    }

    /// Voxel size that it was trained at, meters.
    pub fn grid_size(&self) -> f64 {
        self.grid_size
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
    pub fn has_random_weights(&self) -> bool {
        self.random_weights
    }

    /// Whether the output are class scores rather than language features.
    pub fn is_classifier(&self) -> bool {
        self.output == NetworkOutput::Logits
    }

    /// Bytes of the packed weights; 0 for a network [from a backbone](Self::from_backbone), for
    /// which it is not known.
    pub fn weight_bytes(&self) -> usize {
        self.report.parameters * size_of::<f32>()
    }
}
