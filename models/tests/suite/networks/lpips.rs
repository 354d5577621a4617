//! LPIPS with made-up weights equals torch with the same ones.

use crate::support::on_cpu;
use candle_core::{Device, Tensor};
use scenesplat_models::{Lpips, LpipsNet};
use std::collections::HashMap;
use std::path::Path;

/// splitmix64 of `seed · 2³² + place`, upper 24 bits, in `0..1`: what `generate.py` makes.
fn uniform(seed: u64, count: usize) -> Vec<f32> {
    let hash = |i: u64| {
        let mut z = ((seed << 32) + i).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    (0..count as u64).map(|i| (hash(i) >> 40) as f32 / (1 << 24) as f32).collect()
}

/// Index, side, channels in and out, and whether the pictures are compared there.
type Row = (usize, usize, usize, usize, bool);

const ALEX: [Row; 5] = [
    (0, 11, 3, 64, true),
    (3, 5, 64, 192, true),
    (6, 3, 192, 384, true),
    (8, 3, 384, 256, true),
    (10, 3, 256, 256, true),
];

const VGG: [Row; 13] = [
    (0, 3, 3, 64, false),
    (2, 3, 64, 64, true),
    (5, 3, 64, 128, false),
    (7, 3, 128, 128, true),
    (10, 3, 128, 256, false),
    (12, 3, 256, 256, false),
    (14, 3, 256, 256, true),
    (17, 3, 256, 512, false),
    (19, 3, 512, 512, false),
    (21, 3, 512, 512, true),
    (24, 3, 512, 512, false),
    (26, 3, 512, 512, false),
    (28, 3, 512, 512, true),
];

fn tensors(rows: &[Row], first_seed: u64) -> HashMap<String, Tensor> {
    let mut out = HashMap::new();
    let mut taps = 0;
    for (seed, &(index, side, from, to, tap)) in (first_seed..).step_by(3).zip(rows) {
        let bound = (6.0 / (from * side * side) as f64).sqrt() as f32;
        let weight = uniform(seed, to * from * side * side);
        let weight = weight.into_iter().map(|u| (2.0 * u - 1.0) * bound).collect();
        let weight = on_cpu(weight, &[to, from, side, side]);
        out.insert(format!("features.{index}.weight"), weight);
        let bias = uniform(seed + 1, to).into_iter().map(|u| (2.0 * u - 1.0) * 0.1).collect();
        out.insert(format!("features.{index}.bias"), on_cpu(bias, &[to]));
        if tap {
            let lin = uniform(seed + 2, to).into_iter().map(|u| u * 0.02).collect();
            out.insert(format!("lin{taps}.model.1.weight"), on_cpu(lin, &[1, to, 1, 1]));
            taps += 1;
        }
    }
    out
}

fn write(tensors: &HashMap<String, Tensor>, path: &Path) {
    candle_core::safetensors::save(tensors, path).unwrap();
}

#[test]
fn both_networks_equal_torch() {
    let expected = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/lpips/expected.json");
    let expected: HashMap<String, [f64; 2]> =
        serde_json::from_slice(&std::fs::read(expected).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lpips.safetensors");
    for (net, rows, seed) in [(LpipsNet::Alex, &ALEX[..], 1), (LpipsNet::Vgg, &VGG[..], 100)] {
        write(&tensors(rows, seed), &path);
        let lpips = Lpips::load(&path).unwrap();
        assert_eq!(lpips.net(), net);
        for [height, width] in [[31, 31], [40, 57]] {
            let [a, b] = [1000, 1001].map(|seed| uniform(seed, height * width * 3));
            let mixed: Vec<f32> = a.iter().zip(&b).map(|(a, b)| 0.9 * a + 0.1 * b).collect();
            let expected = expected[&format!("{}_{height}x{width}", net.name())];
            for (other, expected) in [(&b, expected[0]), (&mixed, expected[1])] {
                let got = lpips.distance(&a, other, width, height).unwrap();
                // f32 sums of up to 4608 products in another order.
                assert!((got - expected).abs() <= 2e-5 * expected, "{net:?} {got} {expected}");
            }
            assert_eq!(lpips.distance(&a, &a, width, height).unwrap(), 0.0);
        }
        let side = net.least_side();
        let small = |side: usize| {
            let picture = vec![0.5; side * side * 3];
            lpips.distance(&picture, &picture, side, side)
        };
        assert_eq!(small(side).unwrap(), 0.0);
        let error = small(side - 1).unwrap_err().to_string();
        assert!(error.contains(&format!("{side} × {side}")), "{error}");
        let mut broken = vec![0.5; 40 * 40 * 3];
        broken[(3 * 40 + 7) * 3] = f32::NAN;
        let error = lpips.distance(&broken, &broken, 40, 40).unwrap_err().to_string();
        assert!(error.contains("(7, 3)"), "{error}");
        assert!(lpips.distance(&broken[1..], &broken, 40, 40).is_err());
    }
}

#[test]
fn weights_of_something_else_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lpips.safetensors");
    let mut missing = tensors(&ALEX, 1);
    missing.remove("lin3.model.1.weight");
    write(&missing, &path);
    let error = Lpips::load(&path).unwrap_err().to_string();
    assert!(error.contains("lin3.model.1.weight") && error.contains("alex"), "{error}");
    let mut wrong = tensors(&ALEX, 1);
    let bias = Tensor::zeros(63, candle_core::DType::F32, &Device::Cpu).unwrap();
    wrong.insert("features.0.bias".to_owned(), bias);
    write(&wrong, &path);
    let error = Lpips::load(&path).unwrap_err().to_string();
    assert!(error.contains("features.0.bias") && error.contains("[63]"), "{error}");
    std::fs::write(&path, b"nothing").unwrap();
    assert!(Lpips::load(&path).is_err());
    assert!(Lpips::load(&folder.path().join("none")).is_err());
}
