//! Reads scenes as `segment` does, with the network inside the program.

use scenesplat::alignment::judge::Judge;
use scenesplat::inference::EncodeError;
use scenesplat::network::{NetworkError, WeightOptions, Weights};
use scenesplat::objects::ObjectError;
use scenesplat::objects::surfaces::{SceneSurfaces, SurfaceSettings, scene_surfaces};
use scenesplat::scene::{GaussianScene, squareness};
use scenesplat::{Alignment, AlignmentSettings, Network, SceneEncoder, SceneFeatures, embedded};

/// Why a scene could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The program was built with broken files.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The network refused the scene.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The scene has no surfaces.
    #[error(transparent)]
    Surfaces(#[from] ObjectError),
}

type Result<T> = std::result::Result<T, ReadError>;

/// The network inside the program.
pub struct Reader {
    network: Network,
    judge: Judge,
}

/// A scene as the network read it.
pub struct Read {
    /// Its features.
    pub features: SceneFeatures,
    /// Its surfaces.
    pub surfaces: SceneSurfaces,
    /// How square it is, 0..=1.
    pub squareness: f64,
}

impl Reader {
    /// Loads the network.
    ///
    /// # Errors
    /// If the program was built with broken files.
    pub fn embedded() -> Result<Self> {
        let network =
            Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
        Self::of(network)
    }

    /// With a network from which that of the program is made.
    ///
    /// # Errors
    /// If the program was built with broken files.
    pub fn of(network: Network) -> Result<Self> {
        Ok(Self { network, judge: Judge::embedded()? })
    }

    /// How a scene lies, by its shape and, where that leaves it open, the network.
    ///
    /// # Errors
    /// If the network refuses the scene.
    pub fn alignment(
        &self,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
    ) -> Result<Alignment> {
        let settings = AlignmentSettings { square: self.network.is_square(), ..*settings };
        let (encoder, shape) = (SceneEncoder::new(&self.network), Alignment::of(scene, &settings));
        Ok(self.judge.decide(&encoder, scene, &settings, shape, &mut |_| Ok(()))?)
    }

    /// Features of a scene that lies so.
    ///
    /// # Errors
    /// If the network refuses the scene.
    pub fn features(&self, scene: &GaussianScene, alignment: Alignment) -> Result<SceneFeatures> {
        let encoder = SceneEncoder::new(&self.network);
        Ok(encoder.encode_aligned(scene, alignment, &mut |_| Ok(()))?)
    }

    /// Features and surfaces of a scene that lies so.
    ///
    /// # Errors
    /// If the network refuses the scene.
    pub fn read(&self, scene: &GaussianScene, alignment: Alignment) -> Result<Read> {
        let (turn, metres) = (alignment.rotation(), alignment.scale);
        Ok(Read {
            features: self.features(scene, alignment)?,
            surfaces: scene_surfaces(scene, &turn, metres, &SurfaceSettings::default())?,
            squareness: squareness(scene, &turn),
        })
    }
}
