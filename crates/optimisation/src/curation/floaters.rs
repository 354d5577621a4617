//! Gaussians that float in front of what was measured.

use crate::frame::TrainingFrame;
use crate::{Model, OptimiseError};
use scenesplat_rasterizer::{RasterSettings, RenderRequest, render};
use serde::Serialize;

/// A Gaussian floats if it is nearer than the measurement by this, units of the scene …
const NEARER: f32 = 0.1;
/// … and by this share of it …
const SHARE: f32 = 0.05;
/// … in at least this many frames.
const FRAMES: u16 = 2;

/// Floaters of a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Floaters {
    /// Gaussians that float.
    pub count: usize,
    /// Part of all blending weight that they have, 0 to 1.
    pub mass: f64,
    /// Frames with depth.
    pub frames: usize,
}

/// Counts floaters in frames with depth; `None` if there is none.
///
/// A Gaussian is at the pixel of its center; it is in front if it is there nearer than the measured depth
/// by more than 0.1 and 5 %. What is hidden at no pixel has no weight, so it does not count in the mass.
///
/// # Errors
/// What the rasterizer refuses.
pub fn floaters(
    model: &Model,
    frames: &[TrainingFrame],
    raster: &RasterSettings,
) -> Result<Option<Floaters>, OptimiseError> {
    let n = model.len();
    let (mut in_front, mut mass) = (vec![0u16; n], vec![0.0f64; n]);
    let mut looked = 0;
    for frame in frames {
        let Some(depth) = &frame.depth else { continue };
        looked += 1;
        let request = RenderRequest { contributions: true, ..RenderRequest::default() };
        let drawn = render(model.gaussians(), &frame.view, raster, &request)?;
        let sums = drawn.contributions.map(|c| c.sum).unwrap_or_default();
        let v = &frame.view;
        for i in 0..n {
            let weight = sums.get(i).copied().unwrap_or(0.0);
            if !(weight > 0.0) {
                continue;
            }
            mass[i] += f64::from(weight);
            let [x, y, z] = v.to_camera(model.gaussians().means[i]);
            let (px, py) = (v.fx * x / z + v.cx, v.fy * y / z + v.cy);
            if !(z > 0.0 && px >= 0.0 && py >= 0.0 && px < v.width as f32 && py < v.height as f32) {
                continue;
            }
            let measured = depth[py as usize * v.width as usize + px as usize];
            if measured > 0.01
                && measured.is_finite()
                && z < measured - NEARER.max(SHARE * measured)
            {
                in_front[i] += 1;
            }
        }
    }
    if looked == 0 {
        return Ok(None);
    }
    let floats = |i: &usize| in_front[*i] >= FRAMES.min(looked as u16);
    let total: f64 = mass.iter().sum();
    let floating: f64 = (0..n).filter(floats).map(|i| mass[i]).sum();
    let count = (0..n).filter(floats).count();
    let mass = if total > 0.0 { floating / total } else { 0.0 };
    Ok(Some(Floaters { count, mass, frames: looked }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Stored;
    use crate::frame::tests::{frame, view};

    /// One Gaussian on the measured wall, one half way to it, one within the tolerance.
    #[test]
    fn what_is_in_front_floats() {
        let row = |mean: [f32; 3]| Stored {
            mean,
            log_scale: [-2.5; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            logit: 0.0,
        };
        let rows = [row([0.3, 0.0, 1.0]), row([-0.3, 0.0, 0.0]), row([0.0, 0.3, 0.9])];
        let model = Model::from_arrays(&rows, vec![0.0; 9], 0).unwrap();
        let frame = |depth| frame(view(64, 48), depth);
        let raster = RasterSettings::default();
        let find = |frames: &[TrainingFrame]| floaters(&model, frames, &raster).unwrap();
        assert_eq!(find(&[frame(None)]), None);
        let found = find(&[frame(Some(3.0)), frame(None), frame(Some(3.0))]).unwrap();
        assert_eq!((found.count, found.frames), (1, 2));
        // It is nearer, so larger than a third.
        assert!(found.mass > 0.33 && found.mass < 0.8, "{found:?}");
        // Nothing was measured there.
        assert_eq!(find(&[frame(Some(0.0))]).unwrap().count, 0);
    }

    #[test]
    fn far_away_a_floater_is_nearer_by_five_percent() {
        let floating = |z: f32, measured: f32| {
            let row = Stored {
                mean: [0.0, 0.0, z],
                log_scale: [-2.5; 3],
                quat: [1.0, 0.0, 0.0, 0.0],
                logit: 0.0,
            };
            let model = Model::from_arrays(&[row], vec![0.0; 3], 0).unwrap();
            let frames = [frame(view(64, 48), Some(measured))];
            floaters(&model, &frames, &RasterSettings::default()).unwrap().unwrap().count
        };
        // Measured 10 away: 9.7 is nearer by more than 0.1 but less than 5 %, 9.4 by more than both.
        assert_eq!((floating(7.7, 10.0), floating(7.4, 10.0)), (0, 1));
        // One away: 0.93 is nearer by more than 5 % but less than 0.1.
        assert_eq!(floating(-1.07, 1.0), 0);
    }

    #[test]
    fn each_pixel_is_compared_with_its_own_depth_and_mass_is_over_frames() {
        let row = |mean: [f32; 3], logit: f32| Stored {
            mean,
            log_scale: [-2.5; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            logit,
        };
        // One that floats in two of three frames, one that does so in one, one out of the picture.
        let rows =
            [row([0.3, -0.2, 0.0], 1.0), row([-0.4, 0.3, 0.5], 0.0), row([1.02, 0.0, 0.0], 2.0)];
        let model = Model::from_arrays(&rows, vec![0.0; 9], 0).unwrap();
        let measured = |at: &[(usize, usize)]| {
            let mut frame = frame(view(64, 48), Some(0.0));
            let depth = frame.depth.as_mut().unwrap();
            at.iter().for_each(|(x, y)| depth[64 * y + x] = 5.0);
            frame
        };
        // Pixels: 64 · 0.3 / 2 + 32 = 41.6, 24 − 6.4 = 17.6; 32 − 64 · 0.4 / 2.5 = 21.8, 24 + 7.7 = 31.7.
        let frames = [
            measured(&[(41, 17)]),
            measured(&[(41, 17), (21, 31)]),
            measured(&[(17, 41), (42, 17), (41, 18)]),
        ];
        let raster = RasterSettings::default();
        let found = floaters(&model, &frames, &raster).unwrap().unwrap();
        let request = RenderRequest { contributions: true, ..RenderRequest::default() };
        let sums = render(model.gaussians(), &frames[0].view, &raster, &request)
            .unwrap()
            .contributions
            .unwrap()
            .sum;
        assert!(sums[2] > 0.0, "its border is in the picture");
        let share = f64::from(sums[0]) / sums.iter().map(|s| f64::from(*s)).sum::<f64>();
        assert_eq!((found.count, found.frames), (1, 3));
        assert!((found.mass - share).abs() < 1e-9, "{found:?} {share}");
        // In one frame once is enough; a model that shows nothing has no mass.
        assert_eq!(floaters(&model, &frames[1..2], &raster).unwrap().unwrap().count, 2);
        let behind = Model::from_arrays(&[row([0.0, 0.0, -5.0], 1.0)], vec![0.0; 3], 0).unwrap();
        let none = Floaters { count: 0, mass: 0.0, frames: 3 };
        assert_eq!(floaters(&behind, &frames, &raster).unwrap().unwrap(), none);
    }
}
