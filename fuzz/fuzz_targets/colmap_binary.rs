#![no_main]
//! COLMAP, binary: two 32-bit lengths, then cameras, images and points.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{path, three_parts};
use scenesplat_scene::formats::cameras::read_colmap_binary;

fuzz_target!(|bytes: &[u8]| {
    let [cameras, images, points] = three_parts(bytes);
    let _ = read_colmap_binary(cameras, images, Some(points), path());
});
