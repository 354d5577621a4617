//! Surfaces of sheets and of chance.

use super::*;
use scenesplat_kernels::random::{below, sample_rng, unit};
use std::collections::HashMap;

/// A point every 2.5 cm of a square of 1 m in the plane of axes `u` and `v`, of one color.
fn square(at: [f32; 3], u: usize, v: usize, grey: f32) -> Vec<([f32; 3], [f32; 3])> {
    let mut points = Vec::new();
    for i in 0..40 {
        for j in 0..40 {
            let mut p = at;
            p[u] += 0.025 * i as f32 + 0.012;
            p[v] += 0.025 * j as f32 + 0.012;
            points.push((p, [grey; 3]));
        }
    }
    points
}

fn one_scale(scale: f64) -> SurfaceSettings {
    SurfaceSettings { scales: vec![scale], ..SurfaceSettings::default() }
}

fn of(points: &[([f32; 3], [f32; 3])], settings: &SurfaceSettings) -> Vec<Surfaces> {
    whole(points, settings).scales
}

fn whole(points: &[([f32; 3], [f32; 3])], settings: &SurfaceSettings) -> SceneSurfaces {
    let (coord, color): (Vec<_>, Vec<_>) = points.iter().copied().unzip();
    surfaces(&coord, &color, settings).unwrap()
}

/// Labels agree, all that speaks for a class being that Gaussians have it.
fn agree_hard(labels: &mut [i32], num_classes: usize, found: &SceneSurfaces) -> Result<Agreed> {
    let row_of: Vec<u32> = (0..labels.len() as u32).collect();
    let mut rows = vec![0.0; labels.len() * num_classes];
    for (row, label) in labels.iter().enumerate() {
        if let Some(class) = usize::try_from(*label).ok().filter(|class| *class < num_classes) {
            rows[row * num_classes + class] = 1.0;
        }
    }
    let shares = ClassShares { row_of: &row_of, rows: &rows, num_classes };
    let settings = AgreeSettings { own: 0.0, ..AgreeSettings::default() };
    agree(labels, &shares, found, &settings)
}

/// The surface of most of some rows, and the share of these that it has.
fn most(of: &[u32]) -> (u32, f64) {
    let mut count: HashMap<u32, usize> = HashMap::new();
    of.iter().for_each(|surface| *count.entry(*surface).or_default() += 1);
    let (&surface, &n) = count.iter().max_by_key(|(_, n)| **n).unwrap();
    (surface, n as f64 / of.len() as f64)
}

#[test]
fn floor_and_wall_are_two_surfaces_and_so_are_two_colors() {
    let mut points = square([0.0; 3], 0, 1, 0.5);
    points.extend(square([0.0, 1.0, 0.0], 0, 2, 0.5));
    points.extend(square([0.0, 1.0, 1.0], 0, 2, 0.9));
    let found = &of(&points, &one_scale(1.0))[0];
    let parts: Vec<(u32, f64)> = found.of.chunks(1600).map(most).collect();
    assert!(parts.iter().all(|(_, share)| *share > 0.85), "{parts:?}");
    assert!(parts[0].0 != parts[1].0 && parts[1].0 != parts[2].0, "{parts:?}");
    // Without color the wall is one.
    let grey = SurfaceSettings { color: 0.0, ..one_scale(1.0) };
    let found = &of(&points, &grey)[0];
    let parts: Vec<u32> = found.of.chunks(1600).map(|rows| most(rows).0).collect();
    assert!(parts[0] != parts[1] && parts[1] == parts[2], "{parts:?}");
}

#[test]
fn most_of_a_surface_names_it() {
    let mut points = square([0.0; 3], 0, 1, 0.5);
    points.extend(square([0.0, 1.0, 0.0], 0, 2, 0.5));
    let found = whole(&points, &one_scale(1.0));
    // On the floor every third is wrong; of the wall nothing is known, but for a few.
    let mut labels: Vec<i32> = (0..1600).map(|i| if i % 3 == 0 { 4 } else { 1 }).collect();
    labels.extend((0..1600).map(|i| if i % 10 == 0 { 2 } else { -1 }));
    let before = labels.clone();
    let changed = agree_hard(&mut labels, 5, &found).unwrap().changed;
    let right = labels[..1600].iter().filter(|label| **label == 1).count();
    assert!(right > 1500, "{right}");
    assert_eq!(changed, labels.iter().zip(&before).filter(|(a, b)| a != b).count());
    assert!(labels[1600..].iter().all(|label| [-1, 1, 2].contains(label)));
    assert_eq!(labels.iter().filter(|label| **label < 0).count(), 1440, "none is given");
}

#[test]
fn parts_are_those_of_the_definition() {
    for seed in 0..20 {
        let mut rng = sample_rng(seed, 0, 0);
        let count = 60;
        let mut edges: Vec<(f32, u32, u32)> = (0..150)
            .map(|_| {
                let (a, b) = (below(&mut rng, count), below(&mut rng, count));
                (unit(&mut rng) as f32, a.min(b), a.max(b))
            })
            .filter(|(_, a, b)| a != b)
            .collect();
        edges.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let scale = 0.1 + unit(&mut rng);
        let found = join(count as usize, &edges, scale, 3);
        let slow = by_definition(count as usize, &edges, scale, 3);
        for a in 0..count as usize {
            for b in 0..a {
                assert_eq!(found[a] == found[b], slow[a] == slow[b], "{seed}: {a} {b}");
            }
        }
    }
}

/// Each part is looked through for the largest difference by which it was joined.
fn by_definition(count: usize, edges: &[(f32, u32, u32)], scale: f64, least: usize) -> Vec<usize> {
    let mut part: Vec<usize> = (0..count).collect();
    let mut joined: Vec<(usize, f32)> = Vec::new();
    let size = |part: &[usize], p: usize| part.iter().filter(|q| **q == p).count();
    let rename = |part: &mut Vec<usize>, from: usize, to: usize| {
        part.iter_mut().filter(|q| **q == from).for_each(|q| *q = to);
    };
    for &(w, a, b) in edges {
        let (pa, pb) = (part[a as usize], part[b as usize]);
        let bound = |p: usize| {
            let inside = joined.iter().filter(|(cell, _)| part[*cell] == p);
            let worst = inside.map(|(_, w)| f64::from(*w)).fold(0.0, f64::max);
            worst + scale / size(&part, p) as f64
        };
        if pa != pb && f64::from(w) <= bound(pa).min(bound(pb)) {
            joined.push((a as usize, w));
            rename(&mut part, pa, pb);
        }
    }
    for &(_, a, b) in edges {
        let (pa, pb) = (part[a as usize], part[b as usize]);
        if pa != pb && size(&part, pa).min(size(&part, pb)) < least {
            rename(&mut part, pa, pb);
        }
    }
    part
}

#[test]
fn a_scene_on_its_side_in_another_unit_has_the_same_surfaces() {
    let settings = SurfaceSettings::default();
    let mut rng = sample_rng(4, 0, 0);
    let mut draw = || -> [f32; 3] { std::array::from_fn(|_| unit(&mut rng) as f32) };
    let coord: Vec<[f32; 3]> = (0..3000).map(|_| draw()).collect();
    let sh_dc = (0..3000).map(|_| draw()).collect();
    let standing = GaussianScene { coord, sh_dc, ..GaussianScene::default() };
    let mut lying = standing.clone();
    // +z becomes −y and +y becomes +z: cells would be counted from another corner.
    for p in &mut lying.coord {
        *p = [4.0 * p[0], -4.0 * p[2], 4.0 * p[1]];
    }
    let as_it_is = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let back = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
    let due = scene_surfaces(&standing, &as_it_is, 1.0, &settings).unwrap();
    assert!(due.scales[0].count > 5, "{}", due.scales[0].count);
    assert_eq!(due, scene_surfaces(&lying, &back, 0.25, &settings).unwrap());
    assert_ne!(due, scene_surfaces(&lying, &back, 1.0, &settings).unwrap());
    assert_ne!(due, scene_surfaces(&lying, &as_it_is, 0.25, &settings).unwrap());
}

#[test]
fn hard_input_has_a_stated_result() {
    let settings = SurfaceSettings::default();
    let none = surfaces(&[], &[], &settings).unwrap();
    for found in &none.scales {
        assert_eq!(*found, Surfaces { of: Vec::new(), count: 0 });
    }
    assert_eq!(agree_hard(&mut [], 2, &none).unwrap(), Agreed::default());
    let (far, bad) = ([3e38, -3e38, 0.0], [f32::NAN, 0.0, 0.0]);
    let coord = [[0.0; 3], [0.0; 3], far, bad, [f32::INFINITY, 0.0, 0.0], [1.0; 3]];
    let mut color = [[0.5; 3]; 6];
    color[5] = [0.0, f32::NAN, 0.0];
    let found = surfaces(&coord, &color, &settings).unwrap();
    for scale in &found.scales {
        assert_eq!(scale.of, [0, 0, 1, NO_SURFACE, NO_SURFACE, NO_SURFACE]);
        assert_eq!(scale.count, 2);
    }
    let mut labels = [1, 0, 1, 1, -1, 0];
    agree_hard(&mut labels, 2, &found).unwrap();
    assert_eq!(labels, [0, 0, 1, 1, -1, 0], "what has no surface keeps its label");
    // A cell with nothing near stands for as much as can be seen of it.
    let areas = found.areas(&[0, 0, 1, 1, 1, 1], 2).unwrap();
    assert!(areas.iter().all(|a| *a > 0.0 && *a < 0.01), "{areas:?}");
    assert!(found.areas(&[0], 1).is_err());
    let refused =
        |settings: SurfaceSettings| surfaces(&coord, &color, &settings).unwrap_err().to_string();
    let default = SurfaceSettings::default;
    assert!(refused(SurfaceSettings { cell: 0.0, ..default() }).starts_with("cell: 0"));
    assert!(refused(SurfaceSettings { color: -1.0, ..default() }).starts_with("color: -1"));
    assert!(refused(one_scale(f64::NAN)).starts_with("scales: NaN"));
    assert!(refused(SurfaceSettings { scales: Vec::new(), ..default() }).contains("one at"));
    assert!(surfaces(&coord, &color[1..], &settings).is_err());
    let error = agree_hard(&mut [0, 0, 5, 0, 0, 0], 2, &found).unwrap_err();
    assert!(error.to_string().contains("labels[2] is 5"), "{error}");
}

#[test]
fn neither_threads_nor_a_shift_change_anything() {
    let mut rng = sample_rng(3, 0, 0);
    let mut draw = || -> [f32; 3] { std::array::from_fn(|_| unit(&mut rng) as f32) };
    let points: Vec<_> = (0..4000).map(|_| (draw(), draw())).collect();
    let alone = |threads: usize, shift: f32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // Halves of powers of two: sums are exact.
        let moved: Vec<_> = (points.iter())
            .map(|(p, c)| (p.map(|v| (v * 1024.0).round() / 1024.0 + shift), *c))
            .collect();
        pool.install(|| whole(&moved, &SurfaceSettings { cell: 0.125, ..Default::default() }))
    };
    let once = alone(1, 0.0);
    assert!(once == alone(3, 0.0));
    // Means of places round elsewhere, of which areas are: they may differ in the last bits.
    let shifted = alone(2, 4.0);
    assert!(once.scales == shifted.scales && once.touching == shifted.touching);
    let areas = once.area.iter().zip(&shifted.area);
    assert!(areas.clone().all(|(a, b)| (a / b - 1.0).abs() < 1e-4));
    let counts = [0, 4].map(|k: usize| once.scales[k].count);
    assert!(counts[0] > 10 && counts[0] > counts[1], "{counts:?}");
}

#[test]
fn surface_is_what_there_is_of_it_dense_or_sparse() {
    let mut points = square([0.0; 3], 0, 1, 0.5);
    points.extend(square([0.0, 0.0, 2.0], 0, 1, 0.5));
    points.extend(square([0.0, 0.0, 4.0], 0, 2, 0.5));
    let owner: Vec<i32> = (0..4800).map(|i| i / 3200 - i32::from(i >= 4790)).collect();
    for step in [1, 3, 7] {
        let rows = || (0..4800).step_by(step);
        let some: Vec<_> = rows().map(|row| points[row]).collect();
        let owner: Vec<i32> = rows().map(|row| owner[row]).collect();
        let areas = whole(&some, &SurfaceSettings::default()).areas(&owner, 2).unwrap();
        // A square meter each; borders stand for somewhat more.
        assert!((1.6..2.6).contains(&areas[0]), "every {step}th: {areas:?}");
        assert!((0.8..1.3).contains(&areas[1]), "every {step}th: {areas:?}");
    }
}

#[test]
fn defaults_are_the_documented_ones() {
    let want = SurfaceSettings {
        cell: 0.05,
        color: 1.5,
        scales: vec![1.0, 3.0, 6.0, 10.0, 20.0],
        min_cells: 5,
    };
    assert_eq!(SurfaceSettings::default(), want);
    let agree = AgreeSettings::default();
    assert_eq!((agree.own, agree.keep, agree.least_area), (0.3, 0.25, &[][..]));
}

#[test]
fn cells_differ_by_angle_and_color_of_their_neighbors() {
    let mut rng = sample_rng(6, 0, 0);
    let mut draw = || unit(&mut rng) as f32;
    // A bent sheet with noise, of several Gaussians a cell.
    let points: Vec<([f32; 3], [f32; 3])> = (0..700)
        .map(|_| ([draw(), 0.4 * draw(), 0.0], [draw(), draw(), 0.3 * draw()]))
        .map(|([x, y, _], color)| ([x, y, (3.0 * x).sin() * 0.3 + 0.02 * y], color))
        .collect();
    let (coord, color): (Vec<_>, Vec<_>) = points.iter().copied().unzip();
    let cells = Cells::new(&coord, &color, 0.06);
    let settings = SurfaceSettings { cell: 0.06, color: 0.7, ..SurfaceSettings::default() };
    let (edges, area) = cells.edges(&settings).unwrap();
    let n = cells.center.len();
    // A cell is the rows of one place of the grid from the least corner on.
    let least = [0, 1, 2].map(|k| coord.iter().map(|c| c[k]).fold(f32::INFINITY, f32::min));
    let place =
        |c: &[f32; 3]| [0, 1, 2].map(|k| (f64::from(c[k] - least[k]) / 0.06).floor() as i32);
    for (row, c) in coord.iter().enumerate() {
        let own = cells.of[row];
        let same: Vec<usize> = (0..coord.len()).filter(|r| place(&coord[*r]) == place(c)).collect();
        assert!(same.iter().all(|r| cells.of[*r] == own), "{row}");
        let mean = |of: &[[f32; 3]], k: usize| {
            same.iter().map(|r| f64::from(of[*r][k])).sum::<f64>() / same.len() as f64
        };
        for k in 0..3 {
            assert!((f64::from(cells.center[own as usize][k]) - mean(&coord, k)).abs() < 1e-6);
            assert!((cells.color[own as usize][k] - mean(&color, k)).abs() < 1e-9);
        }
    }
    let square = |a: usize, b: usize| {
        Vec3::from(cells.center[a])
            .as_dvec3()
            .distance_squared(Vec3::from(cells.center[b]).as_dvec3())
    };
    let about: Vec<(Vec<usize>, DVec3)> = (0..n)
        .map(|a| {
            let mut by_distance: Vec<usize> = (0..n).collect();
            by_distance.sort_by(|b, c| square(a, *b).total_cmp(&square(a, *c)));
            let plane =
                by_distance[..13].iter().filter(|b| square(a, **b) < (2.6f64 * 0.06).powi(2));
            let normal = normal(plane.map(|b| cells.center[*b]).collect::<Vec<_>>().into_iter());
            // Eight others, as far as they touch.
            let eighth = square(a, by_distance[8]).min((2.5f64 * 0.06).powi(2));
            let want = std::f64::consts::PI * eighth / 8.0;
            assert!((f64::from(area[a]) / want - 1.0).abs() < 1e-5, "{a}: {} {want}", area[a]);
            let beside =
                by_distance[1..9].iter().filter(|b| square(a, **b) < (2.5f64 * 0.06).powi(2));
            (beside.copied().collect(), normal)
        })
        .collect();
    let mut want = std::collections::BTreeMap::new();
    for (a, (beside, _)) in about.iter().enumerate() {
        for &b in beside {
            let color: f64 = (0..3).map(|k| (cells.color[a][k] - cells.color[b][k]).abs()).sum();
            let angle = 1.0 - about[a].1.dot(about[b].1).abs();
            want.insert([a.min(b) as u32, a.max(b) as u32], angle + 0.7 * color);
        }
    }
    assert_eq!(edges.len(), want.len());
    assert!(edges.is_sorted_by(|a, b| a.0 <= b.0));
    for (difference, a, b) in edges {
        assert!((f64::from(difference) - want[&[a, b]]).abs() < 1e-5, "{a} {b}");
    }
    let all = surfaces(&coord, &color, &settings).unwrap();
    assert_eq!(all.touching, want.into_keys().collect::<Vec<_>>());
    assert_eq!((all.scales.len(), all.largest()), (5, &all.scales[4]));
    // Numbers are in the order of first Gaussians.
    for scale in &all.scales {
        let mut next = 0;
        for &of in &scale.of {
            assert!(of <= next);
            next = next.max(of + 1);
        }
        assert_eq!(next as usize, scale.count);
    }
}

#[test]
fn things_have_their_part_of_a_cell_and_a_plane_its_normal() {
    // Two far cells of four and one Gaussian: each stands for a circle of 12.5 cm with eight others.
    let coord = [[0.0; 3], [0.01; 3], [0.02; 3], [0.03; 3], [5.0; 3]];
    let found = surfaces(&coord, &[[0.5; 3]; 5], &SurfaceSettings::default()).unwrap();
    let whole = std::f64::consts::PI * 0.125 * 0.125 / 8.0;
    let areas = found.areas(&[1, 0, 1, 1, 1], 3).unwrap();
    for (got, want) in areas.iter().zip([0.25 * whole, 1.75 * whole, 0.0]) {
        assert!((got - want).abs() < 1e-6, "{areas:?}");
    }
    // Things that are none, or beyond the count, have no area.
    assert_eq!(found.areas(&[-1, 7, -1, 7, -1], 2).unwrap(), [0.0, 0.0]);
    // Points of the plane 2 x + y = 3 z, which spread differently along it.
    let on = |x: f32, y: f32| [x, y, (2.0 * x + y) / 3.0];
    let points = [on(0.0, 0.0), on(4.0, 0.5), on(1.0, 3.0), on(-2.0, 1.0), on(2.0, -1.0)];
    let n = normal(points.into_iter());
    let want = DVec3::new(2.0, 1.0, -3.0).normalize();
    assert!((n.dot(want).abs() - 1.0).abs() < 1e-6, "{n}");
    assert_eq!(normal(points[..2].iter().copied()), DVec3::ZERO);
}
