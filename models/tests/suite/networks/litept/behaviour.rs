//! What must not change a result, and what must.

use super::scenes::{CHANNELS, decoded, frozen, plain, room, trainable};
use crate::support::{Scene, batch, bits, eval, flat, gradients, is_finite, refusal, rng};
use candle_core::{DType, Device, Tensor};
use scenesplat_models::{
    Backbone, Compute, Forward, LitePtConfig, ModelConfig, Orders, ParamStore, PointCloud,
};

fn finite_bits(network: &dyn Backbone, scenes: &[&Scene]) -> Vec<u32> {
    let out = eval(network, &batch(scenes));
    assert!(is_finite(&out));
    bits(&out)
}

#[test]
fn few_points_one_voxel_duplicates_and_the_largest_coordinate() {
    let scene = |cells: Vec<[i32; 3]>| Scene::new(cells, CHANNELS, "few", 3);
    let most = (1 << 21) - 1;
    for config in [plain(), decoded()] {
        for cells in [
            vec![[0, 0, 0]],
            vec![[5, 6, 7]],
            vec![[0, 0, 0], [0, 0, 1]],
            vec![[0, 0, 0], [900, 3, 17], [4, 4, 4]],
            vec![[3, 3, 3]; 40],
            vec![[most, most, most], [0, 0, 0], [most - 1, 0, 5]],
            (0..50).map(|i| [i / 2 % 5, i / 10, i % 3 / 2]).collect(),
        ] {
            let scene = scene(cells);
            let network = &*frozen(&config, Compute::default());
            let alone = finite_bits(network, &[&scene]);
            assert!(alone.iter().any(|v| f32::from_bits(*v) != 0.0));
            let empty = Scene { cells: vec![], feat: vec![], channels: CHANNELS };
            assert_eq!(finite_bits(network, &[&empty, &scene, &empty]), alone);
            // Training too, where a batch norm may see a single row.
            let (store, network) = trainable(&config);
            let points = batch(&[&scene]);
            let out = network.forward(&points, &mut Forward::train(&mut rng(0))).unwrap();
            assert!(is_finite(&out));
            for (name, grad) in gradients(&store, &out, 1) {
                assert!(grad.iter().all(|v| v.is_finite()), "{name}");
            }
        }
    }
}

#[test]
fn duplicates_of_a_row_are_that_row() {
    // All rows of a voxel see the same places; with the same features they are the same.
    let mut scene = room(6, "a");
    let n = scene.cells.len();
    for row in [3, 3, 17] {
        scene.cells.push(scene.cells[row]);
        let feat = scene.feat[row * CHANNELS..][..CHANNELS].to_vec();
        scene.feat.extend(feat);
    }
    let network = frozen(&plain(), Compute::default());
    let got = finite_bits(&*network, &[&scene]);
    let width = network.out_channels();
    let row = |i: usize| &got[i * width..][..width];
    assert_eq!(row(n), row(3));
    assert_eq!(row(n + 1), row(3));
    assert_eq!(row(n + 2), row(17));
}

#[test]
fn whole_cells_further_on_little_changes() {
    // Curves may take another way there, so patches hold the whole scene here.
    let config = LitePtConfig { enc_patch_size: vec![1024; 4], ..plain() };
    let network = frozen(&config, Compute::default());
    assert_eq!(network.alignment(), 8);
    let near = room(9, "a");
    let far = |by: i32| Scene {
        cells: near.cells.iter().map(|c| c.map(|v| v + by)).collect(),
        ..near.clone()
    };
    let values = |scene: &Scene| flat(&eval(&*network, &batch(&[scene])));
    let here = values(&near);
    let largest = here.iter().fold(0f32, |a, v| a.max(v.abs()));
    let off = |by: i32| {
        let there = values(&far(by));
        there.iter().zip(&here).fold(0f32, |a, (t, h)| a.max((t - h).abs())) / largest
    };
    // A thousand radians further, angles are as exact as here.
    assert!(off(8 * 1000) < 1e-5, "{}", off(8 * 1000));
    assert!(off(1 << 20) < 1e-5, "{}", off(1 << 20));
    // Other cells are another scene.
    assert!(off(1) > 1e-3, "{}", off(1));
}

#[test]
fn drop_path_and_shuffled_orders_come_from_the_generator() {
    let points = batch(&[&room(10, "a")]);
    let config = LitePtConfig { drop_path: 0.4, ..decoded() };
    let run = |seed: u64, orders: Orders, drop_path: f64| {
        let mut rng = rng(seed);
        let mut cx = Forward { orders, ..Forward::train(&mut rng) };
        let config = LitePtConfig { drop_path, ..config.clone() };
        flat(&trainable(&config).1.forward(&points, &mut cx).unwrap())
    };
    assert_eq!(run(1, Orders::Shuffled, 0.4), run(1, Orders::Shuffled, 0.4));
    assert_ne!(run(1, Orders::Listed, 0.4), run(2, Orders::Listed, 0.4), "drop path");
    assert_eq!(run(1, Orders::Listed, 0.0), run(2, Orders::Listed, 0.0));
    assert_ne!(run(1, Orders::Shuffled, 0.0), run(2, Orders::Shuffled, 0.0), "orders");
    let fail = |orders: Vec<Vec<usize>>| {
        let mut rng = rng(0);
        let mut cx = Forward { orders: Orders::Given(orders), ..Forward::eval(&mut rng) };
        let network = frozen(&config, Compute::default());
        network.forward(&points, &mut cx).unwrap_err().to_string()
    };
    assert!(fail(vec![vec![0, 1, 2, 3]; 2]).contains("fewer permutations"));
    assert!(fail(vec![vec![0, 1, 2, 2]; 3]).contains("not a permutation"));
}

#[test]
fn what_does_not_fit_is_refused() {
    let network = frozen(&plain(), Compute::default());
    let fail = |cells: Vec<[i32; 3]>, width: usize| {
        let feat = Tensor::zeros((cells.len(), width), DType::F32, &Device::Cpu).unwrap();
        refusal(&*network, &PointCloud::single(cells, feat).unwrap())
    };
    assert!(fail(vec![[0, 0, 0]], 5).contains("expected [N, 4]"));
    assert!(fail(vec![], 4).contains("without any voxel"));
    assert!(fail(vec![[0, 0, 0], [0, -3, 0]], 4).contains("row 1, axis 1: -3"));
    assert!(fail(vec![[0, 0, 1 << 21]], 4).contains("21 bits"));
    let store = ParamStore::trainable(0);
    let broken = LitePtConfig { stride: vec![3, 2, 2, 2], ..LitePtConfig::small() };
    let error = ModelConfig::new(broken).build(store.builder()).err().unwrap().to_string();
    assert!(error.contains("stride[0]"), "{error}");
}
