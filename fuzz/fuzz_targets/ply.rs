#![no_main]
//! PLY of any encoding: the trainer's, packed, with labels and codes.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::open_scene_bytes;

fuzz_target!(|bytes: &[u8]| {
    if bytes.starts_with(b"ply") {
        check(open_scene_bytes(bytes, path(), &options()));
    }
});
