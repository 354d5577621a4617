//! Every kernel as other systems get it: checked, and written in their languages, without their drivers.

use crate::support::gpu;
use naga::back::{hlsl, msl, spv};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::collections::BTreeSet;
use std::path::Path;

/// Texts that stand in others, and are no kernels by themselves.
const PARTS: [&str; 6] = ["cell_hash", "curve_code", "gelu", "ordered", "scene_of", "shift_code"];

/// Runs all operations, so that their kernels are compiled in every form that they take.
fn run_all() {
    crate::attention::attention_follows_the_formula_in_whole_and_borrowed_patches();
    crate::attention::queries_and_keys_turn_with_their_voxels();
    crate::cloud::pooled_scales_are_those_of_the_cpu_down_to_one_voxel();
    crate::cloud::coarser_scales_follow_the_rule_of_litept();
    crate::cloud::slots_show_rows_of_the_order();
    crate::curves::codes_are_those_of_the_cpu_at_every_depth();
    crate::grid_sample::groups_are_those_of_the_cpu_at_every_length_in_every_order();
    crate::kernel_map::tables_are_those_of_the_cpu_for_every_kernel_size();
    crate::radix_sort::rows_given_go_along_and_the_result_is_the_same_twice();
    crate::scan::sums_are_those_of_the_values_before_at_every_length();
    crate::scan::lists_are_counted_inverted_and_composed();
    crate::norms::norms_follow_the_formula_with_every_ending();
    crate::norms::rows_have_unit_length_whatever_their_size();
    crate::pooling::pooling_follows_the_formula();
    crate::pooling::rows_are_copied_and_added_by_lists();
    crate::products::convolutions_follow_the_formula_whole_and_in_ranges();
    crate::products::linear_layers_follow_the_formula_at_every_width();
    crate::products::lists_say_which_rows_are_read_and_where_results_go();
}

#[test]
fn every_kernel_is_valid_and_becomes_metal_direct3d_and_spir_v() {
    let Some(gpu) = gpu() else { return };
    run_all();
    let mut there = BTreeSet::new();
    for file in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("wgsl")).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        there.insert(name.strip_suffix(".wgsl").unwrap().to_owned());
    }
    PARTS.iter().for_each(|part| assert!(there.remove(*part), "{part}"));
    let compiled = gpu.compiled_kernels();
    let names = compiled.iter().map(|(name, _)| name.split(' ').next().unwrap().to_owned());
    assert_eq!(names.collect::<BTreeSet<_>>(), there, "kernels that no operation here runs");
    for (name, text) in compiled {
        let module = naga::front::wgsl::parse_str(&text);
        let module = module.unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&text)));
        let capabilities = Capabilities::SHADER_FLOAT16;
        let info = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
        let info = info.unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&text)));
        let options = msl::Options { fake_missing_bindings: true, ..Default::default() };
        let (metal, _) = msl::write_string(&module, &info, &options, &Default::default()).unwrap();
        assert!(metal.contains("kernel void"), "{name}");
        let words = spv::write_vec(&module, &info, &spv::Options::default(), None).unwrap();
        assert_eq!(words[0], 0x0723_0203, "{name}: the number that SPIR-V begins with");
        let (options, pipeline) = (hlsl::Options::default(), hlsl::PipelineOptions::default());
        let mut direct3d = String::new();
        let mut writer = hlsl::Writer::new(&mut direct3d, &options, &pipeline);
        writer.write(&module, &info, None).unwrap();
        assert!(direct3d.contains("numthreads"), "{name}");
    }
}
