//! Recomputing blocks changes memory, not results.
use crate::support::{Scene, batch, flat, noise_like, rng};
use scenesplat_models::litept::BlockKind;
use scenesplat_models::{
    Backbone, BackboneConfig, Forward, LitePtConfig, ModelConfig, ParamStore,
    PointTransformerV3Config, Recompute,
};
use std::collections::BTreeMap;

fn gradients(config: BackboneConfig, recomputed: bool) -> (Vec<f32>, BTreeMap<String, Vec<f32>>) {
    let store = ParamStore::trainable(3);
    let network = ModelConfig::new(config).build(store.builder()).unwrap();
    let scene = |rows: std::ops::Range<i32>| {
        let cells = rows.map(|i| [i % 14, i / 14, (i * i / 7) % 5]).collect();
        Scene::new(cells, 11, "feat", 1)
    };
    let points = batch(&[&scene(0..90), &scene(90..196)]);
    let recompute = Recompute::new(store.parameters());
    let mut rng = rng(1);
    let mut cx = Forward::train(&mut rng);
    cx.recompute = recomputed.then(|| recompute.clone());
    let out = network.forward(&points, &mut cx).unwrap();
    let loss = (&out * noise_like(&out, "R", 1)).unwrap().sum_all().unwrap();
    let mut grads = loss.backward().unwrap();
    let before = store.parameters().iter().filter(|(_, v)| grads.get(v).is_some()).count();
    recompute.drain_into(&mut grads).unwrap();
    let parameters = store.parameters().into_iter();
    let all: BTreeMap<String, Vec<f32>> =
        parameters.map(|(name, v)| (name, flat(grads.get(&v).unwrap()))).collect();
    // The test would prove nothing if nothing had been recomputed.
    assert_eq!(before < all.len(), recomputed);
    (flat(&out), all)
}

#[test]
fn gradients_are_those_of_the_plain_run() {
    let config = PointTransformerV3Config { drop_path: 0.3, ..PointTransformerV3Config::tiny() };
    check(config.into());
    let lite = LitePtConfig {
        stride: vec![2; 2],
        enc_depths: vec![1, 1, 3],
        enc_channels: vec![12, 18, 36],
        enc_blocks: vec![BlockKind::Convolution, BlockKind::Both, BlockKind::Attention],
        enc_num_head: vec![1, 1, 2],
        enc_patch_size: vec![64; 3],
        dec_depths: vec![1; 2],
        dec_channels: vec![18, 18],
        dec_blocks: vec![BlockKind::Convolution, BlockKind::Attention],
        dec_num_head: vec![1; 2],
        dec_patch_size: vec![64; 2],
        ..LitePtConfig::small()
    };
    check(lite.into());
}

fn check(config: BackboneConfig) {
    let (plain, recomputed) = (gradients(config.clone(), false), gradients(config, true));
    assert_eq!(plain.0, recomputed.0, "features");
    for (name, expected) in &plain.1 {
        let found = &recomputed.1[name];
        let norm = expected.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let error = expected
            .iter()
            .zip(found)
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(error <= 1e-6 * norm + 1e-9, "{name}: {error:e} of {norm:e}");
        assert!(norm > 0.0, "{name} has no gradient");
    }
}
