//! Networks as on other devices: the formulas of LitePT, and scenes that are hard.

use super::determinism;
use super::litept::numerics;
use crate::support::devices::on_devices;

/// Operations of a network of which only features are asked for.
const FORWARD: &str = "add_bias> batch_norm> expand_groups> gelu> layer_norm> patch_attention> permute_rows> segment_reduce> sparse_conv>";

on_devices! {
    litept_outputs = numerics::outputs_are_those_of_the_formulas,
        "add_bias batch_norm expand_groups gelu layer_norm patch_attention permute_rows point_rope segment_reduce sparse_conv",
        [device];
    litept_gradients = numerics::gradients_are_differences_of_the_formulas,
        "add_bias batch_norm batch_statistics> expand_groups gelu layer_norm patch_attention permute_rows point_rope segment_reduce sparse_conv",
        [kernels device];
    few_voxels_and_odd_places = determinism::few_voxels_and_odd_places, FORWARD,
        [device];
    about_as_many_voxels_as_a_patch_holds = determinism::about_as_many_voxels_as_a_patch_holds, FORWARD,
        [kernels device];
    rows_that_share_a_voxel = determinism::rows_that_share_a_voxel, FORWARD,
        [kernels device];
    features_of_any_finite_size = determinism::features_of_any_finite_size, FORWARD,
        [kernels device];
    damaged_values_stay_in_their_scene = determinism::damaged_values_stay_in_their_scene, FORWARD,
        [device];
    training_on_a_single_voxel = determinism::training_on_a_single_voxel,
        "add_bias batch_norm batch_statistics> expand_groups gelu layer_norm patch_attention segment_reduce sparse_conv",
        [kernels device];
}
