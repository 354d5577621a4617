//! The same formulas as on other devices.

use crate::support_emulated::on_devices;
use crate::{layers, modules, ops};

on_devices! {
    linear = ops::linear,
        kernels ["AddBias ColumnSums"],
        tensors ["add_bias"];
    gelu = ops::gelu,
        kernels ["Gelu GeluBackward"],
        tensors ["gelu"];
    layer_norm = ops::layer_norm,
        kernels ["LayerNorm LayerNormBackward"],
        tensors ["layer_norm"];
    batch_norm = ops::batch_norm,
        kernels ["BatchNorm BatchNormBackward batch_statistics"],
        tensors ["batch_norm batch_statistics"];
    l2_normalize = ops::l2_normalize,
        kernels [""],
        tensors [""];
    sparse_conv = ops::sparse_conv,
        kernels ["SparseConv SparseConvBackward"],
        tensors ["sparse_conv"];
    patch_attention = ops::patch_attention,
        kernels ["PatchAttention PatchAttentionBackward"],
        tensors ["patch_attention"];
    permute_rows = ops::permute_rows,
        kernels ["Gather"],
        tensors ["permute_rows"];
    add_scaled_rows = ops::add_scaled_rows,
        kernels [""],
        tensors [""];
    segments = ops::segments,
        kernels ["Gather SegmentReduce SegmentReduceBackward"],
        tensors ["expand_groups segment_reduce"];
    linear_layer = layers::linear,
        kernels ["AddBias ColumnSums Gelu GeluBackward"],
        tensors ["add_bias gelu"];
    layer_norm_layer = layers::layer_norm,
        kernels ["LayerNorm LayerNormBackward"],
        tensors ["layer_norm"];
    batch_norm_layer = layers::batch_norm,
        kernels ["BatchNorm BatchNormBackward Gelu GeluBackward batch_statistics"],
        tensors ["batch_norm batch_statistics gelu"];
    what_a_batch_norm_remembers = layers::what_a_batch_norm_remembers,
        kernels ["BatchNorm batch_statistics"],
        tensors ["batch_norm batch_statistics"];
    linear_norm_layer = layers::linear_norm,
        kernels ["AddBias BatchNorm BatchNormBackward ColumnSums Gelu GeluBackward batch_statistics"],
        tensors ["add_bias batch_norm batch_statistics gelu"];
    mlp_layer = layers::mlp,
        kernels ["AddBias ColumnSums Gelu GeluBackward"],
        tensors ["add_bias gelu"];
    drop_path_layer = layers::drop_path,
        kernels [""],
        tensors [""];
    sparse_conv_layer = layers::sparse_conv,
        kernels ["AddBias ColumnSums SparseConv SparseConvBackward"],
        tensors ["add_bias sparse_conv"];
    serialized_attention = modules::serialized_attention,
        kernels ["AddBias ColumnSums PatchAttention PatchAttentionBackward"],
        tensors ["add_bias patch_attention"];
    blocks = modules::blocks,
        kernels ["AddBias ColumnSums Gelu GeluBackward LayerNorm LayerNormBackward PatchAttention PatchAttentionBackward SparseConv SparseConvBackward"],
        tensors ["add_bias gelu layer_norm patch_attention sparse_conv"];
    embedding = modules::embedding,
        kernels ["BatchNorm BatchNormBackward Gelu GeluBackward SparseConv SparseConvBackward batch_statistics"],
        tensors ["batch_norm batch_statistics gelu sparse_conv"];
    pooling = modules::pooling,
        kernels ["AddBias BatchNorm BatchNormBackward ColumnSums Gelu GeluBackward SegmentReduce SegmentReduceBackward batch_statistics"],
        tensors ["add_bias batch_norm batch_statistics gelu segment_reduce"];
    unpooling = modules::unpooling,
        kernels ["AddBias BatchNorm BatchNormBackward ColumnSums Gather Gelu GeluBackward SegmentReduce batch_statistics"],
        tensors ["add_bias batch_norm batch_statistics expand_groups gelu"];
}
