//! The direction that is up in a scene.

use crate::frame::Matrix3;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The direction that is up in a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum UpAxis {
    /// +x
    #[serde(rename = "+x")]
    PlusX,
    /// −x
    #[serde(rename = "-x")]
    MinusX,
    /// +y
    #[serde(rename = "+y")]
    PlusY,
    /// −y: scenes from image-based pipelines, whose y points down.
    #[serde(rename = "-y")]
    MinusY,
    /// +z: captured rooms, and what networks are trained on.
    #[default]
    #[serde(rename = "+z")]
    PlusZ,
    /// −z
    #[serde(rename = "-z")]
    MinusZ,
}

impl UpAxis {
    /// All six.
    pub const ALL: [Self; 6] =
        [Self::PlusX, Self::MinusX, Self::PlusY, Self::MinusY, Self::PlusZ, Self::MinusZ];

    /// Its name: `+z`.
    pub fn name(self) -> &'static str {
        ["+x", "-x", "+y", "-y", "+z", "-z"][self as usize]
    }

    /// Number of the axis, 0..3, and whether up points along it.
    pub fn axis(self) -> (usize, bool) {
        (self as usize / 2, (self as usize).is_multiple_of(2))
    }

    /// The rotation that takes a scene with this direction up to one with +z up: one ±1 in every row
    /// and column, determinant 1, the identity for +z. The first axis stays where it is, unless it
    /// is the one that was up.
    pub fn upright(self) -> Matrix3 {
        let (axis, is_positive) = self.axis();
        let up = DVec3::AXES[axis] * if is_positive { 1.0 } else { -1.0 };
        let first = DVec3::AXES[usize::from(axis == 0)];
        // Adding 0 makes no −0 of a product with 0.
        [first, up.cross(first), up].map(|row| (row + 0.0).to_array())
    }
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for UpAxis {
    type Err = String;

    /// Reads a name, with or without the plus.
    fn from_str(text: &str) -> Result<Self, String> {
        let named =
            |axis: &Self| axis.name() == text || axis.name().strip_prefix('+') == Some(text);
        Self::ALL
            .into_iter()
            .find(named)
            .ok_or_else(|| format!("{text:?} is no axis; write +z or -y"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::determinant;

    #[test]
    fn upright_turns_up_to_z_and_never_mirrors() {
        for up in UpAxis::ALL {
            let m = up.upright();
            let (axis, is_positive) = up.axis();
            let column = [0, 1, 2].map(|i| m[i][axis]);
            assert_eq!(column, [0.0, 0.0, if is_positive { 1.0 } else { -1.0 }], "{up}");
            assert_eq!(determinant(&m), 1.0, "{up}");
            assert!(m.iter().flatten().all(|v| !v.is_sign_negative() || *v == -1.0), "{up}: {m:?}");
        }
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(UpAxis::PlusZ.upright(), identity);
    }

    #[test]
    fn names_are_read_back() {
        for up in UpAxis::ALL {
            assert_eq!(up.name().parse(), Ok(up));
            assert_eq!(up.to_string(), up.name());
        }
        assert_eq!("y".parse(), Ok(UpAxis::PlusY));
        for text in ["", "+", "z+", "up", "--z", "+w"] {
            assert!(text.parse::<UpAxis>().is_err(), "{text}");
        }
    }
}
