//! Objects of synthetic rooms against their true instances.

#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

use scenesplat_objects::{
    Agreement, Catalogue, ObjectInput, ObjectSettings, UprightBox, find_objects,
};
use scenesplat_rooms::{CLASSES, SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat_scene::frame::Matrix3;
use scenesplat_scene::{Similarity, Up};

const ROOMS: u64 = 20;
const SEED: u64 = 2026;

fn names() -> Vec<String> {
    CLASSES.iter().map(|c| c.name.to_owned()).collect()
}

fn input<'a>(room: &'a SyntheticRoom, names: &'a [String]) -> ObjectInput<'a> {
    ObjectInput {
        scene: &room.scene,
        labels: room.scene.segment.as_deref().unwrap(),
        scores: None,
        instances: None,
        features: None,
        names,
        upright: Up::PLUS_Z.upright(),
        metres_per_unit: 1.0,
        floor: None,
    }
}

fn room_of(gaussians: usize, seed: u64) -> SyntheticRoom {
    generate(&SyntheticRoomSettings::with_count(gaussians, seed)).unwrap()
}

fn find(input: &ObjectInput<'_>) -> Catalogue {
    find_objects(input, &ObjectSettings::default()).unwrap()
}

fn refused(input: &ObjectInput<'_>) -> String {
    find_objects(input, &ObjectSettings::default()).unwrap_err().to_string()
}

fn agreement(room: &SyntheticRoom, found: &Catalogue) -> Agreement {
    let scene = &room.scene;
    let (ids, labels) = (scene.instance.as_deref().unwrap(), scene.segment.as_deref().unwrap());
    Agreement::of(found, ids, labels, ObjectSettings::default().min_count)
}

#[test]
fn objects_of_twenty_rooms_with_true_labels() {
    let names = names();
    let (mut matches, mut found, mut truth) = (0, 0, 0);
    let (mut centers, mut sizes) = (Vec::new(), Vec::new());
    for room in 0..ROOMS {
        let settings = SyntheticRoomSettings { seed: SEED, room, ..Default::default() };
        let room = generate(&settings).unwrap();
        let catalogue = find(&input(&room, &names));
        let agreed = agreement(&room, &catalogue);
        matches += agreed.matches.len();
        found += agreed.found;
        truth += agreed.truth;
        for m in &agreed.matches {
            // The box of the true rows is what could be found at best.
            let ids = room.scene.instance.as_deref().unwrap();
            let rows: Vec<u32> =
                (0u32..).zip(ids).filter(|(_, id)| **id == m.truth).map(|(r, _)| r).collect();
            let want = UprightBox::around(&room.scene.coord, &rows).unwrap();
            let got = catalogue.objects[m.found].bounds;
            let d: f64 = (0..3).map(|a| (want.center[a] - got.center[a]).powi(2)).sum();
            centers.push(d.sqrt());
            sizes.push((0..3).map(|a| (want.size[a] - got.size[a]).abs()).fold(0.0, f64::max));
        }
        println!("{:?}: missed {:?}, wrong {:?}", room.kind, agreed.missed, agreed.wrong);
    }
    for errors in [&mut centers, &mut sizes] {
        errors.sort_by(f64::total_cmp);
    }
    let at = |v: &[f64], q: f64| v[((v.len() - 1) as f64 * q) as usize];
    let (precision, recall) = (matches as f64 / found as f64, matches as f64 / truth as f64);
    assert!(precision >= 0.9 && recall >= 0.9, "precision {precision:.4}, recall {recall:.4}");
    assert!(at(&centers, 0.9) < 0.05 && at(&sizes, 0.9) < 0.1);
}

#[test]
fn neither_the_order_of_rows_nor_threads_change_what_is_found() {
    let names = names();
    let room = room_of(30_000, 5);
    let found = find(&input(&room, &names));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(found, pool.install(|| find(&input(&room, &names))));
    let n = room.scene.len();
    let back: Vec<usize> = (0..n).rev().collect();
    let turned = SyntheticRoom { scene: room.scene.select_rows(&back).unwrap(), ..room };
    let other = find(&input(&turned, &names));
    let classes =
        |c: &Catalogue| c.objects.iter().map(|o| (o.class.clone(), o.count)).collect::<Vec<_>>();
    assert_eq!(classes(&found), classes(&other));
}

#[test]
fn known_instances_are_the_objects() {
    let names = names();
    let room = room_of(30_000, 6);
    let ids = room.scene.instance.as_deref();
    let input = ObjectInput { instances: ids, ..input(&room, &names) };
    let found = find(&input);
    let agreed = agreement(&room, &found);
    assert_eq!((agreed.precision(), agreed.recall()), (1.0, 1.0));
    assert!(agreed.matches.iter().all(|m| m.iou == 1.0));
    // The object of each Gaussian is a place in the list.
    let places = found.instances();
    for (row, place) in places.iter().enumerate() {
        let own = usize::try_from(*place).ok().map(|at| &found.objects[at]);
        assert_eq!(own.is_some_and(|o| o.rows.binary_search(&(row as u32)).is_ok()), own.is_some());
    }
    let all: usize = found.objects.iter().map(|o| o.count).sum();
    assert_eq!(places.iter().filter(|p| **p >= 0).count(), all);
}

#[test]
fn places_are_in_the_frame_and_unit_of_the_scene() {
    let names = names();
    let room = room_of(30_000, 7);
    let plain = find(&input(&room, &names));
    // Lying on its side, in centimeters: up is -y.
    let mut lying = room;
    lying.scene.coord.iter_mut().for_each(|c| *c = [c[0], -c[2], c[1]].map(|v| v * 100.0));
    let ln = 100f32.ln();
    lying.scene.log_scale.iter_mut().for_each(|s| *s = s.map(|v| v + ln));
    let input = ObjectInput {
        upright: Up::MINUS_Y.upright(),
        metres_per_unit: 0.01,
        ..input(&lying, &names)
    };
    let found = find(&input);
    let of = |c: &Catalogue| c.objects.iter().find(|o| o.class == "floor").unwrap().clone();
    let (a, b) = (of(&plain), of(&found));
    assert!((a.volume - b.volume).abs() < 0.02 * a.bounds.size[0] * a.bounds.size[1]);
    let want = [a.position[0], -a.position[2], a.position[1]].map(|v| v * 100.0);
    for (got, want) in b.position.into_iter().zip(want) {
        assert!((got - want).abs() < 5.0, "{:?} {want:?}", b.position);
    }
    assert!(found.floor.height.abs() < 0.02 && found.floor.is_labelled);
}

/// A rotation about x, then about z, degrees.
fn turn(x: f64, z: f64) -> Matrix3 {
    let ((sx, cx), (sz, cz)) = (x.to_radians().sin_cos(), z.to_radians().sin_cos());
    [[cz, -sz * cx, sz * sx], [sz, cz * cx, -cz * sx], [0.0, sx, cx]]
}

#[test]
fn boxes_of_a_room_out_of_level_are_upright_in_it() {
    let names = names();
    let room = room_of(30_000, 8);
    let plain = find(&input(&room, &names));
    let rotation = turn(11.0, 25.0);
    let mut tilted = room;
    tilted.scene.transform(&Similarity { rotation, ..Similarity::IDENTITY });
    let back = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[j][i]));
    let input = ObjectInput { upright: back, ..input(&tilted, &names) };
    let found = find(&input);
    assert_eq!(found.objects.len(), plain.objects.len());
    assert!((found.floor.height - plain.floor.height).abs() < 0.01, "{:?}", found.floor);
    for (a, b) in plain.objects.iter().zip(&found.objects) {
        assert_eq!((a.label, a.count), (b.label, b.count));
        assert!((a.volume - b.volume).abs() < 0.02 * a.volume + 1e-3, "{} {}", a.volume, b.volume);
        assert!((a.above_floor - b.above_floor).abs() < 0.01);
        // The box lies in the scene, not in the upright frame.
        let want = rotation.map(|r| r.iter().zip(a.position).map(|(r, p)| r * p).sum::<f64>());
        let off = want.iter().zip(b.position).map(|(w, p)| (w - p).powi(2)).sum::<f64>().sqrt();
        assert!(off < 0.02, "{}: {want:?} {:?}", a.class, b.position);
    }
    for bad in
        [[[0.0; 3]; 3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], [[f64::NAN; 3]; 3]]
    {
        let input = ObjectInput { upright: bad, ..input };
        let error = refused(&input);
        assert!(error.contains("upright") && error.contains("a rotation"), "{error}");
    }
}

#[test]
fn a_floor_that_is_known_is_where_heights_begin() {
    let names = names();
    let room = room_of(20_000, 8);
    let plain = find(&input(&room, &names));
    let given = ObjectInput { floor: Some(-0.5), ..input(&room, &names) };
    let found = find(&given);
    assert!(found.floor.is_given && !found.floor.is_labelled && plain.floor.is_labelled);
    for (a, b) in plain.objects.iter().zip(&found.objects) {
        assert!((b.above_floor - a.above_floor - plain.floor.height - 0.5).abs() < 1e-9);
    }
    let nowhere = ObjectInput { floor: Some(f64::INFINITY), ..given };
    assert!(refused(&nowhere).contains("floor"));
}

#[test]
fn instances_that_are_no_objects_are_counted() {
    let names = names();
    let room = room_of(30_000, 6);
    let ids = room.scene.instance.clone().unwrap();
    let mut labels = room.scene.segment.clone().unwrap();
    // One instance loses its class.
    let class = |at: usize| CLASSES[room.objects[at].class.unwrap().index()].name;
    let lost = (0..room.objects.len()).find(|&at| class(at) == "floor").unwrap();
    labels.iter_mut().zip(&ids).filter(|(_, id)| **id == lost as i32).for_each(|(l, _)| *l = -1);
    let sizes = |id: usize| ids.iter().filter(|i| **i == id as i32).count();
    let least = 400;
    let small =
        (0..room.objects.len()).filter(|&i| i != lost && (1..least).contains(&sizes(i))).count();
    assert!(small > 0);
    let input = ObjectInput { labels: &labels, instances: Some(&ids), ..input(&room, &names) };
    let settings = ObjectSettings { min_count: least, ..Default::default() };
    let found = find_objects(&input, &settings).unwrap();
    assert_eq!((found.small_instances, found.nameless_instances), (small, 1));
    let all = (0..room.objects.len()).filter(|&i| sizes(i) > 0).count();
    assert_eq!(found.objects.len(), all - small - 1);
}

#[test]
fn what_does_not_fit_is_refused_and_nothing_is_no_error() {
    let names = names();
    let room = room_of(500, 1);
    let short = ObjectInput { labels: &[0; 3], ..input(&room, &names) };
    let error = refused(&short);
    assert_eq!(error, "labels: expected 500 rows, one a Gaussian, got 3");
    let few = ObjectInput { names: &names[..1], ..input(&room, &names) };
    let error = refused(&few);
    assert!(error.contains("there are 1 names"), "{error}");
    let gap = ObjectSettings { gap: Some(f64::NAN), ..Default::default() };
    assert!(find_objects(&input(&room, &names), &gap).is_err());
    let none = vec![-1; 500];
    let unlabelled = ObjectInput { labels: &none, ..input(&room, &names) };
    assert!(find(&unlabelled).objects.is_empty());
    // Rows without a place are in no object.
    let mut broken = room.clone();
    broken.scene.coord.iter_mut().for_each(|c| c[1] = f32::NAN);
    assert!(find(&input(&broken, &names)).objects.is_empty());
}
