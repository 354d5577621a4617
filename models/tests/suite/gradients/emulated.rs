//! The same formulas as on other devices. Layers and modules run the operations' kernels, so those are launched by operations
//! alone.

use super::{layers, modules, ops};
use crate::support::devices::on_devices;

on_devices! {
    linear = ops::linear, "add_bias", [kernels device];
    gelu = ops::gelu, "gelu", [kernels device];
    layer_norm = ops::layer_norm, "layer_norm", [kernels device];
    batch_norm = ops::batch_norm, "batch_norm batch_statistics>", [kernels device];
    l2_normalize = ops::l2_normalize, "", [kernels device];
    sparse_conv = ops::sparse_conv, "sparse_conv", [kernels device];
    patch_attention = ops::patch_attention, "patch_attention", [kernels device];
    permute_rows = ops::permute_rows, "permute_rows", [kernels device];
    add_scaled_rows = ops::add_scaled_rows, "", [kernels device];
    segments = ops::segments, "expand_groups segment_reduce", [kernels device];
    linear_layer = layers::linear, "add_bias gelu", [device];
    what_a_batch_norm_remembers = layers::what_a_batch_norm_remembers,
        "batch_norm> batch_statistics>", [kernels device];
    linear_norm_layer = layers::linear_norm, "add_bias batch_norm batch_statistics gelu",
        [device];
    serialized_attention = modules::serialized_attention, "add_bias patch_attention", [device];
    blocks = modules::blocks, "add_bias gelu layer_norm patch_attention sparse_conv", [device];
    embedding = modules::embedding, "batch_norm batch_statistics gelu sparse_conv", [device];
    pooling = modules::pooling, "add_bias batch_norm batch_statistics gelu segment_reduce",
        [device];
    unpooling = modules::unpooling, "add_bias batch_norm batch_statistics expand_groups gelu",
        [device];
}
