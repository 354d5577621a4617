#![no_main]
//! Experiments as TOML, without variables of the environment.

use libfuzzer_sys::fuzz_target;
use scenesplat::experiment::ExperimentConfig;
use scenesplat_fuzz::file;

fuzz_target!(|bytes: &[u8]| {
    // Other files are not part of the input.
    if bytes.windows(7).any(|w| w == b"extends") {
        return;
    }
    if let Ok(config) = ExperimentConfig::read_with(&file("experiment.toml", bytes), &|_| None) {
        let _ = config.check();
    }
});
