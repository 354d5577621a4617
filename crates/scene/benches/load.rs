//! Reading 1.5 million Gaussians, beside reading the same bytes and beside the codec alone.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]
#![allow(clippy::unwrap_used, reason = "a benchmark that cannot set itself up should stop")]

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_scene::{
    GaussianScene, ReadOptions, SceneFormat, WriteOptions, open_scene, write_scene,
};
use std::hint::black_box;
use std::io::Read;
use std::path::Path;
use std::time::Duration;

// As the program has it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const ROWS: usize = 1_500_000;

/// Gaussians on the sides of boxes of a room's size, in the order of the boxes, with harmonics that
/// are similar within a box: compressible like a trained scene, as noise would not be.
fn room(sh_degree: u8) -> GaussianScene {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / 8_388_608.0 - 1.0
    };
    let mut scene = GaussianScene { sh_degree, ..GaussianScene::default() };
    let width = scene.sh_rest_len() * 3;
    let (mut centre, mut size, mut color) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    let mut rest = vec![0.0; width];
    for row in 0..ROWS {
        if row % 7500 == 0 {
            centre = [4.0 * next(), 1.5 * next(), 4.0 * next()];
            size = [(); 3].map(|()| 0.6 + 0.5 * next());
            color = [(); 3].map(|()| 1.7 * next());
            rest.iter_mut().for_each(|v| *v = 0.3 * next());
        }
        let mut p = [(); 3].map(|()| next());
        p[row % 3] = p[row % 3].signum();
        scene.coord.push([0, 1, 2].map(|i| centre[i] + size[i] * p[i]));
        scene.log_scale.push([(); 3].map(|()| -4.8 + next()));
        let quat = [(); 4].map(|()| next());
        let norm = quat.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        scene.quat.push(quat.map(|v| v / norm));
        scene.opacity_logit.push(0.5 + 4.0 * next());
        scene.sh_dc.push(color.map(|c| c + 0.4 * next()));
        scene.sh_rest.extend(rest.iter().map(|v| v + 0.08 * next()));
    }
    scene
}

/// All bytes through one buffer, as `cat` reads them.
fn cat(path: &Path) -> usize {
    let mut file = std::fs::File::open(path).unwrap();
    let mut buffer = vec![0u8; 128 << 10];
    let mut total = 0;
    loop {
        match file.read(&mut buffer).unwrap() {
            0 => return total,
            n => total += n,
        }
    }
}

/// The zstd streams of an SPZ file, decompressed through one buffer each, side by side.
fn spz_codec(bytes: &[u8]) -> u64 {
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let (streams, toc) = (usize::from(bytes[15]), u32_at(16));
    let mut at = toc + 16 * streams;
    let mut parts = Vec::new();
    for i in 0..streams {
        let size = u64_at(toc + 16 * i);
        parts.push(&bytes[at..at + size]);
        at += size;
    }
    use rayon::prelude::*;
    let decode = |part: &&[u8]| {
        let mut decoder = zstd::stream::read::Decoder::with_buffer(*part).unwrap();
        let mut buffer = vec![0u8; 128 << 10];
        let mut total = 0u64;
        loop {
            match decoder.read(&mut buffer).unwrap() {
                0 => return total,
                n => total += n as u64,
            }
        }
    };
    parts.par_iter().map(decode).sum()
}

/// The pictures of a SOG archive, decoded side by side.
fn sog_codec(bytes: &[u8]) -> usize {
    use rayon::prelude::*;
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let mut parts = Vec::new();
    for i in 0..zip.len() {
        let mut file = zip.by_index(i).unwrap();
        if file.size() > 0 && file.name().unwrap().ends_with(".webp") {
            let mut out = Vec::new();
            file.read_to_end(&mut out).unwrap();
            parts.push(out);
        }
    }
    let decode = |part: &Vec<u8>| {
        let mut decoder = image_webp::WebPDecoder::new(std::io::Cursor::new(part)).unwrap();
        let mut out = vec![0; decoder.output_buffer_size().unwrap()];
        decoder.read_image(&mut out).unwrap();
        black_box(&out);
        out.len()
    };
    parts.par_iter().map(decode).sum()
}

fn rows(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, path: &Path) {
    let bytes = std::fs::read(path).unwrap();
    group.throughput(Throughput::ElementsAndBytes {
        elements: ROWS as u64,
        bytes: bytes.len() as u64,
    });
    group.bench_function(format!("{name}/cat"), |b| b.iter(|| cat(path)));
    match path.extension().and_then(|e| e.to_str()) {
        Some("spz") => {
            group.bench_function(format!("{name}/codec"), |b| b.iter(|| spz_codec(&bytes)));
        }
        Some("sog") => {
            group.bench_function(format!("{name}/codec"), |b| b.iter(|| sog_codec(&bytes)));
        }
        _ => {}
    }
    drop(bytes);
    let options = ReadOptions::default();
    group.bench_function(format!("{name}/open_scene"), |b| {
        b.iter_with_large_drop(|| open_scene(path, &options).unwrap());
    });
}

fn load(c: &mut Criterion) {
    let dir = tempfile::tempdir().unwrap();
    let mut group = c.benchmark_group("load_1_5M");
    group.sample_size(10).warm_up_time(Duration::from_secs(1));
    group.measurement_time(Duration::from_secs(4));
    for degree in [0, 3] {
        let scene = room(degree);
        for (name, format) in [
            (format!("sh{degree}.ply"), SceneFormat::Ply),
            (format!("sh{degree}.compressed.ply"), SceneFormat::CompressedPly),
            (format!("sh{degree}.spz"), SceneFormat::Spz),
            (format!("sh{degree}.sog"), SceneFormat::Sog),
            (format!("sh{degree}.splat"), SceneFormat::Splat),
        ] {
            if degree > 0 && format == SceneFormat::Splat {
                continue;
            }
            let path = dir.path().join(&name);
            write_scene(&scene, &path, format, &WriteOptions::default(), &mut |_| true).unwrap();
            rows(&mut group, &name, &path);
        }
    }
    group.finish();
}

criterion_group!(benches, load);
criterion_main!(benches);
