#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

use super::*;
use crate::made::{catalogue, input, object};
use scenesplat_scene::GaussianScene;
use std::collections::BTreeSet;

/// Gaussians at these places, of this size along the first two axes, thin along the third.
fn scene(coord: &[[f32; 3]], size: f32, opacity_logit: f32) -> GaussianScene {
    let n = coord.len();
    GaussianScene {
        coord: coord.to_vec(),
        log_scale: vec![[size.ln(), size.ln(), -9.0]; n],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logit: vec![opacity_logit; n],
        sh_dc: vec![[0.0; 3]; n],
        ..GaussianScene::default()
    }
}

fn made(scene: &GaussianScene, cell: f64) -> Result<Colliders> {
    let (labels, names) = (vec![0; scene.len()], ["thing".to_owned()]);
    let found = catalogue(vec![object(0, 0..scene.len() as u32)], scene.len());
    let settings = ColliderSettings { cell, ..ColliderSettings::default() };
    colliders(&input(scene, &labels, &names), &found, &settings)
}

fn hulls(scene: &GaussianScene, cell: f64) -> Vec<Collider> {
    made(scene, cell).unwrap().hulls
}

/// The volume inside, by the divergence theorem, and the area.
fn volume_and_area(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> (f64, f64) {
    let (mut volume, mut area) = (0.0, 0.0);
    for t in triangles {
        let [a, b, c] = t.map(|i| glam::DVec3::from(positions[i as usize].map(f64::from)));
        volume += a.dot(b.cross(c)) / 6.0;
        area += (b - a).cross(c - a).length() / 2.0;
    }
    (volume, area)
}

#[test]
fn a_gaussian_is_a_cube_and_a_floor_a_slab_of_twelve_triangles() {
    let cube = &hulls(&scene(&[[0.12, 0.02, -0.02]], 0.001, 5.0), 0.1)[0];
    assert_eq!((cube.positions.len(), cube.triangles.len()), (8, 12));
    for (axis, [low, high]) in [[0.1f32, 0.2], [0.0, 0.1], [-0.05, 0.05]].into_iter().enumerate() {
        assert!(cube.positions.iter().all(|p| [low, high].contains(&p[axis])), "{cube:?}");
    }
    // A floor at 0 with two millimeters of noise is one layer.
    let noise = |i: i32| 0.002 * ((i * 7 % 5) as f32 - 2.0);
    let place = |i: i32| [0.1 * (i % 20) as f32 + 0.05, 0.1 * (i / 20) as f32 + 0.05, noise(i)];
    let floor: Vec<_> = (0..200).map(place).collect();
    let slab = &hulls(&scene(&floor, 0.001, 5.0), 0.1)[0];
    assert_eq!((slab.positions.len(), slab.triangles.len()), (8, 12));
    let (volume, area) = volume_and_area(&slab.positions, &slab.triangles);
    assert!((volume - 0.2).abs() < 1e-6 && (area - (4.0 + 0.6)).abs() < 1e-5, "{volume} {area}");
}

#[test]
fn surfaces_hold_the_volume_of_their_cubes_and_have_no_other_face() {
    let mut state = 7u64;
    let mut random = move |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((state >> 33) % below) as i64
    };
    for share in [2, 5, 9] {
        let mut cells = BTreeSet::new();
        for x in -3..4 {
            for y in 0..6 {
                cells.extend((0..5).filter(|_| random(10) < share).map(|z| [x, y, z]));
            }
        }
        let cells: Vec<Cell> = cells.into_iter().collect();
        let exposed = (cells.iter())
            .flat_map(|&[x, y, z]| {
                [
                    [x - 1, y, z],
                    [x + 1, y, z],
                    [x, y - 1, z],
                    [x, y + 1, z],
                    [x, y, z - 1],
                    [x, y, z + 1],
                ]
            })
            .filter(|beside| !cells.contains(beside))
            .count();
        let (corners, triangles) = surface(&cells);
        let positions: Vec<_> = corners.iter().map(|c| c.map(|k| k as f32)).collect();
        let (volume, area) = volume_and_area(&positions, &triangles);
        assert!((volume - cells.len() as f64).abs() < 1e-9, "{share}: {volume}, {}", cells.len());
        assert!((area - exposed as f64).abs() < 1e-9, "{share}: {area}, {exposed}");
        assert!(triangles.len() < 2 * exposed, "{share}: nothing was joined");
    }
}

/// Cubes of edge 0.1 that an ellipsoid of these half-axes about the middle of one meets, looked at every twentieth of a cube.
fn met(half: [f64; 3]) -> usize {
    let mut due = BTreeSet::new();
    let steps = half.map(|h| (h * 200.0) as i32);
    for i in -steps[0]..=steps[0] {
        for j in -steps[1]..=steps[1] {
            for k in -steps[2]..=steps[2] {
                let at = [i, j, k].map(|v| f64::from(v) / 200.0);
                let inside =
                    (0..3).map(|a| if half[a] > 0.0 { (at[a] / half[a]).powi(2) } else { 0.0 });
                if inside.sum::<f64>() <= 1.0 {
                    due.insert(at.map(|v| ((v + 0.05) / 0.1).floor() as i32));
                }
            }
        }
    }
    due.len()
}

#[test]
fn discs_and_balls_touch_the_cubes_that_they_meet() {
    let disc = scene(&[[0.05, 0.05, 0.0]], 0.42, 5.0);
    let mut ball = scene(&[[0.05, 0.05, 0.0]], 0.21, 5.0);
    ball.log_scale = vec![[0.21f32.ln(); 3]];
    for (scene, half) in [(disc, [0.42, 0.42, 0.0]), (ball, [0.21; 3])] {
        let hull = &hulls(&scene, 0.1)[0];
        let (volume, _) = volume_and_area(&hull.positions, &hull.triangles);
        let (count, due) = ((volume / 1e-3).round() as usize, met(half));
        // A cube of which a corner alone is met may be missed.
        assert!(count <= due && 10 * count >= 8 * due, "{count} of {due}");
    }
}

#[test]
fn hulls_lie_where_the_scene_does_in_any_frame_and_unit() {
    // +y is up, a unit is two meters: a slab one cube high.
    let places: Vec<_> = (0..100)
        .map(|i| [0.1 * (i % 10) as f32 + 0.05, 0.03, 0.1 * (i / 10) as f32 + 0.05])
        .collect();
    let scene = scene(&places, 0.001, 5.0);
    let (labels, names) = (vec![0; 100], ["floor".to_owned()]);
    let found = catalogue(vec![object(0, 0..100)], 100);
    let input = ObjectInput {
        upright: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        metres_per_unit: 2.0,
        ..input(&scene, &labels, &names)
    };
    let settings = ColliderSettings { cell: 0.2, ..ColliderSettings::default() };
    let hull = &colliders(&input, &found, &settings).unwrap().hulls[0];
    let (volume, _) = volume_and_area(&hull.positions, &hull.triangles);
    assert!((volume - 0.1).abs() < 1e-6, "{volume}");
    let height = |p: &[f32; 3]| (p[1].abs() - 0.05).abs() < 1e-6;
    assert!(hull.positions.iter().all(height), "{:?}", hull.positions);
    for (k, [low, high]) in [(0, [0.0, 1.0]), (2, [0.0, 1.0])] {
        let all = hull.positions.iter().map(|p| f64::from(p[k]));
        let ends = [all.clone().fold(9.0, f64::min), all.fold(-9.0, f64::max)];
        assert!((ends[0] - low).abs() < 1e-6 && (ends[1] - high).abs() < 1e-6, "{ends:?}");
    }
}

#[test]
fn haze_and_what_is_nowhere_near_are_no_trouble() {
    assert!(hulls(&scene(&[[0.0; 3]], 0.01, -3.0), 0.05).is_empty());
    assert!(hulls(&scene(&[], 0.01, 5.0), 0.05).is_empty());
    // Wider than anything: as wide as anything can be.
    let wide = made(&scene(&[[0.0; 3]], 1e30, 5.0), 0.05).unwrap();
    assert_eq!((wide.cut, wide.far, wide.faint), (1, 0, 0));
    let reach = |p: &[f32; 3]| p[0].hypot(p[1]) < 2.1;
    assert!(wide.hulls[0].positions.iter().all(reach) && wide.hulls[0].triangles.len() > 100);
    // Far away no cube can be told from the next.
    let far = made(&scene(&[[1e9, -1e9, 3.0], [1.0; 3]], 0.01, 5.0), 0.05).unwrap();
    assert_eq!((far.far, far.hulls.len()), (1, 1));
    let (volume, _) = volume_and_area(&far.hulls[0].positions, &far.hulls[0].triangles);
    assert!((volume - 0.05f64.powi(3)).abs() < 1e-6, "{volume}");
    let faint = made(&scene(&[[0.0; 3]], 0.01, -3.0), 0.05).unwrap();
    assert_eq!(faint.faint, 1);
    // More than memory holds.
    let error = made(&scene(&[[0.0; 3]; 1000], 3.0, 5.0), 0.005).unwrap_err().to_string();
    assert!(error.contains("give larger cubes"), "{error}");
    let scene = scene(&[[0.0; 3]; 3], 0.01, 5.0);
    let (labels, names) = (vec![0; 3], ["thing".to_owned()]);
    let made = |found: &Catalogue, cell| {
        let settings = ColliderSettings { cell, ..ColliderSettings::default() };
        colliders(&input(&scene, &labels, &names), found, &settings)
    };
    let found = catalogue(vec![object(0, 0..3)], 3);
    for cell in [0.0, -1.0, f64::NAN, 3.0] {
        assert!(made(&found, cell).unwrap_err().to_string().contains("cell"), "{cell}");
    }
    let other = catalogue(vec![object(0, 0..2)], 2);
    assert!(made(&other, 0.05).unwrap_err().to_string().contains("expected 3 rows"));
}

#[test]
fn the_file_holds_the_hulls_in_the_frame_of_its_format() {
    let mut hulls = hulls(&scene(&[[0.12, 0.02, 0.02], [0.32, 0.02, 0.02]], 0.001, 5.0), 0.1);
    hulls[0].id = 3;
    let origin = [400_000.0, 5_000_000.0, 10.0];
    let file = colliders_glb(&hulls, origin).unwrap();
    let word = |at: usize| u32::from_le_bytes(*file[at..].first_chunk().unwrap()) as usize;
    assert_eq!((&file[..4], word(4), word(8)), (&b"glTF"[..], 2, file.len()));
    let json: serde_json::Value = serde_json::from_slice(&file[20..20 + word(12)]).unwrap();
    let binary = &file[28 + word(12)..];
    assert_eq!((word(20 + word(12)), binary.len() % 4), (binary.len(), 0));
    assert_eq!(json["nodes"][0]["name"], "003-0");
    assert_eq!(json["nodes"][0]["extras"], serde_json::json!({ "id": 3, "class": "0" }));
    // +x is left and +y up, where scenes in memory have right and down.
    let to_file = |[x, y, z]: [f64; 3]| [-x, -y, z];
    let translation: Vec<f64> =
        serde_json::from_value(json["nodes"][0]["translation"].clone()).unwrap();
    assert_eq!(translation, to_file(origin));
    let accessors = json["accessors"].as_array().unwrap();
    let bytes = |accessor: usize| {
        let view = &json["bufferViews"][accessor];
        let [start, len] = ["byteOffset", "byteLength"].map(|k| view[k].as_u64().unwrap() as usize);
        &binary[start..start + len]
    };
    let positions: Vec<[f32; 3]> = (bytes(0).as_chunks::<12>().0.iter())
        .map(|p| [0, 4, 8].map(|at| f32::from_le_bytes(*p[at..].first_chunk().unwrap())))
        .collect();
    let triangles: Vec<[u32; 3]> = (bytes(1).as_chunks::<12>().0.iter())
        .map(|p| [0, 4, 8].map(|at| u32::from_le_bytes(*p[at..].first_chunk().unwrap())))
        .collect();
    assert_eq!(
        (accessors[0]["count"].as_u64(), accessors[1]["count"].as_u64()),
        (Some(16), Some(72))
    );
    assert_eq!(triangles, hulls[0].triangles);
    for (file, scene) in positions.iter().zip(&hulls[0].positions) {
        assert_eq!(file.map(f64::from), to_file(scene.map(f64::from)));
    }
    // Seen from outside the corners still go round counterclockwise.
    assert!((volume_and_area(&positions, &triangles).0 - 0.002).abs() < 1e-6);
    let empty = colliders_glb(&[], [0.0; 3]).unwrap();
    assert!(serde_json::from_slice::<serde_json::Value>(&empty[20..]).unwrap()["nodes"].is_null());
}
