//! Files that other programs wrote. Skipped, with a line saying so, where they are not installed.

use crate::common::spz::{
    HERE, compare_within_steps, gunzip, read, read_raw, streams, write, write_with,
};
use crate::common::{self, close, dot, flat, random_scene, shared, strict};
use half::f16;
use scenesplat_scene::formats::spz::{is_spz, read_spz};
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneFormat, SpzFrame, WriteOptions,
};
use std::io::Write;
use std::path::Path;

/// A real file, read by the strict policy as it is.
fn real(relative: &str) -> Option<LoadedScene> {
    let path = shared(relative)?;
    let bytes = std::fs::read(&path).unwrap();
    assert!(is_spz(&bytes[..64.min(bytes.len())]), "{relative}");
    let options = ReadOptions { spz_frame: SpzFrame::Raw, ..strict() };
    let loaded = read_spz(&bytes, &path, &options).unwrap();
    assert_eq!(loaded.kind, SceneFormat::Spz);
    assert!(loaded.report.notes.is_empty(), "{}", loaded.report);
    Some(loaded)
}

#[test]
fn the_first_rows_are_as_unpacked_by_hand() {
    if let Some(loaded) = real("real/objects/biker.spz") {
        let scene = &loaded.scene;
        assert_eq!(scene.coord[0], [-428.0, 9781.0, 1478.0].map(|v| v / 4096.0));
        assert_eq!(scene.log_scale[0], [-6.0625, -4.1875, -7.0625]);
        // In the file w is negative; the same rotation.
        close(&scene.quat[0], &[0.460_796, -0.062_27, -0.885_042, -0.022_14], 1e-6);
        let alpha = f32::from(0x12u8) / 255.0;
        close(&[scene.opacity_logit[0]], &[(alpha / (1.0 - alpha)).ln()], 1e-6);
        let dc = [0x94u8, 0x93, 0x95].map(|b| (f32::from(b) / 255.0 - 0.5) / 0.15);
        assert_eq!(scene.sh_dc[0], dc);
    }
    if let Some(loaded) = real("real/objects/robocop.v2-zstdwrapped.spz") {
        let quat = [0.799_058, -0.568_628, 0.035_294, 0.192_157];
        close(&loaded.scene.quat[0], &quat, 1e-6);
    }
    // The same square in all; the older files are turned upside down.
    for (name, z, color) in [
        ("real/fixtures/minimal-raw.spz", -1.0, 10.0 / 9.0),
        ("real/fixtures/minimal-v2.spz", -1.0, 10.0 / 9.0),
        ("real/fixtures/minimal-v3.spz", 1.0, 10.0 / 17.0),
        ("real/fixtures/minimal-v4.spz", 1.0, 10.0 / 17.0),
    ] {
        let Some(loaded) = real(name) else { continue };
        let scene = &loaded.scene;
        let corners = [[-1.0, 0.0, z], [0.0, 0.0, z], [-1.0, 0.0, 0.0], [0.0; 3]];
        assert_eq!(scene.coord, corners, "{name}");
        assert_eq!(scene.log_scale, [[f32::from(0x7bu8) / 16.0 - 10.0; 3]; 4]);
        for row in 0..4 {
            let sign = [1, 2].map(|bit| if row & bit == 0 { -color } else { color });
            close(&scene.sh_dc[row], &[sign[0], sign[1], 0.5 / 255.0 / 0.15], 1e-6);
            assert_eq!(scene.opacity(row), f32::from(0xe6u8) / 255.0);
            close(&scene.quat[row], &[1.0, 0.0, 0.0, 0.0], 0.004);
        }
    }
}

#[test]
fn biker_agrees_with_its_compressed_ply() {
    let (Some(spz), Some(ply)) =
        (shared("real/objects/biker.spz"), shared("real/objects/biker.compressed.ply"))
    else {
        return;
    };
    let a = read(&std::fs::read(spz).unwrap()).scene;
    let b = common::open(&ply).scene;
    assert_eq!(a.len(), b.len());
    close(flat(&a.coord), flat(&b.coord), 1.2208e-4);
    // Smaller ones do not fit into a byte.
    let scale: Vec<f32> = flat(&b.log_scale).iter().map(|v| v.max(-10.0)).collect();
    close(flat(&a.log_scale), &scale, 0.031_25 + 0.005);
    assert_eq!(a.opacity_logit, b.opacity_logit);
    let rgb = |scene: &GaussianScene| -> Vec<f32> {
        flat(&scene.sh_dc).iter().map(|dc| 0.5 + 0.282_094_8 * dc).collect()
    };
    close(&rgb(&a), &rgb(&b), 3.7e-3);
    let worst = a.quat.iter().zip(&b.quat).map(|(a, b)| dot(a, b)).fold(1.0, f64::min);
    assert!(worst > 0.999_999, "{worst}");
}

#[test]
fn playbot_agrees_with_its_ply_within_each_step() {
    let Some(ply) = shared("real/parity/playbot_lod4.ply") else { return };
    let ply = common::open(&ply).scene;
    for version in 2..=4 {
        let name = format!("real/parity/playbot_lod4.v{version}.spz");
        let Some(path) = shared(&name) else { continue };
        compare_within_steps(&ply, &read(&std::fs::read(path).unwrap()).scene, version);
    }
}

#[test]
fn what_the_reference_wrote_is_written_again_byte_for_byte() {
    for name in ["objects/biker.spz", "parity/biker.v4.spz", "parity/playbot_lod4.v4.spz"] {
        let Some(path) = shared(&format!("real/{name}")) else { continue };
        let file = std::fs::read(path).unwrap();
        for frame in [SpzFrame::Rub, SpzFrame::Raw] {
            let options = ReadOptions { spz_frame: frame, ..ReadOptions::default() };
            let scene = read_spz(&file, Path::new(HERE), &options).unwrap().scene;
            let options = WriteOptions { spz_frame: frame, ..WriteOptions::default() };
            let (again, report) = write_with(&scene, &options);
            assert_eq!(again[..32], file[..32], "{name}");
            for (i, (a, b)) in streams(&file).iter().zip(streams(&again)).enumerate() {
                assert_eq!(a.len(), b.len());
                if i != 4 {
                    assert!(*a == b, "{name}, {frame:?}, stream {i}");
                    continue;
                }
                // Of two components that are the largest within rounding, the one that is left out
                // may come back as the smaller one; then the other is left out.
                let codes = a.as_chunks::<4>().0.iter().zip(b.as_chunks::<4>().0);
                let other: Vec<usize> =
                    (0..).zip(codes).filter(|(_, (a, b))| a != b).map(|(row, _)| row).collect();
                println!("{name}: {} of {} rotations differ", other.len(), scene.len());
                assert!(other.len() <= scene.len() / 400, "{other:?}");
                for row in other {
                    let mut sizes = scene.quat[row].map(f32::abs);
                    sizes.sort_by(f32::total_cmp);
                    assert!(sizes[3] - sizes[2] < 0.7072 / 511.0, "{:?}", scene.quat[row]);
                }
            }
            assert!(report.limits.is_empty(), "{name}: {report}");
        }
    }
}

#[test]
fn our_encoder_makes_the_bytes_of_the_reference_from_the_ply() {
    let (Some(ply), Some(spz)) =
        (shared("real/objects/biker.compressed.ply"), shared("real/objects/biker.spz"))
    else {
        return;
    };
    let scene = common::open(&ply).scene;
    let ours = streams(&write(&scene, 4));
    let theirs = streams(&std::fs::read(spz).unwrap());
    assert!(ours[..4] == theirs[..4], "positions, alphas, colors and scales");
    let codes = ours[4].as_chunks::<4>().0.iter().zip(theirs[4].as_chunks::<4>().0);
    // The same ties as above: ours are written so that they stay what they are.
    assert!(codes.filter(|(a, b)| a != b).count() <= 3);
}

#[test]
fn version_1_has_half_floats() {
    let mut file = b"NGSP\x01\0\0\0\x02\0\0\0\0\0\0\0".to_vec();
    for value in [1.0, -2.5, 0.0, 1000.0, 0.125, -0.001] {
        file.extend_from_slice(&f16::from_f32(value).to_le_bytes());
    }
    file.extend_from_slice(&[0, 255]);
    file.extend_from_slice(&[[0; 3], [255; 3], [160; 3], [255; 3]].concat());
    file.extend_from_slice(&[128, 128, 128, 255, 128, 128]);
    let loaded = read(&file);
    let small = f16::from_f32(-0.001).to_f32();
    assert_eq!(loaded.scene.coord, [[1.0, 2.5, 0.0], [1000.0, -0.125, -small]]);
    assert!(loaded.scene.coord[0][2].is_sign_positive());
    assert_eq!(loaded.scene.opacity_logit, [f32::NEG_INFINITY, f32::INFINITY]);
    assert_eq!(loaded.scene.log_scale, [[0.0; 3], [5.9375; 3]]);
    close(flat(&loaded.scene.sh_dc), &[[-10.0 / 3.0; 3], [10.0 / 3.0; 3]].concat(), 1e-6);
    let half = 0.5 / 127.5f32;
    close(&loaded.scene.quat[0], &[0.999_977, half, -half, -half], 1e-6);
    close(&loaded.scene.quat[1], &[0.0, 0.999_985, -half, -half], 1e-6);
    let raw = read_raw(&file).scene;
    assert_eq!(raw.coord, [[1.0, -2.5, 0.0], [1000.0, 0.125, small]]);
}

#[test]
fn frames_need_not_say_how_long_they_are() {
    let scene = random_scene(20_000, 2, 21);
    let file = write(&scene, 4);
    let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap());
    let mut head = file[..32].to_vec();
    let mut frames = Vec::new();
    for (i, stream) in streams(&file).into_iter().enumerate() {
        let mut to = zstd::stream::Encoder::new(Vec::new(), 3).unwrap();
        to.include_contentsize(false).unwrap();
        to.include_checksum(true).unwrap();
        // Two frames one after the other are a stream, too.
        to.write_all(&stream[..1000]).unwrap();
        let mut frame = to.finish().unwrap();
        frame.extend(zstd::encode_all(&stream[1000..], 3).unwrap());
        head.extend_from_slice(&(frame.len() as u64).to_le_bytes());
        head.extend_from_slice(&number(32 + 16 * i + 8).to_le_bytes());
        frames.extend(frame);
    }
    assert_eq!(read(&[head, frames].concat()).scene, read(&file).scene);
    let body = gunzip(&write(&scene, 3));
    let mut to = zstd::stream::Encoder::new(Vec::new(), 3).unwrap();
    to.include_contentsize(false).unwrap();
    to.write_all(&body).unwrap();
    assert_eq!(read(&to.finish().unwrap()).scene, read(&write(&scene, 3)).scene);
}
