//! A pane in a picture: what it reflects, and what it lets through.

use super::super::pane::Pane;
use scenesplat_scene::Camera;
use scenesplat_scene::linear_light::{display, linear};
use scenesplat_scene::vector::dot;

/// Part of the light that glass reflects at right angles: refractive index 1.5.
pub const FRESNEL_R0: f64 = 0.04;

/// Half of the space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HalfSpace {
    /// Of length 1.
    pub normal: [f64; 3],
    /// Points with `normal · p > offset` are in it.
    pub offset: f64,
}

impl HalfSpace {
    /// Whether a point is in it; what is nowhere is not.
    pub fn contains(&self, point: [f64; 3]) -> bool {
        dot(self.normal, point) > self.offset
    }
}

/// Part of the light that a surface reflects, by the cosine of the angle to its normal (Schlick 1994).
pub fn schlick(cosine: f64) -> f64 {
    FRESNEL_R0 + (1.0 - FRESNEL_R0) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// The cosine to a pane's normal for each pixel that shows it: the pane is in front of what the picture
/// shows (depth 0 = nothing there), and at least `near` away. `None` elsewhere. `[H · W]`
pub(super) fn seen_pane(
    pane: &Pane,
    camera: &Camera,
    near: f64,
    depth: &[f32],
) -> Vec<Option<f64>> {
    let eye = camera.centre();
    let width = camera.width as usize;
    let r = &camera.rotation;
    let height = -pane.before(eye);
    let pixel = |(at, depth): (usize, &f32)| {
        let x = ((at % width) as f64 + 0.5 - camera.cx) / camera.fx;
        let y = ((at / width) as f64 + 0.5 - camera.cy) / camera.fy;
        // Of depth 1, so that the way to the pane is a depth.
        let ray: [f64; 3] = std::array::from_fn(|i| r[0][i] * x + r[1][i] * y + r[2][i]);
        let facing = dot(pane.normal, ray);
        let z = height / facing;
        let hidden = *depth > 0.0 && f64::from(*depth) <= z;
        if !(z.is_finite() && z > near.max(0.0)) || hidden {
            return None;
        }
        let point = std::array::from_fn(|i| eye[i] + z * ray[i]);
        pane.covers(point).then(|| facing.abs() / dot(ray, ray).sqrt())
    };
    depth.iter().enumerate().map(pixel).collect()
}

/// The camera that sees in its picture, left and right exchanged, what a camera sees in the mirror.
pub(super) fn mirrored_camera(camera: &Camera, pane: &Pane) -> Camera {
    let [x, y, z] = camera.rotation.map(|axis| pane.mirrored_direction(axis));
    // A mirror image has left-handed axes; the other x makes them right-handed again.
    let rotation = [x.map(|v| -v), y, z];
    let centre = pane.mirrored(camera.centre());
    Camera {
        rotation,
        translation: rotation.map(|axis| -dot(axis, centre)),
        cx: f64::from(camera.width) - camera.cx,
        ..camera.clone()
    }
}

/// The side of a pane that a camera is on.
pub(super) fn side_of(camera: &Camera, pane: &Pane) -> HalfSpace {
    let sign = if pane.before(camera.centre()) < 0.0 { -1.0 } else { 1.0 };
    let normal = pane.normal.map(|v| sign * v);
    HalfSpace { normal, offset: dot(normal, pane.centre) }
}

/// Puts a pane into a picture, `[H, W, 3]` in values of a display: of the light on it, `schlick` is
/// reflected, `1 − α` of the rest goes through, tinted. `mirror` is the picture of the mirrored camera.
pub(super) fn composite(
    rgb: &mut [f32],
    mirror: &[f32],
    seen: &[Option<f64>],
    pane: &Pane,
    width: usize,
) {
    let through = pane.tint.map(|tint| (1.0 - pane.alpha) * tint);
    for (at, cosine) in seen.iter().enumerate() {
        let Some(cosine) = cosine else { continue };
        let reflected = schlick(*cosine);
        let (row, column) = (at / width, at % width);
        let image = row * width + (width - 1 - column);
        for c in 0..3 {
            let [behind, image] = [rgb[3 * at + c], mirror[3 * image + c]].map(f64::from);
            let light = reflected * linear(image) + (1.0 - reflected) * through[c] * linear(behind);
            rgb[3 * at + c] = display(light) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pane() -> Pane {
        Pane {
            normal: [0.0, 0.0, -1.0],
            across: [1.0, 0.0, 0.0],
            up: [0.0, -1.0, 0.0],
            centre: [0.5, 0.0, 3.0],
            half: [1.0, 0.5],
            alpha: 0.25,
            tint: [0.5, 1.0, 1.0],
            thickness: 0.02,
        }
    }

    #[test]
    fn glass_reflects_four_percent_straight_on_and_all_at_grazing_angles() {
        assert_eq!((schlick(1.0), schlick(0.0)), (0.04, 1.0));
        assert!((schlick(0.5) - 0.07).abs() < 1e-12, "0.04 + 0.96 / 32");
        let rising = (0..100).map(|i| schlick(f64::from(i) / 99.0)).collect::<Vec<_>>();
        assert!(rising.is_sorted_by(|a, b| a > b));
    }

    #[test]
    fn the_mirrored_camera_sees_mirror_images() {
        let camera = super::super::tests::camera();
        let pane = Pane { normal: [0.6, 0.0, -0.8], ..pane() };
        let mirror = mirrored_camera(&camera, &pane);
        for point in [[0.3, 0.2, 1.0], [-1.0, 0.4, 0.5], [0.1, -0.7, 1.5]] {
            // In a mirror one sees a point where its mirror image is.
            let [u, v] = camera.project(pane.mirrored(point)).unwrap();
            let [mirrored_u, mirrored_v] = mirror.project(point).unwrap();
            assert!((u - (f64::from(camera.width) - mirrored_u)).abs() < 1e-9, "{point:?}");
            assert!((v - mirrored_v).abs() < 1e-9);
        }
        let mut mirror = mirror;
        assert!(mirror.check(std::path::Path::new("mirror")).is_ok());
        let side = side_of(&camera, &pane);
        assert!(side.contains(camera.centre()) && !side.contains(pane.mirrored(camera.centre())));
        assert!(!side.contains([f64::NAN; 3]));
    }

    #[test]
    fn a_pane_is_seen_where_nothing_hides_it() {
        let camera = super::super::tests::camera();
        let pixels = (camera.width * camera.height) as usize;
        let mut depth = vec![0.0; pixels];
        let seen = seen_pane(&pane(), &camera, 0.0, &depth);
        // x from −0.5 to 1.5 at depth 3 and f = 100: pixels 20 − 16.7 to 20 + 50; y within ± 16.7.
        for (at, cosine) in seen.iter().enumerate() {
            let (x, y) = ((at % 64) as f64 + 0.5, (at / 64) as f64 + 0.5);
            let inside = x > 20.0 - 50.0 / 3.0 && x < 70.0 && (y - 24.0).abs() < 50.0 / 3.0;
            assert_eq!(cosine.is_some(), inside, "{x} {y}");
            let ray = [(x - 20.0) / 100.0, (y - 24.0) / 100.0, 1.0];
            let want = 1.0 / dot(ray, ray).sqrt();
            assert!(cosine.is_none_or(|cosine| (cosine - want).abs() < 1e-12));
        }
        // Something 2 m away hides it, something behind it does not.
        (depth[24 * 64 + 20], depth[24 * 64 + 21]) = (2.0, 3.5);
        let seen = seen_pane(&pane(), &camera, 0.0, &depth);
        assert!(seen[24 * 64 + 20].is_none() && seen[24 * 64 + 21].is_some());
        assert!(seen_pane(&pane(), &camera, 3.1, &depth).iter().all(Option::is_none));
        let behind = Pane { centre: [0.0, 0.0, -3.0], ..pane() };
        assert!(seen_pane(&behind, &camera, 0.0, &depth).iter().all(Option::is_none));
    }

    #[test]
    fn light_on_a_pane_by_hand() {
        // A pixel at right angles, behind it white light, in the mirror a half of linear light.
        let mut rgb = [1.0f32; 6];
        let half = display(0.5) as f32;
        let mirror = [0.0, 0.0, 0.0, half, half, half];
        composite(&mut rgb, &mirror, &[Some(1.0), None], &pane(), 2);
        assert_eq!(&rgb[3..], [1.0; 3]);
        for (got, through) in rgb[..3].iter().zip([0.375, 0.75, 0.75]) {
            let want = display(0.04 * 0.5 + 0.96 * through);
            assert!((f64::from(*got) - want).abs() < 1e-6, "{rgb:?}");
        }
        // Never more light than there was: white stays at most white.
        let mut white = [1.0f32; 3];
        composite(&mut white, &[1.0; 3], &[Some(0.2)], &pane(), 1);
        assert!(white.iter().all(|v| *v <= 1.0));
    }
}
