#![no_main]
//! Arrays of a folder.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::formats::npy::NpyFile;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(file) = NpyFile::from_bytes(bytes, path()) {
        let count = file.len();
        if let Ok(values) = file.read_f64() {
            assert_eq!(values.len(), count);
        }
        let _ = (file.read_f32(), file.read_f16(), file.read_i64(), file.read_u8());
    }
});
