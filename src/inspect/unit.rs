//! What one unit of the coordinates is.

use super::neighbourhood::{NEIGHBOUR, to_fourth};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::Bounds;
use scenesplat_scene::quantile::quantile;
use serde::Serialize;

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum LengthUnit {
    /// Meters, or the free unit of an object that is about one unit large.
    #[serde(rename = "m")]
    Metre,
    /// Centimeters.
    #[serde(rename = "cm")]
    Centimetre,
    /// Millimeters.
    #[serde(rename = "mm")]
    Millimetre,
    /// Kilometers, or an object scaled to nearly nothing.
    #[serde(rename = "km")]
    Kilometre,
}

impl LengthUnit {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Metre, Self::Centimetre, Self::Millimetre, Self::Kilometre];

    /// Its length, meters.
    pub fn metres(self) -> f64 {
        [1.0, 0.01, 0.001, 1000.0][self as usize]
    }

    /// Its symbol.
    pub fn symbol(self) -> &'static str {
        ["m", "cm", "mm", "km"][self as usize]
    }
}

/// What one unit of the coordinates seems to be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnitGuess {
    /// The unit.
    pub unit: LengthUnit,
    /// How sure, 0..=1.
    pub confidence: f64,
    /// What speaks for it.
    pub evidence: String,
}

/// The unit of a scene as a network reads it, by things of known size or the height of walls.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SizedUnit {
    /// Meters per unit.
    pub metres: f64,
    /// The probability that it is off by less than a tenth, 0..=1.
    pub confidence: f64,
    /// What speaks for it.
    pub evidence: String,
}

/// In what unit a network reads a scene.
#[derive(Debug, Clone, PartialEq)]
pub enum ReadUnit {
    /// As the extent says.
    Clear,
    /// As the extent says, which leaves it open.
    Open,
    /// By what is in the scene.
    Sized(SizedUnit),
}

/// The confidence in meters where neither walls nor things say how large a scene is.
const OPEN: f64 = 0.5;

/// The unit by the extent, as far as a network that reads the scene does not know better.
pub(super) fn as_read(
    guess: Option<UnitGuess>,
    read: Option<&ReadUnit>,
) -> (Option<UnitGuess>, Option<SizedUnit>) {
    match (read, guess) {
        (Some(ReadUnit::Sized(sized)), _) => {
            let SizedUnit { confidence, evidence, .. } = sized.clone();
            let guess = UnitGuess { unit: LengthUnit::Metre, confidence, evidence };
            ((sized.metres == 1.0).then_some(guess), Some(sized.clone()))
        }
        (Some(ReadUnit::Open), Some(mut guess)) if guess.unit == LengthUnit::Metre => {
            guess.confidence = guess.confidence.min(OPEN);
            guess.evidence += "; neither walls nor things of known size tell";
            (Some(guess), None)
        }
        (_, guess) => (guess, None),
    }
}

/// A scene this large, with Gaussians this far apart, is no capture in meters: an aerial survey of a
/// kilometer has them closer, terrain of some hundred meters is smaller.
const LARGE: f64 = 600.0;
const COARSE: f64 = 1.0;

/// From here on a room is better explained by centimeters; terrain is as large, so it stays a remark.
const ROOM_IN_CM: f64 = 150.0;

/// Gaussians whose spacing is measured where a sample is enough.
const SAMPLE: usize = 50_000;

/// Smaller than five voxels of 2 cm.
const TINY: f64 = 0.1;

/// From this confidence on networks read a scene in meters.
const SURE: f64 = 0.9;

/// Whether a unit other than the meter is so sure that networks read the scene scaled. Terrain
/// sampled by the meter is as large as a room in millimeters, but flat.
pub(crate) fn is_surely_no_metre(guess: &UnitGuess, robust: &Bounds) -> bool {
    guess.unit != LengthUnit::Metre
        && guess.confidence >= SURE
        && robust.smallest_extent() > 0.15 * robust.largest_extent()
}

/// Whether the size alone leaves the meter in doubt; only then is the spacing worth measuring.
pub(crate) fn may_be_no_metre(robust: &Bounds) -> bool {
    let size = robust.largest_extent();
    size > ROOM_IN_CM || (0.0 < size && size < TINY)
}

/// Median distance to the fourth neighbor, by a sample of the Gaussians; `None` if there are too
/// few, or a coordinate is not finite.
pub(crate) fn usual_spacing(coord: &[[f32; 3]]) -> Option<f64> {
    let tree = KdTree::new(coord).ok().filter(|_| coord.len() > NEIGHBOUR)?;
    let step = coord.len().div_ceil(SAMPLE);
    let query: Vec<[f32; 3]> = coord.iter().step_by(step).copied().collect();
    quantile(&mut to_fourth(&tree, &query), 0.5).map(f64::from)
}

/// Judges by the largest side of the robust box and the usual distance of neighbors, meters if the
/// unit is the meter. `None` if the scene has no extent.
pub(crate) fn guess_unit(robust: &Bounds, spacing: Option<f64>) -> Option<UnitGuess> {
    let size = robust.largest_extent();
    let spacing = spacing?;
    if size <= 0.0 {
        return None;
    }
    let about = format!("{} units across, neighbors {} apart", short(size), short(spacing));
    let upright = robust.smallest_extent() / size;
    Some(if size > LARGE && spacing > COARSE {
        // Twice as large is twice as sure; a kilometer is the least that a survey has.
        let confidence = (0.6 + 0.2 * (size / LARGE).log2()).min(0.98);
        let evidence = format!("{about}: nothing that is captured in meters is");
        UnitGuess { unit: LengthUnit::Millimetre, confidence, evidence }
    } else if size < TINY {
        let evidence = format!("{about}: smaller than five voxels of 2 cm");
        UnitGuess { unit: LengthUnit::Kilometre, confidence: 0.6, evidence }
    } else if size > ROOM_IN_CM && spacing > 0.5 * COARSE && upright > 0.15 {
        let evidence = format!("{about}, and as high as a room is for its width");
        UnitGuess { unit: LengthUnit::Centimetre, confidence: 0.4, evidence }
    } else {
        let confidence = if (1.0..50.0).contains(&size) { 0.9 } else { 0.6 };
        UnitGuess { unit: LengthUnit::Metre, confidence, evidence: about }
    })
}

/// Three significant digits.
pub(super) fn short(value: f64) -> String {
    let magnitude = value.abs();
    if !value.is_finite() {
        "-".to_owned()
    } else if magnitude != 0.0 && !(1e-3..1e6).contains(&magnitude) {
        format!("{value:.2e}")
    } else if magnitude >= 100.0 {
        format!("{value:.0}")
    } else if magnitude >= 10.0 {
        format!("{value:.1}")
    } else if magnitude >= 1.0 || magnitude == 0.0 {
        format!("{value:.2}")
    } else {
        format!("{value:.4}")
    }
}
