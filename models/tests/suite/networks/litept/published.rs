//! The published networks: sizes, names, and how weights are recognized.

use scenesplat_models::{LitePtConfig, LitePtSize, ModelConfig, ParamStore};

fn store(model: &ModelConfig) -> ParamStore {
    let store = ParamStore::trainable(0);
    model.build(store.builder()).unwrap();
    store
}

fn with_inputs(config: LitePtConfig, in_channels: usize) -> LitePtConfig {
    LitePtConfig { in_channels, ..config }
}

#[test]
fn parameters_are_as_many_as_published() {
    // With the six inputs of the published weights, and with eleven.
    for (config, six, eleven) in [
        (LitePtConfig::small(), 12_712_932, 12_735_432),
        (LitePtConfig::small_with_decoder(), 15_988_716, 16_011_216),
        (LitePtConfig::base(), 45_112_788, 45_146_538),
        (LitePtConfig::large(), 85_880_448, 85_925_448),
    ] {
        for (inputs, want) in [(6, six), (11, eleven)] {
            let model = ModelConfig::new(with_inputs(config.clone(), inputs));
            let store = store(&model);
            let found: usize = store.parameters().values().map(|v| v.elem_count()).sum();
            assert_eq!(found, want);
            let values: usize = store.shapes().values().map(|s| s.iter().product::<usize>()).sum();
            assert_eq!(model.num_values(), values);
        }
    }
}

#[test]
fn the_smallest_has_these_names() {
    let model = ModelConfig::new(with_inputs(LitePtConfig::small(), 6)).with_classes(20);
    let shapes = store(&model).shapes();
    let norm = |name: &str| {
        ["weight", "bias", "running_mean", "running_var", "num_batches_tracked"]
            .map(|part| format!("{name}.{part}"))
    };
    for (name, shape) in [
        ("embedding.stem.conv.weight", vec![36, 5, 5, 5, 6]),
        ("enc.enc0.block1.conv.0.weight", vec![36, 3, 3, 3, 36]),
        ("enc.enc0.block1.conv.0.bias", vec![36]),
        ("enc.enc2.block0.conv.1.weight", vec![144, 144]),
        ("enc.enc2.block0.conv.2.bias", vec![144]),
        ("enc.enc1.down.proj.weight", vec![72, 36]),
        ("enc.enc3.block5.norm0.0.weight", vec![252]),
        ("enc.enc3.block5.norm1.0.weight", vec![252]),
        ("enc.enc3.block5.attn.qkv.weight", vec![756, 252]),
        ("enc.enc4.block1.attn.proj.bias", vec![504]),
        ("enc.enc4.block1.norm2.0.bias", vec![504]),
        ("enc.enc4.block1.mlp.0.fc1.weight", vec![2016, 504]),
        ("enc.enc4.block1.mlp.0.fc2.weight", vec![504, 2016]),
        ("dec.dec3.up.proj.0.weight", vec![252, 504]),
        ("dec.dec0.up.proj_skip.0.weight", vec![72, 36]),
        ("seg_head.weight", vec![20, 72]),
    ] {
        assert_eq!(shapes.get(name), Some(&shape), "{name}");
    }
    for name in norm("embedding.stem.norm")
        .into_iter()
        .chain(norm("enc.enc4.down.norm.0"))
        .chain(norm("dec.dec2.up.proj.1"))
        .chain(norm("dec.dec2.up.proj_skip.1"))
    {
        assert!(shapes.contains_key(&name), "{name}");
    }
    assert!(!shapes.keys().any(|name| name.starts_with("dec.dec0.block")));
}

#[test]
fn weights_are_recognised_with_any_head() {
    let all: Vec<LitePtConfig> =
        LitePtSize::ALL.iter().map(|size| with_inputs(size.config(), 6)).collect();
    for config in &all {
        let alone = ModelConfig::new(config.clone());
        for model in
            [alone.clone(), alone.clone().with_classes(13), alone.clone().with_projection(768)]
        {
            assert_eq!(ModelConfig::recognize(&store(&model).shapes()), Some(model));
        }
    }
    let mut shapes = store(&ModelConfig::new(all[0].clone())).shapes();
    shapes.insert("enc.enc0.block2.conv.0.weight".to_owned(), vec![36, 3, 3, 3, 36]);
    assert_eq!(ModelConfig::recognize(&shapes), None);
    // None of them is taken for another architecture, nor the other way round.
    for model in [ModelConfig::language(), ModelConfig::semseg(), ModelConfig::tiny()] {
        assert_eq!(ModelConfig::recognize(&store(&model).shapes()), Some(model));
    }
}

#[test]
fn a_file_says_which() {
    let text = r#"{"architecture": "litept", "projection": 768}"#;
    let model: ModelConfig = serde_json::from_str(text).unwrap();
    assert_eq!(model, ModelConfig::new(LitePtConfig::small()).with_projection(768));
    for size in LitePtSize::ALL {
        let model = ModelConfig::new(size.config());
        model.check().unwrap();
        let text = serde_json::to_string(&model).unwrap();
        assert!(text.contains(r#""enc_blocks":["convolution","#), "{text}");
        assert_eq!(serde_json::from_str::<ModelConfig>(&text).unwrap(), model);
    }
    let error = |text: &str| serde_json::from_str::<ModelConfig>(text).unwrap_err().to_string();
    let unknown = error(r#"{"architecture": "litept", "enc_blocks": ["pooling"]}"#);
    assert!(unknown.contains("enc_blocks") && unknown.contains("convolution"), "{unknown}");
    let unknown = error(r#"{"architecture": "litept", "mask_token": true}"#);
    assert!(unknown.contains("mask_token"), "{unknown}");
}
