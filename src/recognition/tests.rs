#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
use super::*;
use scenesplat_kernels::random::{sample_rng, unit};

/// Rows near a direction of rooms or of toys in two surfaces, the second of which is of the other kind if `mixed`.
fn example(seed: u64, is_room: bool, mixed: bool) -> Example {
    let mut rng = sample_rng(seed, 0, 0);
    let mut noise = || (0.6 * (unit(&mut rng) - 0.5)) as f32;
    let surface: Vec<u32> = (0..80).map(|i| u32::from(i >= 60)).collect();
    let (mut rows, mut truth) = (Vec::new(), Vec::new());
    for own in &surface {
        let room = is_room != (mixed && *own == 1);
        truth.push(room);
        let toward = if room { [1.0, 0.3, 0.0] } else { [0.4, 1.0, 0.0] };
        rows.extend(toward.map(|v| v + noise()));
    }
    normalize_rows(&mut rows, 3);
    Example { rows, surface, squareness: if is_room { 0.9 } else { 0.3 }, is_room: truth }
}

fn fitted() -> Recognition {
    let examples = |from: u64| -> Vec<Example> {
        (from..from + 8).map(|seed| example(seed, seed % 2 == 0, seed % 4 == 0)).collect()
    };
    Recognition::fit(&examples(10), &examples(50), "hash".to_owned())
}

fn recognized(found: &Recognition, scene: &Example) -> Recognized {
    let features = SceneFeatures::from_rows(scene.rows.clone(), 3).unwrap();
    let surfaces = Surfaces { of: scene.surface.clone(), count: 2 };
    found.of(&features, Some(&surfaces), scene.squareness).unwrap().unwrap()
}

#[test]
fn rooms_are_known_and_toys_are_not_nor_a_toy_in_a_room() {
    let found = fitted();
    let room = recognized(&found, &example(91, true, false));
    assert!(room.share(0.5) > 0.99, "{room:?}");
    let toy = recognized(&found, &example(92, false, false));
    assert!(toy.share(0.5) < 0.01, "{toy:?}");
    // The surface that is none is less probable than the rest of its room, all of its rows alike.
    let mixed = recognized(&found, &example(93, true, true));
    let (wall, thing) = (mixed.probability[0], mixed.probability[79]);
    assert!(wall > 0.5 && thing < 0.5, "{wall} {thing}");
    assert!(mixed.probability[60..].iter().all(|p| *p == thing));
    // Without surfaces the scene is one.
    let scene = example(93, true, true);
    let features = SceneFeatures::from_rows(scene.rows, 3).unwrap();
    let one = found.of(&features, None, scene.squareness).unwrap().unwrap();
    assert_eq!((one.probability.len(), one.score.to_bits()), (80, mixed.score.to_bits()));
    assert!(one.probability.iter().all(|p| *p == one.probability[0]));
    // What is less probable is strange; nearly all of a scene is all of it.
    let of = |probability: Vec<f32>| Recognized { probability, ..mixed.clone() };
    assert_eq!(of(vec![0.2, 0.3, 0.3, 0.3]).strange(0.25), [true, false, false, false]);
    assert_eq!(of(vec![0.2, 0.2, 0.2, 0.2, 0.2, 0.9]).strange(0.25), [true; 6]);
    // The same features in a scene that is not built like a room are less probable.
    let leaning = Example { squareness: 0.1, ..example(91, true, false) };
    assert!(recognized(&found, &leaning).probability[0] < room.probability[0]);
}

#[test]
fn rows_without_direction_have_no_say() {
    let found = fitted();
    let mut scene = example(94, true, false);
    let due = recognized(&found, &scene);
    scene.rows.extend([0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0]);
    scene.surface.extend([0, NO_SURFACE]);
    let got = recognized(&found, &scene);
    assert_eq!(got.probability[..80], due.probability[..]);
    assert!(got.probability[81].is_finite());
    let none = SceneFeatures::from_rows(vec![0.0; 6], 3).unwrap();
    let surfaces = Surfaces { of: vec![0, 0], count: 1 };
    assert_eq!(found.of(&none, Some(&surfaces), 0.5).unwrap(), None);
    let wider = SceneFeatures::from_rows(vec![1.0; 8], 4).unwrap();
    assert_eq!(found.of(&wider, Some(&surfaces), 0.5).unwrap(), None);
}

#[test]
fn logistic_regression_finds_the_odds_that_made_the_examples() {
    // Of one input in {0, 1}: 3 of 4 are so at 1, 1 of 4 at 0; log odds ±ln 3.
    let cell = |x: f64, is_so: bool, weight: f64| (vec![x], is_so, weight);
    let all = [
        cell(0.0, true, 0.125),
        cell(0.0, false, 0.375),
        cell(1.0, true, 0.375),
        cell(1.0, false, 0.125),
    ];
    let found = Logistic::fit(&all);
    let at = |x: f64| found.log_odds([x].into_iter());
    assert!((at(1.0) - 3.0_f64.ln()).abs() < 0.02, "{}", at(1.0));
    assert!((at(0.0) + 3.0_f64.ln()).abs() < 0.02, "{}", at(0.0));
    // What never varies, and what separates perfectly, stay finite.
    let still = Logistic::fit(&[cell(2.0, true, 0.5), cell(2.0, false, 0.5)]);
    assert!(still.log_odds([2.0].into_iter()).abs() < 1e-6);
    let apart = Logistic::fit(&[cell(0.0, false, 0.5), cell(1.0, true, 0.5)]);
    assert!(apart.log_odds([1.0].into_iter()).is_finite());
}

#[test]
fn the_file_of_the_program_is_of_its_network() {
    let found = Recognition::embedded().unwrap();
    let calibration = crate::calibration::Calibration::embedded().unwrap();
    assert_eq!(
        (found.weights, found.row.width(), found.surface.width()),
        (calibration.weights, 96, 3)
    );
}
