#![no_main]
//! Pickles of PyTorch checkpoints, in an archive made around them.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::{file, torch_archive};
use scenesplat_models::weights::{WeightFile, summarize};

fuzz_target!(|bytes: &[u8]| {
    let path = file("checkpoint.pth", &torch_archive(bytes, &[7; 256]));
    if let Ok(weights) = WeightFile::open(&path) {
        for (name, entry) in weights.entries() {
            if let Ok(tensor) = weights.read(name) {
                assert_eq!(tensor.dims(), entry.shape);
                // No more values than strides of 0 can make of what is there.
                assert!(tensor.elem_count() <= 1 << 20, "{name}: {:?}", entry.shape);
            }
        }
    }
    let _ = summarize(&path);
});
