#![no_main]
//! Cameras of NeRF programs.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::formats::cameras::read_transforms_json;

fuzz_target!(|bytes: &[u8]| {
    let _ = read_transforms_json(bytes, path());
});
