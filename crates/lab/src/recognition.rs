//! What of a scene the network inside the program knows, fitted to made scenes.

pub mod scenes;

use crate::reader::{Read, ReadError, Reader};
use scenes::{SHAPES, mixed, part, room, shape, thing};
use scenesplat::kernels::normalize::normalize_rows;
use scenesplat::recognition::{Example, Recognition};
use scenesplat::rooms::{Capture, RoomError};
use scenesplat::scene::edit::EditError;
use scenesplat::scene::{GaussianScene, SceneError};
use scenesplat::{Alignment, AlignmentSettings};

/// Why there are no examples.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecognitionError {
    /// A scene could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
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

/// Rows with features of a scene, as examples.
struct Examples<'r>(&'r Reader);

impl Examples<'_> {
    /// `foreign`: the first of the rows at the end that are no part of the room; 0 for no room.
    fn one(&self, scene: &GaussianScene, foreign: usize) -> Result<Example> {
        // Made scenes lie as networks know rooms.
        let settings = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
        let alignment = Alignment::of(scene, &settings);
        let Read { features, surfaces, squareness } = self.0.read(scene, alignment)?;
        let (mut rows, mut surface, mut is_room) = (Vec::new(), Vec::new(), Vec::new());
        for row in (0..scene.len()).step_by(scene.len().div_ceil(ROWS).max(1)) {
            rows.extend(features.gaussian_rows(row..row + 1).map_err(ReadError::from)?);
            surface.push(surfaces.largest().of[row]);
            is_room.push(row < foreign);
        }
        normalize_rows(&mut rows, features.width());
        Ok(Example { rows, surface, squareness, is_room })
    }

    /// Rooms, parts of rooms, single things and shapes; if `is_mixed`, also rooms with something foreign in them.
    fn of(&self, seed: u64, is_mixed: bool, told: &mut impl FnMut(usize)) -> Result<Vec<Example>> {
        let mut all = Vec::new();
        let mut add = |scene: &GaussianScene, foreign: usize| -> Result<()> {
            all.push(self.one(scene, foreign)?);
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
    reader: &Reader,
    seeds: [u64; 2],
    weights: String,
    mut told: impl FnMut(usize),
) -> Result<Recognition> {
    let examples = Examples(reader);
    // Beside something foreign the features of a room are not those of a room.
    let rows = examples.of(seeds[0], false, &mut told)?;
    let surfaces = examples.of(seeds[1], true, &mut told)?;
    Ok(Recognition::fit(&rows, &surfaces, weights))
}
