//! First points for captures without any: where the cameras look.

use crate::error::OptimiseError;
use crate::frame::{TrainingFrame, scale_of_cameras};
use crate::fused_points::lifted;
use crate::initial::{Cloud, InitialSettings, random_points};
use crate::random::{Counter, Purpose};
use glam::{DMat3, DVec3};
use scenesplat_rasterizer::View;

/// Part of the cameras that have to look at one place.
const LOOKING: f64 = 0.9;
/// Least depth of points that are drawn from pixels, and the most, over the scale of the cameras.
const DEPTHS: [f64; 2] = [0.3, 30.0];
/// Cameras that have to see a point, if there are as many that see one place.
const VIEWS: usize = 3;
/// Opacity and scale that random points begin with.
const THIN: [f32; 2] = [0.1, 0.3];
/// Points that are tried for each that is wanted.
const TRIES: usize = 50;

/// A place that cameras look at from around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Nearest to all optical axes.
    pub point: [f64; 3],
    /// Radius of the ball around it that half of the cameras see as a whole.
    pub radius: f64,
}

/// The place that nine of ten cameras look at; `None` where there is none, as in a room that is seen from inside, or
/// where they all look in one direction.
pub fn focus_of(frames: &[TrainingFrame]) -> Option<Focus> {
    let axes: Vec<(DVec3, DVec3)> = frames.iter().map(|frame| axis_of(&frame.view)).collect();
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for (eye, ahead) in &axes {
        // What is across the axis.
        let across = DMat3::IDENTITY
            - DMat3::from_cols(*ahead * ahead.x, *ahead * ahead.y, *ahead * ahead.z);
        a += across;
        b += across * *eye;
    }
    // Parallel axes meet nowhere: the determinant of their mean is 0, that of axes all around (2/3)³.
    let n = axes.len() as f64;
    if !((a * (1.0 / n)).determinant() > 1e-3) {
        return None;
    }
    let point = a.inverse() * b;
    let mut radii: Vec<f64> = frames
        .iter()
        .zip(&axes)
        .filter_map(|(f, axis)| free_radius(&f.view, *axis, point))
        .collect();
    if (radii.len() as f64) < LOOKING * n {
        return None;
    }
    radii.sort_by(f64::total_cmp);
    let radius = radii[radii.len() / 2];
    (radius > 0.0 && point.is_finite()).then_some(Focus { point: point.to_array(), radius })
}

/// Where a camera is and the direction it looks in.
fn axis_of(view: &View) -> (DVec3, DVec3) {
    let ahead = view.world_to_camera[2];
    let ahead = DVec3::new(ahead[0].into(), ahead[1].into(), ahead[2].into());
    (DVec3::from(view.centre().map(f64::from)), ahead.normalize_or_zero())
}

/// Radius of the largest ball around a point in front of a camera that lies in its picture; `None` if the point does
/// not, or lies nearer to the camera than its axis passes by.
fn free_radius(view: &View, (eye, ahead): (DVec3, DVec3), point: DVec3) -> Option<f64> {
    let away = point - eye;
    let depth = away.dot(ahead);
    if !(depth > 0.0) || (away - depth * ahead).length() > depth {
        return None;
    }
    let at = view.to_camera(point.to_array().map(|v| v as f32)).map(f64::from);
    let sides = [(at[0], view.fx, view.cx, view.width), (at[1], view.fy, view.cy, view.height)];
    let mut least = depth;
    for (across, focal, centre, pixels) in sides {
        let (focal, centre) = (f64::from(focal), f64::from(centre));
        // Distance to the planes through the eye and the first and last pixels.
        let low = (across * focal + centre * at[2]) / focal.hypot(centre);
        let rest = f64::from(pixels) - centre;
        let high = (rest * at[2] - across * focal) / focal.hypot(rest);
        least = least.min(low).min(high);
    }
    (least > 0.0).then_some(least)
}

/// How Gaussians at random points begin: as the settings say, but not as a fog.
///
/// Random points fill space. With an opacity of 0.5 and sizes that touch, they hide from each camera all but the first
/// of them, and nothing behind is learned; with 0.1 and a third of the size, all of it is seen.
pub fn thin(initial: InitialSettings) -> InitialSettings {
    if initial.opacity > THIN[0] && initial.scale > THIN[1] {
        return InitialSettings { opacity: THIN[0], scale: THIN[1], ..initial };
    }
    initial
}

/// `count` random points where the cameras look, with random colors, and where that is in words.
///
/// - Around a [`Focus`] they fill the cube with its radius as half of a side.
/// - Else they are on the rays of random pixels, at depths of 0.3 to 30 times the scale of the cameras, evenly in the
///   logarithm, as far as at least three cameras see them (fewer where few overlap).
///
/// # Errors
/// If cameras are at no finite place.
pub fn points_in_view(
    frames: &[TrainingFrame],
    count: usize,
    seed: u64,
) -> Result<(Cloud, String), OptimiseError> {
    if let Some(focus) = focus_of(frames) {
        let corner = |sign: f64| focus.point.map(|v| (v + sign * focus.radius) as f32);
        let text = format!(
            "RANDOM POINTS in the cube of side {:.3} that the cameras look at",
            2.0 * focus.radius
        );
        return Ok((random_points(count, [corner(-1.0), corner(1.0)], seed)?, text));
    }
    // Few cameras may overlap, as those of a panorama.
    let mut found = (Vec::new(), 0);
    for views in (1..=VIEWS.min(frames.len())).rev() {
        if 2 * found.0.len() < count {
            found = (seen_points(frames, count, seed, views), views);
        }
    }
    let (points, views) = found;
    let (_, colors) = random_points(points.len(), [[0.0; 3], [1.0; 3]], seed)?;
    let text = format!("RANDOM POINTS that {views} or more cameras see");
    Ok(((points, colors), text))
}

/// Points on rays that as many cameras see; fewer than `count` where that is rare.
fn seen_points(frames: &[TrainingFrame], count: usize, seed: u64, views: usize) -> Vec<[f32; 3]> {
    let counter = Counter::new(seed, Purpose::Start, 2);
    let scale = scale_of_cameras(frames);
    let [near, far] = DEPTHS.map(|depth| (depth * scale).ln());
    let point = |i: usize| {
        let [which, pixel, depth, _] = counter.units(i);
        let frame = &frames[(which * frames.len() as f64) as usize];
        let pixel = (pixel * frame.view.pixels() as f64) as usize;
        lifted(frame, pixel, (near + depth * (far - near)).exp() as f32)
    };
    let is_seen = |at: &[f32; 3]| {
        frames.iter().filter(|frame| shows(&frame.view, *at)).take(views).count() == views
    };
    (0..TRIES * count).map(point).filter(is_seen).take(count).collect()
}

/// Whether a point is in a picture.
fn shows(view: &View, point: [f32; 3]) -> bool {
    let [x, y, z] = view.to_camera(point);
    let (u, v) = (x / z * view.fx + view.cx, y / z * view.fy + view.cy);
    z > 0.0 && u >= 0.0 && v >= 0.0 && u < view.width as f32 && v < view.height as f32
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::frame::tests::frame;

    /// A camera at a place that looks in a direction, across the z axis.
    fn looking(eye: [f64; 3], ahead: [f64; 3]) -> TrainingFrame {
        let (eye, z) = (DVec3::from(eye), DVec3::from(ahead).normalize());
        let x = DVec3::Z.cross(z).normalize();
        let rows = [x, z.cross(x), z];
        let row = |axis: DVec3| [axis.x, axis.y, axis.z, -axis.dot(eye)].map(|v| v as f32);
        let world_to_camera = rows.map(row);
        let view =
            View { world_to_camera, fx: 64.0, fy: 64.0, cx: 32.0, cy: 24.0, width: 64, height: 48 };
        frame(view, None)
    }

    fn ring(count: usize, of: impl Fn(f64, f64) -> TrainingFrame) -> Vec<TrainingFrame> {
        (0..count)
            .map(|i| (std::f64::consts::TAU * i as f64 / count as f64).sin_cos())
            .map(|(s, c)| of(s, c))
            .collect()
    }

    /// From around and above an object at (5, 1, −2); far from 0, as its cameras are.
    fn around(scale: f64) -> Vec<TrainingFrame> {
        ring(12, |s, c| {
            let ahead = [-2.0 * c, -2.0 * s, -1.0];
            looking(
                [5.0 - scale * ahead[0], 1.0 - scale * ahead[1], -2.0 - scale * ahead[2]],
                ahead,
            )
        })
    }

    #[test]
    fn cameras_around_an_object_look_at_it() {
        for scale in [0.1, 1.0, 100.0] {
            let focus = focus_of(&around(scale)).unwrap();
            for (found, want) in focus.point.iter().zip([5.0, 1.0, -2.0]) {
                assert!((found - want).abs() < 1e-5 * scale.max(1.0), "{focus:?}");
            }
            // √5 away, 24 of 64 pixels from the middle to the nearest border.
            let want = scale * 5f64.sqrt() * 24.0 / 64f64.hypot(24.0);
            assert!((focus.radius / want - 1.0).abs() < 1e-3, "{focus:?} {want}");
        }
        let ((points, colors), text) = points_in_view(&around(1.0), 500, 3).unwrap();
        assert!(
            points.len() == 500 && colors.len() == 500 && text.contains("cube of side 1.5"),
            "{text}"
        );
        assert!(points.iter().all(|p| (p[0] - 5.0).abs() < 0.79 && (p[2] + 2.0).abs() < 0.79));
        // One camera that looks elsewhere changes nothing much.
        let mut frames = around(1.0);
        frames.push(looking([5.0, 9.0, -2.0], [0.1, 1.0, 0.0]));
        assert!((focus_of(&frames).unwrap().point[0] - 5.0).abs() < 0.2);
    }

    #[test]
    fn fog_becomes_thin() {
        let with =
            |opacity, scale| InitialSettings { opacity, scale, sh_degree: 3, random_quats: true };
        assert_eq!(thin(with(0.5, 1.0)), with(0.1, 0.3));
        // The presets of gsplat stay as they are.
        assert_eq!(thin(with(0.1, 1.0)), with(0.1, 1.0));
        assert_eq!(thin(with(0.5, 0.1)), with(0.5, 0.1));
    }

    #[test]
    fn rooms_and_parallel_cameras_have_no_such_place() {
        let outward = ring(12, |s, c| looking([0.2 * c, 0.2 * s, 0.0], [c, s, 0.0]));
        let parallel: Vec<_> =
            (0..5).map(|i| looking([f64::from(i), 0.0, 0.0], [0.0, 1.0, 0.0])).collect();
        let one = vec![looking([0.0; 3], [0.0, 1.0, 0.0])];
        for (frames, least) in [(outward, 1), (parallel, 3), (one, 1)] {
            assert_eq!(focus_of(&frames), None);
            let ((points, colors), _) = points_in_view(&frames, 200, 1).unwrap();
            assert!(!points.is_empty() && points.len() == colors.len());
            for p in &points {
                let seen = frames.iter().filter(|frame| shows(&frame.view, *p)).count();
                assert!(seen >= least, "{p:?} is seen by {seen}");
            }
        }
        assert!(points_in_view(&[], 10, 1).unwrap().0.0.is_empty());
    }

    #[test]
    fn points_are_drawn_from_all_frames() {
        // Two cameras back to back share nothing.
        let frames = [looking([0.0; 3], [1.0, 0.0, 0.0]), looking([0.0; 3], [-1.0, 0.0, 0.0])];
        let points = seen_points(&frames, 400, 1, 1);
        let ahead = points.iter().filter(|p| p[0] > 0.0).count();
        assert!(points.len() == 400 && (150..250).contains(&ahead), "{ahead} of {}", points.len());
    }

    #[test]
    fn the_free_ball_ends_at_the_nearest_side_of_the_picture() {
        // The axis is off the middle: 10 pixels to the left, 54 to the right, 24 up and down.
        let mut view = looking([0.0; 3], [0.0, 1.0, 0.0]).view;
        view.world_to_camera = [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]];
        view.cx = 10.0;
        let radius =
            |x: f64, y: f64| free_radius(&view, axis_of(&view), DVec3::new(x, y, 1.0)).unwrap();
        // Distances to planes through the eye: of a point at x those of pixels 0 and 64 are
        // (64 x + 10) / √(64² + 10²) and (54 − 64 x) / √(64² + 54²).
        for (x, y, want) in [
            (0.5, 0.0, 22.0 / 64f64.hypot(54.0)),
            (0.0, 0.0, 10.0 / 64f64.hypot(10.0)),
            (0.2, 0.3, (24.0 - 64.0 * 0.3) / 64f64.hypot(24.0)),
            (0.2, -0.3, (24.0 - 64.0 * 0.3) / 64f64.hypot(24.0)),
        ] {
            assert!((radius(x, y) - want).abs() < 1e-6, "{x} {y}: {} {want}", radius(x, y));
        }
        assert_eq!(free_radius(&view, axis_of(&view), DVec3::new(0.9, 0.0, 1.0)), None);
    }

    #[test]
    fn nine_of_ten_cameras_say_where_and_half_of_them_how_large() {
        // Cameras on a circle about (5, 1, −2), at distances 1 to 10, all level.
        let at = |i: usize, away: f64| {
            let (s, c) = (0.7 * i as f64).sin_cos();
            looking([5.0 + away * c, 1.0 + away * s, -2.0], [-c, -s, 0.0])
        };
        let mut frames: Vec<_> = (0..10).map(|i| at(i, 1.0 + i as f64)).collect();
        // Pixels: 24 of 64 above the axis. Of ten radii the sixth.
        let radius = |away: f64| away * 24.0 / 64f64.hypot(24.0);
        let found = focus_of(&frames).unwrap();
        assert!((found.radius - radius(6.0)).abs() < 1e-4, "{found:?}");
        assert!((focus_of(&frames[..5]).unwrap().radius - radius(3.0)).abs() < 1e-4);
        let ((points, colors), text) = points_in_view(&frames, 30, 4).unwrap();
        let corner = |sign: f64| found.point.map(|v| (v + sign * found.radius) as f32);
        assert_eq!((points, colors), random_points(30, [corner(-1.0), corner(1.0)], 4).unwrap());
        let side = format!(
            "RANDOM POINTS in the cube of side {:.3} that the cameras look at",
            2.0 * radius(6.0)
        );
        assert_eq!(text, side);
        // One of ten that looks away is no harm, two are.
        let away = |i: usize| {
            let (s, c) = (0.7 * i as f64).sin_cos();
            looking([5.0 + 2.0 * c, 1.0 + 2.0 * s, -2.0], [c, s, 0.0])
        };
        frames[3] = away(3);
        assert!((focus_of(&frames).unwrap().radius - radius(6.0)).abs() < 1e-4);
        frames[4] = away(4);
        assert_eq!(focus_of(&frames), None);
        let with =
            |opacity, scale| InitialSettings { opacity, scale, sh_degree: 1, random_quats: false };
        assert_eq!(
            (thin(with(0.11, 0.31)), thin(with(0.11, 0.3))),
            (with(0.1, 0.3), with(0.11, 0.3))
        );
    }

    #[test]
    fn points_are_on_rays_of_random_pixels_evenly_in_the_logarithm_of_depth() {
        // In a room, so that there is no focus; pictures of other sizes and lenses.
        let mut frames = ring(5, |s, c| looking([0.4 * c, 0.2 * s, 0.1 * s], [c, s, 0.1]));
        let v = &mut frames[2].view;
        (v.width, v.height, v.fx, v.cx, v.cy) = (30, 60, 40.0, 11.0, 33.0);
        frames.push(looking([0.0, 0.1, 0.0], [1.0, 0.3, 0.0]));
        assert_eq!(focus_of(&frames), None);
        let eyes: Vec<DVec3> =
            frames.iter().map(|f| DVec3::from(f.view.centre().map(f64::from))).collect();
        let mean = eyes.iter().sum::<DVec3>() / 6.0;
        let scale = 1.1 * eyes.iter().map(|e| e.distance(mean)).fold(0.0, f64::max);
        let project = |f: &TrainingFrame, p: [f32; 3]| {
            let [x, y, z] = f.view.to_camera(p).map(f64::from);
            let v = &f.view;
            [
                x / z * f64::from(v.fx) + f64::from(v.cx),
                y / z * f64::from(v.fy) + f64::from(v.cy),
                z,
            ]
        };
        let counter = Counter::new(8, Purpose::Start, 2);
        for views in [1, 2] {
            let found = seen_points(&frames, 60, 8, views);
            let mut next = found.iter();
            let mut tried = 0;
            for i in 0.. {
                let [which, pixel, depth, _] = counter.units(i);
                let f = &frames[(6.0 * which) as usize];
                let (w, pixel) = (f.view.width as usize, (pixel * f.view.pixels() as f64) as usize);
                // 0.3 to 30: a factor of 100.
                let z = 0.3 * scale * 100f64.powf(depth);
                let at = lifted(f, pixel, z as f32);
                let seen = |f: &&TrainingFrame| {
                    let [u, v, z] = project(f, at);
                    z > 0.0
                        && u >= 0.0
                        && v >= 0.0
                        && u < f.view.width.into()
                        && v < f.view.height.into()
                };
                if frames.iter().filter(seen).count() < views {
                    continue;
                }
                let Some(point) = next.next() else { break };
                let [u, v, depth] = project(f, *point);
                assert!((u - (pixel % w) as f64 - 0.5).abs() < 0.01, "{views} {i}: {u}");
                assert!(
                    (v - (pixel / w) as f64 - 0.5).abs() < 0.01 && (depth / z - 1.0).abs() < 1e-4
                );
                tried += 1;
            }
            assert_eq!((tried, found.len()), (60, 60));
        }
        let ((points, colors), text) = points_in_view(&frames, 20, 8).unwrap();
        // Too few are seen by three.
        assert!(seen_points(&frames, 20, 8, 3).len() < 10);
        assert_eq!(points, seen_points(&frames, 20, 8, 2));
        assert_eq!(colors, random_points(20, [[0.0; 3], [1.0; 3]], 8).unwrap().1);
        assert_eq!(text, "RANDOM POINTS that 2 or more cameras see");
        let beside: Vec<_> =
            (0..5).map(|i| looking([0.1 * f64::from(i), 0.0, 0.0], [0.0, 1.0, 0.0])).collect();
        let ((points, _), text) = points_in_view(&beside, 20, 8).unwrap();
        assert_eq!(points, seen_points(&beside, 20, 8, 3));
        assert_eq!(text, "RANDOM POINTS that 3 or more cameras see");
        // Back to back nothing is seen by two.
        let apart = [looking([0.0; 3], [1.0, 0.0, 0.0]), looking([0.0; 3], [-1.0, 0.0, 0.0])];
        let ((points, _), text) = points_in_view(&apart, 20, 8).unwrap();
        assert_eq!((points.len(), text.as_str()), (20, "RANDOM POINTS that 1 or more cameras see"));
    }
}
