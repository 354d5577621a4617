//! What of a scene the network inside the program knows: fits it ([`fitted`]), and measures it ([`Recognizer`]).

pub mod scenes;

use scenes::{SHAPES, mixed, part, room, shape, thing};
use scenesplat::alignment::judge::judged;
use scenesplat::familiarity::Familiarity;
use scenesplat::inference::EncodeError;
use scenesplat::kernels::normalize::normalize_rows;
use scenesplat::network::NetworkError;
use scenesplat::objects::ObjectError;
use scenesplat::objects::surfaces::{SurfaceSettings, Surfaces, scene_surfaces};
use scenesplat::recognition::{Example, Recognition, Recognized};
use scenesplat::rooms::{Capture, RoomError};
use scenesplat::scene::edit::EditError;
use scenesplat::scene::{GaussianScene, SceneError, Up, squareness};
use scenesplat::{Alignment, AlignmentSettings, Network, SceneEncoder, SceneFeatures};

/// Why a scene could not be recognized.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecognitionError {
    /// The program was built with broken files.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The network refused the scene.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The scene has no surfaces.
    #[error(transparent)]
    Surfaces(#[from] ObjectError),
    /// A room could not be made.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// Rows could not be taken out of a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Two scenes could not be made one.
    #[error(transparent)]
    Edit(#[from] EditError),
}

type Result<T> = std::result::Result<T, RecognitionError>;

/// Rows of an example, about.
const ROWS: usize = 1500;

/// Rooms of each capture, and variants of each shape; as many parts of rooms, single things, and rooms with something
/// foreign in them as rooms.
const ROOMS: u64 = 12;
const VARIANTS: u64 = 4;

/// Reads scenes as `segment` does.
pub struct Recognizer<'n> {
    encoder: SceneEncoder<'n>,
    familiar: Familiarity,
}

/// A scene as the network read it.
struct Read {
    features: SceneFeatures,
    surfaces: Surfaces,
    squareness: f64,
}

impl<'n> Recognizer<'n> {
    /// With the network inside the program.
    ///
    /// # Errors
    /// If the program was built with broken files.
    pub fn new(network: &'n Network) -> Result<Self> {
        Ok(Self { encoder: SceneEncoder::new(network), familiar: Familiarity::embedded()? })
    }

    /// What is known of a scene, and the direction that was taken for up; `None` if no row has a feature.
    ///
    /// # Errors
    /// If the network refuses the scene.
    pub fn recognize(
        &self,
        known: &Recognition,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
    ) -> Result<Option<(Recognized, Up)>> {
        let settings = AlignmentSettings { square: self.encoder.network.is_square(), ..*settings };
        let shape = Alignment::of(scene, &settings);
        let alignment =
            judged(&self.encoder, &self.familiar, scene, &settings, shape, &mut |_| Ok(()))?;
        let up = alignment.turned_from;
        let Read { features, surfaces, squareness } = self.read(scene, alignment)?;
        Ok(known.of(&features, &surfaces, squareness)?.map(|found| (found, up)))
    }

    fn read(&self, scene: &GaussianScene, alignment: Alignment) -> Result<Read> {
        let (upright, metres) = (alignment.upright(), alignment.scale);
        let squareness = squareness(scene, alignment.turned_from);
        let surfaces = scene_surfaces(scene, &upright, metres, &SurfaceSettings::default())?;
        let surfaces = surfaces.largest().clone();
        let features = self.encoder.encode_aligned(scene, alignment, &mut |_| Ok(()))?;
        Ok(Read { features, surfaces, squareness })
    }

    /// `foreign`: the first of the rows at the end that are no part of the room; 0 for no room.
    fn example(&self, scene: &GaussianScene, foreign: usize) -> Result<Example> {
        // Made scenes lie as networks know rooms.
        let settings = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
        let alignment = Alignment::of(scene, &settings);
        let Read { features, surfaces, squareness } = self.read(scene, alignment)?;
        let (mut rows, mut surface, mut is_room) = (Vec::new(), Vec::new(), Vec::new());
        for row in (0..scene.len()).step_by(scene.len().div_ceil(ROWS).max(1)) {
            rows.extend(features.gaussian_rows(row..row + 1)?);
            surface.push(surfaces.of[row]);
            is_room.push(row < foreign);
        }
        normalize_rows(&mut rows, features.width());
        Ok(Example { rows, surface, squareness, is_room })
    }

    /// Rooms, parts of rooms, single things and shapes; if `is_mixed`, also rooms with something foreign in them.
    fn examples(
        &self,
        seed: u64,
        is_mixed: bool,
        told: &mut impl FnMut(usize),
    ) -> Result<Vec<Example>> {
        let mut all = Vec::new();
        let mut add = |scene: &GaussianScene, foreign: usize| -> Result<()> {
            all.push(self.example(scene, foreign)?);
            told(all.len());
            Ok(())
        };
        for capture in [Capture::Made, Capture::Scan, Capture::Model] {
            for number in 0..ROOMS {
                let scene = room(seed, number, capture)?;
                let part = part(seed, 100 + number, capture)?;
                add(&scene, scene.len())?;
                add(&part, part.len())?;
                add(&thing(seed, 200 + number, capture)?, 0)?;
                if is_mixed {
                    let (scene, foreign) = mixed(seed, 300 + number, capture)?;
                    add(&scene, foreign)?;
                }
            }
        }
        for kind in SHAPES {
            for number in 0..VARIANTS {
                add(&shape(seed, number, kind), 0)?;
            }
        }
        Ok(all)
    }
}

/// Fits what the program knows of rooms to made ones, and to what is none. `weights`: SHA-256 of the network's;
/// `told` hears how many scenes are read.
///
/// # Errors
/// If a scene cannot be made or read.
pub fn fitted(
    network: &Network,
    seeds: [u64; 2],
    weights: String,
    mut told: impl FnMut(usize),
) -> Result<Recognition> {
    let reader = Recognizer::new(network)?;
    // Beside something foreign the features of a room are not those of a room.
    let rows = reader.examples(seeds[0], false, &mut told)?;
    let surfaces = reader.examples(seeds[1], true, &mut told)?;
    Ok(Recognition::fit(&rows, &surfaces, weights))
}
