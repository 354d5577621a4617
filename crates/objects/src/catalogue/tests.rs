//! Objects of scenes made by hand.

use super::*;
use crate::made::input;
use scenesplat_scene::GaussianScene;

#[test]
fn only_labeled_gaussians_of_instances_are_taken_from_what_is_left_over() {
    let scene = GaussianScene {
        coord: (0..7_u8).map(|x| [f32::from(x), 0.0, 0.0]).collect(),
        ..GaussianScene::default()
    };
    // Five have a label, two of which are in the instance; two of the instance have none.
    let labels = [0, 0, -1, -1, 0, 0, 0];
    let instances = [3, 3, 3, 3, -1, -1, -1];
    let names = ["chair".to_owned()];
    let input = ObjectInput { instances: Some(&instances), ..input(&scene, &labels, &names) };
    let settings = ObjectSettings { min_count: 1, ..ObjectSettings::default() };
    let found = find_objects(&input, &settings).unwrap();
    assert_eq!(found.objects.iter().map(|o| o.count).collect::<Vec<_>>(), [4]);
    // 5 - 2.
    assert_eq!(found.left_over, 3);
}

fn scene(coord: &[[f32; 3]]) -> GaussianScene {
    GaussianScene { coord: coord.to_vec(), ..GaussianScene::default() }
}

/// The eight corners of a box.
fn corners(low: [f32; 3], size: [f32; 3]) -> Vec<[f32; 3]> {
    (0..8)
        .map(|i| [0, 1, 2].map(|k| low[k] + if (i >> k) & 1 == 1 { size[k] } else { 0.0 }))
        .collect()
}

#[test]
fn every_value_of_an_object_by_hand() {
    let names = ["chair", "brick wall", "floor"].map(str::to_owned);
    // Two chairs of eight Gaussians, the farther one first; a wall at x = 4; a floor at 0.5; a stray; no place.
    let mut coord = corners([2.0, 1.0, 1.5], [0.25, 0.125, 0.5]);
    coord.extend(corners([0.0, 1.0, 0.5], [0.25, 0.125, 0.5]));
    coord.extend([[4.0, 1.0, 1.5], [4.0, 1.125, 1.5], [4.0, 1.125, 1.75]]);
    coord.extend([[9.0, 9.0, 0.5], [9.1, 9.0, 0.5], [9.0, 9.1, 0.5]]);
    coord.extend([[-5.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]]);
    let labels: Vec<i32> = [0; 16].into_iter().chain([1, 1, 1, 2, 2, 2, 0, 0]).collect();
    let scores: Vec<f32> = (0..24).map(|i| 0.01 * i as f32).collect();
    // Half a meter to the unit, and up is y: rows of the rotation are its axes.
    let upright = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
    let laid: Vec<[f32; 3]> = coord.iter().map(|c| [2.0 * c[0], 2.0 * c[2], -2.0 * c[1]]).collect();
    let scene = scene(&laid);
    let given = ObjectInput {
        scores: Some(&scores),
        upright,
        metres_per_unit: 0.5,
        ..input(&scene, &labels, &names)
    };
    let settings =
        ObjectSettings { min_count: 3, gap: Some(0.6), reshape: false, ..Default::default() };
    let found = find_objects(&given, &settings).unwrap();
    assert_eq!(found.floor, Floor { height: 0.5, is_labelled: true, is_given: false });
    // The stray is left over; what has no place is not counted.
    assert_eq!(
        (found.left_over, found.gaussians, found.small_instances, found.nameless_instances),
        (1, 24, 0, 0)
    );
    let about: Vec<_> =
        found.objects.iter().map(|o| (o.id, o.class.as_str(), o.label, o.count)).collect();
    assert_eq!(
        about,
        [(1, "chair", 0, 8), (2, "chair", 0, 8), (3, "brick wall", 1, 3), (4, "floor", 2, 3)]
    );
    assert_eq!(found.counts(), [("chair", 2, 16), ("brick wall", 1, 3), ("floor", 1, 3)]);
    let (near, far) = (&found.objects[0], &found.objects[1]);
    assert_eq!(
        (&near.rows, &far.rows),
        (&(8..16).collect::<Vec<u32>>(), &(0..8).collect::<Vec<u32>>())
    );
    let is_near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(
        is_near(&far.bounds.center, &[2.125, 1.0625, 1.75])
            && is_near(&far.bounds.size, &[0.25, 0.125, 0.5])
    );
    assert!(is_near(&far.position, &[4.25, 3.5, -2.125]), "{:?}", far.position);
    assert!(
        is_near(&far.corners[0], &[4.0, 3.0, -2.0]) && is_near(&far.corners[6], &[4.5, 4.0, -2.25]),
        "{:?}",
        far.corners
    );
    assert!(is_near(&[far.volume, far.above_floor, near.above_floor], &[0.015_625, 1.0, 0.0]));
    // Rows 0 to 7 have scores of 0 to 0.07. The nearest part is 1.75 from the wall.
    assert!(is_near(&[far.score.unwrap(), far.wall_distance.unwrap()], &[0.035, 1.75]), "{far:?}");
    assert_eq!(
        (found.objects[2].wall_distance, found.objects[3].wall_distance.is_some()),
        (None, true)
    );
    let mut places = vec![1; 8];
    places.extend([vec![0; 8], vec![2; 3], vec![3; 3], vec![-1; 2]].concat());
    assert_eq!(found.instances(), places);
    // Other words for the wall and the floor: distances are from chairs, and the floor is the lowest.
    let other = ObjectSettings { wall: "chair".to_owned(), floor: "sea".to_owned(), ..settings };
    let found = find_objects(&given, &other).unwrap();
    assert_eq!((found.floor.is_labelled, found.objects[0].wall_distance), (false, None));
    assert!(found.objects[2].wall_distance.is_some());
    // Four of a class are no object where five are asked for.
    let more = ObjectSettings { min_count: 9, ..settings };
    let found = find_objects(&given, &more).unwrap();
    assert_eq!((found.objects.len(), found.left_over), (0, 23));
    let nan = [f32::NAN; 24];
    let unsure = find_objects(&ObjectInput { scores: Some(&nan), ..given }, &other).unwrap();
    assert_eq!(unsure.objects[0].score, None);
}

#[test]
fn an_instance_has_the_class_of_most_of_its_rows() {
    let coord = [[0.0; 3]; 12].map(|c| c);
    let mut coord = coord.to_vec();
    coord[11] = [f32::INFINITY, 0.0, 0.0];
    // 5: of equal ones the smaller label; 2: most, unlabeled ones have no say; 7: none; 1: of no place.
    let instances = [5, 5, 5, 5, 2, 2, 2, 2, 7, -1, -2, 1];
    let labels = [3, 1, 3, 1, 4, 0, 4, -1, -1, 2, 2, 2];
    let (named, nameless) = known(&instances, &labels, &coord);
    assert_eq!(named, [(4, vec![4, 5, 6, 7]), (1, vec![0, 1, 2, 3])]);
    assert_eq!(nameless, 1);
}

#[test]
fn a_gap_is_two_and_a_half_spacings_within_limits() {
    // On a grid the fourth nearest is as far as the first.
    let grid = |step: f32, shift: f32| -> Vec<[f32; 3]> {
        (0..49).map(|i| [step * (i % 7) as f32 + shift, step * (i / 7) as f32, 0.0]).collect()
    };
    let rows: Vec<u32> = (0..49).collect();
    let found = spacing(&grid(0.06, 0.0), &rows).unwrap();
    assert!((found - 0.06 / 1.09).abs() < 1e-6, "{found}");
    let names = ["thing".to_owned()];
    let count = |coord: &[[f32; 3]], gap: Option<f64>| {
        let labels = vec![0; coord.len()];
        let settings = ObjectSettings { min_count: 1, gap, reshape: false, ..Default::default() };
        let scene = scene(coord);
        find_objects(&input(&scene, &labels, &names), &settings).unwrap().objects.len()
    };
    // With two more that lie alone the row in the middle is at a border, where the fourth nearest is √2 · 0.06 m away:
    // 2.5 · 0.0849 / 1.09 = 0.1946 m.
    let two =
        |between: f32| [grid(0.06, 0.0), vec![[5.0, 0.0, 0.0], [5.0 + between, 0.0, 0.0]]].concat();
    assert_eq!(
        [count(&two(0.194), None), count(&two(0.196), None), count(&two(0.196), Some(0.2))],
        [2, 3, 2]
    );
    // 0.04 m at least: places with ten Gaussians each have no spacing. 0.25 m at most.
    let places = |at: f32| [vec![[0.0; 3]; 10], vec![[at, 0.0, 0.0]; 10]].concat();
    assert_eq!([count(&places(0.038), None), count(&places(0.042), None)], [1, 2]);
    let line = |step: f32| (0..9).map(|i| [step * i as f32, 0.0, 0.0]).collect::<Vec<[f32; 3]>>();
    assert_eq!([count(&line(0.24), None), count(&line(0.26), None)], [1, 9]);
}

#[test]
fn features_part_what_touches_and_halves_of_a_curtain_are_one() {
    let names = ["thing", "Curtain", "drape", "curtains", "picture"].map(str::to_owned);
    let coord: Vec<[f32; 3]> = (0..40).map(|i| [0.05 * i as f32, 0.0, 0.0]).collect();
    let part = scene(&coord);
    // The second half turns its feature by acos(0.6); lengths do not matter.
    let add = |row: usize, sum: &mut [f32]| {
        let feature = if row < 20 { [2.0, 0.0] } else { [0.3, 0.4] };
        sum.iter_mut().zip(feature).for_each(|(s, f)| *s += f);
    };
    let count = |min_similarity: f32, features: bool| {
        let labels = [0; 40];
        let given = ObjectInput {
            features: features.then_some((2, &add)),
            ..input(&part, &labels, &names)
        };
        let settings = ObjectSettings {
            min_count: 5,
            gap: Some(0.2),
            min_similarity,
            reshape: false,
            ..Default::default()
        };
        find_objects(&given, &settings).unwrap().objects.len()
    };
    assert_eq!([count(0.55, true), count(0.65, true), count(0.65, false)], [1, 2, 1]);
    // Two halves 1.2 m apart, 2 m high.
    let half =
        |x: f32| (0..200).map(move |i| [x + 0.05 * (i % 10) as f32, 0.0, 0.1 * (i / 10) as f32]);
    let both = scene(&half(0.0).chain(half(1.65)).collect::<Vec<_>>());
    for (label, want) in [(1, 1), (2, 1), (3, 1), (4, 2)] {
        let labels = [label; 400];
        let settings = ObjectSettings { gap: Some(0.12), ..Default::default() };
        let found = find_objects(&input(&both, &labels, &names), &settings).unwrap();
        assert_eq!(found.objects.len(), want, "{label}");
    }
}

#[test]
fn a_piece_stands_when_seven_of_ten_flat_gaussians_are_upright() {
    // Flat across z, turned about x: the height of the normal is its cosine.
    let turned = |cosine: f32| {
        let half = cosine.acos() / 2.0;
        [half.cos(), half.sin(), 0.0, 0.0]
    };
    let names = ["wall".to_owned()];
    let stands = |cosines: &[f32]| {
        let mut scene = scene(&vec![[0.0; 3]; cosines.len() + 1]);
        scene.quat = cosines.iter().map(|c| turned(*c)).chain([turned(1.0)]).collect();
        scene.log_scale = vec![[-1.0, -1.0, -5.0]; cosines.len()];
        // The last is round and has no say.
        scene.log_scale.push([-1.0; 3]);
        let labels = vec![0; cosines.len() + 1];
        super::stands(
            &input(&scene, &labels, &names),
            &(0..cosines.len() as u32 + 1).collect::<Vec<_>>(),
        )
    };
    let ten = |upright: usize, cosine: f32| -> Vec<f32> {
        (0..10).map(|i| if i < upright { cosine } else { 0.9 }).collect()
    };
    assert!(stands(&ten(7, 0.34)) && stands(&ten(7, -0.34)));
    assert!(!stands(&ten(6, 0.0)) && !stands(&ten(7, 0.36)) && !stands(&[]));
    // A ceiling faces down.
    assert!(!stands(&[-0.9; 10]));
}
