//! The direction that is up in a scene.

use crate::frame::{Matrix3, product};
use crate::vector::dot;
use glam::DVec3;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
use std::fmt;
use std::str::FromStr;

/// The direction that is up in a scene: a unit vector. Written and read as the name of an axis, `-y`,
/// or as three numbers, `0.1,-0.9,0.4`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Up([f64; 3]);

impl Up {
    /// +x
    pub const PLUS_X: Self = Self([1.0, 0.0, 0.0]);
    /// −x
    pub const MINUS_X: Self = Self([-1.0, 0.0, 0.0]);
    /// +y
    pub const PLUS_Y: Self = Self([0.0, 1.0, 0.0]);
    /// −y: scenes from image-based pipelines, whose y points down.
    pub const MINUS_Y: Self = Self([0.0, -1.0, 0.0]);
    /// +z: captured rooms, and what networks are trained on.
    pub const PLUS_Z: Self = Self([0.0, 0.0, 1.0]);
    /// −z
    pub const MINUS_Z: Self = Self([0.0, 0.0, -1.0]);

    /// The six axes.
    pub const AXES: [Self; 6] =
        [Self::PLUS_X, Self::MINUS_X, Self::PLUS_Y, Self::MINUS_Y, Self::PLUS_Z, Self::MINUS_Z];

    /// A direction of any length; `None` if it has none, or is not finite.
    pub fn new(direction: [f64; 3]) -> Option<Self> {
        let largest = direction.iter().fold(0.0f64, |a, v| a.max(v.abs()));
        if !(largest.is_finite() && largest > 0.0) || direction.iter().any(|v| v.is_nan()) {
            return None;
        }
        // Of huge and tiny numbers the square is not a number.
        let v = DVec3::from(direction.map(|v| v / largest)).normalize();
        Self::AXES.into_iter().find(|a| a.0 == v.to_array()).or(Some(Self(v.to_array())))
    }

    /// The unit vector.
    pub fn vector(self) -> [f64; 3] {
        self.0
    }

    /// The name of the axis that it is, `-y`; `None` if it is none.
    pub fn axis_name(self) -> Option<&'static str> {
        let names = ["+x", "-x", "+y", "-y", "+z", "-z"];
        Self::AXES.iter().position(|a| *a == self).map(|at| names[at])
    }

    /// The axis that is nearest; of equally near ones the first.
    pub fn nearest_axis(self) -> Self {
        let cosine = |axis: Self| dot(axis.0, self.0);
        let first = Self::AXES[0];
        Self::AXES.into_iter().fold(first, |a, b| if cosine(b) > cosine(a) { b } else { a })
    }

    /// The angle to another direction, degrees, 0..=180.
    pub fn degrees_from(self, other: Self) -> f64 {
        DVec3::from(self.0).angle_between(DVec3::from(other.0)).to_degrees()
    }

    /// For people: the axis, or the direction and how far it is from the nearest axis.
    pub fn described(self) -> String {
        let axis = self.nearest_axis();
        match self.axis_name() {
            Some(name) => name.to_owned(),
            None => format!("{self}, {:.1} degrees from {axis}", self.degrees_from(axis)),
        }
    }

    /// The opposite direction.
    pub fn opposite(self) -> Self {
        // Adding 0 makes no −0 of a 0.
        Self(self.0.map(|v| 0.0 - v))
    }

    /// The rotation that takes a scene with this direction up to one with +z up.
    ///
    /// For an axis it has one ±1 in every row and column, is the identity for +z, and leaves the first
    /// axis where it is unless that is the one that was up. Another direction is turned as its nearest
    /// axis, and then by the shortest way.
    pub fn upright(self) -> Matrix3 {
        let axis = self.nearest_axis();
        let up = DVec3::from(axis.0);
        let first = DVec3::AXES[usize::from(axis.0[0] != 0.0)];
        // Adding 0 makes no −0 of a product with 0.
        let turn = [first, up.cross(first), up].map(|row| (row + 0.0).to_array());
        if axis == self {
            return turn;
        }
        let tilted = turn.map(|row| dot(row, self.0));
        product(&shortest_to_z(tilted), &turn)
    }
}

/// The smallest rotation that takes a unit vector with z > −1 to +z.
pub(crate) fn shortest_to_z([x, y, z]: [f64; 3]) -> Matrix3 {
    let f = 1.0 / (1.0 + z);
    [[1.0 - f * x * x, -f * x * y, -x], [-f * x * y, 1.0 - f * y * y, -y], [x, y, z]]
}

impl Default for Up {
    fn default() -> Self {
        Self::PLUS_Z
    }
}

impl fmt::Display for Up {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.axis_name() {
            Some(name) => f.write_str(name),
            None => {
                // Adding 0 makes no −0 of a rounded 0.
                let [x, y, z] = self.0.map(|v| (v * 1e6).round() / 1e6 + 0.0);
                write!(f, "{x},{y},{z}")
            }
        }
    }
}

impl Serialize for Up {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Up {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

impl FromStr for Up {
    type Err = String;

    /// Reads the name of an axis, with or without the plus, or three numbers.
    fn from_str(text: &str) -> Result<Self, String> {
        let is_named = |axis: &Self| {
            axis.axis_name()
                .is_some_and(|name| name == text || name.strip_prefix('+') == Some(text))
        };
        if let Some(axis) = Self::AXES.into_iter().find(is_named) {
            return Ok(axis);
        }
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse()).collect();
        let three = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
        three.and_then(Self::new).ok_or_else(|| {
            format!("{text:?} is no direction; write +z, -y, or three numbers such as 0.1,-0.9,0.4")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::determinant;

    #[test]
    fn upright_turns_an_axis_to_z_without_rounding_and_never_mirrors() {
        for up in Up::AXES {
            let m = up.upright();
            assert_eq!(m.map(|row| dot(row, up.vector())), [0.0, 0.0, 1.0], "{up}");
            assert_eq!(determinant(&m), 1.0, "{up}");
            assert!(m.iter().flatten().all(|v| !v.is_sign_negative() || *v == -1.0), "{up}: {m:?}");
        }
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(Up::PLUS_Z.upright(), identity);
    }

    #[test]
    fn upright_turns_any_direction_to_z() {
        for direction in [[1.0, 1.0, 1.0], [-3.0, 0.1, 0.2], [0.0, 1e-3, -1.0], [1e300, 1e300, 0.0]]
        {
            let up = Up::new(direction).unwrap();
            let m = up.upright();
            let turned = m.map(|row| dot(row, up.vector()));
            for (got, due) in turned.into_iter().zip([0.0, 0.0, 1.0]) {
                assert!((got - due).abs() < 1e-14, "{up}: {turned:?}");
            }
            assert!((determinant(&m) - 1.0).abs() < 1e-14, "{up}");
        }
        assert_eq!(Up::new([0.0, -7.0, 0.0]), Some(Up::MINUS_Y));
        for none in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(Up::new(none), None);
        }
    }

    #[test]
    fn angles_and_nearest_axes() {
        let up = Up::new([0.1, -0.9, 0.2]).unwrap();
        assert_eq!(up.nearest_axis(), Up::MINUS_Y);
        assert_eq!(Up::PLUS_X.degrees_from(Up::MINUS_X), 180.0);
        assert!((up.degrees_from(Up::MINUS_Y) - 13.95).abs() < 0.01);
        assert_eq!(Up::MINUS_Y.opposite(), Up::PLUS_Y);
    }

    #[test]
    fn names_are_read_back() {
        for up in Up::AXES {
            assert_eq!(up.to_string().parse(), Ok(up));
        }
        assert_eq!("y".parse(), Ok(Up::PLUS_Y));
        let up = Up::new([0.1, -0.9, 0.4]).unwrap();
        let back: Up = up.to_string().parse().unwrap();
        assert!(back.degrees_from(up) < 1e-4, "{up} {back}");
        for text in
            ["", "+", "z+", "up", "--z", "+w", "1,2", "1,2,3,4", "0,0,0", "nan,0,1", "1,x,2"]
        {
            assert!(text.parse::<Up>().is_err(), "{text}");
        }
    }
}
