//! What precision and joined layers change, and what they must not.

use crate::support::{Scene, batch, eval, frozen, rng, rows, trainable, with_threads};
use candle_core::{DType, Device, Tensor};
use scenesplat_kernels::Precision;
use scenesplat_models::{
    Backbone, Compute, Forward, ModelConfig, ParamStore, PointCloud, PointTransformerV3Config,
};
use std::collections::BTreeMap;

fn config(compute: Compute) -> PointTransformerV3Config {
    PointTransformerV3Config { in_channels: 11, compute, ..PointTransformerV3Config::language() }
        .with_stages(&[[1, 16, 2], [1, 32, 4], [2, 48, 3]], &[[1, 72, 3], [2, 64, 4]], 128)
}

fn room(side: i32, seed: u64) -> Scene {
    Scene::room(side, 7, 11, "feat", seed)
}

fn features(compute: Compute, points: &PointCloud) -> Vec<Vec<f32>> {
    rows(&eval(&*frozen(|vb| ModelConfig::new(config(compute)).build(vb)), points))
}

/// ‖a − b‖ / ‖b‖ over all values.
fn relative(a: &[Vec<f32>], b: &[Vec<f32>]) -> f64 {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let (mut difference, mut norm) = (0.0, 0.0);
    for (a, b) in pairs {
        difference += (f64::from(*a) - f64::from(*b)).powi(2);
        norm += f64::from(*b).powi(2);
    }
    (difference / norm).sqrt()
}

/// Cosines of the rows, ascending.
fn cosines(a: &[Vec<f32>], b: &[Vec<f32>]) -> Vec<f64> {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let mut all: Vec<f64> =
        a.iter().zip(b).map(|(a, b)| dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()).collect();
    all.sort_by(f64::total_cmp);
    all
}

#[test]
fn joined_layers_differ_by_roundings_only() {
    let points = batch(&[&room(40, 1)]);
    let exact = features(Compute::EXACT, &points);
    let joined = features(Compute::default(), &points);
    let error = relative(&joined, &exact);
    // Two ways to f32 through some 60 operations; not the same bits, or nothing was joined.
    assert!(error > 0.0 && error < 1e-5, "{error}");
}

#[test]
fn lower_precisions_stay_near_f32() {
    let points = batch(&[&room(40, 2)]);
    for fold in [false, true] {
        let exact = features(Compute { precision: Precision::F32, fold }, &points);
        let split = features(Compute { precision: Precision::F32Split, fold }, &points);
        assert!(relative(&split, &exact) < 5e-5, "split: {}", relative(&split, &exact));
        let bf16 = features(Compute { precision: Precision::Bf16, fold }, &points);
        let cosines = cosines(&bf16, &exact);
        let (median, low) = (cosines[cosines.len() / 2], cosines[cosines.len() / 100]);
        assert!(median >= 0.999 && low >= 0.99, "bf16: cosine {median}, 1st percentile {low}");
        // Eight bits of mantissa: an error below this would mean that nothing was rounded.
        assert!(relative(&bf16, &exact) > 1e-4, "bf16: {}", relative(&bf16, &exact));
        let int8 = features(Compute { precision: Precision::Int8, fold }, &points);
        let cosines = self::cosines(&int8, &exact);
        let (median, low) = (cosines[cosines.len() / 2], cosines[cosines.len() / 100]);
        assert!(median >= 0.995 && low >= 0.97, "int8: cosine {median}, 1st percentile {low}");
        assert!(relative(&int8, &bf16) > 1e-3, "int8: {}", relative(&int8, &bf16));
    }
}

#[test]
fn int8_is_refused_in_training_by_name() {
    let compute = Compute { precision: Precision::Int8, fold: true };
    let built = ModelConfig::new(config(compute)).build(ParamStore::trainable(0).builder());
    let refused = built.err().unwrap().to_string();
    assert!(refused.contains("int8 is for inference"), "{refused}");
    let x = Tensor::zeros((2, 64), DType::F32, &Device::Cpu).unwrap();
    let w = Tensor::zeros((64, 64), DType::F32, &Device::Cpu).unwrap();
    let refused = scenesplat_models::ops::linear_with(Precision::Int8, &x, &w, None).unwrap_err();
    assert!(refused.to_string().contains("int8 is for inference"), "{refused}");
}

#[test]
fn any_precision_is_deterministic_and_ignores_batch_mates() {
    let (one, other) = (room(30, 3), room(17, 4));
    for precision in Precision::ALL {
        let compute = Compute { precision, fold: true };
        let bits = |rows: &[Vec<f32>]| -> Vec<u32> {
            rows.iter().flatten().map(|v| v.to_bits()).collect()
        };
        let run = |threads: usize, points: &PointCloud| {
            with_threads(threads, || features(compute, points))
        };
        let alone = run(1, &batch(&[&one]));
        for threads in [2, 3] {
            let again = run(threads, &batch(&[&one]));
            assert!(bits(&again) == bits(&alone), "{precision} with {threads} threads");
        }
        let both = run(2, &batch(&[&other, &one]));
        assert!(
            bits(&both[other.cells.len()..]) == bits(&alone),
            "{precision} beside another scene"
        );
    }
}

/// Gradients of a training step, by name.
fn gradients(precision: Precision) -> BTreeMap<String, Vec<f32>> {
    let compute = Compute { precision, fold: true };
    let config = PointTransformerV3Config { drop_path: 0.0, ..config(compute) };
    let (store, model) = trainable(|vb| ModelConfig::new(config).build(vb));
    let points = batch(&[&room(24, 5)]);
    let out = model.forward(&points, &mut Forward::train(&mut rng(3))).unwrap();
    crate::support::gradients(&store, &out, 1)
}

#[test]
fn gradients_in_bf16_point_the_same_way() {
    let exact = gradients(Precision::F32);
    let bf16 = gradients(Precision::Bf16);
    let flat = |g: &BTreeMap<String, Vec<f32>>| vec![g.values().flatten().copied().collect()];
    let whole = cosines(&flat(&bf16), &flat(&exact))[0];
    // Hashed weights are steep: what one block rounds, the next ones amplify, so that the gradient
    // of a random direction turns by degrees on its way back to the first layer.
    assert!(whole > 0.9, "cosine of all gradients {whole}");
    for (name, values) in exact.iter().filter(|(name, _)| name.starts_with("dec.dec0.block0")) {
        let cosine = cosines(&[bf16[name].clone()], std::slice::from_ref(values))[0];
        assert!(cosine > 0.98, "{name}: cosine {cosine}");
    }
    assert!(relative(&flat(&bf16), &flat(&exact)) > 1e-4, "nothing was rounded");
}
