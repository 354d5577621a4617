//! Normals against a slow version in f64.

use super::*;
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn normals_are_those_of_the_slow_version() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (w, h) = (11i64, 8i64);
    let view = View { fx: 9.0, fy: 12.0, cx: 4.0, cy: 5.0, ..crate::segmenter::tests::view(11, 8) };
    // A bent surface with a step in the middle, noise of a hundredth, and holes of every kind.
    let mut depth: Vec<f32> = (0..w * h)
        .map(|at| {
            let (x, y) = ((at % w) as f32, (at / w) as f32);
            2.0 + 0.02 * x - 0.015 * y
                + if x > 6.0 { 0.3 } else { 0.0 }
                + rng.random_range(0.0..0.02)
        })
        .collect();
    for (at, hole) in [(0, 0.0), (17, -1.0), (40, f32::NAN), (41, f32::INFINITY), (52, 0.0)] {
        depth[at] = hole;
    }
    let at = |x: i64, y: i64| {
        (0..w).contains(&x).then_some(()).and((0..h).contains(&y).then_some((y * w + x) as usize))
    };
    let z =
        |i: usize| if depth[i].is_finite() && depth[i] > 0.0 { f64::from(depth[i]) } else { 0.0 };
    let point = |i: usize| {
        let (x, y) = ((i as i64 % w) as f64 + 0.5, (i as i64 / w) as f64 + 0.5);
        DVec3::new((x - 4.0) / 9.0 * z(i), (y - 5.0) / 12.0 * z(i), z(i))
    };
    let same = |a: usize, b: usize| z(b) > 0.0 && (z(a) - z(b)).abs() <= 0.05 * z(a).min(z(b));
    let raw = |i: usize| -> DVec3 {
        let (x, y) = (i as i64 % w, i as i64 / w);
        let along = |dx: i64, dy: i64| {
            let side = |s: i64| at(x + s * dx, y + s * dy).filter(|o| same(i, *o)).unwrap_or(i);
            point(side(1)) - point(side(-1))
        };
        let n = along(1, 0).cross(along(0, 1));
        if z(i) == 0.0 || n.length() == 0.0 {
            return DVec3::ZERO;
        }
        n.normalize() * -n.dot(point(i)).signum()
    };
    let found = Surface::of(&depth, &view);
    let mut known = 0;
    for i in 0..(w * h) as usize {
        let (x, y) = (i as i64 % w, i as i64 / w);
        let mut sum = DVec3::ZERO;
        for other in (-2..=2)
            .flat_map(|v| (-2..=2).map(move |u| (u, v)))
            .filter_map(|(u, v)| at(x + u, y + v))
        {
            if (z(other) - z(i)).abs() <= 0.05 * z(i) {
                sum += raw(other);
            }
        }
        let want = if z(i) > 0.0 { sum.normalize_or_zero() } else { DVec3::ZERO };
        known += usize::from(want != DVec3::ZERO);
        let off = (found.normals[i].as_dvec3() - want).length();
        assert!(off < 1e-3, "({x}, {y}): {} {want}", found.normals[i]);
        assert!((found.points[i].as_dvec3() - point(i)).length() < 1e-5);
    }
    assert!(known > 70, "{known}");
    // A single row or column has no normal, as there is nothing to turn it by.
    let row =
        Surface::of(&[2.0, 2.01, 2.02], &View { height: 1, ..crate::segmenter::tests::view(3, 1) });
    assert_eq!(row.normals, [Vec3::ZERO; 3]);
}
