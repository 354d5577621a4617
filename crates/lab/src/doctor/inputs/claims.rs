//! Small files that claim to be large ones: nothing is reserved for what they cannot hold.

use super::files::{file_name, open, refused, scene};
use crate::doctor::case::Case;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::gemm::PackedMatrix;
use scenesplat_kernels::patch_attention::{Heads, forward};
use scenesplat_kernels::patches;
use scenesplat_rasterizer::View;
use scenesplat_rasterizer::segments::{SegmentFolder, SegmentOptions};
use scenesplat_rooms::{SyntheticRoomSettings, Vocabulary, generate};
use scenesplat_scene::picture::decode_picture;
use scenesplat_scene::{
    Policy as ReadPolicy, SceneFormat, WriteOptions, open_cameras, write_scene,
};
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("npy-of-2-to-40-rows", |t| npy_rows(t, "(1099511627776, 3)", 72, &["coord.npy"])),
        case("npy-whose-size-wraps", |t| {
            npy_rows(t, "(6148914691236517206, 3)", 72, &["coord.npy"])
        }),
        case("npy-of-other-rows", |t| npy_rows(t, "(5, 3)", 60, &["5", "6"])),
        case("splat-of-31-bytes", |t| {
            let path = t.file("scene.splat", &[7; 31])?;
            refused(open(&path, ReadPolicy::Repair), &["scene.splat"])
        }),
        case("glb-whose-length-lies", glb_length),
        case("png-bomb", png_bomb),
        case("png-of-4-billion-pixels", |t| {
            let bytes = png(65_535, 65_535);
            let path = t.file("picture.png", &bytes)?;
            refused(decode_picture(&bytes, &path), &["picture.png"])
        }),
        case("feature-table-without-rows", wide_table),
        case("camera-of-4-billion-pixels", camera_size),
        case("room-of-a-million-and-one", |_| {
            let num_gaussians = Some(usize::MAX);
            let settings =
                SyntheticRoomSettings { num_gaussians, ..SyntheticRoomSettings::default() };
            refused(generate(&settings), &["num_gaussians"])
        }),
        case("vocabulary-of-2-to-64", |_| {
            for dim in [0, 31, 1 << 20, usize::MAX] {
                refused(Vocabulary::new(dim), &[&dim.to_string()])?;
            }
            Ok(())
        }),
        case("lengths-that-wrap", |_| {
            let rows = usize::MAX / 2 + 2;
            let made = catch_unwind(|| PackedMatrix::from_strided(&[0.0; 4], rows, 2, 1, rows));
            ensure!(made.is_err(), "a matrix of 2^63 rows was made of 4 values");
            Ok(())
        }),
        case("order-that-is-no-permutation", no_permutation),
    ];
    cases.extend(
        [
            ("in-channels-2-to-62", "in_channels", "4611686018427387904"),
            ("in-channels-a-million", "in_channels", "1000000"),
            ("mlp-ratio-a-million", "mlp_ratio", "1000000"),
        ]
        .map(|(name, field, size)| {
            case(format!("config-{name}"), move |t| {
                let text =
                    format!("{{\"{field}\": {size}, \"input\": {{\"channels\": [\"color\"]}}}}");
                let path = t.file("config.json", text.as_bytes())?;
                refused(scenesplat::NetworkConfig::read(&path), &["config.json", field])
            })
        }),
    );
    cases
}

/// An array file that claims a shape.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    let padded = format!("{dict:<117}\n");
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend_from_slice(&(padded.len() as u16).to_le_bytes());
    out.extend_from_slice(padded.as_bytes());
    out.extend_from_slice(data);
    out
}

/// A scene of six Gaussians as a file.
fn written(trial: &Trial<'_>, format: SceneFormat) -> Result<PathBuf, Failure> {
    let path = trial.folder().join(file_name(format));
    write_scene(&scene(6, 0, 1), &path, format, &WriteOptions::default(), &mut |_| true)?;
    Ok(path)
}

/// A folder of arrays, one of which claims a shape for so many bytes; `words`: what the refusal says.
fn npy_rows(trial: &Trial<'_>, shape: &str, bytes: usize, words: &[&str]) -> Result<(), Failure> {
    let path = written(trial, SceneFormat::NpyFolder)?;
    std::fs::write(path.join("coord.npy"), npy("<f4", shape, &vec![0; bytes]))?;
    refused(open(&path, ReadPolicy::Repair), words)
}

fn glb_length(trial: &Trial<'_>) -> Result<(), Failure> {
    let path = written(trial, SceneFormat::Glb)?;
    let mut bytes = std::fs::read(&path)?;
    // The length of the whole file stands behind the magic word and the version.
    bytes[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    std::fs::write(&path, &bytes)?;
    refused(open(&path, ReadPolicy::Repair), &["scene.glb"])
}

/// A PNG file that says this size, with a few bytes of pixels.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |name: &[u8; 4], data: &[u8]| {
        out.extend_from_slice(&(data.len() as u32).to_be_bytes());
        out.extend_from_slice(name);
        out.extend_from_slice(data);
        out.extend_from_slice(&crc(&[name, data].concat()).to_be_bytes());
    };
    // 8 bits, red, green, blue.
    chunk(b"IHDR", &[&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 2, 0, 0, 0]].concat());
    // A deflate stream of one stored block of four bytes.
    chunk(b"IDAT", &[0x78, 0x01, 0x01, 4, 0, 0xfb, 0xff, 0, 0, 0, 0, 0, 4, 0, 1]);
    chunk(b"IEND", &[]);
    out
}

/// The checksum of PNG chunks.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |c, _| {
                if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 }
            },
        )
    })
}

fn png_bomb(trial: &Trial<'_>) -> Result<(), Failure> {
    // Within the largest size of a picture, so that only its own bytes tell.
    let bytes = png(11_000, 11_000);
    let path = trial.file("picture.png", &bytes)?;
    refused(decode_picture(&bytes, &path), &["11000", "cannot hold"])?;
    // A picture of that form with its own size is read.
    let small = png(1, 1);
    let path = trial.file("small.png", &small)?;
    let picture = decode_picture(&small, &path)?;
    ensure!((picture.width(), picture.height()) == (1, 1), "the small picture has another size");
    Ok(())
}

fn wide_table(trial: &Trial<'_>) -> Result<(), Failure> {
    let ids: Vec<u8> = [-1i32; 12].iter().flat_map(|v| v.to_le_bytes()).collect();
    trial.file("a_s.npy", &npy("<i4", "(1, 3, 4)", &ids))?;
    trial.file("a_f.npy", &npy("<f2", "(0, 16777216)", &[]))?;
    let folder = SegmentFolder::open(trial.folder(), SegmentOptions::default())?;
    refused(folder.read(0, 4, 3), &["a_f.npy", "16777216"])
}

fn camera_size(trial: &Trial<'_>) -> Result<(), Failure> {
    let text = r#"[{"id": 0, "img_name": "a", "width": 4294967295, "height": 4294967295,
        "position": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 4e9, "fy": 4e9}]"#;
    let path: &Path = &trial.file("cameras.json", text.as_bytes())?;
    let cameras = open_cameras(path)?.cameras;
    refused(View::from_camera(&cameras[0]), &["4294967295"])
}

fn no_permutation(_: &Trial<'_>) -> Result<(), Failure> {
    let heads = Heads { count: 1, dim: 16 };
    let rows = 64;
    let attend = |order: Vec<u32>, len: usize| {
        catch_unwind(move || {
            let patches = patches::cut(&[0, rows], 16);
            let qkv = vec![0.5; len * 3 * 16];
            let mut out = vec![0.0; rows * 16];
            forward(&qkv, heads, &patches, &order, &mut out);
            out[0]
        })
    };
    let good: Vec<u32> = (0..rows as u32).collect();
    ensure!(
        attend(good.clone(), rows).is_ok_and(|v| (v - 0.5).abs() < 1e-6),
        "a right order is refused"
    );
    for (what, order, len) in [
        ("a row twice", vec![0; rows], rows),
        ("a row beyond the end", good.iter().map(|r| r + 60).collect(), rows),
        ("too few rows", good, rows / 2),
    ] {
        ensure!(attend(order, len).is_err(), "{what} is taken");
    }
    Ok(())
}
