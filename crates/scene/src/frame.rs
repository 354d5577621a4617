//! Coordinate frames, and moving a scene from one to another.
//!
//! A [`Frame`] names the directions of +x, +y and +z as a viewer sees them: `RDF` is right, down,
//! forward. In memory a scene is in the frame of the original trainer's PLY files, nominally
//! [`Frame::CANONICAL`]; readers of formats with another prescribed frame convert. PLY, `.splat`,
//! `.ksplat` and SOG carry no frame at all: what is up in such a file is what its author made up.

use glam::{DMat3, DVec3};
use std::fmt;
use std::str::FromStr;

/// A 3×3 matrix, row by row.
pub type Matrix3 = [[f64; 3]; 3];

/// Where the three axes point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    letters: [u8; 3],
}

impl Frame {
    /// Right, down, forward: the frame of scenes in memory, of COLMAP and of PLY files.
    pub const CANONICAL: Self = Self { letters: *b"RDF" };
    /// Right, up, back: the frame of SPZ files and of OpenGL cameras.
    pub const RUB: Self = Self { letters: *b"RUB" };
    /// Left, up, forward: the frame of glTF files.
    pub const LUF: Self = Self { letters: *b"LUF" };

    /// The matrix that takes coordinates in this frame to coordinates in `to`: one ±1 in every row
    /// and column. Its determinant is −1 between a left-handed and a right-handed frame.
    pub fn matrix_to(self, to: Self) -> Matrix3 {
        product(&to.axes(), &transposed(&self.axes()))
    }

    /// The axes as vectors of right, up, back.
    fn axes(self) -> Matrix3 {
        self.letters.map(|letter| match letter {
            b'R' => [1.0, 0.0, 0.0],
            b'L' => [-1.0, 0.0, 0.0],
            b'U' => [0.0, 1.0, 0.0],
            b'D' => [0.0, -1.0, 0.0],
            b'B' => [0.0, 0.0, 1.0],
            _ => [0.0, 0.0, -1.0],
        })
    }
}

impl FromStr for Frame {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || {
            format!(
                "{text:?} is no frame; write where +x, +y and +z point, one letter of each pair \
                 right/left, up/down, forward/back: RDF (PLY, COLMAP), RUB (SPZ, OpenGL), LUF (glTF)"
            )
        };
        let upper = text.to_ascii_uppercase();
        let letters: [u8; 3] = upper.as_bytes().try_into().map_err(|_| bad())?;
        let pair = |letter| ["RL", "UD", "FB"].iter().position(|p| p.as_bytes().contains(&letter));
        let mut seen = [false; 3];
        for letter in letters {
            let at = pair(letter).ok_or_else(bad)?;
            if std::mem::replace(&mut seen[at], true) {
                return Err(bad());
            }
        }
        Ok(Self { letters })
    }
}

impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.letters.iter().try_for_each(|&l| write!(f, "{}", char::from(l)))
    }
}

/// The matrix of these rows.
pub(crate) fn matrix(rows: &Matrix3) -> DMat3 {
    DMat3::from_cols_array_2d(rows).transpose()
}

/// The matrix with rows and columns exchanged.
pub(crate) fn transposed(m: &Matrix3) -> Matrix3 {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]))
}

/// The product of two matrices.
pub(crate) fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    (matrix(a) * matrix(b)).transpose().to_cols_array_2d()
}

/// The product of a matrix and a vector.
pub(crate) fn apply(m: &Matrix3, v: [f64; 3]) -> [f64; 3] {
    (matrix(m) * DVec3::from(v)).to_array()
}

/// The determinant.
pub(crate) fn determinant(m: &Matrix3) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    fn all() -> Vec<Frame> {
        let mut frames = Vec::new();
        for order in ["abc", "acb", "bac", "bca", "cab", "cba"] {
            for signs in 0..8 {
                let letter = |c: char| match c {
                    'a' => ['R', 'L'][signs & 1],
                    'b' => ['U', 'D'][signs >> 1 & 1],
                    _ => ['F', 'B'][signs >> 2],
                };
                frames.push(order.chars().map(letter).collect::<String>().parse().unwrap());
            }
        }
        frames
    }

    #[test]
    fn every_pair_of_frames_goes_there_and_back() {
        let frames = all();
        assert_eq!(frames.len(), 48);
        for &a in &frames {
            assert_eq!(a.matrix_to(a), IDENTITY);
            for &b in &frames {
                assert_eq!(product(&b.matrix_to(a), &a.matrix_to(b)), IDENTITY, "{a} {b}");
                assert_eq!(determinant(&a.matrix_to(b)).abs(), 1.0);
            }
        }
    }

    #[test]
    fn known_conversions() {
        let flip = Frame::CANONICAL.matrix_to(Frame::RUB);
        assert_eq!(flip, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
        let z_up: Frame = "rfu".parse().unwrap();
        // Down is +y in RDF, so up in the new frame's z is −y.
        assert_eq!(Frame::CANONICAL.matrix_to(z_up)[2], [0.0, -1.0, 0.0]);
        assert_eq!(z_up.to_string(), "RFU");
    }

    #[test]
    fn nonsense_is_refused() {
        for text in ["", "RD", "RDFF", "RRF", "RLF", "XYZ", "ÄÖÜ"] {
            assert!(text.parse::<Frame>().is_err(), "{text}");
        }
    }
}
