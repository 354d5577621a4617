//! Test-time augmentation against the mean over scenes that are turned and scaled by hand.

use scenesplat::alignment::AlignmentSettings;
use scenesplat::models::Head;
use scenesplat::network::NetworkConfig;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::{Network, SceneEncoder, SceneFeatures, WeightOptions, Weights};

fn encode(encoder: &SceneEncoder<'_>, scene: &GaussianScene) -> SceneFeatures {
    encoder.encode(scene, &mut |_| Ok(())).unwrap()
}

/// By quarter turns to the left, and a factor.
fn moved(scene: &GaussianScene, quarters: usize, scale: f64) -> GaussianScene {
    let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][quarters];
    let half = quarters as f64 * std::f64::consts::FRAC_PI_4;
    let mut moved = scene.clone();
    for [x, y, z] in &mut moved.coord {
        let [a, b, c] = [*x, *y, *z].map(f64::from);
        [*x, *y, *z] = [cos * a - sin * b, sin * a + cos * b, c].map(|v| (scale * v) as f32);
    }
    moved.log_scale.iter_mut().flatten().for_each(|s| *s += scale.ln() as f32);
    for q in &mut moved.quat {
        let [w, x, y, z] = q.map(f64::from);
        let (s, c) = half.sin_cos();
        let turned = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w];
        // Networks read the sign with w >= 0; where w is 0, the largest number is positive.
        let largest = turned.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
        let lead = if turned[0].abs() > 1e-6 { turned[0] } else { largest };
        *q = turned.map(|v| (v * lead.signum()) as f32);
    }
    moved
}

#[test]
fn the_result_is_the_mean_over_copies() {
    let scene = generate(&SyntheticRoomSettings::with_count(4000, 1)).unwrap().scene;
    let classes = {
        let mut config = NetworkConfig::tiny();
        config.model.head = Head::Classes(5);
        config
    };
    for (config, is_classifier) in [(NetworkConfig::tiny(), false), (classes, true)] {
        let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default()).unwrap();
        assert_eq!(network.is_classifier(), is_classifier);
        let alignment = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
        let plain = SceneEncoder { grid_size: 0.1, alignment, ..SceneEncoder::new(&network) };
        let by_hand = [(0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0), (0, 0.95), (1, 0.95)];
        let got = encode(&SceneEncoder { tta: by_hand.len(), ..plain.clone() }, &scene);
        let one = encode(&plain, &scene);
        assert_eq!((got.inverse(), got.sampled()), (one.inverse(), one.sampled()));
        assert_eq!(got.summary.passes, by_hand.len());

        let width = one.width();
        let mut due = vec![0.0f64; one.num_slots() * width];
        for (quarters, scale) in by_hand {
            let copy = encode(&plain, &moved(&scene, quarters, scale));
            let rows = copy.gaussian_rows(0..scene.len()).unwrap();
            for (sum, &row) in due.chunks_exact_mut(width).zip(one.sampled()) {
                let row = &rows[row as usize * width..][..width];
                sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
            }
        }
        for row in due.chunks_exact_mut(width) {
            let length = row.iter().map(|v| v * v).sum::<f64>().sqrt();
            let divisor = if is_classifier { by_hand.len() as f64 } else { length };
            row.iter_mut().for_each(|v| *v /= divisor);
        }
        let rows = got.slot_rows(0..got.num_slots()).unwrap();
        let worst = rows.iter().zip(&due).map(|(a, b)| (f64::from(*a) - b).abs());
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 1e-5, "classifier {is_classifier}: {worst}");
        let plain = one.slot_rows(0..one.num_slots()).unwrap();
        assert!(
            rows.iter().zip(&plain).any(|(a, b)| (a - b).abs() > 1e-3),
            "copies change nothing"
        );
    }
}

#[test]
fn so_many_copies_as_there_are() {
    let network =
        Network::load(NetworkConfig::tiny(), &Weights::Seeded(0), WeightOptions::default())
            .unwrap();
    let scene = generate(&SyntheticRoomSettings::with_count(300, 1)).unwrap().scene;
    for tta in [0, 13] {
        let encoder = SceneEncoder { tta, ..SceneEncoder::new(&network) };
        let error = encoder.encode(&scene, &mut |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("1 to 12"), "{error}");
    }
    // Progress goes from 0 to 1 and never back.
    let encoder = SceneEncoder { tta: 12, grid_size: 0.2, ..SceneEncoder::new(&network) };
    let mut at = Vec::new();
    encoder
        .encode(&scene, &mut |progress| {
            at.push(progress);
            Ok(())
        })
        .unwrap();
    assert!(at.is_sorted_by(|a, b| a.done <= b.done && a.pass <= b.pass), "{at:?}");
    let last = at.last().unwrap();
    assert_eq!((last.pass, last.passes), (12, 12));
    assert!(last.done > 0.99 && at[0].done < 0.01);
}
