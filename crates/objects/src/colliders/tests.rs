#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

use super::*;
use crate::made::{catalogue, input, object};

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

fn hulls(scene: &GaussianScene, cell: f64) -> Vec<Collider> {
    let (labels, names) = (vec![0; scene.len()], ["thing".to_owned()]);
    let found = catalogue(vec![object(0, 0..scene.len() as u32)], scene.len());
    let settings = ColliderSettings { cell, ..ColliderSettings::default() };
    colliders(&input(scene, &labels, &names), &found, &settings).unwrap()
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
    for (axis, [low, high]) in [[0.1f32, 0.2], [0.0, 0.1], [-0.1, 0.0]].into_iter().enumerate() {
        assert!(cube.positions.iter().all(|p| [low, high].contains(&p[axis])), "{cube:?}");
    }
    let floor: Vec<_> = (0..200)
        .map(|i| [0.1 * (i % 20) as f32 + 0.05, 0.1 * (i / 20) as f32 + 0.05, 0.05])
        .collect();
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

#[test]
fn a_disc_touches_the_cubes_that_it_covers() {
    let cell = 0.1;
    let disc = &hulls(&scene(&[[0.05, 0.05, 0.05]], 0.42, 5.0), cell)[0];
    // Every place of the disc, looked at a hundredth of a cube apart.
    let mut due = BTreeSet::new();
    for i in -4200..=4200i32 {
        for j in -4200..=4200i32 {
            if i % 10 == 0 && j % 10 == 0 && i * i + j * j <= 4200 * 4200 {
                let at = |k: i32| ((0.05 + f64::from(k) / 10_000.0) / cell).floor() as i64;
                due.insert([at(i), at(j), 0]);
            }
        }
    }
    let (volume, _) = volume_and_area(&disc.positions, &disc.triangles);
    let count = (volume / cell.powi(3)).round() as usize;
    // At the rim a cube that is met by a corner alone may be missed.
    assert!(count <= due.len() && count + 8 >= due.len(), "{count} of {}", due.len());
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
    let hull = &colliders(&input, &found, &settings).unwrap()[0];
    let (volume, _) = volume_and_area(&hull.positions, &hull.triangles);
    assert!((volume - 0.1).abs() < 1e-6, "{volume}");
    let height = |p: &[f32; 3]| p[1].abs() < 1e-6 || (p[1] - 0.1).abs() < 1e-6;
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
    // Wider than anything, and far away.
    for (coord, size) in [([0.0; 3], 1e30), ([1e9, -1e9, 3.0], 0.01)] {
        let hull = &hulls(&scene(&[coord], size, 5.0), 0.05)[0];
        assert!(
            hull.triangles.len() >= 12 && hull.positions.iter().flatten().all(|v| v.is_finite())
        );
        assert!(
            hull.positions
                .iter()
                .all(|p| (p[0] - coord[0]).abs() < 3.0 + 1e3 * f32::from(size < 1.0))
        );
    }
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
    // +x is left, +y up, +z forward: of +x right, +y forward, +z up.
    let to_file = |[x, y, z]: [f64; 3]| [-x, z, y];
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
