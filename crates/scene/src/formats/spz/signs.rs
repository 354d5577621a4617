//! What a change of axis directions does to the numbers of a Gaussian.

use crate::GaussianScene;
use crate::formats::SpzFrame;
use crate::frame::Frame;
use rayon::prelude::*;

/// Signs by which numbers in a file and in memory differ; the same in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Signs {
    /// Of x, y and z.
    pub(super) coord: [f32; 3],
    /// Of the vector part of quaternions.
    pub(super) quat: [f32; 3],
    /// Of the harmonics of bands 1 to 4.
    pub(super) rest: [f32; 24],
}

impl Signs {
    /// Between `frame` and the canonical frame; `None` where axes change places.
    pub(super) fn of(frame: Frame) -> Option<Self> {
        let m = frame.matrix_to(Frame::CANONICAL);
        let diagonal = (0..3).all(|i| m[i][i] != 0.0);
        diagonal.then(|| Self::flip([m[0][0], m[1][1], m[2][2]].map(|v| v as f32)))
    }

    /// For the frame that the user says a file is in.
    pub(super) fn assumed(frame: SpzFrame) -> Self {
        match frame {
            SpzFrame::Rub => Self::flip([1.0, -1.0, -1.0]),
            SpzFrame::Raw => Self::flip([1.0; 3]),
        }
    }

    fn flip([x, y, z]: [f32; 3]) -> Self {
        #[rustfmt::skip]
        let rest = [
            y, z, x,
            x * y, y * z, 1.0, x * z, 1.0,
            y, x * y * z, y, z, x, z, x,
            // The last function of band 4 is even along every axis, but the reference changes its
            // sign with y. It does so on both ways, and files of degree 4 come from it: to do the
            // same is what gives back the numbers that went in.
            x * y, y * z, x * y, y * z, 1.0, x * z, 1.0, x * z, y,
        ];
        Self { coord: [x, y, z], quat: [y * z, x * z, x * y], rest }
    }

    /// Changes the signs of a scene that is in memory.
    pub(super) fn apply(&self, scene: &mut GaussianScene) {
        // Zeros keep their sign, as in the decoders.
        let flip = |v: &mut f32, sign: f32| {
            if *v != 0.0 {
                *v *= sign;
            }
        };
        let flip_three = |v: &mut [f32], signs: [f32; 3]| {
            v.iter_mut().zip(signs).for_each(|(v, sign)| flip(v, sign));
        };
        scene.coord.par_iter_mut().for_each(|v| flip_three(v, self.coord));
        scene.quat.par_iter_mut().for_each(|q| flip_three(&mut q[1..], self.quat));
        let width = scene.sh_rest_len() * 3;
        if width > 0 {
            scene.sh_rest.par_chunks_exact_mut(width).for_each(|row| {
                for (rgb, &sign) in row.as_chunks_mut::<3>().0.iter_mut().zip(&self.rest) {
                    flip_three(rgb, [sign; 3]);
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spherical_harmonics::rest_basis;

    #[test]
    fn harmonics_change_sign_as_their_functions_do() {
        let d = [0.48, -0.6, 0.64];
        for signs in 0..8 {
            let f = [1, 2, 4].map(|bit| if signs & bit == 0 { 1.0f32 } else { -1.0 });
            let flipped = [0, 1, 2].map(|i| d[i] * f64::from(f[i]));
            let (before, after) = (rest_basis(d), rest_basis(flipped));
            let rest = Signs::flip(f).rest;
            for i in 0..23 {
                assert!((after[i] - before[i] * f64::from(rest[i])).abs() < 1e-12, "{f:?} {i}");
            }
            // The exception of the reference.
            assert!((after[23] - before[23]).abs() < 1e-12);
            assert_eq!(rest[23], f[1]);
        }
    }

    #[test]
    fn frames_of_the_format() {
        assert_eq!(Signs::of(Frame::RUB), Some(Signs::assumed(SpzFrame::Rub)));
        assert_eq!(Signs::of(Frame::CANONICAL), Some(Signs::assumed(SpzFrame::Raw)));
        assert_eq!(Signs::of(Frame::LUF).unwrap().coord, [-1.0, -1.0, 1.0]);
        assert_eq!(Signs::of("RFU".parse().unwrap()), None);
    }
}
