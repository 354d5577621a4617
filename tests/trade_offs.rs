//! What trades accuracy for time, as a user of the library meets it: each part of a setting reaches the
//! encoder, and a front is exactly what no other point beats.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat::datasets::Anchor;
use scenesplat::inference::Fidelity;
use scenesplat::network::NetworkChoice;
use scenesplat::pareto::front;
use scenesplat::{Network, SceneEncoder, Setting, WeightOptions, Weights};

#[test]
fn parts_of_a_setting_reach_the_encoder() {
    let config = "tiny".parse::<NetworkChoice>().unwrap().resolve().unwrap();
    let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default()).unwrap();
    let of = |text: &str| {
        let setting: Setting = text.parse().unwrap();
        let encoder = setting.apply_to_encoder(SceneEncoder::new(&network));
        (encoder.grid_size, encoder.fidelity, encoder.codes)
    };
    let plain = of("");
    assert_eq!(plain, (network.grid_size(), Fidelity::Fast, None));
    assert_eq!(of("voxel=0.37"), (0.37, plain.1, plain.2));
    assert_eq!(of("passes=1"), plain);
    assert_eq!(of("passes=3"), (plain.0, Fidelity::Passes(3), plain.2));
    assert_eq!(of("passes=all"), (plain.0, Fidelity::Exact, plain.2));
    assert_eq!(of("codes=5"), (plain.0, plain.1, Some(5)));
    let anchor = |text: &str| {
        let setting: Setting = text.parse().unwrap();
        setting.apply_to_encoder(SceneEncoder::new(&network)).anchor
    };
    assert_eq!([anchor(""), anchor("anchor=world")], [Anchor::Box, Anchor::World]);
    // What an encoder has and a setting does not name stays.
    let mut encoder = SceneEncoder::new(&network);
    (encoder.grid_size, encoder.fidelity, encoder.codes) = (0.5, Fidelity::Exact, Some(7));
    let after = Setting::default().apply_to_encoder(encoder);
    assert_eq!((after.grid_size, after.fidelity, after.codes), (0.5, Fidelity::Exact, Some(7)));
}

#[test]
fn a_front_is_what_no_other_point_beats() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..200 {
        // Few values, so that points share a cost, a worth, or both.
        let points: Vec<[f64; 2]> = (0..rng.random_range(1..12))
            .map(|_| [(); 2].map(|()| f64::from(rng.random_range(0..5))))
            .collect();
        let no_worse = |a: [f64; 2], b: [f64; 2]| a[0] <= b[0] && a[1] >= b[1];
        for (i, kept) in front(&points).into_iter().enumerate() {
            let beaten = points.iter().enumerate().any(|(j, other)| {
                // Of equal points the first stays.
                no_worse(*other, points[i]) && (*other != points[i] || j < i)
            });
            assert_eq!(kept, !beaten, "{points:?}: {i}");
        }
    }
}
