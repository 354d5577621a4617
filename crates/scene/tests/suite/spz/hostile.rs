//! Files that lie, are cut off, or were damaged: an error or the truth, never a panic.

use crate::common::spz::{
    HERE, gunzip, gzip, header, open, problem, replace_stream, small_files, with_record, write,
};
use crate::common::{SplitMix, random_scene, strict};
use scenesplat_scene::formats::spz::{is_spz, read_spz};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{ReadOptions, open_scene_bytes};
use std::path::Path;

#[test]
fn bytes_that_follow_are_reported_and_refused_by_the_strict_policy() {
    let mut scene = random_scene(40, 1, 3);
    for labelled in [false, true] {
        scene.segment = labelled.then(|| vec![1; 40]);
        for version in 2..=4 {
            let mut bytes = write(&scene, version);
            let whole = open(&bytes).unwrap();
            assert_eq!(whole.report.count(Rule::FileTrailing), 0);
            bytes.extend_from_slice(b"more");
            let loaded = open(&bytes).unwrap();
            assert_eq!(loaded.scene, whole.scene);
            let finding = loaded.report.finding(Rule::FileTrailing).unwrap();
            assert_eq!((finding.first_element, finding.example.as_str()), (40, "4 bytes"));
            assert!(read_spz(&bytes, Path::new(HERE), &strict()).is_err());
        }
    }
    let mut body = gunzip(&write(&scene, 3));
    for mut bytes in [zstd::encode_all(&body[..], 3).unwrap(), gzip(&body)] {
        bytes.extend_from_slice(b"more");
        assert_eq!(
            open(&bytes).unwrap().report.finding(Rule::FileTrailing).unwrap().example,
            "4 bytes"
        );
    }
    // Within the stream, where nothing says that records follow.
    scene.segment = None;
    body = gunzip(&write(&scene, 3));
    body.push(0);
    for bytes in [gzip(&body), zstd::encode_all(&body[..], 3).unwrap(), body] {
        assert_eq!(open(&bytes).unwrap().report.count(Rule::FileTrailing), 1);
        assert!(read_spz(&bytes, Path::new(HERE), &strict()).is_err());
    }
}

#[test]
fn other_versions_and_degrees_are_named() {
    for (bytes, what) in [
        (header(0, 1, 0), "version 0"),
        (header(5, 1, 0), "version 5"),
        (header(3, 1, 5), "degree 5"),
        (header(3, 1, 255), "degree 255"),
        (gzip(&header(4, 1, 0)), "version 4 within a stream"),
        (gzip(b"some other file that was compressed"), "not with NGSP"),
        (zstd::encode_all(&b"some other file"[..], 3).unwrap(), "ends within its header"),
        (gzip(&[0; 1 << 20]), "not with NGSP"),
        (gzip(b""), "ends within its header"),
        (b"NGSP".to_vec(), "ends within its header"),
        (b"plyplyplyplyplyplyply".to_vec(), "not with NGSP"),
    ] {
        let text = problem(&bytes);
        assert!(text.contains(what), "{text}");
    }
    let mut bits = header(2, 1, 0);
    bits[13] = 32;
    assert!(problem(&bits).contains("32 fractional bits"));
    // No Gaussian at all is an error of its own.
    for bytes in [header(3, 0, 0), gzip(&header(2, 0, 3))] {
        assert!(problem(&bytes).contains(Rule::FileEmpty.about().bad_value));
    }
}

#[test]
fn only_streams_that_hold_an_spz_file_are_taken_for_one() {
    assert!(!is_spz(b"ply\n") && !is_spz(b"") && !is_spz(b"NGS") && !is_spz(b"PK\x03\x04"));
    for (name, bytes) in small_files() {
        for cut in [bytes.len(), bytes.len() / 2, 64, 4] {
            assert!(is_spz(&bytes[..cut]), "{name} cut to {cut}");
        }
    }
    let mut rng = SplitMix(3);
    let noise: Vec<u8> = (0..100_000).map(|_| rng.next() as u8).collect();
    for other in [&b"ply\nformat"[..], b"NGS", b"", &[0; 1 << 20], &noise] {
        for bytes in [gzip(other), zstd::encode_all(other, 3).unwrap()] {
            assert!(!is_spz(&bytes), "{} bytes of something else", other.len());
            let text = open_scene_bytes(&bytes, Path::new(HERE), &ReadOptions::default());
            let text = text.unwrap_err().to_string();
            let is_ply = other.starts_with(b"ply");
            let named =
                if is_ply { "-compressed PLY file" } else { "-compressed, but no .spz file" };
            assert!(text.contains(named), "{text}");
        }
    }
}

#[test]
fn a_table_of_contents_that_lies_is_refused() {
    let file = write(&random_scene(40, 1, 3), 4);
    let with = |at: usize, value: &[u8]| {
        let mut bytes = file.clone();
        bytes[at..at + value.len()].copy_from_slice(value);
        problem(&bytes)
    };
    for toc in [0u32, 31, file.len() as u32 + 1, u32::MAX] {
        assert!(with(16, &toc.to_le_bytes()).contains("table of contents at byte"));
    }
    assert!(with(16, &(file.len() as u32 - 5).to_le_bytes()).contains("ends within its table"));
    assert!(with(15, &[0]).contains("none of them for its positions"));
    assert!(with(15, &[255]).contains("table of contents"));
    assert!(with(12, &[0]).contains("more than its header calls for"));
    assert!(with(12, &[2]).contains("40 Gaussians take 960"));
    for i in 0..6 {
        let entry = 32 + 16 * i;
        for size in [1u64, 41 * 9, u64::MAX] {
            let text = with(entry + 8, &size.to_le_bytes());
            assert!(text.contains(&format!("take {size} bytes")), "{text}");
        }
        for size in [file.len() as u64, u64::MAX] {
            let text = with(entry, &size.to_le_bytes());
            assert!(text.contains(&format!("a stream {i} of {size} bytes")), "{text}");
        }
        // A byte less here is a byte more there: neither stream is whole.
        let size = u64::from_le_bytes(file[entry..entry + 8].try_into().unwrap());
        let text = with(entry, &(size - 1).to_le_bytes());
        let due = ["decompressed", "zstd", "end after"];
        assert!(due.iter().any(|due| text.contains(due)), "{text}");
        let text = problem(&replace_stream(&file, i, b"no zstd at all"));
        assert!(text.contains("are no zstd stream"), "{text}");
    }
}

#[test]
fn labels_that_lie_are_refused() {
    const LABELS: u32 = 0x5353_0001;
    let plain = write(&random_scene(40, 1, 3), 4);
    let with = |payload: &[u8]| problem(&with_record(&plain, LABELS, payload));
    let with_size = |payload: &[u8], size: u32| {
        let mut file = with_record(&plain, LABELS, payload);
        file[36..40].copy_from_slice(&size.to_le_bytes());
        problem(&file)
    };
    let frame = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).unwrap();
    let text = with(b"nothing");
    assert!(text.contains("labels are no zstd stream"), "{text}");
    let text = with(&frame(b"nothing"));
    assert!(text.contains("block of labels"), "{text}");
    assert!(with_size(b"nothing", 8).contains("7 of 8 bytes of an extension record"));
    assert!(with_size(b"", u32::MAX).contains("labels of 4294967295 bytes"));
    // 40 rows do not take 100 MiB, said or not.
    let text = with(&frame(&vec![0; 100 << 20]));
    assert!(text.contains("labels hold 104857600 bytes"), "{text}");
    // Those of another scene.
    let mut other = random_scene(41, 0, 1);
    other.segment = Some(vec![0; 41]);
    let other = write(&other, 4);
    let toc = u32::from_le_bytes(other[16..20].try_into().unwrap()) as usize;
    let text = with(&other[40..toc]);
    assert!(text.contains("41 Gaussians, not 40"), "{text}");
}
