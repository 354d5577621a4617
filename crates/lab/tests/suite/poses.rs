//! The quick form of `lab poses`: a made room keeps its labels in any pose.

use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::StatedUp;
use scenesplat_lab::poses::{Labeller, poses, random_pose};

#[test]
fn a_room_keeps_its_labels_in_any_pose() {
    let room = generate(&SyntheticRoomSettings { seed: 777, ..Default::default() }).unwrap().scene;
    let labeller = Labeller::embedded().unwrap();
    let of =
        |any_unit| poses(&labeller, &room, StatedUp::UPRIGHT, (47, 2), any_unit, |_| ()).unwrap();
    for result in of(false) {
        assert!(result.tilt < 0.1 && result.unit == 1.0 && !result.is_warned, "{result:?}");
        assert!(result.same > 0.95, "{result:?}");
    }
    // The unit is found by what is in the room, and said to be a guess.
    for result in of(true) {
        assert!(result.tilt < 0.1 && result.is_warned, "{result:?}");
        assert!((result.unit - 1.0).abs() < 0.05, "{result:?}");
        assert!(result.same > 0.8, "{result:?}");
    }
}

#[test]
fn poses_are_turns_of_any_direction() {
    let poses: Vec<_> = (0..200).map(|number| random_pose(1, number, true)).collect();
    for pose in &poses {
        for (i, a) in pose.rotation.iter().enumerate() {
            for (j, b) in pose.rotation.iter().enumerate() {
                let due = if i == j { 1.0 } else { 0.0 };
                let dot = a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                assert!((dot - due).abs() < 1e-12, "{pose:?}");
            }
        }
        assert!((0.05..=20.0).contains(&pose.scale));
    }
    // Up goes everywhere: its mean is near 0, and each third of heights has a third of them.
    let up = |a: usize| poses.iter().map(|p| p.rotation[a][2]).sum::<f64>() / 200.0;
    assert!((0..3).all(|a| up(a).abs() < 0.15), "{} {} {}", up(0), up(1), up(2));
    let low = poses.iter().filter(|p| p.rotation[2][2] < -1.0 / 3.0).count();
    assert!((45..90).contains(&low), "{low}");
}
