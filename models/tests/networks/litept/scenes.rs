//! Small networks that together have every kind of block at every place, and scenes for them.

use crate::support_device::device;
use candle_core::Tensor;
use scenesplat_models::litept::BlockKind::{Attention, Both, Convolution};
use scenesplat_models::weights::{WeightSource, unit};
use scenesplat_models::{Backbone, Compute, LitePt, LitePtConfig, ParamStore, PointCloud};

pub const CHANNELS: usize = 4;
/// Of the hashed weights.
pub const SEED: u64 = 5;

/// As S: convolutions, then attention, no blocks in the decoder.
pub fn plain() -> LitePtConfig {
    LitePtConfig {
        in_channels: CHANNELS,
        stride: vec![2; 3],
        enc_depths: vec![1, 2, 2, 1],
        enc_channels: vec![6, 10, 24, 36],
        enc_blocks: vec![Convolution, Convolution, Attention, Attention],
        enc_num_head: vec![1, 1, 2, 2],
        enc_patch_size: vec![1024, 1024, 16, 1024],
        dec_depths: vec![0; 3],
        dec_channels: vec![12, 10, 24],
        dec_blocks: vec![Convolution; 3],
        dec_num_head: vec![1; 3],
        dec_patch_size: vec![1024; 3],
        mlp_ratio: 2,
        ..LitePtConfig::small()
    }
}

/// As S*: blocks in the decoder; attention at the finest scale too, a stride of 4, blocks of both
/// kinds in one, patches shorter than the scenes.
pub fn decoded() -> LitePtConfig {
    LitePtConfig {
        stride: vec![4, 2],
        enc_depths: vec![1, 2, 5],
        enc_channels: vec![12, 18, 36],
        enc_blocks: vec![Both, Both, Attention],
        enc_num_head: vec![1, 3, 2],
        enc_patch_size: vec![50, 13, 7],
        dec_depths: vec![2, 1],
        dec_channels: vec![18, 12],
        dec_blocks: vec![Attention, Convolution],
        dec_num_head: vec![1, 1],
        dec_patch_size: vec![31, 9],
        rope_base: 10.0,
        ..plain()
    }
}

pub struct Scene {
    pub cells: Vec<[i32; 3]>,
    pub feat: Vec<f32>,
}

/// A floor and two walls, bumpy, in no order.
pub fn room(side: i32, name: &str) -> Scene {
    let mut cells = Vec::new();
    for a in 0..side {
        for b in 0..side {
            cells.push([a, b, (a / 3) % 2]);
            if b > 1 {
                cells.extend([[a, 0, b], [0, a + 1, b]]);
            }
        }
    }
    cells.sort_by_key(|c| (c[0] * 31 + c[1] * 17 + c[2] * 7) % 101);
    let feat = unit(name, cells.len() * CHANNELS, 3);
    Scene { cells, feat }
}

pub fn batch(scenes: &[&Scene]) -> PointCloud {
    let cells: Vec<[i32; 3]> = scenes.iter().flat_map(|s| s.cells.clone()).collect();
    let feat: Vec<f32> = scenes.iter().flat_map(|s| s.feat.clone()).collect();
    let mut offsets = vec![0];
    scenes.iter().for_each(|s| offsets.push(offsets.last().unwrap() + s.cells.len()));
    let feat = Tensor::from_vec(feat, (cells.len(), CHANNELS), &device()).unwrap();
    PointCloud::new(cells, feat, offsets).unwrap()
}

pub fn frozen(config: &LitePtConfig, compute: Compute) -> Box<dyn Backbone> {
    let store = ParamStore::frozen(WeightSource::hashed(SEED, "")).on(&device());
    let config = LitePtConfig { compute, ..config.clone() };
    Box::new(LitePt::new(&config, store.builder()).unwrap())
}

pub fn trainable(config: &LitePtConfig) -> (ParamStore, Box<dyn Backbone>) {
    let store = ParamStore::trainable_from(WeightSource::hashed(SEED, ""), 0).on(&device());
    let network = LitePt::new(config, store.builder()).unwrap();
    (store, Box::new(network))
}

pub fn flat(t: &Tensor) -> Vec<f32> {
    t.flatten_all().unwrap().to_vec1().unwrap()
}
