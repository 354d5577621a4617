//! Metrics of a picture of 640 × 480 pixels in three channels.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_metrics::image::sharpness::{GrayImage, variance_of_laplacian};
use scenesplat_metrics::image::{ImageView, SsimPadding, psnr, ssim, ssim_with_gradient};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

fn image_metrics(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut noise = || -> Vec<f32> { (0..WIDTH * HEIGHT * 3).map(|_| rng.random()).collect() };
    let (a, b) = (noise(), noise());
    let view = |v| ImageView::new(v, WIDTH, HEIGHT, 3).expect("sizes fit");
    let (a, b) = (view(&a), view(&b));
    let gray: Vec<u8> = a.values().iter().step_by(3).map(|v| (v * 255.0) as u8).collect();
    let gray = GrayImage::new(gray, WIDTH).expect("sizes fit");
    let mut group = c.benchmark_group("image");
    group.throughput(Throughput::Elements((WIDTH * HEIGHT) as u64));
    group.bench_function("psnr", |bench| bench.iter(|| psnr(a, b)));
    group.bench_function("ssim", |bench| bench.iter(|| ssim(a, b, SsimPadding::Valid)));
    group.bench_function("ssim_with_gradient", |bench| {
        bench.iter(|| ssim_with_gradient(a, b, SsimPadding::Valid));
    });
    group.bench_function("variance_of_laplacian", |bench| {
        bench.iter(|| variance_of_laplacian(&gray));
    });
    group.finish();
}

criterion_group!(benches, image_metrics);
criterion_main!(benches);
