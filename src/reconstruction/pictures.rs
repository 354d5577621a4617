//! A reconstruction beside the scene, as pictures.

use super::Reconstruction;
use crate::preview::{Ceiling, picture_of};
use scenesplat_rasterizer::{
    Gaussians, RasterError, RasterSettings, RenderRequest, View, render, render_features,
};
use scenesplat_scene::picture::RgbPicture;
use scenesplat_scene::{Camera, GaussianScene};

/// A pixel is masked where at least this much of its light comes from masked Gaussians.
const MASKED: f32 = 0.5;
/// Pixels between two pictures.
const GAP: u32 = 4;
const GAP_COLOR: [u8; 3] = [255; 3];

/// The scene, the scene without what is masked, and what is reconstructed, ready to be drawn.
#[derive(Debug)]
pub struct ReconstructionPictures {
    scenes: [Gaussians; 3],
    /// 1 for masked Gaussians. `[N]`
    hidden: Vec<f32>,
    settings: RasterSettings,
}

/// What one camera sees.
#[derive(Debug, Clone)]
pub struct ReconstructionPicture {
    /// Scene, masked scene and reconstruction, from left to right.
    pub picture: RgbPicture,
    /// Pixels at least half of whose light comes from masked Gaussians.
    pub masked_pixels: usize,
    /// Over these: how near the reconstruction is to the scene, dB; `None` without such pixels.
    pub psnr: Option<f64>,
    /// The same of the masked scene, whose holes show what is behind.
    pub psnr_of_holes: Option<f64>,
}

impl ReconstructionPictures {
    /// `scene`: what was [reconstructed](super::ReconstructionRun::reconstruct). What the ceiling hides and
    /// what is nearer than `near` (units of the scene) is not drawn.
    ///
    /// # Errors
    /// If a scene cannot be drawn.
    pub fn new(
        scene: &GaussianScene,
        made: &Reconstruction,
        ceiling: Option<Ceiling>,
        near: Option<f64>,
    ) -> Result<Self, RasterError> {
        let activated = |scene: &GaussianScene| -> Result<Gaussians, RasterError> {
            let mut gaussians = Gaussians::from_scene(scene)?;
            for (opacity, mean) in gaussians.opacities.iter_mut().zip(&gaussians.means) {
                if ceiling.is_some_and(|ceiling| ceiling.hides(*mean)) {
                    *opacity = 0.0;
                }
            }
            Ok(gaussians)
        };
        let antialiased = scene.antialiased;
        let mut settings = RasterSettings { antialiased, ..RasterSettings::gsplat_1_6() };
        settings.near = near.map_or(settings.near, |near| settings.near.max(near as f32));
        Ok(Self {
            scenes: [activated(scene)?, activated(&made.masked)?, activated(&made.reconstructed)?],
            hidden: made.hidden.iter().map(|&hidden| f32::from(u8::from(hidden))).collect(),
            settings,
        })
    }

    /// Draws what a camera sees.
    ///
    /// # Errors
    /// If the camera's lens cannot be drawn.
    pub fn draw(&self, camera: &Camera) -> Result<ReconstructionPicture, RasterError> {
        let view = View::from_camera(camera)?;
        let mut pictures = Vec::with_capacity(3);
        for gaussians in &self.scenes {
            let drawn = render(gaussians, &view, &self.settings, &RenderRequest::rgb())?;
            pictures.push(drawn.rgb.unwrap_or_default());
        }
        let weight = render_features(&self.scenes[0], &view, &self.settings, &self.hidden, 1)?;
        let masked: Vec<usize> = (0..weight.len()).filter(|&i| weight[i] >= MASKED).collect();
        Ok(ReconstructionPicture {
            psnr: psnr(&pictures[0], &pictures[2], &masked),
            psnr_of_holes: psnr(&pictures[0], &pictures[1], &masked),
            masked_pixels: masked.len(),
            picture: beside(&pictures, camera.width, camera.height),
        })
    }
}

/// Peak signal to noise ratio over some pixels, colors cut to 0..=1; infinite for equal ones.
fn psnr(truth: &[f32], made: &[f32], pixels: &[usize]) -> Option<f64> {
    let square = |i: usize| {
        let cut = |v: f32| f64::from(v.clamp(0.0, 1.0));
        (cut(truth[i]) - cut(made[i])).powi(2)
    };
    let sum: f64 = pixels.iter().flat_map(|&p| (3 * p..3 * p + 3).map(square)).sum();
    let count = 3 * pixels.len();
    (count > 0).then(|| -10.0 * (sum / count as f64).log10())
}

/// Pictures of one size side by side.
fn beside(pictures: &[Vec<f32>], width: u32, height: u32) -> RgbPicture {
    let count = pictures.len() as u32;
    let mut all = RgbPicture::filled(count * width + (count - 1) * GAP, height, GAP_COLOR);
    for (k, rgb) in (0..).zip(pictures) {
        let Some(picture) = picture_of(rgb, width, height) else { continue };
        for (x, y, color) in picture.enumerate() {
            all.set(k * (width + GAP) + x, y, color);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preview::LookAt;
    use scenesplat_scene::Up;

    #[test]
    fn differences_count_where_something_is_masked() {
        let (truth, made) = (vec![0.5; 9], [vec![0.5; 3], vec![0.6; 3], vec![2.0; 3]].concat());
        assert_eq!(psnr(&truth, &made, &[]), None);
        assert_eq!(psnr(&truth, &made, &[0]), Some(f64::INFINITY));
        assert!((psnr(&truth, &made, &[1]).unwrap() - 20.0).abs() < 1e-4);
        assert!((psnr(&truth, &made, &[2]).unwrap() - 6.0206).abs() < 1e-3, "colors end at 1");
    }

    #[test]
    fn three_pictures_of_two_gaussians() {
        let scene = GaussianScene {
            coord: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
            log_scale: vec![[-1.2; 3]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacity_logit: vec![9.0; 2],
            sh_dc: vec![[1.5, -1.5, -1.5], [-1.5, -1.5, 1.5]],
            ..GaussianScene::default()
        };
        let mut reconstructed = scene.clone();
        reconstructed.sh_dc[1] = [-1.5, 1.5, -1.5];
        let made = Reconstruction {
            hidden: vec![false, true],
            masked: scene.select_rows(&[0]).unwrap(),
            reconstructed,
            voxels: [2, 1],
            errors: Vec::new(),
        };
        let pictures = ReconstructionPictures::new(&scene, &made, None, None).unwrap();
        let look = LookAt { eye: [0.0, -6.0, 0.0], target: [0.0; 3], fov: 40.0 };
        let camera = look.camera("view", Up::PLUS_Z, [60, 40]).unwrap();
        let drawn = pictures.draw(&camera).unwrap();
        assert_eq!((drawn.picture.width(), drawn.picture.height()), (188, 40));
        let left = |k: u32| drawn.picture.get(k * 64 + 21, 20).unwrap();
        let right = |k: u32| drawn.picture.get(k * 64 + 39, 20).unwrap();
        assert!((0..3).all(|k| left(k)[0] > 200), "the visible one is in all of them");
        assert!(right(0)[2] > 200 && right(1) == [0; 3] && right(2)[1] > 200);
        assert_eq!(drawn.picture.get(61, 0), Some(GAP_COLOR));
        assert!((20..400).contains(&drawn.masked_pixels), "{}", drawn.masked_pixels);
        // Blue against green, and against nothing.
        assert!(drawn.psnr.unwrap() < drawn.psnr_of_holes.unwrap());
        let same = Reconstruction { reconstructed: scene.clone(), ..made };
        let drawn = ReconstructionPictures::new(&scene, &same, None, None).unwrap();
        assert_eq!(drawn.draw(&camera).unwrap().psnr, Some(f64::INFINITY));
    }
}
