//! Files that lie, are cut off, or were damaged: an error or the truth, never a panic.

use crate::common::{SplitMix, random_scene, shared};
use crate::{HERE, gunzip, gzip, write};
use scenesplat_scene::formats::spz::{is_spz, read_spz};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{LoadedScene, Policy, ReadOptions, SceneError, open_scene_bytes};
use std::path::Path;

pub fn open(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_spz(bytes, Path::new(HERE), &ReadOptions::default())
}

pub fn problem(bytes: &[u8]) -> String {
    let text = open(bytes).unwrap_err().to_string();
    assert!(text.starts_with("a.spz: "), "{text}");
    text
}

/// The header of a file of version 1 to 3.
pub fn header(version: u32, rows: u32, degree: u8) -> Vec<u8> {
    let mut out = b"NGSP".to_vec();
    out.extend_from_slice(&version.to_le_bytes());
    out.extend_from_slice(&rows.to_le_bytes());
    out.extend_from_slice(&[degree, 12, 0, 0]);
    out
}

/// A small file of every kind, with labels.
pub fn small_files() -> Vec<(&'static str, Vec<u8>)> {
    let mut scene = random_scene(40, 1, 3);
    scene.segment = Some((0..40).collect());
    let (v2, v3, v4) = (write(&scene, 2), write(&scene, 3), write(&scene, 4));
    let body = gunzip(&v3);
    let wrapped = zstd::encode_all(&body[..], 5).unwrap();
    vec![("v2", v2), ("v3", v3), ("v4", v4), ("wrapped", wrapped), ("raw", body)]
}

#[test]
fn a_file_that_is_cut_anywhere_is_refused() {
    for (name, bytes) in small_files() {
        assert_eq!(open(&bytes).unwrap().scene.len(), 40, "{name}");
        for cut in 0..bytes.len() {
            let result = open(&bytes[..cut]);
            // A raw file that ends where a record of labels would begin has just none.
            let without_labels = name == "raw" && cut == 16 + 40 * 29;
            assert_eq!(result.is_ok(), without_labels, "{name} cut to {cut} of {}", bytes.len());
        }
    }
}

#[test]
fn bytes_that_follow_are_reported_and_refused_by_the_strict_policy() {
    let strict = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
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
            assert!(read_spz(&bytes, Path::new(HERE), &strict).is_err());
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
        assert!(read_spz(&bytes, Path::new(HERE), &strict).is_err());
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
            assert!(text.contains("-compressed, but no .spz file"), "{text}");
        }
    }
}

/// A file of version 4 with another stream `i`; the size in the table is left as it is.
pub fn replace_stream(file: &[u8], i: usize, stream: &[u8]) -> Vec<u8> {
    let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap()) as usize;
    let toc = u32::from_le_bytes(file[16..20].try_into().unwrap()) as usize;
    let start =
        toc + 16 * usize::from(file[15]) + (0..i).map(|i| number(toc + 16 * i)).sum::<usize>();
    let end = start + number(toc + 16 * i);
    let mut out = [&file[..start], stream, &file[end..]].concat();
    out[toc + 16 * i..][..8].copy_from_slice(&(stream.len() as u64).to_le_bytes());
    out
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
    const LABELS: [u8; 4] = 0x5353_0001u32.to_le_bytes();
    let plain = write(&random_scene(40, 1, 3), 4);
    let with = |payload: &[u8], size: u32| {
        let mut out = plain[..32].to_vec();
        out[14] |= 2;
        out[16..20].copy_from_slice(&(40 + payload.len() as u32).to_le_bytes());
        out.extend_from_slice(&LABELS);
        out.extend_from_slice(&size.to_le_bytes());
        out.extend_from_slice(payload);
        out.extend_from_slice(&plain[32..]);
        problem(&out)
    };
    let frame = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).unwrap();
    let text = with(b"nothing", 7);
    assert!(text.contains("labels are no zstd stream"), "{text}");
    let text = with(&frame(b"nothing"), frame(b"nothing").len() as u32);
    assert!(text.contains("block of labels"), "{text}");
    assert!(with(b"nothing", 8).contains("7 of 8 bytes of an extension record"));
    assert!(with(b"", u32::MAX).contains("labels of 4294967295 bytes"));
    // 40 rows do not take 100 MiB, said or not.
    let huge = frame(&vec![0; 100 << 20]);
    let text = with(&huge, huge.len() as u32);
    assert!(text.contains("labels hold 104857600 bytes"), "{text}");
    // Those of another scene.
    let mut other = random_scene(41, 0, 1);
    other.segment = Some(vec![0; 41]);
    let other = write(&other, 4);
    let toc = u32::from_le_bytes(other[16..20].try_into().unwrap()) as usize;
    let text = with(&other[40..toc], (toc - 40) as u32);
    assert!(text.contains("41 Gaussians, not 40"), "{text}");
}

/// Opens damaged copies of a file: the right number of rows, or an error, never anything else.
fn mutate(name: &str, bytes: &[u8], rows: usize, times: usize) {
    let mut rng = SplitMix(rows as u64 ^ bytes.len() as u64);
    for i in 0..times {
        let mut copy = bytes.to_vec();
        for _ in 0..=rng.below(3) {
            // Half of them in the header, where most can go wrong.
            let at =
                if i % 2 == 0 { rng.below(copy.len().min(160)) } else { rng.below(copy.len()) };
            match rng.below(4) {
                0 => copy[at] = rng.next() as u8,
                1 => copy[at] ^= 1 << rng.below(8),
                2 => copy[at] = [0, 255][rng.below(2)],
                _ => copy.truncate(at + 1),
            }
        }
        if let Ok(loaded) = open(&copy) {
            let claimed = match &copy[..] {
                [b'N', b'G', b'S', b'P', ..] => {
                    u32::from_le_bytes(copy[8..12].try_into().unwrap()) as usize
                }
                _ => rows,
            };
            assert_eq!(loaded.source_rows(), claimed, "{name}, mutation {i}");
            let dropped = loaded.report.dropped_rows;
            assert_eq!(loaded.scene.len() + dropped, claimed, "{name}, mutation {i}");
            loaded.scene.check_rows().unwrap();
        }
    }
}

#[test]
fn damaged_files_give_errors_or_as_many_rows_as_they_say() {
    for (name, bytes) in small_files() {
        mutate(name, &bytes, 40, 2000);
        // Damage within the stream, behind its checksum.
        if name == "raw" {
            let mut rng = SplitMix(1);
            for i in 0..2000 {
                let mut body = bytes.clone();
                let at = if i % 2 == 0 { rng.below(16) } else { rng.below(body.len()) };
                body[at] ^= 1 << rng.below(8);
                let claimed = u32::from_le_bytes(body[8..12].try_into().unwrap()) as usize;
                for bytes in [gzip(&body), zstd::bulk::compress(&body, 1).unwrap()] {
                    if let Ok(loaded) = open(&bytes) {
                        assert_eq!(loaded.source_rows(), claimed);
                    }
                }
            }
        }
    }
    for name in ["minimal-raw", "minimal-v2", "minimal-v3", "minimal-v4"] {
        let Some(path) = shared(&format!("real/fixtures/{name}.spz")) else { continue };
        mutate(name, &std::fs::read(path).unwrap(), 4, 2000);
    }
    // Large enough for several threads and for streams of many blocks.
    for version in 2..=4 {
        let name = format!("real/parity/playbot_lod4.v{version}.spz");
        let Some(path) = shared(&name) else { continue };
        mutate(&name, &std::fs::read(path).unwrap(), 8406, 60);
    }
}
