//! SPZ files: written and read with all the options, and taken apart.

use super::{close, dot, flat, random_scene, write_as};
use scenesplat_scene::formats::spz::read_spz;
use scenesplat_scene::{
    GaussianScene, LoadedScene, ReadOptions, SceneError, SceneFormat, SpzFrame, WriteOptions,
    WriteReport,
};
use std::io::{Read, Write};
use std::path::Path;

pub const HERE: &str = "a.spz";

pub fn open(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    read_spz(bytes, Path::new(HERE), &ReadOptions::default())
}

pub fn read(bytes: &[u8]) -> LoadedScene {
    open(bytes).unwrap()
}

pub fn problem(bytes: &[u8]) -> String {
    let text = open(bytes).unwrap_err().to_string();
    assert!(text.starts_with("a.spz: "), "{text}");
    text
}

pub fn read_raw(bytes: &[u8]) -> LoadedScene {
    let options = ReadOptions { spz_frame: SpzFrame::Raw, ..ReadOptions::default() };
    read_spz(bytes, Path::new(HERE), &options).unwrap()
}

pub fn write_with(scene: &GaussianScene, options: &WriteOptions) -> (Vec<u8>, WriteReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(HERE);
    let report = write_as(scene, &path, SceneFormat::Spz, options).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((report.bytes, report.gaussians), (bytes.len() as u64, scene.len()));
    assert_eq!(report.files, [path]);
    (bytes, report)
}

pub fn write(scene: &GaussianScene, spz_version: u8) -> Vec<u8> {
    write_with(scene, &WriteOptions { spz_version, ..WriteOptions::default() }).0
}

/// `stored` is `scene` after it was an SPZ file.
pub fn compare_within_steps(scene: &GaussianScene, stored: &GaussianScene, version: u8) {
    assert_eq!((scene.len(), scene.sh_degree), (stored.len(), stored.sh_degree));
    close(flat(&scene.coord), flat(&stored.coord), 0.5 / 4096.0 * 1.001);
    let clip = |v: &[f32], min: f32, max: f32| -> Vec<f32> {
        v.iter().map(|v| v.clamp(min, max)).collect()
    };
    let dc = 0.5 / 0.15f32;
    close(&clip(flat(&scene.sh_dc), -dc, dc), flat(&stored.sh_dc), dc / 255.0 * 1.001);
    close(&clip(flat(&scene.log_scale), -10.0, 5.9375), flat(&stored.log_scale), 0.031_26);
    for row in 0..scene.len() {
        let (a, b) = (scene.opacity(row), stored.opacity(row));
        assert!((a - b).abs() <= 0.5 / 255.0 * 1.001, "{a} {b}");
        // 8 bits leave w to follow: worst where it is small. 10 bits: half a step in three.
        let due = if version == 2 { 0.995 } else { 0.999_996 };
        let dot = dot(&scene.quat[row], &stored.quat[row]);
        assert!(dot >= due, "row {row}: {dot}, {:?} {:?}", scene.quat[row], stored.quat[row]);
    }
    let width = scene.sh_rest_len() * 3;
    for (i, (a, b)) in scene.sh_rest.iter().zip(&stored.sh_rest).enumerate() {
        // Rounded to 1/128, then to a bucket of 8 or 16 of them; the sign of the frame may turn the
        // clipped end around.
        let bucket = if i % width < 9 { 8.0 } else { 16.0 };
        assert!((a.clamp(-1.0, 1.0) - b).abs() <= (bucket / 2.0 + 0.51) / 128.0, "{i}: {a} {b}");
    }
}

/// The decompressed streams of a file of version 4.
pub fn streams(file: &[u8]) -> Vec<Vec<u8>> {
    let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
    let (toc, num) = (word(16), usize::from(file[15]));
    let mut at = toc + 16 * num;
    let mut out = Vec::new();
    for i in 0..num {
        let size = word(toc + 16 * i);
        out.push(zstd::decode_all(&file[at..at + size]).unwrap());
        at += size;
    }
    assert_eq!(at, file.len());
    out
}

pub fn gunzip(file: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    flate2::read::GzDecoder::new(file).read_to_end(&mut body).unwrap();
    body
}

pub fn gzip(body: &[u8]) -> Vec<u8> {
    let mut to = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    to.write_all(body).unwrap();
    to.finish().unwrap()
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

/// A file with one extension record: before the table of contents in version 4, else at its end.
pub fn with_record(file: &[u8], kind: u32, payload: &[u8]) -> Vec<u8> {
    let record = [&kind.to_le_bytes(), &(payload.len() as u32).to_le_bytes(), payload].concat();
    if !file.starts_with(b"NGSP") {
        let mut body = gunzip(file);
        body[14] |= 2;
        return gzip(&[body, record].concat());
    }
    let toc = u32::from_le_bytes(file[16..20].try_into().unwrap()) as usize;
    let mut out = [&file[..toc], &record, &file[toc..]].concat();
    out[14] |= 2;
    out[16..20].copy_from_slice(&((toc + record.len()) as u32).to_le_bytes());
    out
}
