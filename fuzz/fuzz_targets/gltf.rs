#![no_main]
//! glTF, text and binary.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::gltf::read_gltf;

fuzz_target!(|bytes: &[u8]| {
    check(read_gltf(bytes, path(), &options()));
});
