//! What a user must know about how a scene is read.

use crate::inspect::LengthUnit;
use scenesplat_scene::Up;
use serde::Serialize;

/// Something about a scene that changes what a network makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "what")]
pub enum Remark {
    /// A turned copy is read.
    Turned {
        /// What was up.
        from: Up,
    },
    /// A level copy is read.
    Leveled {
        /// Degrees that the floor was off.
        tilt: f64,
    },
    /// A copy with its walls along the axes is read.
    Squared {
        /// Degrees that the walls were off.
        yaw: f64,
    },
    /// A copy is read that is as high as rooms are.
    ScaledToRoom {
        /// Meters per unit.
        by: f64,
        /// Height of its walls, units.
        height: f64,
    },
    /// A copy is read in which things have the sizes that they have in rooms.
    ScaledBySize {
        /// Meters per unit.
        by: f64,
        /// How sure it is that this is off by less than a tenth.
        confidence: f64,
    },
    /// Up is not clear.
    UpUnclear {
        /// The direction that is taken.
        likely: Up,
        /// How sure.
        confidence: f64,
    },
    /// A scaled copy is read.
    Scaled {
        /// Meters per unit.
        by: f64,
    },
    /// The unit seems to be another one; the scene is read as if it were the meter.
    UnitUnclear {
        /// The likeliest unit.
        likely: LengthUnit,
        /// How sure.
        confidence: f64,
    },
    /// Nothing says what the unit is, and in meters the scene would be no room; it is read as if it were the meter.
    SizeUnclear {
        /// Height of the scene, units.
        height: f64,
    },
}

impl Remark {
    /// Whether it is about the unit.
    pub(super) fn is_of_unit(&self) -> bool {
        matches!(
            self,
            Self::Scaled { .. }
                | Self::ScaledToRoom { .. }
                | Self::ScaledBySize { .. }
                | Self::UnitUnclear { .. }
                | Self::SizeUnclear { .. }
        )
    }

    /// Whether nothing was done about it, so that labels may be wrong.
    pub fn is_warning(&self) -> bool {
        match self {
            Self::UpUnclear { .. } | Self::UnitUnclear { .. } | Self::SizeUnclear { .. } => true,
            // Heights of rooms differ by a fifth, and by what is in them a unit is found to a few percent.
            Self::ScaledToRoom { .. } | Self::ScaledBySize { .. } => true,
            Self::Turned { .. }
            | Self::Leveled { .. }
            | Self::Squared { .. }
            | Self::Scaled { .. } => false,
        }
    }
}
