//! Small networks that together have every kind of block at every place, and scenes for them.

use crate::support::{self, Scene};
use scenesplat_models::litept::BlockKind::{Attention, Both, Convolution};
use scenesplat_models::{Backbone, Compute, LitePt, LitePtConfig, ParamStore};

pub const CHANNELS: usize = 4;

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

/// A room whose rows are in no order.
pub fn room(side: i32, name: &str) -> Scene {
    let mut scene = Scene::room(side, 3, CHANNELS, name, 3);
    scene.cells.sort_by_key(|c| (c[0] * 31 + c[1] * 17 + c[2] * 7) % 101);
    scene
}

pub fn frozen(config: &LitePtConfig, compute: Compute) -> Box<dyn Backbone> {
    let config = LitePtConfig { compute, ..config.clone() };
    Box::new(support::frozen(|vb| LitePt::new(&config, vb)))
}

pub fn trainable(config: &LitePtConfig) -> (ParamStore, Box<dyn Backbone>) {
    let (store, network) = support::trainable(|vb| LitePt::new(config, vb));
    (store, Box::new(network))
}
