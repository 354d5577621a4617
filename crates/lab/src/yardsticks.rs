//! How high things are in synthetic rooms as the network inside the program finds them: makes
//! `assets/embedded/yardsticks.json`, and measures how far off a unit is that it gives.

use crate::reader::{ReadError, Reader};
use crate::recognition::RecognitionError;
use crate::recognition::scenes::room;
use scenesplat::AlignmentSettings;
use scenesplat::alignment::judge::{sample, things};
use scenesplat::rooms::Capture;
use scenesplat::scene::{GaussianScene, Similarity, TextTable, Up};
use scenesplat::yardsticks::{Measured, Yardsticks};

/// Rooms of each kind of capture.
const ROOMS: u64 = 24;

/// Units in which a room is looked at: a network sees it differently in each.
const UNITS: [f64; 3] = [0.8, 1.0, 1.25];

/// The rooms of a seed.
///
/// # Errors
/// If one cannot be generated.
pub fn rooms(seed: u64) -> impl Iterator<Item = Result<GaussianScene, RecognitionError>> {
    let captures = [Capture::Made, Capture::Scan, Capture::Model];
    captures
        .into_iter()
        .flat_map(move |capture| (0..ROOMS).map(move |number| room(seed, number, capture)))
}

/// What is measured of an upright scene in meters, in three units, as meters.
///
/// # Errors
/// If the network refuses it.
pub fn measured(
    reader: &Reader,
    texts: &TextTable,
    scene: &GaussianScene,
) -> Result<Vec<Measured>, ReadError> {
    let sample = sample(scene)?;
    let settings = AlignmentSettings {
        up: Some(Up::PLUS_Z),
        metres_per_unit: Some(1.0),
        ..AlignmentSettings::default()
    };
    UNITS
        .into_iter()
        .map(|unit| {
            let mut scaled = sample.clone();
            scaled.transform(&Similarity { scale: unit, ..Similarity::IDENTITY });
            let alignment = reader.alignment(&scaled, &settings)?;
            let features = reader.features(&scaled, alignment.clone())?;
            let mut found = things(texts, &features, &alignment, &scaled)?;
            let all = found.values_mut().flat_map(|(heights, _)| heights);
            all.for_each(|height| *height -= unit.ln());
            Ok(found)
        })
        .collect()
}

/// Fits yardsticks to the rooms of a seed. `told`: after each, with its number.
///
/// # Errors
/// If the network refuses one.
pub fn fitted(
    reader: &Reader,
    texts: &TextTable,
    seed: u64,
    weights: String,
    mut told: impl FnMut(usize),
) -> Result<Yardsticks, RecognitionError> {
    let mut scenes = Vec::new();
    for (number, scene) in rooms(seed).enumerate() {
        scenes.extend(measured(reader, texts, &scene?)?);
        told(number + 1);
    }
    Ok(Yardsticks::fit(&scenes, weights))
}
