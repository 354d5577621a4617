//! [`LimitValues`]

use crate::error::{check_positive, require};
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Shrinks a scene and limits its values, as the original's scene loaders do on reading.
    ///
    /// The default changes nothing. Limits of the network's input are in
    /// [`InputFeatures`](crate::InputFeatures), after all transforms; these are before them.
    pub struct LimitValues {
        /// Positions and sizes are divided by this, first; labeled points stay as they are, as in the
        /// original.
        pub divide: f32 = 1.0,
        /// Lowest and highest size, meters.
        pub scale: Option<[f32; 2]> = None,
        /// Lowest opacity.
        pub opacity_floor: f32 = 0.0,
    }
}

impl Transform for LimitValues {
    fn check(&self) -> Result<(), DataError> {
        check_positive("limit_values.divide", f64::from(self.divide))?;
        if let Some([low, high]) = self.scale {
            let value = format!("[{low}, {high}]");
            require(low <= high, "limit_values.scale", value, "two numbers, the lower first")?;
        }
        let floor = self.opacity_floor;
        let ok = (0.0..=1.0).contains(&floor);
        require(ok, "limit_values.opacity_floor", floor, "a number in 0..=1")
    }

    fn apply(&self, sample: &mut Sample, _: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if self.divide != 1.0 {
            for values in sample.coord.iter_mut().chain(&mut sample.scale) {
                *values = values.map(|v| v / self.divide);
            }
        }
        if let Some([low, high]) = self.scale {
            sample.scale.as_flattened_mut().iter_mut().for_each(|s| *s = s.clamp(low, high));
        }
        for opacity in &mut sample.opacity {
            // A NaN stays, so that it is found.
            if *opacity < self.opacity_floor {
                *opacity = self.opacity_floor;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, room};

    #[test]
    fn values_are_limited_after_shrinking() {
        let mut sample = at(&[[10.0, 20.0, 30.0]; 2]);
        sample.scale = vec![[0.01, 50.0, 200.0]; 2];
        sample.opacity = vec![0.0, f32::NAN];
        let limits = LimitValues { divide: 10.0, scale: Some([0.01, 10.0]), opacity_floor: 0.001 };
        let limited = applied(&limits, &sample, 0);
        assert_eq!(limited.coord[0], [1.0, 2.0, 3.0]);
        assert_eq!(limited.scale[0], [0.01, 5.0, 10.0]);
        assert_eq!(limited.opacity[0], 0.001);
        assert!(limited.opacity[1].is_nan());
        let room = room(100);
        assert_eq!(applied(&LimitValues::default(), &room, 0), room);
    }
}
