//! The same numbers as on other devices.

use super::tiny_networks::run;
use super::{convolution, modules};
use crate::support::devices::on_devices;
use scenesplat_models::Mode;

/// Operations of a network.
const NETWORK: &str = "add_bias batch_norm expand_groups gelu layer_norm patch_attention permute_rows segment_reduce sparse_conv";
/// And those of one that takes the statistics of its batch.
const TRAINED: &str = "add_bias batch_norm batch_statistics> expand_groups gelu layer_norm patch_attention permute_rows segment_reduce sparse_conv";

on_devices! {
    submanifold_convolution = convolution::forward_and_gradients, "sparse_conv",
        [kernels device];
    attention = modules::attention, "add_bias patch_attention", [kernels device];
    block = modules::block, "add_bias gelu layer_norm patch_attention sparse_conv",
        [device];
    embedding = modules::embedding, "batch_norm gelu sparse_conv", [device];
    pooling = modules::pooling, "add_bias batch_norm gelu segment_reduce", [kernels device];
    unpooling = modules::unpooling, "add_bias batch_norm expand_groups gelu", [device];
    plain_eval = || run("f_tiny", Mode::Eval), NETWORK, [device];
    plain_train = || run("f_tiny", Mode::Train), TRAINED, [device];
    batch_eval = || run("f_tiny_batch", Mode::Eval), NETWORK, [device];
    batch_train = || run("f_tiny_batch", Mode::Train), TRAINED, [kernels device];
    flash_patches_train = || run("f_tiny_flash", Mode::Train), TRAINED, [device];
    self_supervised_train = || run("f_tiny_ssl", Mode::Train), TRAINED, [device];
    shuffled_orders_train = || run("f_tiny_shuffle", Mode::Train), TRAINED, [device];
}
