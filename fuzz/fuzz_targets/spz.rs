#![no_main]
//! SPZ in every wrapping and version.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::spz::read_spz;

fuzz_target!(|bytes: &[u8]| {
    check(read_spz(bytes, path(), &options()));
});
