#![no_main]
//! Cameras of the trainer.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::formats::cameras::read_cameras_json;

fuzz_target!(|bytes: &[u8]| {
    let _ = read_cameras_json(bytes, path());
});
