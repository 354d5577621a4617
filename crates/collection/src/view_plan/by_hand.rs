//! Places, directions and cameras by hand, and what is picked by a slow version.

use super::*;

fn settings(count: usize) -> ViewPlanSettings {
    ViewPlanSettings { count, size: [96, 72], fov: 90.0, up: Up::PLUS_Z }
}

fn gaussians(means: Vec<[f32; 3]>, opacities: Vec<f32>, scale: f32) -> Gaussians {
    let n = means.len();
    Gaussians {
        means,
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        scales: vec![[scale; 3]; n],
        opacities,
        sh: vec![0.0; 3 * n],
        sh_degree: 0,
    }
}

/// Walls, floor and ceiling of a box of 4 × 3 × 2.5 with a pillar, and what is not in the way.
fn room() -> Gaussians {
    let side = [4.0f32, 3.0, 2.5];
    let mut means = Vec::new();
    for (axis, end) in (0..3).flat_map(|axis| [(axis, 0.0), (axis, 1.0)]) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for i in 0..144 {
            let mut p = [0.0; 3];
            p[axis] = end * side[axis];
            p[u] = side[u] * ((i % 12) as f32 + 0.5) / 12.0;
            p[v] = side[v] * ((i / 12) as f32 + 0.5) / 12.0;
            means.push(p);
        }
    }
    means.extend((0..20).map(|i| [3.0, 1.0, 0.125 * i as f32]));
    let solid = means.len();
    means.extend([[1.0, 1.5, 1.2], [50.0, 0.0, 0.0]]);
    let mut opacities = vec![0.9; solid];
    opacities.extend([0.29, 0.1]);
    gaussians(means, opacities, 0.12)
}

#[test]
fn cameras_look_where_they_are_sent_in_the_axes_of_the_scene() {
    let tall = settings(1);
    // With −y up the scene's (x, y, z) is (x, z, −y) upright, so an upright place (1, 2, 3) is (1, −3, 2) there.
    let scene = room();
    let planner = Planner::of(&scene, ViewPlanSettings { up: Up::MINUS_Y, ..tall }).unwrap();
    let right = std::f64::consts::FRAC_PI_2;
    let candidate =
        Candidate { eye: DVec3::new(1.0, 2.0, 3.0), azimuth: right, pitch: 0.0, place: 0 };
    let camera = planner.camera(&candidate, "x".to_owned(), [96, 72]);
    let near = |found: [f64; 3], want: [f64; 3]| {
        assert!((0..3).all(|k| (found[k] - want[k]).abs() < 1e-9), "{found:?} {want:?}");
    };
    for (found, want) in
        camera.rotation.iter().zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    {
        near(*found, want);
    }
    near(camera.centre(), [1.0, -3.0, 2.0]);
    near(camera.translation, [-1.0, 3.0, -2.0]);
    assert_eq!((camera.name.as_str(), camera.width, camera.height), ("x", 96, 72));
    // Half of 90° has the tangent 1: half of the shorter side.
    assert!((camera.fx - 36.0).abs() < 1e-9 && (camera.fy - 36.0).abs() < 1e-9);
    assert_eq!((camera.cx, camera.cy), (48.0, 36.0));
    // Up is +z: what is ahead is in the middle, what is to the right is to the right, what is above is above.
    let planner = Planner::of(&scene, tall).unwrap();
    let (azimuth, pitch) = (0.7f64, -0.4f64);
    let eye = DVec3::new(0.5, -1.0, 2.0);
    let camera =
        planner.camera(&Candidate { eye, azimuth, pitch, place: 0 }, String::new(), [96, 72]);
    let ahead = DVec3::new(azimuth.cos() * pitch.cos(), azimuth.sin() * pitch.cos(), pitch.sin());
    let side = DVec3::new(azimuth.sin(), -azimuth.cos(), 0.0);
    let above = side.cross(ahead);
    assert!(above.z > 0.9);
    for (off, want) in [(DVec3::ZERO, [48.0, 36.0]), (side, [66.0, 36.0]), (above, [48.0, 18.0])] {
        let found = camera.project((eye + 2.0 * ahead + off).to_array()).unwrap();
        assert!((0..2).all(|k| (found[k] - want[k]).abs() < 1e-9), "{found:?} {want:?}");
    }
}

#[test]
fn directions_and_orbits_are_the_documented_ones() {
    let scene = room();
    let planner = Planner::of(&scene, settings(1)).unwrap();
    let places = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];
    let all = planner.around_places(&places);
    assert_eq!(all.len(), 2 * 8 * 3);
    let tau = std::f64::consts::TAU;
    for (i, c) in all.iter().enumerate() {
        let (place, turn, row) = (i / 24, i / 3 % 8, i % 3);
        assert_eq!((c.place, c.eye, c.pitch), (place, places[place], [-0.6, -0.15, 0.35][row]));
        // Eighths of a turn; rows are turned by thirds of an eighth.
        assert!((c.azimuth - tau * (3 * turn + row) as f64 / 24.0).abs() < 1e-12, "{i}");
    }
    let orbits = planner.orbits();
    assert_eq!(orbits.len(), 3 * 2 * 16);
    let (middle, half) =
        ((planner.low + planner.high) / 2.0, (planner.high - planner.low).length() / 2.0);
    for (i, c) in orbits.iter().enumerate() {
        let (ring, row, turn) = (i / 32, i / 16 % 2, i % 16);
        let azimuth = tau * (3 * turn + ring + row) as f64 / 48.0;
        assert!((c.azimuth - azimuth).abs() < 1e-12 && c.pitch == [-0.25, -0.7, 0.2][ring]);
        let ahead =
            DVec3::new(azimuth.cos() * c.pitch.cos(), azimuth.sin() * c.pitch.cos(), c.pitch.sin());
        let want = middle - [2.2, 1.4][row] * half * ahead;
        assert!((c.eye - want).length() < 1e-9 && c.place == i, "{i}: {c:?}");
    }
}

#[test]
fn free_places_are_those_of_the_slow_version() {
    let scene = room();
    let solid: Vec<DVec3> = (scene.means.iter().zip(&scene.opacities))
        .filter(|(_, o)| **o >= 0.3)
        .map(|(p, _)| DVec3::from(p.map(f64::from)))
        .collect();
    // A hundredth of 884 solid ones may be stray at either end: the walls stand there 144 times.
    let (low, high) = (DVec3::ZERO, DVec3::new(4.0, 3.0, 2.5));
    let mut free = Vec::new();
    for (part, i) in [0.35, 0.5, 0.65, 0.8].into_iter().flat_map(|p| (0..81).map(move |i| (p, i))) {
        let share =
            DVec3::new((f64::from(i % 9) + 0.5) / 9.0, (f64::from(i / 9) + 0.5) / 9.0, part);
        let place = low + share * (high - low);
        let space = solid.iter().map(|s| s.distance(place)).fold(f64::INFINITY, f64::min);
        // 6 % of the shortest side.
        if space >= 0.06 * 2.5 {
            free.push((place, space));
        }
    }
    for (count, wanted) in [(1, 8), (17, 9), (30, 15), (90, 24)] {
        let planner = Planner::of(&scene, settings(count)).unwrap();
        assert!((planner.clearance() - 0.15).abs() < 1e-6);
        assert!((planner.low - low).length() < 1e-6 && (planner.high - high).length() < 1e-6);
        let found = planner.free_places();
        assert_eq!(found.len(), wanted, "{count}");
        let mut chosen: Vec<DVec3> = Vec::new();
        for place in &found {
            // The one with the most space, then the one farthest from the others; equal ones are any of them.
            let score = |(p, space): &(DVec3, f64)| {
                let apart = chosen.iter().map(|c| c.distance(*p));
                if chosen.is_empty() { *space } else { apart.fold(f64::INFINITY, f64::min) }
            };
            let best = free.iter().map(score).fold(0.0, f64::max);
            let own = free.iter().find(|f| f.0.distance(*place) < 1e-5).unwrap();
            assert!((score(own) - best).abs() < 1e-5, "{place}: {} {best}", score(own));
            chosen.push(*place);
        }
    }
    // Of something flat a tenth of the longest side counts: 0.06 · 0.4.
    let flat = gaussians(
        solid.iter().map(|p| [p.x as f32, p.y as f32, 0.0]).collect(),
        vec![0.3; solid.len()],
        0.1,
    );
    let planner = Planner::of(&flat, settings(1)).unwrap();
    assert!((planner.clearance() - 0.024).abs() < 1e-6, "{}", planner.clearance());
    let faint = gaussians(vec![[0.0; 3]; 3], vec![0.299; 3], 0.1);
    let error = Planner::of(&faint, settings(1)).err().unwrap().to_string();
    assert!(error.contains("no Gaussian has an opacity of 0.3 or more"), "{error}");
}

#[test]
fn what_is_picked_is_what_the_rules_leave() {
    let scene = room();
    let planner = Planner::of(&scene, settings(5)).unwrap();
    // In the middle, beside the pillar, inside the pillar, far outside.
    let places =
        [[1.5, 1.5, 1.2], [2.6, 1.2, 1.2], [3.0, 1.0, 1.0], [9.0, -6.0, 1.2]].map(DVec3::from);
    let candidates = planner.around_places(&places);
    for outside in [false, true] {
        let plan = planner.pick(&candidates, outside).unwrap();
        let seen: Vec<_> = (candidates.iter())
            .map(|c| {
                let camera = planner.camera(c, String::new(), [96, 72]);
                seen_in(&scene, &View::from_camera(&camera).unwrap(), 0.15).unwrap()
            })
            .collect();
        let light = |place: usize| {
            seen[24 * place..24 * (place + 1)].iter().map(|s| f64::from(s.open)).sum::<f64>() / 24.0
        };
        let good = |i: usize| {
            let alone = f64::from(seen[i].near) <= 0.1 && f64::from(seen[i].open) < 0.95;
            alone && (outside || light(i / 24) <= 0.4)
        };
        let shown: Vec<Shown> = (0..candidates.len())
            .map(|i| Shown {
                things: if good(i) { seen[i].rows.clone() } else { vec![] },
                quality: 1.0,
            })
            .collect();
        let picked = choose_pictures(&shown, scene.len(), 5);
        assert_eq!((plan.cameras.len(), plan.tried, plan.outside), (picked.len(), 96, outside));
        assert_eq!(plan.refused, (0..96).filter(|i| !good(*i)).count());
        assert!(plan.refused > 24 && plan.refused < 90, "{}", plan.refused);
        for (n, (camera, i)) in plan.cameras.iter().zip(&picked).enumerate() {
            assert_eq!(*camera, planner.camera(&candidates[*i], format!("view_{n:03}"), [96, 72]));
        }
        let things: std::collections::BTreeSet<u32> =
            picked.iter().flat_map(|i| seen[*i].rows.clone()).collect();
        assert!((plan.seen - things.len() as f64 / scene.len() as f64).abs() < 1e-12);
    }
}

#[test]
fn settings_without_a_picture_or_an_angle_are_refused() {
    let scene = room();
    let of = |change: fn(&mut ViewPlanSettings)| {
        let mut settings = settings(2);
        change(&mut settings);
        settings.check().map_err(|error| error.to_string())
    };
    for (change, part) in [
        ((|s| s.count = 0) as fn(&mut ViewPlanSettings), "views: 0 of 96×72; at least 1 of 16×16"),
        (|s| s.size = [15, 16], "2 of 15×16"),
        (|s| s.size = [16, 15], "2 of 16×15"),
        (|s| s.fov = 0.0, "angle of view: is 0; above 0 and below 180"),
        (|s| s.fov = 180.0, "angle of view: is 180"),
    ] {
        assert!(of(change).unwrap_err().contains(part));
    }
    assert!(of(|s| (s.count, s.size, s.fov) = (1, [16, 16], 179.0)).is_ok());
    assert!(plan_views(&scene, &ViewPlanSettings { count: 0, ..settings(1) }).is_err());
    // Walls of 0.12 let light through between them: what is inside shows more than what is around.
    let plan = plan_views(&scene, &settings(6)).unwrap();
    assert_eq!(
        (plan.outside, plan.tried, plan.cameras[5].name.as_str()),
        (false, 8 * 24, "view_005")
    );
}

/// A closed box of few large Gaussians around a block of many small ones, most of which hide behind others.
fn closed() -> Gaussians {
    let side = [4.0f32, 3.0, 2.5];
    let (mut means, mut scales) = (Vec::new(), Vec::new());
    for (axis, end) in (0..3).flat_map(|axis| [(axis, 0.0), (axis, 1.0)]) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for i in 0..36 {
            let mut p = [0.0; 3];
            p[axis] = end * side[axis];
            p[u] = side[u] * ((i % 6) as f32 + 0.5) / 6.0;
            p[v] = side[v] * ((i / 6) as f32 + 0.5) / 6.0;
            means.push(p);
            scales.push([0.35; 3]);
        }
    }
    means.extend((0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(|v| 1.0 + 0.08 * v as f32)));
    scales.resize(means.len(), [0.06; 3]);
    Gaussians { scales, opacities: vec![0.98; means.len()], ..gaussians(means, Vec::new(), 0.0) }
}

#[test]
fn views_that_were_tried_count_wherever_the_cameras_stand() {
    let mut inside_stays = 0;
    for (scene, count) in [(room(), 6), (closed(), 1)] {
        let settings = settings(count);
        let planner = Planner::of(&scene, settings).unwrap();
        let inside = planner.pick(&planner.around_places(&planner.free_places()), false).unwrap();
        let around = planner.pick(&planner.orbits(), true).unwrap();
        let both = inside.seen < 0.5;
        let plan = plan_views(&scene, &settings).unwrap();
        let of = |of: fn(&ViewPlan) -> usize| of(&inside) + if both { of(&around) } else { 0 };
        assert_eq!((plan.tried, plan.refused), (of(|p| p.tried), of(|p| p.refused)), "{count}");
        assert_eq!(plan.outside, both && around.seen > inside.seen, "{count}");
        inside_stays += usize::from(both && !plan.outside);
    }
    assert!(inside_stays > 0, "no plan keeps its places inside after it looked from around");
}
