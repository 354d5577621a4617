//! Resizing, a tiny SAM 2 of full resolution, the upscaling of masks.

use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_kernels::Precision;
use scenesplat_scene::picture::RgbPicture;
use scenesplat_vision::resize::{Filter, resize};
use scenesplat_vision::sam2::PromptPoint;
use scenesplat_vision::{Sam2, Sam2Config, SiglipImageEncoder};
use std::hint::black_box;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn vision(c: &mut Criterion) {
    let picture =
        RgbPicture::from_fn(876, 584, |x, y| [(x / 4) as u8, (y / 3) as u8, (x ^ y) as u8]);
    c.bench_function("resize/876x584_to_512", |b| {
        b.iter(|| black_box(resize(&picture, 512, 512, Filter::Bilinear)));
    });
    let mut group = c.benchmark_group("networks");
    group.sample_size(10);
    if let Ok(network) = Sam2::seeded(Sam2Config::tiny(), 1, Precision::F32) {
        group.bench_function("sam2_tiny/picture", |b| b.iter(|| network.encode(&picture)));
        if let Ok(seen) = network.encode(&picture) {
            let prompts = vec![vec![PromptPoint::inside([400.0, 300.0])]; 8];
            group.bench_function("sam2/8_clicks", |b| b.iter(|| network.predict(&seen, &prompts)));
        }
    }
    for precision in [Precision::F32, Precision::Bf16] {
        if let Ok(encoder) = SiglipImageEncoder::seeded_base_512(1, precision) {
            let one = [picture.clone()];
            group.bench_function(format!("siglip_base_512/{precision}"), |b| {
                b.iter(|| encoder.encode(&one));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, vision);
criterion_main!(benches);
