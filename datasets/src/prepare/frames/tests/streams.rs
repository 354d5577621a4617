//! ScanNet's streams, one file for all frames: whole, of two lenses, and damaged.

use super::*;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

/// A `.sens` file that a test may damage.
struct Sens {
    kinds: [i32; 2],
    steps: f32,
    frames: Vec<(Pose, Vec<u8>, Vec<u8>)>,
    /// Added to the principal point of the depth, x.
    shift: f32,
    count: Option<u64>,
}

impl Sens {
    fn new(depth_kind: i32) -> Self {
        let depth = |there| {
            let bytes: Vec<u8> = depths(there, 1000).iter().flat_map(|v| v.to_le_bytes()).collect();
            if depth_kind == 1 { zlib(&bytes) } else { bytes }
        };
        let lost = [[f64::NEG_INFINITY; 4]; 4];
        let frames = vec![
            (POSE, color(), depth(2000)),
            (lost, color(), depth(2000)),
            (POSE, color(), depth(u16::MAX)),
        ];
        Self { kinds: [1, depth_kind], steps: 1000.0, frames, shift: 0.0, count: None }
    }

    fn bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut put = |bytes: &[u8]| out.extend_from_slice(bytes);
        let matrix = |values: &Pose| -> Vec<u8> {
            values.as_flattened().iter().flat_map(|v| (*v as f32).to_le_bytes()).collect()
        };
        let lens = |shift: f64| {
            // Pixels of the file count from the center of the first: (3.5, 2.5) is the middle.
            let mut k = lens::IDENTITY;
            (k[0][0], k[1][1], k[0][2], k[1][2]) = (4.0, 4.0, 3.5 + shift, 2.5);
            matrix(&k)
        };
        let identity = matrix(&lens::IDENTITY);
        put(&4u32.to_le_bytes());
        put(&4u64.to_le_bytes());
        put(b"Mini");
        for bytes in [&lens(0.0), &identity, &lens(f64::from(self.shift)), &identity] {
            put(bytes);
        }
        self.kinds.iter().for_each(|kind| put(&kind.to_le_bytes()));
        [8u32, 6, 8, 6].iter().for_each(|side| put(&side.to_le_bytes()));
        put(&self.steps.to_le_bytes());
        put(&self.count.unwrap_or(self.frames.len() as u64).to_le_bytes());
        for (pose, color, depth) in &self.frames {
            put(&matrix(pose));
            for value in [0, 0, color.len() as u64, depth.len() as u64] {
                put(&value.to_le_bytes());
            }
            put(color);
            put(depth);
        }
        out
    }
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn scannet_streams() {
    let mini = Mini::new();
    for kind in [0, 1] {
        mini.write("a.sens", Sens::new(kind).bytes());
        // The file, and the folder that holds it.
        for path in [mini.at("a.sens"), mini.at("")] {
            let (frames, skipped, notes) = read(&path, FrameLayout::Scannet);
            assert_eq!(skipped, [("000001".to_owned(), SkipReason::PoseNotFinite)]);
            assert_eq!((frames.len(), notes.len()), (2, 0));
            near(world_point(&frames[0], PIXEL), POINT);
            assert_eq!((frames[0].camera.name.as_str(), frames[0].camera.cx), ("000000.png", 4.0));
            assert_eq!(frames[0].picture, color());
            // 65535 is unknown: a point at the camera.
            near(world_point(&frames[1], PIXEL), [1.0, 2.0, 3.0]);
        }
    }
    // Raw colors become a PNG.
    let mut sens = Sens::new(0);
    sens.kinds[0] = 0;
    sens.frames.iter_mut().for_each(|frame| frame.1 = vec![9; 8 * 6 * 3]);
    mini.write("a.sens", sens.bytes());
    let (frames, ..) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    let rgb =
        scenesplat_scene::picture::decode_picture(&frames[0].picture, Path::new("a")).unwrap();
    assert_eq!(rgb.to_rgb8().pixels()[47], [9; 3]);
    // 5000 steps per meter: 2000 are 0.4 m.
    mini.write("a.sens", Sens { steps: 5000.0, ..Sens::new(1) }.bytes());
    let (frames, ..) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    near(world_point(&frames[0], PIXEL), [1.4, 1.75, 3.15]);
}

/// A depth camera whose axis is two pixels to the right sees at (6, 1) what the color camera sees at (4, 1): in its axes
/// at 2 · ((4.5 − 4) / 4, (1.5 − 3) / 4, 1).
#[test]
fn depths_of_another_lens_are_brought_into_the_colors_pixels() {
    let mini = Mini::new();
    for (shift, resampled) in [(2.0, true), (0.9, false)] {
        mini.write("a.sens", Sens { shift, ..Sens::new(1) }.bytes());
        let (frames, ..) = read(&mini.at("a.sens"), FrameLayout::Scannet);
        assert_eq!(frames[0].depth.as_ref().unwrap().resampled, resampled);
        let (pixel, point) = if resampled { ([4, 1], [3.0, 1.75, 3.75]) } else { (PIXEL, POINT) };
        near(world_point(&frames[0], pixel), point);
    }
    // What the depth camera does not see is unknown: its last column is the color's last but two.
    mini.write("a.sens", Sens { shift: 2.0, ..Sens::new(1) }.bytes());
    let (frames, ..) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    let depth = &frames[0].depth.as_ref().unwrap().picture;
    let Samples::Sixteen(values) = depth.samples() else { panic!("16 bits") };
    assert_eq!(values[8..16], [1000, 1000, 1000, 1000, 2000, 1000, 0, 0]);
}

/// Numbers of the header by hand: lenses from byte 16 on, 64 bytes a matrix.
#[test]
fn a_stream_says_its_lenses_row_by_row_and_what_is_not_aligned() {
    let mini = Mini::new();
    let mut sens = Sens::new(1);
    sens.frames.truncate(1);
    sens.frames[0].0 = lenses::TURNED;
    let mut bytes = sens.bytes();
    let mut put = |at: usize, value: f32| bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    for matrix in [16, 144] {
        // Entries 0, 5, 2 and 6 of 16.
        for (at, value) in [(0, 5.0), (20, 3.0), (8, 2.75), (24, 2.25)] {
            put(matrix + at, value);
        }
    }
    mini.write("a.sens", &bytes);
    let (frames, _, notes) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    let camera = &frames[0].camera;
    assert_eq!([camera.fx, camera.fy, camera.cx, camera.cy], [5.0, 3.0, 3.25, 2.75]);
    for (got, want) in camera.camera_to_world().iter().zip(lenses::TURNED) {
        assert!((0..4).all(|k| (got[k] - want[k]).abs() < 1e-6), "{got:?} {want:?}");
    }
    assert!(notes.is_empty() && !frames[0].depth.as_ref().unwrap().resampled);
    // The places of the two cameras are the second and the fourth matrix.
    for (at, what) in [(80, "matrix of color is not"), (208, "matrix of depth is not")] {
        let mut moved = bytes.clone();
        moved[at + 12..at + 16].copy_from_slice(&1f32.to_le_bytes());
        mini.write("a.sens", &moved);
        let (_, _, notes) = read(&mini.at("a.sens"), FrameLayout::Scannet);
        assert!(notes.len() == 1 && notes[0].contains(what), "{notes:?}");
    }
    // A lens of the depth alone, far off: its own counts for the depth, not for the color.
    let mut other = bytes.clone();
    other[144..148].copy_from_slice(&9f32.to_le_bytes());
    mini.write("a.sens", &other);
    let (frames, ..) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    assert!(frames[0].camera.fx == 5.0 && frames[0].depth.as_ref().unwrap().resampled);
    // A frame without color is none, one without depth has none.
    let depth = sens.frames[0].2.clone();
    sens.frames = vec![(POSE, Vec::new(), depth), (POSE, color(), Vec::new())];
    mini.write("a.sens", sens.bytes());
    let (frames, skipped, _) = read(&mini.at("a.sens"), FrameLayout::Scannet);
    assert_eq!(skipped, [("000000".to_owned(), SkipReason::NoPicture)]);
    assert!(frames[0].camera.name == "000001.png" && frames[0].depth.is_none());
}

#[test]
fn damaged_streams_are_refused() {
    let mini = Mini::new();
    let (path, scannet) = (mini.at("a.sens"), FrameLayout::Scannet);
    let refuse = |bytes: &[u8], parts: &[&str]| {
        mini.write("a.sens", bytes);
        refused(&path, scannet, parts);
    };
    let whole = Sens::new(1).bytes();
    refuse(b"", &["ends after 0 bytes", "the header"]);
    refuse(&whole[..200], &["within the header", "fetch it again"]);
    refuse(&whole[..whole.len() - 1], &["a.sens", "within frame 2 of 3"]);
    refuse(&[&[9], &whole[1..]].concat(), &["begins with 9"]);
    let name = [&whole[..4], &u64::MAX.to_le_bytes(), &whole[12..]].concat();
    refuse(&name, &["name of the sensor"]);
    let count = |count| Sens { count: Some(count), ..Sens::new(1) }.bytes();
    refuse(&count(u64::MAX), &["18446744073709551615 frames", "cannot hold them"]);
    refuse(&count(0), &["no frames"]);
    let kinds = |kinds| Sens { kinds, ..Sens::new(1) }.bytes();
    refuse(&kinds([2, 2]), &["depths of kind 2", "export the scan"]);
    refuse(&kinds([-1, 1]), &["colors of kind -1"]);
    refuse(&Sens { steps: 0.0, ..Sens::new(1) }.bytes(), &["0 steps"]);
    let frame = |color: &[u8], depth: &[u8]| {
        let mut sens = Sens::new(1);
        sens.frames = vec![(POSE, color.to_vec(), depth.to_vec())];
        sens.bytes()
    };
    // 16 MB that unpack from 16 kB: no more than one byte beyond the size is unpacked.
    refuse(&frame(&color(), &zlib(&vec![0; 16 << 20])), &["97 bytes of depth or more"]);
    refuse(&frame(&color(), &zlib(&[0; 95])), &["95 bytes of depth"]);
    refuse(&frame(&color(), b"nothing"), &["frame 0", "cannot be unpacked"]);
    refuse(&frame(b"no picture", &zlib(&[0; 96])), &["no PNG or JPEG"]);
    let small = RgbPicture::filled(4, 3, [0; 3]).encode_png().unwrap();
    refuse(&frame(&small, &zlib(&[0; 96])), &["is 4 × 3", "8 × 6"]);
    // Sizes of a header are looked at before memory is reserved: 65535² pixels of depth.
    let mut huge = frame(&color(), &zlib(&[0; 96]));
    let at = 4 + 8 + 4 + 4 * 64 + 8 + 8;
    huge[at..at + 8].copy_from_slice(&[0xff, 0xff, 0, 0, 0xff, 0xff, 0, 0]);
    refuse(&huge, &["65535", "sizes"]);
    huge[at..at + 8].copy_from_slice(&[0, 0x20, 0, 0, 0, 0x20, 0, 0]);
    refuse(&huge, &["too few for its size"]);
    std::fs::remove_file(&path).unwrap();
    refused(&mini.at(""), scannet, &["neither a .sens file"]);
}
