//! Turns and moves as users write them.

use crate::Frame;
use crate::frame::{Matrix3, product};
use std::str::FromStr;

/// From which frame to which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameChange {
    /// The frame the scene is in.
    pub from: Frame,
    /// The frame it shall be in.
    pub to: Frame,
}

impl FromStr for FrameChange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(match text.split_once(':') {
            Some((from, to)) => Self { from: from.parse()?, to: to.parse()? },
            None => Self { from: Frame::CANONICAL, to: text.parse()? },
        })
    }
}

/// Turns about the fixed axes x, then y, then z, in degrees; each against the clock for a viewer
/// toward whom the axis points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EulerAngles(pub [f64; 3]);

impl EulerAngles {
    /// The rotation, `Rz · Ry · Rx`. Quarter turns are exact.
    pub fn matrix(self) -> Matrix3 {
        let [x, y, z] = self.0.map(sine_and_cosine);
        let about_x = [[1.0, 0.0, 0.0], [0.0, x[1], -x[0]], [0.0, x[0], x[1]]];
        let about_y = [[y[1], 0.0, y[0]], [0.0, 1.0, 0.0], [-y[0], 0.0, y[1]]];
        let about_z = [[z[1], -z[0], 0.0], [z[0], z[1], 0.0], [0.0, 0.0, 1.0]];
        // Adding 0 makes no −0 of a product with 0.
        product(&about_z, &product(&about_y, &about_x)).map(|row| row.map(|v| v + 0.0))
    }
}

/// Sine and cosine of degrees; of multiples of 90 without rounding.
fn sine_and_cosine(degrees: f64) -> [f64; 2] {
    let turn = degrees.rem_euclid(360.0);
    match turn {
        0.0 => [0.0, 1.0],
        90.0 => [1.0, 0.0],
        180.0 => [0.0, -1.0],
        270.0 => [-1.0, 0.0],
        _ => {
            let (sine, cosine) = turn.to_radians().sin_cos();
            [sine, cosine]
        }
    }
}

impl FromStr for EulerAngles {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("{text:?}: write three angles in degrees, about x, y, z: 0,0,90");
        three(text).map(Self).ok_or_else(bad)
    }
}

/// A move, in units of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset(pub [f64; 3]);

impl FromStr for Offset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("{text:?}: write a move along x, y, z: 0,0,1.5");
        three(text).map(Self).ok_or_else(bad)
    }
}

/// Three finite numbers with commas between.
fn three(text: &str) -> Option<[f64; 3]> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    numbers?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::determinant;

    fn turned(angles: [f64; 3], p: [f64; 3]) -> [f64; 3] {
        EulerAngles(angles).matrix().map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2])
    }

    #[test]
    fn turns_are_about_fixed_axes_in_order() {
        assert_eq!(turned([0.0, 0.0, 90.0], [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]);
        assert_eq!(turned([90.0, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_eq!(turned([0.0, 90.0, 0.0], [0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]);
        // x first: y becomes z; then z stays under the turn about z.
        assert_eq!(turned([90.0, 0.0, 90.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_eq!(EulerAngles([360.0, -360.0, 720.0]).matrix()[1], [0.0, 1.0, 0.0]);
        let m = EulerAngles([10.0, -75.5, 200.0]).matrix();
        assert!((determinant(&m) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn nonsense_is_refused() {
        for text in ["", "1", "1,2", "1,2,3,4", "nan,0,0", "inf,0,0", "a,b,c"] {
            assert!(text.parse::<EulerAngles>().is_err(), "{text}");
            assert!(text.parse::<Offset>().is_err(), "{text}");
        }
        assert_eq!("-1, 2.5,0".parse(), Ok(Offset([-1.0, 2.5, 0.0])));
        assert!("RDF:XYZ".parse::<FrameChange>().is_err());
        let change: FrameChange = "rub".parse().unwrap();
        assert_eq!((change.from, change.to), (Frame::CANONICAL, Frame::RUB));
    }
}
