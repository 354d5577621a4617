//! What captures do to pictures: motion blur, glass, changing light, noise of the sensor.
//!
//! [`PictureSimulator`] takes the pictures of a path one after the other, in linear light and in this
//! order: the mean of the renders of an exposure, a pane of glass, exposure and white balance with
//! the limits of a sensor, its noise. It draws nothing itself: a [`PictureRenderer`] does.
//!
//! An effect that is absent costs nothing: without any, a picture is what the renderer made, bit for bit.
//! Random numbers belong to (seed, frame, effect), so one effect never changes what another draws.
//!
//! Effects on where Gaussians are belong to the scene: [`simulate`](super::simulate) it first.

mod exposure;
mod motion;
mod reflection;

pub use motion::{
    MOST_POSES, RigidMotion, Twist, blur_pixels, exposure_poses, interpolate, poses_of_blur,
};
pub use reflection::{FRESNEL_R0, HalfSpace, schlick};

use super::strength::{BLUR_DEGREES, NOISE_READ, NOISE_SHOT};
use super::{Effect, EffectSet, Pane, frame_rng};
use crate::rng::{normal_pair, normals};
use exposure::Automatic;
use rayon::prelude::*;
use scenesplat_scene::Camera;
use scenesplat_scene::linear_light::{display, linear};

/// Distance behind a camera of the point about which it shakes: a wrist, meters.
const PIVOT_METRES: f64 = 0.3;
/// Distance at which the length of a blur is measured, meters.
pub const BLUR_DISTANCE: f64 = 2.0;

/// A picture as a renderer gives it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnPicture {
    /// Values of a display, at least 0, nominally at most 1. `[H, W, 3]`
    pub rgb: Vec<f32>,
    /// Along the camera's z, units of the scene, 0 where nothing solid is. `[H, W]`
    pub depth: Option<Vec<f32>>,
}

/// What draws pictures of a scene.
pub trait PictureRenderer {
    /// Why it cannot.
    type Error;

    /// Draws what a camera sees, of all Gaussians or of those in half of the space.
    ///
    /// # Errors
    /// What the renderer refuses.
    fn draw(&self, camera: &Camera, part: Option<&HalfSpace>) -> Result<DrawnPicture, Self::Error>;
}

/// Why a picture cannot be simulated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PictureError<E> {
    /// The renderer refuses.
    #[error(transparent)]
    Draw(E),
    /// The renderer gave something else than a picture of the camera.
    #[error("{what}: {expected} values are expected, the renderer gave {got}")]
    Values {
        /// Of what.
        what: &'static str,
        /// For the camera's picture.
        expected: usize,
        /// Given.
        got: usize,
    },
}

/// An effect that pictures do not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{name} is an effect on scenes: apply it to the scene before pictures are taken; pictures have \
     {}", Effect::ON_PICTURES.map(Effect::name).join(", ")
)]
pub struct NotOnPictures {
    /// Its name.
    pub name: &'static str,
}

impl Effect {
    /// Those that happen when pictures are taken, in the order in which they are applied.
    pub const ON_PICTURES: [Self; 4] = [Self::Blur, Self::Glass, Self::Light, Self::Noise];
}

impl EffectSet {
    /// The effects on the scene's Gaussians, and those on pictures of it.
    pub fn split_for_pictures(&self) -> (Self, Self) {
        let (mut scene, mut pictures) = (Self::default(), Self::default());
        for (effect, severity) in self.present() {
            let part =
                if Effect::ON_PICTURES.contains(&effect) { &mut pictures } else { &mut scene };
            part.severity[effect as usize] = severity;
        }
        (scene, pictures)
    }
}

/// What became of one picture.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PictureReport {
    /// Renders that it took: 1 without effects.
    pub renders: usize,
    /// Length of the motion at [`BLUR_DISTANCE`] in the middle of the picture, pixels.
    pub blur_pixels: f64,
    /// Poses that the exposure was made of.
    pub poses: usize,
    /// Part of the pixels that show a pane, 0 to 1.
    pub glass: f64,
    /// What linear red, green and blue were multiplied by.
    pub gain: [f64; 3],
}

/// Takes pictures with the effects of a capture.
#[derive(Debug, Clone)]
pub struct PictureSimulator {
    effects: EffectSet,
    seed: u64,
    near: f64,
    pane: Option<Pane>,
    automatic: Automatic,
}

impl PictureSimulator {
    /// For these effects. `pane` is where glass is ([`Pane::on`]): without it, or without that effect,
    /// there is none. What is nearer to a camera than `near` is not drawn.
    ///
    /// # Errors
    /// Effects that pictures do not have, by name.
    pub fn new(
        effects: &EffectSet,
        seed: u64,
        pane: Option<Pane>,
        near: f64,
    ) -> Result<Self, NotOnPictures> {
        if let Some((effect, _)) = effects.split_for_pictures().0.present().next() {
            return Err(NotOnPictures { name: effect.name() });
        }
        let pane = pane.filter(|_| effects.severity(Effect::Glass) > 0.0);
        Ok(Self { effects: *effects, seed, near, pane, automatic: Automatic::default() })
    }

    /// Whether the renderer has to give depth: where there is a pane.
    pub fn needs_depth(&self) -> bool {
        self.pane.is_some()
    }

    /// How a camera moves during the exposure of a frame: it turns about a point behind it, by normally
    /// distributed angles about both axes across its view.
    pub fn motion(&self, frame: u64) -> Twist {
        let severity = self.effects.severity(Effect::Blur);
        if severity == 0.0 {
            return Twist::default();
        }
        let angles = normal_pair(&mut frame_rng(self.seed, Effect::Blur, frame, 0));
        let [x, y] = angles.map(|angle| (BLUR_DEGREES * severity * angle).to_radians());
        // −ω × the point that rests, (0, 0, −PIVOT_METRES).
        Twist { omega: [x, y, 0.0], v: [y * PIVOT_METRES, -x * PIVOT_METRES, 0.0] }
    }

    /// Takes the next picture. Automatic exposure follows the order of the calls; all else depends on the
    /// number of the frame.
    ///
    /// # Errors
    /// What the renderer refuses, and pictures of other sizes than the camera's.
    pub fn take<R: PictureRenderer>(
        &mut self,
        renderer: &R,
        frame: u64,
        camera: &Camera,
    ) -> Result<(DrawnPicture, PictureReport), PictureError<R::Error>> {
        let motion = self.motion(frame);
        let pixels = blur_pixels(camera, &motion, BLUR_DISTANCE);
        let poses = poses_of_blur(pixels);
        let draw = |camera: &Camera, part: Option<&HalfSpace>| {
            let picture = renderer.draw(camera, part).map_err(PictureError::Draw)?;
            check(&picture, camera, self.needs_depth())?;
            Ok(picture)
        };
        let mut picture = if poses == 1 {
            draw(camera, None)?
        } else {
            let poses = exposure_poses(camera, &motion, poses);
            mean(poses.iter().map(|pose| draw(pose, None)))?
        };
        let mut report = PictureReport {
            renders: poses,
            blur_pixels: pixels,
            poses,
            glass: 0.0,
            gain: [1.0; 3],
        };
        if let (Some(pane), Some(depth)) = (&self.pane, &mut picture.depth) {
            let seen = reflection::seen_pane(pane, camera, self.near, depth);
            let count = seen.iter().flatten().count();
            if count > 0 {
                let mirror = reflection::mirrored_camera(camera, pane);
                let mirror = draw(&mirror, Some(&reflection::side_of(camera, pane)))?;
                let width = camera.width as usize;
                reflection::composite(&mut picture.rgb, &mirror.rgb, &seen, pane, width);
                // Sensors of depth see nothing in glass.
                let inside = depth.iter_mut().zip(&seen).filter(|(_, seen)| seen.is_some());
                inside.for_each(|(depth, _)| *depth = 0.0);
                report.renders += 1;
                report.glass = count as f64 / seen.len() as f64;
            }
        }
        if self.effects.severity(Effect::Light) > 0.0 {
            report.gain = self.expose(&mut picture.rgb, frame);
        }
        if self.effects.severity(Effect::Noise) > 0.0 {
            self.add_noise(&mut picture.rgb, frame, camera.width as usize);
        }
        Ok((picture, report))
    }

    /// Changes exposure and white balance, and cuts what a sensor cannot hold.
    fn expose(&mut self, rgb: &mut [f32], frame: u64) -> [f64; 3] {
        let light: Vec<[f64; 3]> =
            rgb.as_chunks::<3>().0.par_iter().map(|p| p.map(|v| linear(v.into()))).collect();
        let automatic = self.automatic.follow(exposure::mean_light(&light));
        let severity = self.effects.severity(Effect::Light);
        let gains = exposure::gains(severity, self.seed, frame, automatic);
        let pixels = rgb.as_chunks_mut::<3>().0.par_iter_mut().zip(&light);
        pixels.for_each(|(pixel, light)| {
            *pixel = [0, 1, 2].map(|c| display((light[c] * gains[c]).clamp(0.0, 1.0)) as f32);
        });
        gains
    }

    /// Noise that grows with the root of the light, and noise that does not.
    fn add_noise(&self, rgb: &mut [f32], frame: u64, width: usize) {
        let severity = self.effects.severity(Effect::Noise);
        let (read, shot) = (NOISE_READ * severity, NOISE_SHOT * severity);
        rgb.par_chunks_mut(3 * width).enumerate().for_each(|(row, values)| {
            // Counted by rows, so that threads change nothing.
            let mut rng = frame_rng(self.seed, Effect::Noise, frame, row as u64);
            let count = values.len();
            normals(&mut rng, count, |i, x| {
                let light = linear(values[i].into()).clamp(0.0, 1.0);
                // Two independent sources are one of the sum of their variances.
                let sd = (read * read + shot * shot * light).sqrt();
                values[i] = display((light + sd * x).clamp(0.0, 1.0)) as f32;
            });
        });
    }
}

/// That a picture has the values of a camera's.
fn check<E>(picture: &DrawnPicture, camera: &Camera, depth: bool) -> Result<(), PictureError<E>> {
    let pixels = camera.width as usize * camera.height as usize;
    let fits = |what, expected, got| {
        if expected == got { Ok(()) } else { Err(PictureError::Values { what, expected, got }) }
    };
    fits("colour", 3 * pixels, picture.rgb.len())?;
    match &picture.depth {
        None if !depth => Ok(()),
        given => fits("depth", pixels, given.as_ref().map_or(0, Vec::len)),
    }
}

/// The mean of pictures in linear light; of depths over those that have one, 0 where fewer than half do.
fn mean<E>(
    pictures: impl Iterator<Item = Result<DrawnPicture, PictureError<E>>>,
) -> Result<DrawnPicture, PictureError<E>> {
    let (mut light, mut count) = (Vec::new(), 0);
    // Sums, and of how many pictures.
    let mut depths: Option<Vec<(f64, usize)>> = None;
    for picture in pictures {
        let picture = picture?;
        if count == 0 {
            light = vec![0.0; picture.rgb.len()];
            depths = picture.depth.as_ref().map(|depth| vec![(0.0, 0); depth.len()]);
        }
        light.par_iter_mut().zip(&picture.rgb).for_each(|(sum, v)| *sum += linear((*v).into()));
        for (sum, &depth) in depths.iter_mut().flatten().zip(picture.depth.iter().flatten()) {
            if depth > 0.0 {
                *sum = (sum.0 + f64::from(depth), sum.1 + 1);
            }
        }
        count += 1;
    }
    let rgb = light.par_iter().map(|sum| display(sum / count as f64) as f32).collect();
    let depth = |(sum, there): &(f64, usize)| {
        if 2 * there >= count.max(1) { (sum / *there as f64) as f32 } else { 0.0 }
    };
    let depth = depths.map(|sums| sums.iter().map(depth).collect());
    Ok(DrawnPicture { rgb, depth })
}

#[cfg(test)]
mod tests;
