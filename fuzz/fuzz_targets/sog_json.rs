#![no_main]
//! The descriptions of SOG folders and of levels of detail.

use libfuzzer_sys::fuzz_target;
use scenesplat_scene::formats::sog::{is_lod_meta_json, is_sog_meta_json};

fuzz_target!(|bytes: &[u8]| {
    is_sog_meta_json(bytes);
    is_lod_meta_json(bytes);
});
