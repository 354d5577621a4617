#![no_main]
//! Sections of buckets.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::ksplat::read_ksplat;

fuzz_target!(|bytes: &[u8]| {
    check(read_ksplat(bytes, path(), &options()));
});
