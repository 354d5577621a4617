#![no_main]
//! USD, as text and in archives.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::usd::{is_usdz, read_usda, read_usdz};

fuzz_target!(|bytes: &[u8]| {
    check(match is_usdz(bytes) {
        true => read_usdz(bytes, path(), &options()),
        false => read_usda(bytes, path(), &options()),
    });
});
