#![no_main]
//! Blocks of labels and language codes.

use libfuzzer_sys::fuzz_target;
use scenesplat_fuzz::path;
use scenesplat_scene::formats::semantics::decode;
use scenesplat_scene::{GaussianScene, RepairReport};

fuzz_target!(|bytes: &[u8]| {
    let mut scene = GaussianScene {
        coord: vec![[0.0; 3]; 3],
        log_scale: vec![[0.0; 3]; 3],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 3],
        opacity_logit: vec![0.0; 3],
        sh_dc: vec![[0.0; 3]; 3],
        ..GaussianScene::default()
    };
    if decode(bytes, 3, &mut scene, &mut RepairReport::default(), path()).is_ok() {
        scene.check_rows().expect("every array has one row per Gaussian");
    }
});
