//! What a single picture says: how sharp it is, how noisy, how much of it is clipped.

use scenesplat_datasets::effects::strength::{NOISE_READ, NOISE_SHOT};
use scenesplat_metrics::image::ImageError;
use scenesplat_metrics::image::sharpness::{GrayImage, shrink_to_width, variance_of_laplacian};
use scenesplat_scene::linear_light::linear;
use scenesplat_scene::picture::RgbPicture;

/// Width at which sharpness is compared, pixels.
const SHARPNESS_WIDTH: usize = 640;
/// Side of the patches in which noise is looked for, pixels.
const PATCH: usize = 16;
/// Patches darker or brighter than this are clipped or nearly so.
const DARK: f64 = 12.0;
const BRIGHT: f64 = 243.0;
/// Quantile of the patches: the flat ones, which have little but noise.
const FLAT: f64 = 0.25;
/// Part of the fine detail that must not be noise.
const LEAST_LEFT: f64 = 0.3;
/// Fewer patches say nothing.
const FEWEST_PATCHES: usize = 12;
/// Standard deviation of rounding to whole numbers, 1/√12.
const ROUNDING: f64 = 0.288_675;
/// Norm of the weights of gray: how much of the noise of three channels is in it.
const GRAY_NORM: f64 = 0.668_6;

/// Figures of a picture by itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FrameFigures {
    /// Variance of the Laplacian at up to 640 pixels of width, less that of its noise, over the square of its
    /// mean: exposure does not change it.
    pub sharpness: f64,
    /// Energy of fine detail by direction, gray steps²: the mean of `∇ΔI ∇ΔIᵀ`, entries xx, xy, yy, less that
    /// of noise. Motion takes away what is along it.
    pub detail: [f64; 3],
    /// Part of the energy before noise was taken off that is left, 0 to 1.
    pub detail_left: f64,
    /// Standard deviation of noise in flat patches, gray steps of 1/255; `None` where no patch is flat enough
    /// to tell.
    pub noise_steps: Option<f64>,
    /// That noise over what the simulator's is at severity 1 and this light; rounding is taken off.
    pub noise_severity: Option<f64>,
    /// Part of the pixels with a channel of 250 and more, 0 to 1.
    pub saturated: f64,
    /// Part of the pixels with no channel above 5, 0 to 1.
    pub black: f64,
}

/// Measures a picture.
///
/// # Errors
/// If it has no pixels.
pub fn frame_figures(picture: &RgbPicture) -> Result<FrameFigures, ImageError> {
    let gray = GrayImage::from_rgb(picture.pixels(), picture.width() as usize)?;
    let share = |of: fn(&[u8; 3]) -> bool| {
        picture.pixels().iter().filter(|p| of(p)).count() as f64 / picture.pixels().len() as f64
    };
    let (noise_steps, noise_severity) = noise(&gray).unzip();
    let small = shrink_to_width(&gray, SHARPNESS_WIDTH)?;
    let mean = small.values().iter().map(|v| f64::from(*v)).sum::<f64>();
    let mean = (mean / small.values().len() as f64).max(1.0);
    // Independent noise has 1 + 4 · 1 + 16 − … = 20 times its variance in a Laplacian; shrinking by a factor
    // takes it down by the number of pixels that become one.
    let shrunk = gray.width() as f64 / small.width() as f64;
    let noise = noise_steps.unwrap_or(0.0) / shrunk;
    let laplacian = (variance_of_laplacian(&small) - 20.0 * noise * noise).max(0.0);
    let (detail, detail_left) = detail(&small, noise);
    Ok(FrameFigures {
        sharpness: laplacian / (mean * mean),
        detail,
        detail_left,
        noise_steps,
        noise_severity,
        saturated: share(|p| p.iter().any(|v| *v >= 250)),
        black: share(|p| p.iter().all(|v| *v <= 5)),
    })
}

/// Energy of fine detail by direction, and the part of it that is not noise.
fn detail(gray: &GrayImage, noise: f64) -> ([f64; 3], f64) {
    let (width, height, values) = (gray.width(), gray.height(), gray.values());
    let at = |x: usize, y: usize| f64::from(values[y * width + x]);
    let laplacian = |x: usize, y: usize| {
        at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1) - 4.0 * at(x, y)
    };
    let mut sum = [0.0; 3];
    let mut count = 0;
    for y in 2..height.saturating_sub(2) {
        for x in 2..width.saturating_sub(2) {
            let across = 0.5 * (laplacian(x + 1, y) - laplacian(x - 1, y));
            let down = 0.5 * (laplacian(x, y + 1) - laplacian(x, y - 1));
            sum = [sum[0] + across * across, sum[1] + across * down, sum[2] + down * down];
            count += 1;
        }
    }
    let all = sum.map(|v| v / f64::from(count.max(1)));
    // The squares of the weights of such a difference add up to 9.5.
    let own = 9.5 * noise * noise;
    let detail = [(all[0] - own).max(0.0), all[1], (all[2] - own).max(0.0)];
    let trace = all[0] + all[2];
    (detail, if trace > 0.0 { (detail[0] + detail[2]) / trace } else { 0.0 })
}

/// How much more of one direction's detail than of another's a picture lacks of what it should show: the
/// logarithm of the ratio of the largest to the smallest eigenvalue of `wanted⁻¹ · detail`. 0 = it is like
/// it, sharper, softer, brighter or darker by the same in all directions. `None` where there is too little
/// detail or too much noise to tell.
pub(super) fn motion(photo: &FrameFigures, wanted: &FrameFigures) -> Option<f64> {
    let ([a, b, c], [p, q, r]) = (photo.detail, wanted.detail);
    let determinant = p * r - q * q;
    let clear = photo.detail_left.min(wanted.detail_left) >= LEAST_LEFT;
    if !(clear && determinant > 1e-6 * (p + r).powi(2) && a + c > 0.0) {
        return None;
    }
    // Of P − λ R: R's determinant, minus the mixed one, P's.
    let mixed = a * r + c * p - 2.0 * b * q;
    let root = (mixed * mixed - 4.0 * determinant * (a * c - b * b)).max(0.0).sqrt();
    let (low, high) = (mixed - root, mixed + root);
    (low > 1e-3 * high).then(|| (high / low).ln()).or(Some(1e3f64.ln()))
}

/// Noise of the flat patches: gray steps, and as a severity.
///
/// # Source
/// Immerkær, Fast Noise Variance Estimation (1996): the difference of two Laplacians, which edges and
/// ramps leave at 0, has 36 times the variance of the noise. The lower quartile over patches is ours.
fn noise(gray: &GrayImage) -> Option<(f64, f64)> {
    let (width, values) = (gray.width(), gray.values());
    let at = |x: usize, y: usize| f64::from(values[y * width + x]);
    let mut patches = Vec::new();
    for top in (1..gray.height().saturating_sub(PATCH)).step_by(PATCH) {
        for left in (1..width.saturating_sub(PATCH)).step_by(PATCH) {
            let (mut sum, mut response) = (0.0, 0.0);
            for y in top..top + PATCH {
                for x in left..left + PATCH {
                    let row = |y: usize| at(x - 1, y) - 2.0 * at(x, y) + at(x + 1, y);
                    response += (row(y - 1) - 2.0 * row(y) + row(y + 1)).abs();
                    sum += at(x, y);
                }
            }
            let count = (PATCH * PATCH) as f64;
            let mean = sum / count;
            if (DARK..BRIGHT).contains(&mean) {
                // The mean of |x| of a normal x is √(2/π) σ.
                let sd = response / count * (std::f64::consts::PI / 2.0).sqrt() / 6.0;
                patches.push((sd, mean));
            }
        }
    }
    if patches.len() < FEWEST_PATCHES {
        return None;
    }
    let at = ((patches.len() - 1) as f64 * FLAT).round() as usize;
    let severity = |(sd, mean): (f64, f64)| {
        let light = linear(mean / 255.0);
        // How far a step of linear light shows.
        let slope = 1.0 / (linear(mean / 255.0 + 1e-4) - light) * 1e-4;
        let at_one = (NOISE_READ * NOISE_READ + NOISE_SHOT * NOISE_SHOT * light).sqrt();
        let own = (sd * sd - ROUNDING * ROUNDING).max(0.0).sqrt() / 255.0;
        own / (GRAY_NORM * slope * at_one)
    };
    let mut severities: Vec<f64> = patches.iter().map(|p| severity(*p)).collect();
    let (_, &mut severity, _) = severities.select_nth_unstable_by(at, f64::total_cmp);
    let (_, &mut (sd, _), _) = patches.select_nth_unstable_by(at, |a, b| a.0.total_cmp(&b.0));
    Some((sd, severity))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_datasets::effects::pictures::{
        DrawnPicture, HalfSpace, PictureRenderer, PictureSimulator,
    };
    use scenesplat_scene::linear_light::display;
    use scenesplat_scene::{Camera, Distortion};

    /// Soft shades of gray: what noise is measured on.
    struct Shades;

    impl PictureRenderer for Shades {
        type Error = std::convert::Infallible;

        fn draw(
            &self,
            camera: &Camera,
            _: Option<&HalfSpace>,
        ) -> Result<DrawnPicture, Self::Error> {
            let value = |at: u32| {
                let (x, y) = (f64::from(at % camera.width), f64::from(at / camera.width));
                (0.45 + 0.3 * (0.02 * x).sin() * (0.03 * y).cos()) as f32
            };
            let rgb = (0..camera.width * camera.height).flat_map(|at| [value(at); 3]).collect();
            Ok(DrawnPicture { rgb, depth: None })
        }
    }

    fn shades(effect: &str) -> RgbPicture {
        let camera = Camera {
            name: String::new(),
            width: 320,
            height: 240,
            fx: 300.0,
            fy: 300.0,
            cx: 160.0,
            cy: 120.0,
            distortion: Distortion::None,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let mut simulator = PictureSimulator::new(&effect.parse().unwrap(), 3, None, 0.0).unwrap();
        let (picture, _) = simulator.take(&Shades, 0, &camera).unwrap();
        scenesplat::preview::picture_of(&picture.rgb, 320, 240).unwrap()
    }

    #[test]
    fn noise_is_measured_as_strong_as_it_was_made() {
        for severity in [1.0, 2.0, 3.0, 5.0] {
            let found = frame_figures(&shades(&format!("noise={severity}"))).unwrap();
            let measured = found.noise_severity.unwrap();
            // The lower quartile of patches is a little below their mean.
            assert!((measured / severity - 1.0).abs() < 0.15, "{severity}: {found:?}");
        }
        let clean = frame_figures(&shades("none")).unwrap();
        assert!(clean.noise_severity.unwrap() < 0.1, "{clean:?}");
        let black = RgbPicture::filled(320, 240, [0; 3]);
        let found = frame_figures(&black).unwrap();
        assert_eq!((found.noise_steps, found.black, found.saturated), (None, 1.0, 0.0));
    }

    #[test]
    fn sharpness_does_not_ask_how_bright_or_noisy_a_picture_is() {
        let stripes = |low: f64, high: f64| {
            RgbPicture::from_fn(320, 240, |x, _| {
                [(255.0 * display(if x / 8 % 2 == 0 { low } else { high })).round() as u8; 3]
            })
        };
        let [one, half] = [(0.2, 0.6), (0.1, 0.3)]
            .map(|(low, high)| frame_figures(&stripes(low, high)).unwrap().sharpness);
        assert!((half / one - 1.0).abs() < 0.15, "{one} {half}");
        // Most of what noise adds, 20 times its variance, is taken off again.
        let noisy = frame_figures(&shades("noise=5")).unwrap();
        let plain = frame_figures(&shades("none")).unwrap().sharpness;
        let added = 20.0 * (noisy.noise_steps.unwrap() / 115.0).powi(2);
        assert!(noisy.sharpness < 0.6 * added && plain < 0.02 * added, "{noisy:?} {plain} {added}");
    }

    #[test]
    fn motion_is_what_one_direction_lacks() {
        // Dots, sharp, softer in all directions, drawn out along x.
        let dots = |wide: [f64; 2], gain: f64| {
            let picture = RgbPicture::from_fn(320, 240, |x, y| {
                let off = |v: u32| f64::from(v % 20) - 9.5;
                let d = (off(x) / wide[0]).powi(2) + (off(y) / wide[1]).powi(2);
                [(40.0 + gain * 160.0 * (-0.5 * d).exp()).round() as u8; 3]
            });
            frame_figures(&picture).unwrap()
        };
        let sharp = dots([2.0, 2.0], 1.0);
        for same in [dots([2.0, 2.0], 0.5), dots([3.0, 3.0], 1.0), sharp] {
            assert!(motion(&same, &sharp).unwrap() < 0.02, "{same:?}");
        }
        let moved = [2.3, 2.7, 3.5].map(|w| motion(&dots([w, 2.0], 1.0), &sharp).unwrap());
        assert!(moved.is_sorted() && moved[0] > 0.15 && moved[2] < 5.0, "{moved:?}");
        // A turn of the picture changes nothing.
        let turned = motion(&dots([2.0, 2.7], 1.0), &sharp).unwrap();
        assert!((turned - moved[1]).abs() < 0.02);
        let flat = frame_figures(&RgbPicture::filled(320, 240, [90; 3])).unwrap();
        assert_eq!(motion(&flat, &sharp), None);
        assert_eq!(motion(&sharp, &flat), None);
    }

    #[test]
    fn clipped_pixels_are_counted() {
        let picture = RgbPicture::from_fn(64, 64, |x, y| match (x < 16, y < 32) {
            (true, _) => [255, 10, 10],
            (_, true) => [5, 5, 0],
            _ => [128; 3],
        });
        let found = frame_figures(&picture).unwrap();
        assert_eq!((found.saturated, found.black), (0.25, 0.375));
    }
}
