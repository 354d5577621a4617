#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
use super::*;
use crate::Similarity;
use crate::frame::transposed;
use crate::vector::{dot, rotation};

/// Flat Gaussians with a normal along z.
fn flat(coord: Vec<[f32; 3]>) -> GaussianScene {
    GaussianScene {
        log_scale: vec![[-3.0, -3.0, f32::NEG_INFINITY]; coord.len()],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; coord.len()],
        opacity_logit: vec![f32::INFINITY; coord.len()],
        sh_dc: vec![[0.0; 3]; coord.len()],
        coord,
        ..GaussianScene::default()
    }
}

/// A floor of 2 × 1.6 m with a column of 1 m on it.
fn column() -> GaussianScene {
    let cell = |i: u16, n: u16| [f32::from(i % n) * 0.05, f32::from(i / n) * 0.05];
    let floor = (0..40 * 32).map(|i| [cell(i, 40)[0], cell(i, 40)[1], 0.0]);
    let column = (0..20 * 16).map(|i| [1.0, 0.5 + 0.02 * f32::from(i % 16), cell(i, 16)[1]]);
    flat(floor.chain(column).collect())
}

/// A room of 5 × 4 × 2.6 m with a table, of points without shape, each up to 1 cm off its surface.
fn points() -> GaussianScene {
    let mut bits = 7u32;
    let mut next = || {
        bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (bits >> 8) as f32 / 16_777_216.0
    };
    let mut coord = Vec::new();
    for _ in 0..12_000 {
        let (x, y, z, off) = (5.0 * next(), 4.0 * next(), 2.6 * next(), 0.01 * next());
        coord.extend([[x, y, off], [x, off, z], [off, y, z], [5.0 - off, y, z]]);
        coord.push([1.0 + 0.3 * x, 1.0 + 0.2 * y, 0.75 + off]);
    }
    let round = vec![[-4.0; 3]; coord.len()];
    GaussianScene { log_scale: round, ..flat(coord) }
}

fn turned(scene: &GaussianScene, rotation: Matrix3) -> GaussianScene {
    let mut scene = scene.clone();
    scene.transform(&Similarity { rotation, scale: 3.0, translation: [3.0, -2.0, 7.0] });
    scene
}

/// Turns by quaternions that no axis follows.
fn turns() -> impl Iterator<Item = Matrix3> {
    let quats =
        [[0.9, 0.2, -0.3, 0.1], [0.2, -0.7, 0.4, 0.5], [0.1, 0.6, 0.7, -0.4], [0.5, 0.5, 0.1, 0.9]];
    quats.into_iter().map(|q: [f64; 4]| {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        rotation(q.map(|v| v / norm))
    })
}

#[test]
fn a_floor_is_found_along_each_axis_without_rounding() {
    for up in Up::AXES {
        let scene = turned(&column(), transposed(&up.upright()));
        let guess = guess_up(&scene, StatedUp::UPRIGHT);
        assert_eq!(guess.direction, up, "{guess:?}");
        assert!(guess.is_sure() && !guess.given, "{guess:?}");
    }
}

#[test]
fn a_floor_is_found_in_any_pose_of_flat_gaussians_and_of_bare_points() {
    for (scene, most) in [(column(), 0.01), (points(), 0.3)] {
        let still = guess_up(&scene, StatedUp::UPRIGHT);
        assert!(still.direction.degrees_from(Up::PLUS_Z) < most, "{still:?}");
        for turn in turns() {
            let due = Up::new(turn.map(|row| dot(row, [0.0, 0.0, 1.0]))).unwrap();
            let guess = guess_up(&turned(&scene, turn), StatedUp::UPRIGHT);
            let off = guess.candidates[0].direction.degrees_from(due);
            assert!(off < most, "{off} degrees: {guess:?}");
            // Upright again it is level.
            let upright = guess.candidates[0].direction.upright();
            let up = upright.map(|row| dot(row, due.vector()));
            assert!(up[2] > most.to_radians().cos(), "{up:?}");
        }
    }
}

/// A scene with part of its rows once more below z = 0, where they are seen less.
fn mirrored(scene: &GaussianScene, every: usize) -> GaussianScene {
    let mut scene = scene.clone();
    for i in (0..scene.len()).step_by(every) {
        let [x, y, z] = scene.coord[i];
        scene.coord.push([x, y, -z]);
        scene.log_scale.push(scene.log_scale[i]);
        scene.quat.push(scene.quat[i]);
        scene.opacity_logit.push(0.0);
        scene.sh_dc.push(scene.sh_dc[i]);
    }
    scene
}

#[test]
fn what_a_shiny_floor_shows_below_itself_is_no_part_of_the_room() {
    let confidence = guess_up(&points(), StatedUp::UPRIGHT).confidence;
    for (every, turn) in [2, 4, 10].into_iter().zip(turns()) {
        let due = Up::new(turn.map(|row| dot(row, [0.0, 0.0, 1.0]))).unwrap();
        let guess = guess_up(&turned(&mirrored(&points(), every), turn), StatedUp::UPRIGHT);
        let off = guess.candidates[0].direction.degrees_from(due);
        assert!(off < 1.0, "1 of {every}, {off} degrees: {guess:?}");
        let change = (guess.confidence - confidence).abs();
        assert!(change < 0.1, "1 of {every}: {confidence} alone, {}", guess.confidence);
    }
}

#[test]
fn what_the_file_states_decides_where_the_scene_leaves_it_open() {
    // A ball: no side differs from another.
    let ball: Vec<[f32; 3]> = (0..3000)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 3000.0;
            let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
            [r * phi.cos(), r * phi.sin(), z]
        })
        .collect();
    let ball = GaussianScene { log_scale: vec![[-4.0; 3]; ball.len()], ..flat(ball) };
    for direction in Up::AXES {
        let stated = StatedUp { direction, source: "a test" };
        let guess = guess_up(&ball, stated);
        assert!(!guess.is_sure(), "{guess:?}");
        assert!(guess.direction.degrees_from(direction) <= PITCH, "{guess:?}");
        assert!(guess.evidence.contains("a test decides"), "{guess:?}");
    }
    // A cube whose floor has a few more Gaussians than its other sides: a weak reason for +z.
    let side = |i: u16| [f32::from(i % 30) / 30.0, f32::from(i / 30) / 30.0];
    let mut cube = Vec::new();
    for [u, v] in (0..900).map(side) {
        cube.extend([[u, v, 0.0], [u, v, 0.001], [u, v, 1.0], [u, 0.0, v], [u, 1.0, v]]);
        cube.extend([[0.0, u, v], [1.0, u, v]]);
    }
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let (z, y, x) = ([1.0, 0.0, 0.0, 0.0], [half, half, 0.0, 0.0], [half, 0.0, half, 0.0]);
    let quat = [z, z, z, y, y, x, x].into_iter().cycle().take(cube.len()).collect();
    let cube = GaussianScene { quat, ..flat(cube) };
    for (direction, due) in [(Up::MINUS_Y, Up::MINUS_Y), (Up::PLUS_Z, Up::PLUS_Z)] {
        let guess = guess_up(&cube, StatedUp { direction, source: "a test" });
        assert_eq!(guess.candidates[0].direction, Up::PLUS_Z, "{guess:?}");
        assert_eq!(guess.direction, due, "{guess:?}");
    }
    // And not where it says so.
    let stated = StatedUp { direction: Up::MINUS_Y, source: "a test" };
    assert_eq!(guess_up(&column(), stated).direction, Up::PLUS_Z);
}

#[test]
fn surfaces_of_different_heights_are_no_tilted_plane() {
    // Two floors side by side, 5 cm apart in height.
    let cell = |i: u16| [f32::from(i % 40) * 0.05, f32::from(i / 40) * 0.05];
    let step = |i: u16| if i % 40 < 20 { 0.0 } else { 0.05 };
    let floor = flat((0..40 * 32).map(|i| [cell(i)[0], cell(i)[1], step(i)]).collect());
    let found = plane::fullest_plane(&Surface::of(&floor), DVec3::Z);
    assert!(found.is_none_or(|plane| plane.normal.z > 0.5f64.to_radians().cos()), "{found:?}");
}

#[test]
fn points_planes_and_far_places_have_an_up_too() {
    for coord in [
        Vec::new(),
        vec![[1.0, 2.0, 3.0]],
        vec![[1.0, 2.0, 3.0]; 500],
        (0..400u16).map(|i| [f32::from(i % 20), f32::from(i / 20), 0.0]).collect(),
        (0..400u16).map(|i| [f32::from(i), 0.0, 0.0]).collect(),
        (0..400u16).map(|i| [1e9 + 64.0 * f32::from(i % 20), -1e9, f32::from(i / 20)]).collect(),
        vec![[1e30, -1e30, 0.0], [f32::MAX, f32::MIN, 1.0]],
        vec![[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0], [0.0; 3]],
    ] {
        let flat = flat(coord);
        let round = GaussianScene { log_scale: vec![[-3.0; 3]; flat.len()], ..flat.clone() };
        for scene in [flat, round] {
            let guess = guess_up(&scene, StatedUp::UPRIGHT);
            assert!(guess.candidates.iter().all(|c| c.score.is_finite()), "{guess:?}");
            assert!((0.0..=1.0).contains(&guess.confidence));
            assert!(guess.direction.vector().iter().all(|v| v.is_finite()));
        }
    }
}

#[test]
fn rooms_are_square_in_any_pose_and_balls_and_noise_are_not() {
    // Even over the sphere: the golden angle.
    let on_ball = |i: u32| {
        let (turn, z) = (2.399_963 * i as f32, 1.0 - (2 * i + 1) as f32 / 20_000.0);
        let flat = (1.0 - z * z).sqrt();
        [flat * turn.cos(), flat * turn.sin(), z]
    };
    let ball = flat((0..20_000).map(on_ball).collect());
    let room = points();
    let of = |scene: &GaussianScene| squareness(scene, &Up::PLUS_Z.upright());
    assert!(of(&room) > 0.9, "{}", of(&room));
    assert!(of(&ball) < 0.12, "its Gaussians all face up: {}", of(&ball));
    // All of it faces up; on its side it is a wall; at 45 degrees it is neither.
    let floor = flat((0..10_000).map(|i| [(i % 100) as f32, (i / 100) as f32, 0.0]).collect());
    assert!(of(&floor) > 0.97 && squareness(&floor, &Up::PLUS_X.upright()) > 0.97);
    assert!(squareness(&floor, &Up::new([0.0, 1.0, 1.0]).unwrap().upright()) < 0.02);
    for rotation in turns() {
        let up = Up::new(rotation.map(|row| row[2])).unwrap();
        let found = squareness(&turned(&room, rotation), &up.upright());
        assert!((found - of(&room)).abs() < 0.05, "{found} {}", of(&room));
    }
    // A room of few points is one still.
    let few: Vec<usize> = (0..room.len()).step_by(24).collect();
    let few = of(&room.select_rows(&few).unwrap());
    assert!(few > 0.8, "{few}");
    // Without rows, and without any normal, a third.
    let none = of(&GaussianScene::default());
    assert!((none - 1.0 / 3.0).abs() < 1e-9, "{none}");
}
