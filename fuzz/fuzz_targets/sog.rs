#![no_main]
//! Anything that calls itself this format.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::scene_from_bytes;

fuzz_target!(|bytes: &[u8]| scene_from_bytes(bytes));
