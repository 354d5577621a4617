//! `.ksplat` files: reading and damage.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{SplitMix, shared};
use half::f16;
use scenesplat_scene::formats::ksplat::{is_ksplat, read_ksplat};
use scenesplat_scene::formats::splat::is_splat;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat, open_scene,
};
use std::path::Path;

fn read(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_ksplat(bytes, Path::new("a.ksplat"), &ReadOptions::default())
}

fn read_file(path: &Path) -> LoadedScene {
    let bytes = std::fs::read(path).unwrap();
    assert!(is_ksplat(&bytes) && !is_splat(&bytes), "{}", path.display());
    read(&bytes).unwrap()
}

/// A section, written independently of the crate. Buckets hold 4.
struct Section {
    degree: u16,
    full: u32,
    partial: Vec<u32>,
    /// Records there is room for beyond those there are.
    spare: u32,
}

impl Section {
    fn rows(&self) -> u32 {
        4 * self.full + self.partial.iter().sum::<u32>()
    }
}

/// What row `row` of all holds, whatever the level.
struct Expected {
    offset: [u16; 3],
    scale: [f32; 3],
    quat: [f32; 4],
    color: [u8; 4],
}

fn expected(row: u32) -> Expected {
    Expected {
        offset: [row as u16, 32_767, 65_534 - row as u16],
        scale: [0.5, 0.25, 0.125].map(|s| s * (1.0 + (row % 4) as f32 * 0.25)),
        quat: [[1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.5, 0.5], [0.0, 0.0, 1.0, 0.0]][row as usize % 3],
        color: [row as u8, 100, 200, 128],
    }
}

/// The coefficient for coefficient `k`, `channel`, of a row.
fn coefficient(row: u32, k: usize, channel: usize) -> f32 {
    (k * 3 + channel) as f32 / 64.0 - (row % 2) as f32 * 0.5
}

const RANGE: f64 = 32_767.0;
const BLOCK: f64 = 8.0;

fn center(section: usize, bucket: usize) -> [f32; 3] {
    [section as f32 * 10.0, bucket as f32, -1.0]
}

fn ksplat(level: u16, sections: &[Section]) -> Vec<u8> {
    let total: u32 = sections.iter().map(Section::rows).sum();
    let mut out = vec![0u8; 4096 + 1024 * sections.len()];
    let put = |out: &mut Vec<u8>, at: usize, value: u32| {
        out[at..at + 4].copy_from_slice(&value.to_le_bytes());
    };
    out[1] = 1;
    put(&mut out, 4, sections.len() as u32);
    put(&mut out, 8, sections.len() as u32);
    put(&mut out, 12, total);
    put(&mut out, 16, total);
    put(&mut out, 20, u32::from(level));
    put(&mut out, 36, (-1.0f32).to_bits());
    put(&mut out, 40, 1.0f32.to_bits());
    let mut row = 0;
    for (index, section) in sections.iter().enumerate() {
        let at = 4096 + 1024 * index;
        let buckets = section.full + section.partial.len() as u32;
        put(&mut out, at, section.rows());
        put(&mut out, at + 4, section.rows() + section.spare);
        put(&mut out, at + 8, 4);
        put(&mut out, at + 12, buckets);
        put(&mut out, at + 16, (BLOCK as f32).to_bits());
        put(&mut out, at + 20, 12);
        put(&mut out, at + 32, section.full);
        put(&mut out, at + 36, section.partial.len() as u32);
        put(&mut out, at + 40, u32::from(section.degree));
        section.partial.iter().for_each(|count| out.extend(count.to_le_bytes()));
        for bucket in 0..buckets as usize {
            center(index, bucket).iter().for_each(|v| out.extend(v.to_le_bytes()));
        }
        let start = out.len();
        for _ in 0..section.rows() {
            let e = expected(row);
            if level == 0 {
                let floats = e.offset.map(f32::from);
                floats
                    .iter()
                    .chain(&e.scale)
                    .chain(&e.quat)
                    .for_each(|v| out.extend(v.to_le_bytes()));
            } else {
                e.offset.iter().for_each(|v| out.extend(v.to_le_bytes()));
                e.scale
                    .iter()
                    .chain(&e.quat)
                    .for_each(|&v| out.extend(f16::from_f32(v).to_le_bytes()));
            }
            out.extend(e.color);
            let mut first = 0;
            for band in 1..=usize::from(section.degree) {
                for channel in 0..3 {
                    for m in 0..2 * band + 1 {
                        let value = coefficient(row, first + m, channel);
                        match level {
                            0 => out.extend(value.to_le_bytes()),
                            1 => out.extend(f16::from_f32(value).to_le_bytes()),
                            _ => out.push(((value + 1.0) / 2.0 * 255.0) as u8),
                        }
                    }
                }
                first += 2 * band + 1;
            }
            row += 1;
        }
        let record = (out.len() - start) / section.rows().max(1) as usize;
        out.extend(vec![0xee; record * section.spare as usize]);
    }
    out
}

fn sections() -> [Section; 4] {
    [
        Section { degree: 1, full: 2, partial: vec![3, 1], spare: 0 },
        Section { degree: 0, full: 0, partial: vec![], spare: 0 },
        Section { degree: 2, full: 0, partial: vec![1, 0, 2], spare: 2 },
        Section { degree: 2, full: 1, partial: vec![], spare: 0 },
    ]
}

#[test]
fn sections_buckets_and_levels() {
    for level in 0..=2 {
        let bytes = ksplat(level, &sections());
        assert!(is_ksplat(&bytes));
        let loaded = read(&bytes).unwrap();
        let scene = &loaded.scene;
        assert_eq!((loaded.kind, scene.len(), scene.sh_degree), (SceneFormat::Ksplat, 19, 2));
        assert!(loaded.report.is_clean(), "{}", loaded.report);
        // Section and bucket of every row.
        let places = [(0, 0, 4), (0, 1, 4), (0, 2, 3), (0, 3, 1), (2, 0, 1), (2, 2, 2), (3, 0, 4)];
        let places = places.into_iter().flat_map(|(s, b, n)| vec![(s, b); n]);
        for (row, (section, bucket)) in places.enumerate() {
            let e = expected(row as u32);
            let offset = e.offset.map(f64::from);
            let center = center(section, bucket).map(f64::from);
            let step = BLOCK / 2.0 / RANGE;
            for i in 0..3 {
                let due =
                    if level == 0 { offset[i] } else { (offset[i] - RANGE) * step + center[i] };
                assert!(
                    (f64::from(scene.coord[row][i]) - due).abs() < 1e-6,
                    "level {level} row {row}"
                );
            }
            assert_eq!(scene.log_scale[row], e.scale.map(f32::ln), "level {level} row {row}");
            assert_eq!(scene.quat[row], e.quat);
            assert_eq!(scene.color_u8(row), [e.color[0], e.color[1], e.color[2]]);
            assert!((scene.opacity(row) - 128.0 / 255.0).abs() < 1e-6);
            let known = if section == 0 { 3 } else { 8 };
            for k in 0..8 {
                for channel in 0..3 {
                    let value = scene.sh_rest[row * 24 + k * 3 + channel];
                    let due = if k < known { coefficient(row as u32, k, channel) } else { 0.0 };
                    let allowed = if level < 2 { 0.0 } else { 2.001 / 255.0 };
                    assert!(
                        (value - due).abs() <= allowed,
                        "level {level} row {row}: {value} {due}"
                    );
                }
            }
        }
        let bare = ReadOptions { sh_rest: false, ..ReadOptions::default() };
        let bare = read_ksplat(&bytes, Path::new("a"), &bare).unwrap().scene;
        assert_eq!((bare.sh_degree, bare.sh_rest.len()), (0, 0));
        assert_eq!(bare.coord, scene.coord);
        let longer = [&bytes[..], &[0; 5]].concat();
        assert_eq!(read(&longer).unwrap().report.count(Rule::FileTrailing), 1);
    }
}

#[test]
fn the_smallest_real_file() {
    let Some(path) = shared("real/fixtures/minimal.ksplat") else { return };
    let loaded = read_file(&path);
    let scene = &loaded.scene;
    assert_eq!(scene.coord, [[-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0; 3]]);
    assert_eq!(scene.log_scale[0], [0.1f32.ln(); 3]);
    assert_eq!(scene.color_u8(2), [0x55, 0xaa, 0x80]);
    assert!((scene.opacity(0) - 230.0 / 255.0).abs() < 1e-6);
    // Its fourth number is 1; the first is w.
    assert_eq!(scene.quat[0], [0.0, 0.0, 0.0, 1.0]);
}

fn compare(a: &GaussianScene, b: &GaussianScene, i: usize, j: usize, size: f32, color: f32) {
    for axis in 0..3 {
        let (x, y) = (a.coord[i][axis], b.coord[j][axis]);
        assert!((x - y).abs() <= size + 1e-5, "coord of row {i}: {x} {y}");
        let (x, y) = (a.log_scale[i][axis].exp(), b.log_scale[j][axis].exp());
        // Half floats: 11 bits, and steps of 6e-8 for the smallest.
        assert!((x - y).abs() <= y * (6e-4 + size) + 6e-8, "scale of row {i}: {x} {y}");
        let shown = |dc: f32| (0.5 + 0.282_094_8 * dc).clamp(0.0, 1.0);
        let (x, y) = (shown(a.sh_dc[i][axis]), shown(b.sh_dc[j][axis]));
        assert!((x - y).abs() <= 1.001 / 255.0 + color, "colour of row {i}: {x} {y}");
    }
    assert!((a.opacity(i) - b.opacity(j)).abs() <= 1.001 / 255.0 + color, "row {i}");
    let dot: f32 = (0..4).map(|k| a.quat[i][k] * b.quat[j][k]).sum();
    assert!(dot.abs() > 0.999_9, "rotation of row {i}: {dot}");
}

#[test]
fn parity_with_the_same_scene_in_ply() {
    let Some(plain) = shared("real/parity/playbot_lod4.ply") else { return };
    let plain = open_scene(&plain, &ReadOptions::default()).unwrap().scene;
    for (name, exact, rest) in
        [("l0", true, 1e-6f32), ("l1", false, 2e-3), ("l2", false, 4.06 / 255.0)]
    {
        let Some(path) = shared(&format!("real/parity/playbot_lod4.{name}.ksplat")) else {
            continue;
        };
        let scene = read_file(&path).scene;
        assert_eq!((scene.len(), scene.sh_degree), (8406, 2), "{name}");
        // Blocks of 5 in 65534 steps, rounded.
        let size = if exact { 0.0 } else { 5.0 / 65_534.0 / 2.0 };
        for row in 0..scene.len() {
            compare(&scene, &plain, row, row, size, 0.0);
            let values = row * 24..(row + 1) * 24;
            for (x, y) in scene.sh_rest[values.clone()].iter().zip(&plain.sh_rest[values]) {
                assert!((x - y).abs() <= rest, "{name} row {row}: {x} {y}");
            }
        }
    }
}

#[test]
fn parity_of_a_larger_scene() {
    let Some(ksplat) = shared("real/parity/biker.l1.ksplat") else { return };
    let a = read_file(&ksplat).scene;
    // Both come from the same scene, which was a compressed file itself, and have its order.
    for (name, size, color) in [
        ("real/objects/biker.compressed.ply", 4e-5, 0.0),
        ("real/parity/biker.compressed.ply", 1e-3, 0.5 / 255.0),
    ] {
        let Some(packed) = shared(name) else { continue };
        let b = open_scene(&packed, &ReadOptions::default()).unwrap().scene;
        assert_eq!((a.len(), b.len()), (152_746, 152_746));
        for row in 0..a.len() {
            compare(&a, &b, row, row, size, color);
        }
    }
}

#[test]
fn counts_that_lie() {
    let good = ksplat(1, &sections());
    read(&good).unwrap();
    let with = |at: usize, value: u32| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        read(&bytes)
    };
    let section = 4096;
    for (at, what) in [
        (4, "headers of sections"),
        (16, "counts 4294967295 Gaussians"),
        (20, "compression level 65535"),
        (section, "at most"),
        (section + 4, "Gaussians of 42 bytes"),
        (section + 8, "Gaussians in its buckets"),
        (section + 12, "centres of buckets"),
        (section + 20, "65535 bytes"),
        (section + 32, "centres"),
        (section + 36, "counts of buckets"),
        (section + 40, "degree 65535"),
    ] {
        let error = with(at, u32::MAX).unwrap_err().to_string();
        assert!(error.contains(what), "at {at}: {error}");
    }
    // Buckets that hold one too few or too many, and more than a bucket can.
    let fill = 4096 + 4 * 1024;
    for count in [2, 4, 5, 0, u32::MAX] {
        let error = with(fill, count).unwrap_err().to_string();
        assert!(error.contains("bucket"), "{count}: {error}");
    }
    assert!(with(section + 8, 0).is_err() && with(section + 32, 1).is_err());
    for (at, value) in [(16, 18), (16, 20), (16, 0), (section, 11), (4, 3), (4, 0)] {
        assert!(with(at, value).is_err(), "{value} at {at}");
    }
    let none = [&[0u8, 1][..], &[0; 4094]].concat();
    assert!(read(&none).unwrap_err().to_string().contains("no Gaussian"));
    assert!(read(&[&[1u8, 0][..], &[0; 4094]].concat()).unwrap_err().to_string().contains("1.0"));
    // Without sections the counts must not be believed either.
    let mut none = none;
    none[16] = 1;
    assert!(read(&none).unwrap_err().to_string().contains("sections hold 0"));
}

#[test]
fn damage_is_an_error_or_the_right_number_of_rows() {
    let mut fixtures: Vec<Vec<u8>> = (0..=2).map(|level| ksplat(level, &sections())).collect();
    fixtures.extend(shared("real/fixtures/minimal.ksplat").map(|p| std::fs::read(p).unwrap()));
    for bytes in &fixtures {
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "cut at {length} of {}", bytes.len());
        }
    }
    let mut rng = SplitMix(9);
    let (mut good, mut refused) = (0, 0);
    for round in 0..2000 * fixtures.len() {
        let mut bytes = fixtures[round % fixtures.len()].clone();
        let body = 4096 + 1024 * usize::from(bytes[4]);
        for _ in 0..=rng.below(3) {
            // Headers are mostly zeros: aim at their fields, or at the data.
            let at = match rng.below(3) {
                0 => rng.below(44),
                1 => 4096 + 1024 * rng.below((body - 4096) / 1024) + rng.below(44),
                _ => body + rng.below(bytes.len() - body),
            };
            bytes[at] = [rng.next() as u8, 0, 255, 1][rng.below(4)];
        }
        if rng.below(8) == 0 {
            bytes.truncate(rng.below(bytes.len()));
        }
        match std::panic::catch_unwind(|| (is_ksplat(&bytes), read(&bytes))) {
            Ok((_, Ok(loaded))) => {
                let count = u32::from_le_bytes([bytes[16], bytes[17], bytes[18], bytes[19]]);
                assert_eq!(loaded.source_rows(), count as usize, "round {round}");
                good += 1;
            }
            Ok((_, Err(_))) => refused += 1,
            Err(_) => panic!("round {round}"),
        }
    }
    assert!(good > 1000 && refused > 1000, "{good} read, {refused} refused");
}
