//! What full-size networks take on this machine: seconds and memory, with weights from a seed.
//!
//! `cargo run --release -p scenesplat-vision --example full_size -- sam2|siglip`
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "it ends with whatever went wrong")]

use scenesplat_kernels::Precision;
use scenesplat_scene::picture::RgbPicture;
use scenesplat_vision::{AutomaticMasks, MaskSettings, Sam2, Sam2Config, SiglipImageEncoder};
use std::time::Instant;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn peak_gib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / 1024.0 / 1024.0
}

fn timed<T>(what: &str, f: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = f();
    println!("{what}: {:.3} s, peak {:.2} GiB", start.elapsed().as_secs_f64(), peak_gib());
    result
}

fn main() {
    let picture =
        RgbPicture::from_fn(876, 584, |x, y| [(x / 4) as u8, (y / 3) as u8, (x ^ y) as u8]);
    println!("{} threads", rayon::current_num_threads());
    if std::env::args().any(|a| a == "sam2") {
        let load = || Sam2::seeded(Sam2Config::large(), 1, Precision::F32).unwrap();
        let network = timed("sam2 large: weights", load);
        for _ in 0..3 {
            timed("sam2 large: picture", || network.encode(&picture).unwrap());
        }
        let seen = network.encode(&picture).unwrap();
        for _ in 0..2 {
            let click = |i: u16| {
                vec![scenesplat_vision::sam2::PromptPoint::inside([f32::from(i) * 13.0, 300.0])]
            };
            let prompts: Vec<_> = (0..64).map(click).collect();
            timed("sam2 large: 64 clicks", || network.predict(&seen, &prompts).unwrap());
        }
        let settings =
            MaskSettings { points_per_side: 8, crop_layers: 0, ..MaskSettings::scenesplat() };
        let masks = AutomaticMasks::new(&network, settings).unwrap();
        let (_, counts) =
            timed("sam2 large: masks of 64 points", || masks.generate_counted(&picture).unwrap());
        println!("{counts:?}");
    }
    if std::env::args().any(|a| a == "siglip") {
        for precision in [Precision::F32, Precision::Bf16] {
            let encoder = SiglipImageEncoder::seeded_base_512(1, precision).unwrap();
            for count in [1, 8] {
                let pictures = vec![picture.clone(); count];
                for _ in 0..3 {
                    let what = format!("siglip2 base 512, {precision}: {count} pictures");
                    timed(&what, || encoder.encode(&pictures).unwrap());
                }
            }
        }
    }
}
