use super::*;
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::Similarity;

fn room() -> GaussianScene {
    let settings = SyntheticRoomSettings { num_gaussians: Some(8_000), ..Default::default() };
    generate(&settings).unwrap().scene
}

/// The scene with another direction up.
fn lying(scene: &GaussianScene, up: Up) -> GaussianScene {
    let m = up.upright();
    let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
    let mut scene = scene.clone();
    scene.transform(&Similarity { rotation, scale: 1.0, translation: [0.0; 3] });
    scene
}

#[test]
fn an_upright_room_in_metres_is_read_as_it_is() {
    let room = room();
    let alignment = Alignment::of(&room, &AlignmentSettings::default());
    assert!(alignment.is_identity() && alignment.remarks.is_empty(), "{alignment:?}");
    assert!(matches!(alignment.apply(&room), Cow::Borrowed(_)));
}

#[test]
fn a_turned_room_comes_back_with_its_orientations() {
    let room = room();
    for up in Up::AXES.into_iter().filter(|up| *up != Up::PLUS_Z) {
        let alignment = Alignment::of(&lying(&room, up), &AlignmentSettings::default());
        assert_eq!(alignment.turned_from, up);
        assert_eq!(alignment.remarks, [Remark::Turned { from: up }]);
        let lying = lying(&room, up);
        let back = alignment.apply(&lying);
        assert_eq!(back.coord, room.coord, "{up}");
        // The same ellipsoid: |w| of the difference of two rotations is 1. Half a turn may
        // change the order of a product, which an ellipsoid does not show.
        let near = |a: &[f32; 4], b: &[f32; 4]| {
            a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>().abs() > 1.0 - 1e-5
        };
        if up != Up::MINUS_Z {
            assert!(back.quat.iter().zip(&room.quat).all(|(a, b)| near(a, b)), "{up}");
        }
        assert_eq!(back.normal, room.normal, "{up}");
    }
}

#[test]
fn millimetres_become_metres_and_what_is_unclear_is_said() {
    let room = room();
    let scaled = |by: f64| {
        let mut scene = room.clone();
        let rotation = Up::PLUS_Z.upright();
        scene.transform(&Similarity { rotation, scale: by, translation: [0.0; 3] });
        scene
    };
    let mm = scaled(1000.0);
    let alignment = Alignment::of(&mm, &AlignmentSettings::default());
    assert_eq!(alignment.remarks, [Remark::Scaled { by: 0.001 }]);
    let back = alignment.apply(&mm);
    let close = |a: f32, b: f32| (a - b).abs() < 1e-4;
    assert!((0..3).all(|a| close(back.coord[7][a], room.coord[7][a])));
    assert!((0..3).all(|a| close(back.log_scale[7][a], room.log_scale[7][a])));
    for (by, unit) in [(100.0, LengthUnit::Centimetre), (0.01, LengthUnit::Kilometre)] {
        let alignment = Alignment::of(&scaled(by), &AlignmentSettings::default());
        assert!(alignment.is_identity());
        let [remark @ Remark::UnitUnclear { likely, .. }] = alignment.remarks[..] else {
            panic!("{alignment:?}")
        };
        assert_eq!((likely, remark.is_warning()), (unit, true));
    }
    let given = AlignmentSettings { metres_per_unit: Some(0.01), ..Default::default() };
    assert_eq!(Alignment::of(&scaled(100.0), &given).scale, 0.01);
}

#[test]
fn the_user_decides() {
    let room = room();
    let lying = lying(&room, Up::MINUS_Y);
    let as_is = AlignmentSettings {
        as_is: true,
        up: Some(Up::MINUS_Y),
        metres_per_unit: Some(2.0),
        ..Default::default()
    };
    let alignment = Alignment::of(&lying, &as_is);
    assert!(alignment.is_identity() && alignment.remarks.is_empty(), "{alignment:?}");
    assert_eq!(alignment.up.direction, Up::MINUS_Y);
    let given = AlignmentSettings { up: Some(Up::PLUS_X), ..Default::default() };
    assert_eq!(Alignment::of(&room, &given).turned_from, Up::PLUS_X);
}

#[test]
fn what_cannot_be_told_is_a_warning_unless_there_is_next_to_nothing() {
    let ball = |n: usize| {
        let mut scene = GaussianScene::default();
        for i in 0..n {
            // Points on a sphere: no side differs from another.
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
            let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
            scene.coord.push([r * phi.cos(), r * phi.sin(), z]);
        }
        scene.log_scale = vec![[-4.0; 3]; n];
        scene.quat = vec![[1.0, 0.0, 0.0, 0.0]; n];
        scene.opacity_logit = vec![2.0; n];
        scene.sh_dc = vec![[0.0; 3]; n];
        scene
    };
    let alignment = Alignment::of(&ball(3000), &AlignmentSettings::default());
    assert!(alignment.is_identity());
    assert!(matches!(alignment.remarks[..], [Remark::UpUnclear { .. }]), "{alignment:?}");
    assert!(Alignment::of(&ball(50), &AlignmentSettings::default()).remarks.is_empty());
    assert!(Alignment::of(&ball(0), &AlignmentSettings::default()).is_identity());
}

fn turned_by(scene: &GaussianScene, angles: [f64; 3], scale: f64) -> GaussianScene {
    let mut scene = scene.clone();
    let rotation = scenesplat_scene::edit::EulerAngles(angles).matrix();
    scene.transform(&Similarity { rotation, scale, translation: [3.0, -1.0, 4.0] });
    scene
}

#[test]
fn a_tilted_room_is_read_level() {
    let room = room();
    for angles in [[5.0, 0.0, 0.0], [-3.0, 8.0, 0.0], [0.0, -12.0, 30.0]] {
        let tilted = turned_by(&room, angles, 1.0);
        let alignment = Alignment::of(&tilted, &AlignmentSettings::default());
        assert!(matches!(alignment.remarks[..], [Remark::Leveled { .. }]), "{alignment:?}");
        let read = alignment.apply(&tilted);
        let again = Alignment::of(&read, &AlignmentSettings::default());
        assert!(again.is_identity(), "{angles:?}: {again:?}");
        // The floor is where it is planted: 4 m up along the vertical.
        let due = read.coord.iter().zip(&room.coord).filter(|(_, old)| old[2].abs() < 0.02);
        let heights: Vec<f32> = due.map(|(p, _)| alignment.floors.height(p[2])).collect();
        let most = heights.iter().map(|h| h.abs()).fold(0.0, f32::max);
        assert!(heights.len() > 100 && most < 0.06, "{angles:?}: {most}");
    }
}

#[test]
fn walls_come_along_the_axes_where_a_network_wants_it() {
    let room = room();
    let turned = turned_by(&room, [0.0, 0.0, 37.0], 1.0);
    let alignment = Alignment::of(&turned, &AlignmentSettings::default());
    assert!(alignment.is_identity(), "{alignment:?}");
    let square = AlignmentSettings { square: true, ..Default::default() };
    let alignment = Alignment::of(&turned, &square);
    let [Remark::Squared { yaw }] = alignment.remarks[..] else { panic!("{alignment:?}") };
    assert!((yaw - 37.0).abs() < 0.5, "{yaw}");
    let again = Alignment::of(&alignment.apply(&turned), &square);
    assert!(again.is_identity(), "{again:?}");
}

#[test]
fn four_quarter_turns_of_a_room_are_read_as_one() {
    let room = room();
    let square = AlignmentSettings { square: true, ..Default::default() };
    let read = |scene: &GaussianScene| {
        let alignment = Alignment::of(scene, &square);
        assert!(alignment.remarks.is_empty(), "{alignment:?}");
        alignment.apply(scene).into_owned()
    };
    let due = read(&room);
    let apart =
        |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
    for yaw in [90.0, 180.0, 270.0] {
        let mut turned = room.clone();
        let rotation = scenesplat_scene::edit::EulerAngles([0.0, 0.0, yaw]).matrix();
        turned.transform(&Similarity { rotation, ..Similarity::IDENTITY });
        let found = read(&turned);
        let most = found.coord.iter().zip(&due.coord).map(|(a, b)| apart(a, b)).fold(0.0, f32::max);
        assert!(most < 0.01, "{yaw}: {most}");
    }
}

#[test]
fn a_closed_room_that_is_too_high_or_too_low_is_in_another_unit() {
    let settings = SyntheticRoomSettings { num_gaussians: Some(40_000), ..Default::default() };
    let room = generate(&settings).unwrap().scene;
    for by in [2.0, 0.5, 10.0] {
        let scene = turned_by(&room, [0.0; 3], by);
        let alignment = Alignment::of(&scene, &AlignmentSettings::default());
        let [Remark::ScaledToRoom { by: found, .. }] = alignment.remarks[..] else {
            panic!("{by}: {alignment:?}")
        };
        assert!((found * by - 1.0).abs() < 0.25, "{by}: {alignment:?}");
        let given = AlignmentSettings { metres_per_unit: Some(1.0), ..Default::default() };
        assert!(Alignment::of(&scene, &given).is_identity());
    }
}

#[test]
fn a_low_room_is_in_another_unit_if_its_walls_end_at_one_height() {
    let settings = SyntheticRoomSettings { num_gaussians: Some(40_000), ..Default::default() };
    let room = generate(&settings).unwrap().scene;
    let height = robust_bounds(&room.coord).extent()[2];
    let whole = turned_by(&room, [0.0; 3], 1.95 / height);
    let is_scaled = |scene: &GaussianScene| {
        let alignment = Alignment::of(scene, &AlignmentSettings::default());
        alignment.remarks.iter().any(|r| matches!(r, Remark::ScaledToRoom { .. }))
    };
    assert!(is_scaled(&whole));
    // On one side of the room the capture stops short of the ceiling: the walls may have been higher.
    let bounds = robust_bounds(&whole.coord);
    let middle = (bounds.low[0] + bounds.high[0]) / 2.0;
    let limit = bounds.low[2] + 1.4;
    let is_seen = |p: &[f32; 3]| f64::from(p[0]) < middle || f64::from(p[2]) < limit;
    let rows: Vec<usize> = (0..whole.len()).filter(|&r| is_seen(&whole.coord[r])).collect();
    let torn = whole.select_rows(&rows).unwrap();
    assert_eq!(Walls::of(&torn).closed, 4);
    assert!(!is_scaled(&torn));
}

#[test]
fn the_floor_is_found_or_given() {
    let room = room();
    let found = Alignment::of(&room, &AlignmentSettings::default()).floors;
    assert!(found.has_plane() && found.heights[0].abs() < 0.02, "{found:?}");
    let mm = AlignmentSettings {
        floor: Some(500.0),
        metres_per_unit: Some(0.001),
        ..Default::default()
    };
    assert_eq!(Alignment::of(&room, &mm).floors, Floors::given(0.5));
}
