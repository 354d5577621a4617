#![no_main]
//! Files of weights: every tensor that a file names is read.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::file;
use scenesplat_models::weights::WeightFile;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(weights) = WeightFile::open(&file("model.safetensors", bytes)) {
        for (name, entry) in weights.entries() {
            if let Ok(tensor) = weights.read(name) {
                assert_eq!(tensor.dims(), entry.shape);
            }
        }
    }
});
