#![no_main]
//! Records of 32 bytes.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::splat::read_splat;

fuzz_target!(|bytes: &[u8]| {
    check(read_splat(bytes, path(), &options()));
});
