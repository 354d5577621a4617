use scenesplat_kernels::grid_sample::MAX_GRID_SIZE;
use scenesplat_rooms::vocabulary::VocabularyError;
use scenesplat_scene::SceneError;
use std::path::{Path, PathBuf};

/// Why there is no network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// A configuration with unknown or wrong fields, or fields that do not fit together.
    #[error("{}", path.display())]
    Config {
        /// Which file.
        path: PathBuf,
        /// The field, and what is wrong with it.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A network that cannot be built, or weights that are not its own.
    #[error(transparent)]
    Model(#[from] candle_core::Error),
    /// A size, meters, that voxels cannot have.
    #[error("grid_size: {0} is not above 0 and at most {MAX_GRID_SIZE} meters")]
    GridSize(f64),
    /// A precision that the device does not compute in.
    #[error("precision {precision}: {device} computes in {possible}")]
    Precision {
        /// Which.
        precision: scenesplat_kernels::Precision,
        /// What the device calls itself.
        device: String,
        /// In what it computes.
        possible: &'static str,
    },
    /// A network that reads nothing.
    #[error("input.channels: at least one channel is needed")]
    NoChannels,
    /// A network that no words fit.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
}

impl NetworkError {
    /// Something wrong with the configuration in `path`; made for `map_err`.
    pub(crate) fn config<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
        path: impl AsRef<Path>,
    ) -> impl FnOnce(E) -> Self {
        let path = path.as_ref().to_owned();
        move |error| Self::Config { path, source: error.into() }
    }
}
