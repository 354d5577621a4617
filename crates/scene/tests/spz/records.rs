//! Frames, and what travels in extension records.

use crate::common::random_scene;
use crate::{
    HERE, close, compare_within_steps, dot, flat, gunzip, gzip, read, read_raw, write, write_with,
};
use half::f16;
use scenesplat_scene::formats::spz::read_spz;
use scenesplat_scene::{
    Frame, GaussianScene, LanguageCode, LanguageCodebook, ReadOptions, SpzFrame, WriteOptions,
};
use std::path::Path;

#[test]
fn frames_are_turned_into_each_other() {
    let scene = random_scene(500, 3, 2);
    for version in 2..=4 {
        let (raw, _) = write_with(
            &scene,
            &WriteOptions {
                spz_version: version,
                spz_frame: SpzFrame::Raw,
                overwrite: false,
                ..WriteOptions::default()
            },
        );
        // What is stored as it is, and read as right, up, back, is off by that frame.
        let mut turned = read(&raw).scene;
        let straight = read_raw(&raw).scene;
        turned.change_frame(Frame::CANONICAL, Frame::RUB);
        assert_eq!(turned, straight);
        // Codes of −1 and 0.992 are not each other's negative, so a clipped value may differ.
        compare_within_steps(&scene, &read(&write(&scene, version)).scene, version);
    }
}

/// A file of version 4, with one record before its table of contents.
fn with_record(file: &[u8], kind: u32, payload: &[u8]) -> Vec<u8> {
    let toc = u32::from_le_bytes(file[16..20].try_into().unwrap()) as usize;
    let mut out = file[..toc].to_vec();
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    out.extend_from_slice(payload);
    out[14] |= 2;
    let toc_now = out.len() as u32;
    out[16..20].copy_from_slice(&toc_now.to_le_bytes());
    out.extend_from_slice(&file[toc..]);
    out
}

/// A file of version 2 or 3, with one record at its end.
fn with_legacy_record(file: &[u8], kind: u32, payload: &[u8]) -> Vec<u8> {
    let mut body = gunzip(file);
    body[14] |= 2;
    body.extend_from_slice(&kind.to_le_bytes());
    body.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    body.extend_from_slice(payload);
    gzip(&body)
}

#[test]
fn a_file_may_say_which_frame_it_is_in() {
    const KIND: u32 = 0xadbe_0003;
    let scene = random_scene(500, 3, 12);
    // 6 is RDF, 7 LUF, 12 RFU: not turned, mirrored, and turned.
    for (number, frame) in [(4u32, "RUB"), (6, "RDF"), (7, "LUF"), (12, "RFU")] {
        let mut moved = scene.clone();
        moved.change_frame(Frame::CANONICAL, frame.parse().unwrap());
        for version in [3, 4] {
            let options = WriteOptions {
                spz_version: version,
                spz_frame: SpzFrame::Raw,
                overwrite: false,
                ..WriteOptions::default()
            };
            let (bytes, _) = write_with(&moved, &options);
            let payload = number.to_le_bytes();
            let bytes = match version {
                4 => with_record(&bytes, KIND, &payload),
                _ => with_legacy_record(&bytes, KIND, &payload),
            };
            let loaded = read(&bytes);
            assert!(loaded.report.notes[0].contains(frame), "{}", loaded.report);
            let due = {
                let mut due = read_raw(&bytes).scene;
                due.change_frame(frame.parse().unwrap(), Frame::CANONICAL);
                due
            };
            close(flat(&loaded.scene.coord), flat(&due.coord), 0.0);
            close(flat(&loaded.scene.coord), flat(&scene.coord), 1.23e-4);
            for (a, b) in loaded.scene.quat.iter().zip(&scene.quat) {
                assert!(dot(a, b) > 0.999_996, "{frame} {a:?} {b:?}");
            }
            close(&loaded.scene.sh_rest, &due.sh_rest, 1e-6);
            let notes = read_raw(&bytes).report.notes;
            assert!(notes[0].contains(frame) && notes[0].contains("not converted"), "{notes:?}");
        }
    }
    for version in [3, 4] {
        let bytes = write(&scene, version);
        let payload = [3; 24];
        let more = match version {
            4 => with_record(&bytes, 0x4e41_0001, &payload),
            _ => with_legacy_record(&bytes, 0x4e41_0001, &payload),
        };
        let loaded = read(&more);
        assert_eq!(loaded.scene, read(&bytes).scene);
        assert!(loaded.report.notes[0].contains("0x4e410001"), "{}", loaded.report);
    }
}

fn labelled(rows: usize, with_codes: bool) -> GaussianScene {
    let mut scene = random_scene(rows, 1, 77);
    scene.segment = Some((0..rows as i32).map(|i| i % 41 - 1).collect());
    scene.instance = Some((0..rows as i32).map(|i| i / 5 - 1).collect());
    scene.segment_score = Some((0..rows).map(|i| i as f32 / 7.0).collect());
    if with_codes {
        scene.lang_code = Some(LanguageCode {
            values: (0..rows * 16).map(|i| f16::from_f32((i % 97) as f32 - 40.0)).collect(),
            codebook: LanguageCodebook {
                mean: (0..768).map(|i| i as f32 / 768.0).collect(),
                axes: (0..16 * 768).map(|i| (i % 13) as f32 - 6.0).collect(),
            },
        });
    }
    scene
}

#[test]
fn labels_and_language_codes_come_along() {
    for version in 2..=4 {
        for (rows, with_codes) in [(1, true), (3000, false), (10_000, true)] {
            let scene = labelled(rows, with_codes);
            let bytes = write(&scene, version);
            let back = read(&bytes);
            assert_eq!(back.scene.segment, scene.segment);
            assert_eq!(back.scene.instance, scene.instance);
            assert_eq!(back.scene.segment_score, scene.segment_score);
            assert_eq!(back.scene.lang_code, scene.lang_code);
            assert!(back.report.notes.is_empty(), "{}", back.report);
            assert!(write(&back.scene, version) == bytes, "version {version}");
            let flags = if version == 4 { bytes[14] } else { gunzip(&bytes)[14] };
            assert_eq!(flags, 2);
        }
        let bytes = write(&random_scene(5, 0, 1), version);
        let flags = if version == 4 { bytes[14] } else { gunzip(&bytes)[14] };
        assert_eq!(flags, 0, "no labels, no records");
    }
}

#[test]
fn harmonics_are_left_out_on_request() {
    let options = ReadOptions { sh_rest: false, ..ReadOptions::default() };
    let scene = labelled(5000, false);
    for version in 2..=4 {
        let bytes = write(&scene, version);
        let bare = read_spz(&bytes, Path::new(HERE), &options).unwrap().scene;
        let mut whole = read(&bytes).scene;
        whole.sh_rest.clear();
        whole.sh_degree = 0;
        assert_eq!(bare, whole);
    }
}
