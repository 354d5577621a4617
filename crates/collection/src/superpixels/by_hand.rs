//! Clusters by hand, and by a slow version in f64.

use super::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pixels of these places and normals, of black.
fn pixels(width: usize, points: Vec<Vec3>, normals: Vec<Vec3>) -> Pixels {
    let height = points.len() / width;
    Pixels {
        width,
        height,
        lab: vec![Vec3::ZERO; points.len()],
        surface: Surface { points, normals },
    }
}

#[test]
fn settings_have_documented_defaults_and_limits() {
    let default = SuperpixelSettings::default();
    let want = SuperpixelSettings { side: 12, compactness: 0.6, merge: 0.5, smallest: 40 };
    assert_eq!(default, want);
    let name = Superpixels::new(default).unwrap().name();
    assert_eq!(name, "superpixels 1 side 12 compactness 0.6 merge 0.5 smallest 40");
    assert!(Superpixels::new(default).unwrap().wants_depth());
    for (change, message) in [
        ((|s| s.side = 4) as fn(&mut SuperpixelSettings), ""),
        (|s| s.side = 256, ""),
        (|s| s.side = 3, "side of superpixels: is 3; it has to be from 4 to 256"),
        (|s| s.side = 257, "side of superpixels: is 257"),
        (|s| s.compactness = 10.0, ""),
        (|s| s.compactness = 0.0, "compactness: is 0; it has to be above 0 and at most 10"),
        (|s| s.compactness = 10.5, "compactness: is 10.5"),
        (|s| (s.merge, s.smallest) = (0.0, 0), ""),
        (|s| s.merge = 10.0, ""),
        (|s| s.merge = 10.5, "merge: is 10.5; it has to be from 0 to 10"),
        (|s| s.merge = -0.5, "merge: is -0.5"),
        (|s| s.merge = f32::NAN, "merge: is NaN"),
    ] {
        let mut settings = default;
        change(&mut settings);
        let found = settings.check().map_or_else(|error| error.to_string(), |()| String::new());
        assert!(found.contains(message) && found.is_empty() == message.is_empty(), "{found}");
    }
}

#[test]
fn a_distance_adds_place_color_plane_and_normal() {
    // Pixel 13 of rows of 5 is column 3 of row 2: two to the right of the center and two above it. With half a unit a
    // pixel these are 8 / 4 = 2. The color is off by 5 of 10: ¼.
    let of = |point: Vec3, normal: Vec3, center: Vec3| {
        let mut all = pixels(5, vec![Vec3::ZERO; 15], vec![Vec3::ZERO; 15]);
        (all.lab[13], all.surface.points[13]) = (Vec3::new(13.0, 4.0, -1.0), point);
        all.surface.normals[13] = normal;
        let lab = Vec3::new(10.0, 0.0, -1.0);
        let center = Center { x: 1.0, y: 4.0, lab, point: center, normal: Vec3::NEG_Z };
        distance(&all, 13, &center, 0.5)
    };
    let (none, ahead) = (Vec3::ZERO, Vec3::NEG_Z);
    let tilted = Vec3::new(0.6, 0.0, -0.8);
    for (point, normal, center, want) in [
        (none, none, none, 2.25),
        // Depth that only one of both has counts 1.
        (Vec3::Z, ahead, none, 3.25),
        (none, none, Vec3::Z, 3.25),
        // Off the center's plane by 0.03 of the nearer depth 2: (0.015 / 0.02)² = 0.5625, whatever lies across.
        (Vec3::new(0.7, -0.4, 2.03), ahead, 2.0 * Vec3::Z, 2.812_5),
        (2.0 * Vec3::Z, ahead, Vec3::new(0.3, 0.9, 2.03), 2.812_5),
        // 1 off a depth of 1 would be 2500, and counts 25.
        (2.0 * Vec3::Z, ahead, Vec3::Z, 27.25),
        // Normals that differ by (0.6, 0, 0.2): 0.4 / 0.16 = 2.5.
        (Vec3::Z, tilted, Vec3::Z, 4.75),
    ] {
        let found = of(point, normal, center);
        assert!((found - want).abs() < 1e-3, "{point} {center}: {found} {want}");
    }
}

#[test]
fn centers_are_means_of_what_is_known() {
    // Two rows of four; the last pixel of each cluster has a normal of its own.
    let z = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    let none = Vec3::ZERO;
    let points = vec![z(1.0, 2.0), z(2.0, 4.0), none, z(0.0, 1.0), none, z(3.0, 3.0), none, none];
    let normal = |p: &Vec3| if p.z > 0.0 { Vec3::new(p.z, 0.0, -4.0) } else { none };
    let mut all = pixels(4, points.clone(), points.iter().map(normal).collect());
    all.lab = (0..8).map(|i| Vec3::new(i as f32, 10.0 * i as f32, -1.0)).collect();
    // Cluster 0: pixels 0, 1, 2, 5; cluster 1: 3 and 4, of which half is known; cluster 2: none; cluster 3: 6 and 7.
    let ids = [0, 0, 0, 1, 1, 0, 3, 3];
    let old = Center { x: 9.0, y: 8.0, lab: Vec3::ONE, point: Vec3::Z, normal: Vec3::X };
    let found = means(&all, &ids, 4, &[Center::default(), Center::default(), old]);
    let same = |c: &Center, place: [f32; 2], lab: f32, point: Vec3, normal: Vec3| {
        let lab = Vec3::new(lab, 10.0 * lab, -1.0);
        let off =
            (c.lab - lab).length() + (c.point - point).length() + (c.normal - normal).length();
        assert!((c.x - place[0]).abs() + (c.y - place[1]).abs() + off < 1e-4, "{c:?}");
    };
    // Columns 0, 1, 2, 1 of rows 0, 0, 0, 1. Three of four are known; normals (2, ·, −4), (4, ·, −4) and (3, ·, −4) sum to
    // (9, 0, −12), which is 15 long.
    same(&found[0], [1.0, 0.25], 2.0, z(2.0, 3.0), Vec3::new(0.6, 0.0, -0.8));
    same(&found[1], [1.5, 0.5], 3.5, none, none);
    assert_eq!((found[2].x, found[2].y, found[2].point), (9.0, 8.0, Vec3::Z));
    same(&found[3], [2.5, 1.0], 6.5, none, none);
    // Without an old one it is 0.
    assert_eq!(means(&all, &ids, 4, &[])[2].x, 0.0);
}

/// SLIC as it is told: six rounds in which each pixel takes the nearest of the nine centers around its home.
fn slow_clusters(all: &Pixels, side: usize, compactness: f64) -> Vec<usize> {
    let (w, h) = (all.width, all.height);
    let (columns, rows) = (w.div_ceil(side), h.div_ceil(side));
    let home = |at: usize| [at % w * columns / w, at / w * rows / h];
    let f = |v: Vec3| v.as_dvec3();
    let known = |at: usize| all.surface.points[at].z > 0.0;
    let mut ids: Vec<usize> = (0..w * h).map(|at| home(at)[1] * columns + home(at)[0]).collect();
    let mut centers = vec![([0.0; 2], DVec3::ZERO, DVec3::ZERO, DVec3::ZERO); columns * rows];
    for round in 0..=6 {
        for (id, center) in centers.iter_mut().enumerate() {
            let own: Vec<usize> = (0..w * h).filter(|at| ids[*at] == id).collect();
            let deep: Vec<usize> = own.iter().copied().filter(|at| known(*at)).collect();
            let n = own.len() as f64;
            if own.is_empty() {
                continue;
            }
            let mean = |of: &dyn Fn(usize) -> f64| own.iter().map(|at| of(*at)).sum::<f64>() / n;
            center.0 = [mean(&|at| (at % w) as f64), mean(&|at| (at / w) as f64)];
            center.1 = own.iter().map(|at| f(all.lab[*at])).sum::<DVec3>() / n;
            (center.2, center.3) = (DVec3::ZERO, DVec3::ZERO);
            if 2 * deep.len() > own.len() {
                let points: DVec3 = deep.iter().map(|at| f(all.surface.points[*at])).sum();
                let normals: DVec3 = deep.iter().map(|at| f(all.surface.normals[*at])).sum();
                (center.2, center.3) = (points / deep.len() as f64, normals.normalize_or_zero());
            }
        }
        if round == 6 {
            break;
        }
        for at in 0..w * h {
            let [column, row] = home(at);
            let apart = |id: usize| {
                let (place, lab, point, normal) = centers[id];
                let square = |v: f64| v * v;
                let d = square((at % w) as f64 - place[0]) + square((at / w) as f64 - place[1]);
                let mut sum = d * square(compactness / side as f64);
                sum += f(all.lab[at]).distance_squared(lab) / 100.0;
                let p = f(all.surface.points[at]);
                match (p.z > 0.0, point.z > 0.0) {
                    (true, true) => {
                        let off = normal.dot(p - point) / p.z.min(point.z) / 0.02;
                        let turned = f(all.surface.normals[at]).distance_squared(normal);
                        sum + square(off).min(25.0) + turned / 0.16
                    }
                    (false, false) => sum,
                    _ => sum + 1.0,
                }
            };
            let near =
                |id: usize| (id % columns).abs_diff(column) < 2 && (id / columns).abs_diff(row) < 2;
            let around = (0..columns * rows).filter(|id| near(*id));
            ids[at] = around.min_by(|a, b| apart(*a).total_cmp(&apart(*b))).unwrap();
        }
    }
    ids
}

#[test]
fn clusters_are_those_of_the_slow_version() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (width, height, side, compactness) in [(23, 14, 5, 0.6), (9, 31, 4, 2.0)] {
        let mut draw = |from: f32, to: f32| rng.random_range(from..to);
        let count = width * height;
        let mut all = pixels(width, vec![Vec3::ZERO; count], vec![Vec3::ZERO; count]);
        for at in 0..count {
            all.lab[at] = Vec3::new(draw(40.0, 60.0), draw(-9.0, 9.0), draw(-9.0, 9.0));
            if draw(0.0, 1.0) < 0.7 {
                all.surface.points[at] =
                    Vec3::new(draw(-1.0, 1.0), draw(-1.0, 1.0), draw(1.9, 2.1));
                all.surface.normals[at] =
                    Vec3::new(draw(-0.3, 0.3), draw(-0.3, 0.3), -1.0).normalize();
            }
        }
        let settings = SuperpixelSettings { side, compactness, ..SuperpixelSettings::default() };
        let found: Vec<usize> = cluster(&all, &settings).iter().map(|id| *id as usize).collect();
        assert_eq!(found, slow_clusters(&all, side as usize, f64::from(compactness)));
    }
}

#[test]
fn side_compactness_limit_and_least_size_are_those_of_the_settings() {
    // A step of 5 of lightness along a diagonal, and a spot of eight pixels.
    let picture = scenesplat_scene::picture::RgbPicture::from_fn(40, 24, |x, y| {
        let spot = (4..8).contains(&x) && (10..12).contains(&y);
        [if spot { 230 } else { 100 + 12 * u8::from(2 * x > 3 * y + 20) }; 3]
    });
    let view = crate::segmenter::tests::view(40, 24);
    let posed = PosedPicture { name: "a", picture: &picture, view: &view, depth: None };
    let of = |change: fn(&mut SuperpixelSettings)| {
        let mut settings =
            SuperpixelSettings { side: 8, merge: 0.0, smallest: 0, ..Default::default() };
        change(&mut settings);
        let found = Superpixels::new(settings).unwrap().segment(&posed).unwrap();
        assert_eq!((found.left_out, found.map.at(0, 0)), (0, 0));
        found.map.num_ids()
    };
    // Without merging there is a cluster for each cell of 8 × 8 or 4 × 4, at least.
    assert!(of(|_| ()) >= 15 && of(|s| s.side = 4) >= 60);
    // The step is half of what counts as 1, and the spot more than 4 of it. The spot is smaller than nine.
    assert_eq!(of(|s| s.merge = 0.7), 2);
    assert!(of(|s| s.merge = 0.3) > 2);
    assert_eq!(of(|s| (s.merge, s.smallest) = (0.7, 9)), 1);
    assert_eq!(of(|s| (s.merge, s.smallest) = (0.7, 8)), 2);
}
