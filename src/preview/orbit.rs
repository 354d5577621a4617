//! Cameras around a scene without cameras.

use super::framing::{CUT_SHARE, Framing, Upright};
use super::rows::{PreviewRows, visible_discs};
use scenesplat_scene::{Camera, Up};

/// Cameras that look at a scene from around it, and what has to be left out to look into it.
#[derive(Debug, Clone, PartialEq)]
pub struct Orbit {
    /// Evenly around the scene, all aimed at its middle.
    pub cameras: Vec<Camera>,
    /// For a room: the depth at which its near walls end, units of the scene.
    pub near: Option<f64>,
    /// For a closed room: the ceiling.
    pub ceiling: Option<Ceiling>,
}

/// What is above a level plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ceiling {
    up: [f64; 3],
    height: f64,
}

impl Ceiling {
    /// Whether a point of the scene is above.
    pub fn hides(&self, point: [f32; 3]) -> bool {
        (0..3).map(|a| self.up[a] * f64::from(point[a])).sum::<f64>() > self.height
    }
}

/// The narrower angle of view, degrees.
const FOV: f64 = 40.0;
/// Azimuth that the first camera looks to, degrees.
const FIRST: f64 = 60.0;

impl Orbit {
    /// `count` cameras of `size` pixels around the Gaussians that matter: the faintest
    /// and the outermost 2 % of each axis do not, so that no outlier sets the distance. The first
    /// looks from low x and y, the others follow against the clock as seen from above.
    ///
    /// Objects are looked at from 25° above the horizon; rooms from 45°, with the ceiling and the walls before the cameras
    /// left out. A room without a ceiling is one if walls stand before most of the cameras.
    pub fn around(rows: &PreviewRows<'_>, up: Up, count: usize, size: [u32; 2]) -> Self {
        let upright = Upright::new(up);
        let discs = visible_discs(rows, upright);
        let framing = Framing::of(&discs, true);
        let (low, high) = framing.bounds();
        let middle = [0, 1, 2].map(|a| (low[a] + high[a]) / 2.0);
        let diagonal = (0..3).map(|a| (high[a] - low[a]).powi(2)).sum::<f64>().sqrt();
        let radius = diagonal / 2.0;
        let half_view = (FOV / 2.0).to_radians();
        let distance = radius / half_view.sin();
        let azimuths: Vec<f64> =
            (0..count).map(|k| FIRST + 360.0 * k as f64 / count as f64).collect();
        let is_cut_open = framing.is_cut_open_for(&azimuths);
        let elevation = if is_cut_open { 45.0_f64 } else { 25.0 }.to_radians();
        let camera = |(k, azimuth): (usize, &f64)| {
            let azimuth = azimuth.to_radians();
            let (s, c) = azimuth.sin_cos();
            let forward = [elevation.cos() * c, elevation.cos() * s, -elevation.sin()];
            let right = [s, -c, 0.0];
            let down = [-elevation.sin() * c, -elevation.sin() * s, -elevation.cos()];
            let eye = upright.turn_back([0, 1, 2].map(|a| middle[a] - distance * forward[a]));
            let rotation = [right, down, forward].map(|axis| upright.turn_back(axis).into());
            Camera::pinhole(format!("orbit_{k:03}"), size, FOV, eye.into(), rotation)
        };
        let (_, cut_high) = framing.cut_sides();
        let ceiling =
            cut_high[2].map(|height| Ceiling { up: upright.turn_back([0.0, 0.0, 1.0]), height });
        let near = is_cut_open.then_some(distance - CUT_SHARE * radius);
        Self { cameras: azimuths.iter().enumerate().map(camera).collect(), near, ceiling }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lopsided block of 1000 points, some outliers, around (10, −20, 5).
    fn block() -> Vec<[f32; 3]> {
        let mut coord: Vec<[f32; 3]> = (0..1000_u16)
            .map(|i| [i % 10, i / 10 % 10, i / 100].map(f32::from))
            .map(|[x, y, z]| [10.0 + 0.4 * x, -20.0 + 0.1 * y, 5.0 + 0.2 * z])
            .collect();
        coord.extend([[1e6, 0.0, 0.0], [0.0, f32::MAX, 0.0], [f32::NAN, 0.0, 0.0]]);
        coord
    }

    fn orbit(coord: &[[f32; 3]], up: Up, count: usize, size: [u32; 2]) -> Orbit {
        let n = coord.len();
        let rows = PreviewRows {
            coord,
            color: &vec![[0; 3]; n],
            radius: &vec![0.02; n],
            opacity: &vec![0.9; n],
            shapes: None,
        };
        Orbit::around(&rows, up, count, size)
    }

    #[test]
    fn every_camera_sees_the_block_and_stands_upright() {
        let coord = block();
        for (number, up) in Up::AXES.into_iter().enumerate() {
            let (axis, sign) = (number / 2, if number % 2 == 0 { 1.0 } else { -1.0 });
            for size in [[640, 480], [300, 500]] {
                let orbit = orbit(&coord, up, 5, size);
                for mut camera in orbit.cameras {
                    camera.check(std::path::Path::new("orbit")).unwrap();
                    let inside = |p: &&[f32; 3]| {
                        let pixel = camera.project(p.map(f64::from));
                        pixel.is_some_and(|pixel| camera.contains(pixel))
                    };
                    // All but a corner: the outermost 2 % of each axis do not set the distance.
                    let seen = coord[..1000].iter().filter(inside).count();
                    assert!(seen >= 990, "{up:?}: {seen}");
                    // Up in the scene is up in the picture, and the camera stands above.
                    assert!(camera.rotation[1][axis] * sign < -0.5, "{up:?}");
                    let middle = [11.8, -19.55, 5.9];
                    assert!((camera.centre()[axis] - middle[axis]) * sign > 1.0, "{up:?}");
                }
            }
        }
    }

    #[test]
    fn no_and_one_gaussian() {
        for coord in [&[][..], &[[3.0, 4.0, 5.0]]] {
            let orbit = orbit(coord, Up::PLUS_Z, 2, [64, 64]);
            assert_eq!((orbit.cameras.len(), orbit.near), (2, None));
            for mut camera in orbit.cameras {
                camera.check(std::path::Path::new("orbit")).unwrap();
            }
        }
    }
}
