//! Networks as on other devices: the formulas of LitePT, and scenes that are hard.

use crate::determinism;
use crate::litept::numerics;
use crate::support_emulated::on_devices;

/// What a network launches forward.
const FORWARD: &str =
    "AddBias BatchNorm Gather Gelu LayerNorm PatchAttention SegmentReduce SparseConv";
/// And backward.
const BACKWARD: &str = "BatchNormBackward ColumnSums GeluBackward LayerNormBackward PatchAttentionBackward SegmentReduceBackward SparseConvBackward";
/// What is composed for a network.
const COMPOSED: &str = "add_bias batch_norm expand_groups gelu layer_norm patch_attention permute_rows segment_reduce sparse_conv";

on_devices! {
    litept_outputs = numerics::outputs_are_those_of_the_formulas,
        kernels [FORWARD, "PointRope"],
        tensors ["add_bias batch_norm expand_groups gelu layer_norm patch_attention permute_rows point_rope sparse_conv"];
    litept_gradients = numerics::gradients_are_differences_of_the_formulas,
        kernels [FORWARD, BACKWARD, "PointRope batch_statistics"],
        tensors ["add_bias batch_norm batch_statistics expand_groups gelu layer_norm patch_attention permute_rows point_rope sparse_conv"];
    few_voxels_and_odd_places = determinism::few_voxels_and_odd_places,
        kernels [FORWARD],
        tensors [COMPOSED];
    about_as_many_voxels_as_a_patch_holds = determinism::about_as_many_voxels_as_a_patch_holds,
        kernels [FORWARD],
        tensors [COMPOSED];
    rows_that_share_a_voxel = determinism::rows_that_share_a_voxel,
        kernels [FORWARD],
        tensors [COMPOSED];
    features_of_any_finite_size = determinism::features_of_any_finite_size,
        kernels [FORWARD],
        tensors [COMPOSED];
    // Composed, the bits of a row hang on how many rows a product has.
    damaged_values_stay_in_their_scene = determinism::damaged_values_stay_in_their_scene,
        kernels [FORWARD];
    training_on_a_single_voxel = determinism::training_on_a_single_voxel,
        kernels [FORWARD, BACKWARD, "batch_statistics"],
        tensors ["add_bias batch_norm batch_statistics expand_groups gelu layer_norm patch_attention segment_reduce sparse_conv"];
}
