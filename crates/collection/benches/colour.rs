//! What color statistics of crops take: one of few colors, as renders have, and one of many, as photos have.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_collection::{ColourStatistics, PictureEncoder};
use scenesplat_scene::picture::RgbPicture;
use std::hint::black_box;

fn noise(x: u32, y: u32) -> u32 {
    let v = x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B);
    (v ^ v >> 15).wrapping_mul(0xC2B2_AE35) >> 8
}

fn colour(c: &mut Criterion) {
    let mut group = c.benchmark_group("colour_statistics");
    for side in [64, 320] {
        let few = RgbPicture::from_fn(side, side, |x, y| [(x / 16) as u8, (y / 16) as u8, 90]);
        let many = RgbPicture::from_fn(side, side, |x, y| {
            let n = noise(x, y);
            [
                (x / 2) as u8 + (n & 15) as u8,
                (y / 2) as u8 + (n >> 4 & 15) as u8,
                90 + (n >> 8 & 15) as u8,
            ]
        });
        group.throughput(Throughput::Elements(u64::from(side * side)));
        for (name, picture) in [("few", few), ("many", many)] {
            group.bench_function(format!("{name}_colours/{side}"), |b| {
                b.iter(|| black_box(ColourStatistics.encode(std::slice::from_ref(&picture))));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, colour);
criterion_main!(benches);
