#![no_main]
//! SOG archives.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{check, options, path};
use scenesplat_scene::formats::sog::read_sog_archive;

fuzz_target!(|bytes: &[u8]| {
    check(read_sog_archive(bytes, path(), &options()));
});
