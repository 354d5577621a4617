//! [`CenterShift`]

use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Moves the middle of the bounding box to x = y = 0 and, if wanted, its floor to z = 0.
    ///
    /// In f32, as the original and as [`center_shift`](crate::plan::center_shift), so that training and
    /// inference see the same cells. Without Gaussians nothing moves.
    pub struct CenterShift {
        /// Whether z is shifted too.
        pub apply_z: bool = true,
    }
}

impl Transform for CenterShift {
    fn apply(&self, sample: &mut Sample, _: &mut SampleRng) -> Result<(), DataError> {
        let Some([low, high]) = sample.bounds() else { return Ok(()) };
        let z = if self.apply_z { low[2] } else { 0.0 };
        let shift = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, z];
        for c in sample.places_mut() {
            (0..3).for_each(|axis| c[axis] -= shift[axis]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::center_shift;
    use crate::transforms::testing::{applied, at, room};

    #[test]
    fn as_inference_shifts() {
        let sample = room(2000);
        let moved = applied(&CenterShift::default(), &sample, 0);
        assert_eq!(moved.coord, center_shift(&sample.coord));
        let flat = applied(&CenterShift { apply_z: false }, &sample, 0);
        for (a, b) in flat.coord.iter().zip(&sample.coord) {
            assert_eq!(a[2], b[2]);
        }
        // Labeled points keep their place among the Gaussians.
        let points = moved.labelled_points.unwrap().coord;
        assert!(points.iter().zip(moved.coord.iter().step_by(7)).all(|(p, c)| p == c));
    }

    #[test]
    fn one() {
        let moved = applied(&CenterShift::default(), &at(&[[5.0, -3.0, 2.0]]), 0);
        assert_eq!(moved.coord, [[0.0; 3]]);
    }
}
