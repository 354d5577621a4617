//! Numbers of the reference, f64 on the same f32 inputs.

use crate::support::{Scene, everything};
use scenesplat_rasterizer::*;
use scenesplat_test_support::Golden;

/// Pictures, outside and on pixels where a threshold is within float noise: the manifest's.
const IMAGE: f64 = 2e-5;
const BOUNDARY: f64 = 5e-3;

/// Compares pixels of `channels` values, each within the tolerance for its pixel.
fn close(what: &str, got: &[f32], expected: &[f64], boundary: &[f64]) {
    let channels = expected.len() / boundary.len();
    assert_eq!(got.len(), expected.len(), "{what}");
    for (i, (&got, &expected)) in got.iter().zip(expected).enumerate() {
        let flag = boundary[i / channels];
        let tolerance = if flag == 0.0 { IMAGE } else { BOUNDARY } * (1.0 + expected.abs());
        let error = (f64::from(got) - expected).abs();
        assert!(error <= tolerance, "{what}[{i}] = {got}, not {expected}; flags {flag}");
    }
}

/// Compares weights of Gaussians.
fn close_rows(what: &str, got: &[f32], expected: &[f64]) {
    for (i, (&got, &expected)) in got.iter().zip(expected).enumerate() {
        let error = (f64::from(got) - expected).abs();
        assert!(error <= 1e-5 * expected.abs() + 5e-3, "{what}[{i}] = {got}, {expected}");
    }
}

/// All pictures of a configuration, and what its Gaussians did.
fn check_pictures(
    golden: &Golden,
    scene: &Scene,
    settings: &RasterSettings,
    request: &RenderRequest,
) {
    for (camera, view) in scene.views.iter().enumerate() {
        let out = render(&scene.gaussians, view, settings, request).unwrap();
        let boundary = golden.part("boundary", camera);
        let image = |name: &str, got: &[f32]| {
            close(&format!("{name} of {camera}"), got, &golden.part(name, camera), &boundary);
        };
        image("rgb", out.rgb.as_ref().unwrap());
        image("alpha", &out.alpha());
        image("depth_acc", out.depth_accumulated.as_ref().unwrap());
        image("depth_exp", out.depth_expected.as_ref().unwrap());
        check_median(&golden.part("depth_med", camera), &boundary, &out.depth_median.unwrap());
        let did = out.contributions.unwrap();
        let expected = golden.part("wsum", camera);
        let (own, hostile) = did.sum.split_at(expected.len());
        close_rows("wsum", own, &expected);
        close_rows("wmax", &did.max, &golden.part("wmax", camera));
        // One count more or less per flagged pixel at most, and few of them.
        if golden.has("wcnt") {
            let flagged = boundary.iter().filter(|&&b| b != 0.0).count() as i64;
            let mut off = 0;
            for (&got, expected) in did.count.iter().zip(golden.part("wcnt", camera)) {
                off += (i64::from(got) - expected as i64).abs();
            }
            assert!(off <= flagged, "{off} counts off, {flagged} flagged pixels");
        }
        assert!(hostile.iter().all(|&w| w == 0.0), "a hostile Gaussian has weight");
    }
}

/// The median depth jumps where the transmittance passes ½ within float noise: such pixels may hold the
/// depth of a neighbor in the list.
fn check_median(expected: &[f64], boundary: &[f64], got: &[f32]) {
    assert_eq!(got.len(), expected.len());
    let off = |i: usize| {
        let error = (f64::from(got[i]) - expected[i]).abs();
        error > IMAGE * (1.0 + expected[i]) && boundary[i] == 0.0
    };
    let count = (0..got.len()).filter(|&i| off(i)).count();
    assert!(count <= 2, "{count} medians of {} are off", got.len());
}

#[test]
fn pictures() {
    let Some(scene) = Scene::synthetic() else { return };
    let default = RasterSettings::default();
    let antialiased = RasterSettings { antialiased: true, ..default };
    let legacy = RasterSettings::gsplat_1_5();
    for (name, settings, degree) in [
        ("classic_sh0", default, 0),
        ("classic_sh1", default, 1),
        ("classic_sh2", default, 2),
        ("classic_sh3", default, 3),
        ("antialiased_sh3", antialiased, 3),
        ("legacy_alpha0999_sh3", legacy, 3),
    ] {
        println!("{name}");
        let Some(golden) = Golden::raster(&format!("render_{name}")) else { return };
        let request = RenderRequest { sh_degree: Some(degree), ..everything() };
        check_pictures(&golden, &scene, &settings, &request);
    }
}

#[test]
fn background() {
    let Some(scene) = Scene::synthetic() else { return };
    let Some(golden) = Golden::raster("render_background_sh3") else { return };
    for (camera, view) in scene.views.iter().enumerate() {
        let background = Some(golden.rows("backgrounds")[camera]);
        let settings = RasterSettings { background, ..RasterSettings::default() };
        let out = render(&scene.gaussians, view, &settings, &everything()).unwrap();
        let boundary = golden.part("boundary", camera);
        close("rgb", &out.rgb.unwrap(), &golden.part("rgb", camera), &boundary);
        assert_eq!(out.work.background_pixels, view.pixels());
    }
}

#[test]
fn hostile_gaussians_change_nothing() {
    let Some((clean, hostile)) = Scene::synthetic().zip(Scene::hazards()) else { return };
    let Some(golden) = Golden::raster("render_classic_sh3") else { return };
    assert_eq!(hostile.gaussians.len(), clean.gaussians.len() + 10);
    let settings = RasterSettings::default();
    check_pictures(&golden, &hostile, &settings, &everything());
    let mut seen = 0;
    for view in &clean.views {
        let picture = |s: &Scene| render(&s.gaussians, view, &settings, &everything()).unwrap();
        let (a, b) = (picture(&clean), picture(&hostile));
        assert_eq!(a.rgb, b.rgb, "bit for bit");
        assert_eq!(a.transmittance, b.transmittance);
        assert_eq!(a.last, b.last);
        let (a, b) = (a.culled, b.culled);
        // The third camera has most of them behind it.
        if a.depth == b.depth {
            assert_eq!(b.zero_quat, a.zero_quat + 1);
            // A NaN and an infinite mean and scale, a NaN quaternion.
            assert_eq!(b.not_finite, a.not_finite + 5);
            assert_eq!(b.opacity, a.opacity + 3);
            assert_eq!(b.overflow, a.overflow + 1);
            seen += 1;
        }
    }
    assert_eq!(seen, 2);
}

#[test]
fn garden_pictures() {
    let Some(garden) = Scene::garden() else { return };
    let settings = RasterSettings::default();
    check_pictures(&garden.golden, &garden, &settings, &everything());
    for (camera, view) in garden.views.iter().enumerate() {
        let projected = project(&garden.gaussians, view, &settings).unwrap();
        check_projection(&garden.golden, &projected, camera);
    }
}

#[test]
fn projection() {
    let Some(Scene { gaussians, views, .. }) = Scene::synthetic() else { return };
    let Some(golden) = Golden::raster("projection") else { return };
    let settings = RasterSettings { antialiased: true, ..RasterSettings::default() };
    for (camera, view) in views.iter().enumerate() {
        let plain = project(&gaussians, view, &RasterSettings::default()).unwrap();
        check_projection(&golden, &plain, camera);
        let factor = golden.part("comp", camera);
        let antialiased = project(&gaussians, view, &settings).unwrap();
        for (&i, &got) in antialiased.index.iter().zip(&antialiased.compensation) {
            assert!((f64::from(got) - factor[i as usize]).abs() < 1e-6, "factor of {i}");
        }
        let order = golden.part("depth_order", camera);
        let mut rows: Vec<usize> = (0..plain.len()).collect();
        rows.sort_by(|&a, &b| plain.depth[a].total_cmp(&plain.depth[b]));
        for (row, &expected) in rows.iter().zip(order.iter().filter(|&&i| i >= 0.0)) {
            assert_eq!(f64::from(plain.index[*row]), expected);
        }
    }
}

fn check_projection(golden: &Golden, projected: &Projected, camera: usize) {
    let [radii, means, depths, conics] =
        ["radii_opac", "means2d", "depths", "conics"].map(|name| golden.part(name, camera));
    let visible = |i: &u32| radii[2 * *i as usize] > 0.0;
    let expected: Vec<u32> = (0..radii.len() as u32 / 2).filter(visible).collect();
    assert_eq!(projected.index, expected, "visible ones");
    for (row, &i) in projected.index.iter().enumerate() {
        let i = i as usize;
        for k in 0..2 {
            let mean = means[2 * i + k];
            let got = f64::from(projected.mean2d[row][k]);
            assert!((got - mean).abs() < 1e-4, "mean {k} of {i}: {got}, not {mean}");
            let extent = projected.half_extent[row][k];
            if (extent - extent.round()).abs() > 1e-5 * extent.max(1.0) {
                assert_eq!(f64::from(extent.ceil()), radii[2 * i + k], "radius {k} of {i}");
            }
        }
        assert!((f64::from(projected.depth[row]) - depths[i]).abs() <= 1e-6 * depths[i].max(1.0));
        let conic = &conics[3 * i..3 * i + 3];
        let largest = conic.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for k in 0..3 {
            let error = (f64::from(projected.conic[row][k]) - conic[k]).abs();
            assert!(error <= 2e-6 * largest, "conic {k} of {i}: {error} of {largest}");
        }
    }
}

#[test]
fn tiles() {
    let Some(Scene { gaussians, views, .. }) = Scene::synthetic() else { return };
    let Some(golden) = Golden::raster("tiles16") else { return };
    let settings = RasterSettings::default();
    let [cameras, tiles, minimum] =
        ["min_cam", "min_tile", "min_gauss"].map(|name| golden.ints::<usize>(name));
    for (camera, view) in views.iter().enumerate() {
        let projected = project(&gaussians, view, &settings).unwrap();
        let lists = tile_lists(&projected, view, &settings);
        assert_eq!((lists.columns, lists.rows), (6, 4));
        let list = |tile: usize| {
            let entries = &lists.entries[lists.offsets[tile]..lists.offsets[tile + 1]];
            entries.iter().map(|&row| projected.index[row as usize] as usize)
        };
        for ((&c, &tile), &gaussian) in cameras.iter().zip(&tiles).zip(&minimum) {
            if c == camera {
                assert!(list(tile).any(|i| i == gaussian), "{gaussian} not in {tile}");
            }
        }
        let mut counts = vec![0.0; gaussians.len()];
        (0..lists.len()).flat_map(list).for_each(|i| counts[i] += 1.0);
        let bounds = golden.part("count_aabb_opac", camera);
        for (i, (count, bound)) in counts.iter().zip(&bounds).enumerate() {
            assert!(count <= bound, "{i} is in {count} tiles, its box in {bound}");
        }
        let total: f64 = counts.iter().sum();
        let exact: f64 = golden.part("count_ellipse", camera).iter().sum();
        assert!(total <= exact, "{total} pairs, {exact} with whole tiles");
    }
}
