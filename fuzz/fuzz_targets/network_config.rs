#![no_main]
//! `config.json` beside weights, and networks as TOML: what is accepted has sizes that are checked.

use libfuzzer_sys::fuzz_target;
use scenesplat::network::NetworkConfig;
use scenesplat_fuzz::file;

fuzz_target!(|bytes: &[u8]| {
    for name in ["config.json", "network.toml"] {
        if let Ok(config) = NetworkConfig::read(&file(name, bytes)) {
            let _ = config.check();
        }
    }
});
