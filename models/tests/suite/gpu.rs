//! Networks on a graphics processor (in CI a software one) against the reference numbers and the CPU.

use crate::golden::tiny_networks::Case;
use crate::networks::litept::scenes::{CHANNELS, decoded, plain, room};
use crate::support::{SEED, Scene, Tensors, batch, bits, eval, flat, frozen, rng, try_eval};
use scenesplat_gpu::ops::Stored;
use scenesplat_gpu::{Choice, Gpu};
use scenesplat_models::point_transformer_v3::{PoolingReduce, Version};
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{
    Backbone, BackboneConfig, Compute, Forward, LevelOptions, Mode, ModelConfig, ParamStore,
    PointTransformerV3Config, Shortcuts,
};
use std::sync::OnceLock;

/// The device; `None` says why, which CI takes for a failure.
fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Result<Gpu, String>> = OnceLock::new();
    let opened = GPU.get_or_init(|| Gpu::open(&Choice::Best).map_err(|error| error.to_string()));
    match opened {
        Ok(gpu) => Some(gpu.clone()),
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
}

/// A network of hashed weights on the device, and the same on the CPU.
fn both(config: &ModelConfig, gpu: &Gpu, stored: Stored) -> [Box<dyn Backbone>; 2] {
    [frozen(|vb| config.build_on_gpu(vb, gpu, stored)), frozen(|vb| config.build(vb))]
}

fn second_version(decoder: &[[usize; 3]]) -> ModelConfig {
    let base = PointTransformerV3Config {
        version: Version::M2,
        in_channels: CHANNELS,
        pooling: PoolingReduce::Max,
        mlp_ratio: 2,
        ..PointTransformerV3Config::language()
    };
    ModelConfig::new(base.with_stages(&[[2, 8, 2], [1, 12, 3], [2, 16, 2]], decoder, 20))
}

fn first_version() -> ModelConfig {
    let base = PointTransformerV3Config {
        in_channels: CHANNELS,
        mlp_ratio: 2,
        ..PointTransformerV3Config::language()
    };
    let (encoder, decoder) = ([[1, 16, 1], [2, 24, 2], [1, 36, 2]], [[2, 40, 2], [1, 24, 3]]);
    ModelConfig::new(base.with_stages(&encoder, &decoder, 48))
}

/// Small networks that together have every kind of layer.
fn configs() -> Vec<(&'static str, ModelConfig)> {
    let decoder = [[1, 10, 2], [2, 12, 1]];
    vec![
        ("first version", first_version()),
        ("first version, classes", first_version().with_classes(7)),
        ("first version, projection", first_version().with_projection(30)),
        ("second version", second_version(&decoder)),
        ("second version, encoder alone", second_version(&[])),
        ("LitePT", ModelConfig::new(plain())),
        ("LitePT, blocks of both kinds", ModelConfig::new(decoded()).with_classes(5)),
    ]
}

/// Largest difference relative to the largest value.
fn difference(got: &[f32], want: &[f32]) -> f64 {
    assert_eq!(got.len(), want.len());
    assert!(got.iter().chain(want).all(|v| v.is_finite()));
    let largest = want.iter().fold(1e-6, |m: f32, v| m.max(v.abs()));
    got.iter().zip(want).fold(0.0, |m: f64, (g, w)| m.max(f64::from((g - w).abs() / largest)))
}

/// The mean of the cosines of rows with the same rows.
fn cosine(got: &[f32], want: &[f32], width: usize) -> f64 {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    assert!(got.iter().chain(want).all(|v| v.is_finite()));
    let rows = got.chunks_exact(width).zip(want.chunks_exact(width));
    let cosine = |(a, b)| dot(a, b) / (dot(a, a) * dot(b, b)).sqrt();
    rows.map(cosine).sum::<f64>() / (got.len() / width) as f64
}

fn golden(name: &str) {
    let (Some(gpu), Some(case)) = (gpu(), Case::open(name, Mode::Eval)) else { return };
    let store = ParamStore::frozen(WeightSource::hashed(case.seed, ""));
    let config = BackboneConfig::from(case.config.clone());
    let network = config.build_on_gpu(store.builder(), &gpu, Stored::F32).unwrap();
    let mut rng = rng(0);
    let mut cx = Forward { orders: case.orders(), ..Forward::eval(&mut rng) };
    let out = network.forward(&case.inputs.points(), &mut cx).unwrap();
    case.numbers.compare_tensor("eval.out.feat", &out);
}

#[test]
fn a_network_gives_the_original_s_numbers() {
    golden("f_tiny");
}

#[test]
fn a_batch_gives_the_original_s_numbers() {
    golden("f_tiny_batch");
}

#[test]
fn patches_of_flash_attention_give_the_original_s_numbers() {
    golden("f_tiny_flash");
}

#[test]
fn shuffled_orders_give_the_original_s_numbers() {
    golden("f_tiny_shuffle");
}

#[test]
fn every_kind_of_network_gives_what_the_cpu_gives() {
    let Some(gpu) = gpu() else { return };
    let (a, b) = (room(9, "a"), room(5, "b"));
    let points = batch(&[&a, &b]);
    for (name, config) in configs() {
        for fold in [true, false] {
            let config = config.clone().with_compute(Compute { fold, ..Compute::default() });
            let [on_gpu, on_cpu] = both(&config, &gpu, Stored::F32);
            assert_eq!(on_gpu.out_channels(), on_cpu.out_channels(), "{name}");
            assert_eq!(on_gpu.alignment(), on_cpu.alignment(), "{name}");
            let (got, want) = (flat(&eval(&*on_gpu, &points)), flat(&eval(&*on_cpu, &points)));
            let error = difference(&got, &want);
            // Layer norms of rows that vary little magnify rounding.
            assert!(error < 5e-5, "{name}, fold {fold}: {error:e}");
        }
    }
}

#[test]
fn sixteen_bit_storage_keeps_the_direction_of_features() {
    let Some(gpu) = gpu() else { return };
    let points = batch(&[&room(9, "a")]);
    for (name, config) in configs() {
        let config =
            ModelConfig { head: scenesplat_models::Head::Features { projection: None }, ..config };
        if !gpu.has_f16() {
            let store = ParamStore::frozen(WeightSource::hashed(SEED, ""));
            let refused = config.build_on_gpu(store.builder(), &gpu, Stored::F16);
            assert!(refused.err().unwrap().to_string().contains("16-bit"));
            continue;
        }
        let [on_gpu, on_cpu] = both(&config, &gpu, Stored::F16);
        let (got, want) = (flat(&eval(&*on_gpu, &points)), flat(&eval(&*on_cpu, &points)));
        let mean = cosine(&got, &want, on_cpu.out_channels());
        assert!(mean > 0.999, "{name}: {mean}");
        assert!(mean < 1.0 - 1e-9, "{name}: stored in 32 bits");
    }
}

#[test]
fn a_scene_is_the_same_bits_alone_in_a_batch_and_every_time() {
    let Some(gpu) = gpu() else { return };
    let (a, b) = (room(8, "a"), room(5, "b"));
    let empty = Scene { cells: vec![], feat: vec![], channels: CHANNELS };
    for (name, config) in configs() {
        let network = frozen(|vb| config.build_on_gpu(vb, &gpu, Stored::F32));
        let alone = bits(&eval(&*network, &batch(&[&a])));
        assert_eq!(bits(&eval(&*network, &batch(&[&a]))), alone, "{name}: again");
        let among = bits(&eval(&*network, &batch(&[&b, &empty, &a, &b])));
        let first = b.cells.len() * network.out_channels();
        assert_eq!(among[first..first + alone.len()], alone, "{name}: in a batch");
    }
}

#[test]
fn few_points_duplicates_and_the_largest_coordinate_are_as_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let most = (1 << 21) - 1;
    for (name, config) in configs() {
        let [on_gpu, on_cpu] = both(&config, &gpu, Stored::F32);
        for cells in [
            vec![[0, 0, 0]],
            vec![[0, 0, 0], [0, 0, 1]],
            vec![[3, 3, 3]; 40],
            vec![[most, most, most], [0, 0, 0], [most - 1, 0, 5]],
        ] {
            let points = batch(&[&Scene::new(cells, CHANNELS, "few", 3)]);
            let (got, want) = (flat(&eval(&*on_gpu, &points)), flat(&eval(&*on_cpu, &points)));
            let error = difference(&got, &want);
            assert!(error < 1e-4, "{name}: {error:e}");
        }
    }
}

/// A device whose arrays hold less than a scene's tables and slots makes the same bits of them in pieces.
#[test]
fn pieces_give_the_same_bits_as_the_whole() {
    let Some(gpu) = gpu() else { return };
    let scene = room(20, "a");
    let points = batch(&[&scene]);
    for (name, config) in [("first", first_version()), ("LitePT", ModelConfig::new(decoded()))] {
        // Weights and rows fit; neighbor tables, slots and hidden rows do not.
        let limit = scene.cells.len() as u64 * 40 * 4;
        let small = gpu.limited_to(limit);
        let whole = frozen(|vb| config.build_on_gpu(vb, &gpu, Stored::F32));
        let pieces = frozen(|vb| config.build_on_gpu(vb, &small, Stored::F32));
        assert_eq!(bits(&eval(&*pieces, &points)), bits(&eval(&*whole, &points)), "{name}");
        let line = |voxels: usize| {
            let cells = (0..voxels as i32).map(|i| [i, 0, 0]).collect();
            batch(&[&Scene::new(cells, CHANNELS, "line", 3)])
        };
        let most = pieces.most_voxels().unwrap();
        assert!(most >= scene.cells.len() && whole.most_voxels().unwrap() > most, "{name}: {most}");
        eval(&*pieces, &line(most));
        let error = try_eval(&*pieces, &line(most + 1)).unwrap_err().to_string();
        assert!(error.contains("use smaller tiles"), "{name}: {error}");
    }
}

#[test]
fn what_a_network_cannot_do_there_is_an_error() {
    let Some(gpu) = gpu() else { return };
    let store = || ParamStore::frozen(WeightSource::hashed(SEED, ""));
    let mut short = PointTransformerV3Config::tiny();
    short.shortcuts = Shortcuts { rank: Some(4), ..Shortcuts::default() };
    let refused = ModelConfig::new(short).build_on_gpu(store().builder(), &gpu, Stored::F32);
    assert!(refused.err().unwrap().to_string().contains("CPU only"));
    let other = ModelConfig::new(scenesplat_models::PointTransformerV1Config::default());
    let refused = other.build_on_gpu(store().builder(), &gpu, Stored::F32);
    assert!(refused.err().unwrap().to_string().contains("point_transformer_v1"));
    let network = frozen(|vb| first_version().build_on_gpu(vb, &gpu, Stored::F32));
    let points = batch(&[&room(5, "a")]);
    let trained = network.forward(&points, &mut Forward::train(&mut rng(0)));
    assert!(trained.unwrap_err().to_string().contains("cannot be trained"));
    let levels = LevelOptions { mask: None, decoder: false };
    assert!(network.forward_levels(&points, levels, &mut Forward::eval(&mut rng(0))).is_err());
    let narrow = batch(&[&Scene::new(vec![[0, 0, 0]], CHANNELS + 1, "narrow", 1)]);
    assert!(try_eval(&*network, &narrow).unwrap_err().to_string().contains("expected [N, 4]"));
}

#[test]
fn scales_of_an_encoder_are_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let [on_gpu, on_cpu] = both(&second_version(&[]), &gpu, Stored::F32);
    let points = batch(&[&room(7, "a"), &room(4, "b")]);
    let levels = |network: &dyn Backbone| {
        let options = LevelOptions { mask: None, decoder: false };
        network.forward_levels(&points, options, &mut Forward::eval(&mut rng(0))).unwrap()
    };
    let (got, want) = (levels(&*on_gpu), levels(&*on_cpu));
    assert_eq!(got.encoder().len(), 3);
    for (got, want) in got.encoder().iter().zip(want.encoder()) {
        assert_eq!(got.offsets, want.offsets);
        assert!(difference(&flat(&got.feat), &flat(&want.feat)) < 2e-5);
    }
}

/// In the middle of a session a driver takes the device away: an error, and no panic, from then on.
#[test]
fn a_lost_device_is_an_error() {
    if gpu().is_none() {
        return;
    }
    let own = Gpu::open(&Choice::Best).unwrap();
    let network = frozen(|vb| first_version().build_on_gpu(vb, &own, Stored::F32));
    let points = batch(&[&room(5, "a")]);
    eval(&*network, &points);
    own.lose();
    for _ in 0..2 {
        let error = try_eval(&*network, &points).unwrap_err().to_string();
        assert!(error.contains("lost"), "{error}");
    }
}

/// Memory that a block gives up serves the next one.
#[test]
fn blocks_share_memory() {
    if gpu().is_none() {
        return;
    }
    let points = batch(&[&room(12, "a")]);
    let with_blocks = |blocks: usize| {
        let base = PointTransformerV3Config { in_channels: CHANNELS, ..Default::default() };
        let config = ModelConfig::new(base.with_stages(&[[blocks, 16, 1]], &[], 64));
        let own = Gpu::open(&Choice::Best).unwrap();
        let network = frozen(|vb| config.build_on_gpu(vb, &own, Stored::F32));
        let weights = own.memory().live;
        eval(&*network, &points);
        assert_eq!(own.memory().live, weights, "all but the weights is given back");
        own.memory().peak - weights
    };
    // One for each curve, whose slots are kept.
    assert_eq!(with_blocks(4), with_blocks(8));
}
