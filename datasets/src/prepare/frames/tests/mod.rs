//! Each layout on a miniature made in the test: two or three frames of 8 × 6 pixels.
//!
//! All of them show one room: the camera of the first frame stands at (1, 2, 3) and looks along +x of the world, with +z
//! up; its lens has a focal length of 4 pixels and is centered. Its pixel (6, 1), whose center is (6.5, 1.5), is 2 m
//! away along the axis: in the camera's axes at 2 · ((6.5 − 4) / 4, (1.5 − 3) / 4, 1) = (1.25, −0.75, 2), which is
//! (1 + 2, 2 − 1.25, 3 + 0.75) in the world.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod checks;
mod depths;
mod layouts;
mod lenses;
mod streams;

use super::lens::{Lens, Pose};
use super::*;
use scenesplat_scene::formats::cameras::{open_cameras, write_cameras_json};
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use std::path::PathBuf;
use tempfile::TempDir;

const SIZE: [u32; 2] = [8, 6];
const PIXEL: [u32; 2] = [6, 1];
const POINT: [f64; 3] = [3.0, 0.75, 3.75];

/// Camera to world, axes right, down, forward: right is −y, down is −z, forward is +x.
const POSE: Pose =
    [[0.0, 0.0, 1.0, 1.0], [-1.0, 0.0, 0.0, 2.0], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
/// The same camera with axes right, up, back.
const OPENGL: Pose =
    [[0.0, 0.0, -1.0, 1.0], [-1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]];

struct Mini(TempDir);

impl Mini {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.at(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    fn picture(&self, name: &str) {
        self.write(name, color());
    }

    /// A depth with `there` at the pixel and `elsewhere` at the others.
    fn depth(&self, name: &str, there: u16, elsewhere: u16) {
        self.write(name, depth_png(SIZE, &depths(there, elsewhere)));
    }

    fn hdf5(&self, name: &str, values: &[f64], shape: &[u64]) {
        let path = self.at(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut file = hdf5_pure::FileBuilder::new();
        file.create_dataset("dataset").with_data(values).with_shape(shape);
        file.write(path).unwrap();
    }
}

/// A PNG of 8 × 6 pixels. Its bytes pass through whatever its name says.
fn color() -> Vec<u8> {
    RgbPicture::filled(SIZE[0], SIZE[1], [200, 100, 50]).encode_png().unwrap()
}

fn depths(there: u16, elsewhere: u16) -> Vec<u16> {
    let mut values = vec![elsewhere; 48];
    values[(PIXEL[1] * SIZE[0] + PIXEL[0]) as usize] = there;
    values
}

fn depth_png([width, height]: [u32; 2], values: &[u16]) -> Vec<u8> {
    let samples = Samples::Sixteen(values.to_vec());
    Picture::new(width, height, Channels::Gray, samples).unwrap().encode_png().unwrap()
}

/// 16 numbers as text.
fn words(pose: &Pose) -> String {
    pose.as_flattened().iter().map(|v| format!("{v} ")).collect()
}

/// A pose with one entry changed.
fn with(pose: &Pose, [row, column]: [usize; 2], value: f64) -> Pose {
    let mut out = *pose;
    out[row][column] = value;
    out
}

/// What was read: frames, and the names of others with the reason.
type Read = (Vec<PosedFrame>, Vec<(String, SkipReason)>, Vec<String>);

fn read(path: &Path, layout: FrameLayout) -> Read {
    let mut frames = open_frames(path, layout).unwrap();
    let (mut out, mut skipped) = (Vec::new(), Vec::new());
    for index in 0..frames.len() {
        match frames.read(index).unwrap() {
            FrameRead::Frame(frame) => out.push(*frame),
            FrameRead::Skipped { name, reason } => skipped.push((name, reason)),
        }
    }
    same_after_writing(&out);
    (out, skipped, frames.notes().to_vec())
}

/// That the written file of cameras is read with the same poses and lenses.
fn same_after_writing(frames: &[PosedFrame]) {
    let cameras: Vec<_> = frames.iter().map(|frame| frame.camera.clone()).collect();
    let mini = Mini::new();
    write_cameras_json(&cameras, &mini.at("cameras.json")).unwrap();
    let read = open_cameras(&mini.at("cameras.json")).unwrap().cameras;
    assert_eq!(read.len(), cameras.len());
    for (got, want) in read.iter().zip(&cameras) {
        assert_eq!((&got.name, got.width, got.height), (&want.name, want.width, want.height));
        assert_eq!((got.fx, got.fy, got.cx, got.cy), (want.fx, want.fy, want.cx, want.cy));
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        for (a, b) in got.camera_to_world().iter().zip(want.camera_to_world()) {
            assert!((0..4).all(|k| near(a[k], b[k])), "{a:?} {b:?}");
        }
    }
}

/// Where the center of a pixel is in the world, by camera and depth as `optimise` reads them.
fn world_point(frame: &PosedFrame, [x, y]: [u32; 2]) -> [f64; 3] {
    let depth = &frame.depth.as_ref().unwrap().picture;
    let Samples::Sixteen(values) = depth.samples() else { panic!("depth has 16 bits") };
    let camera = frame.camera.resized([depth.width(), depth.height()]);
    let z = f64::from(values[(y * depth.width() + x) as usize]) / STEPS_PER_METRE;
    let u = (f64::from(x) + 0.5 - camera.cx) / camera.fx * z;
    let v = (f64::from(y) + 0.5 - camera.cy) / camera.fy * z;
    camera.camera_to_world().map(|row| row[0] * u + row[1] * v + row[2] * z + row[3])[..3]
        .try_into()
        .unwrap()
}

#[track_caller]
fn near(got: [f64; 3], want: [f64; 3]) {
    assert!((0..3).all(|k| (got[k] - want[k]).abs() < 1e-3), "{got:?}, expected {want:?}");
}

/// The text of an error with its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let inner = error.source().map(|inner| format!(": {}", chain(inner)));
    format!("{error}{}", inner.unwrap_or_default())
}

/// That opening or reading fails, with these words.
#[track_caller]
fn refused(path: &Path, layout: FrameLayout, parts: &[&str]) {
    let error = match open_frames(path, layout) {
        Err(error) => error,
        Ok(mut frames) => {
            let all = (0..frames.len()).map(|index| frames.read(index));
            all.collect::<Result<Vec<_>, _>>().unwrap_err()
        }
    };
    let text = chain(&error);
    assert!(parts.iter().all(|part| text.contains(part)), "{parts:?}: {text}");
}

/// Names that differ in special letters alone would be one file.
#[test]
fn names_of_frames_are_told_apart() {
    let mini = Mini::new();
    let lens = Lens::of_corner([4.0, 4.0, 4.0, 3.0], None);
    mini.picture("a.png");
    let entry = |name: &str| files::FrameEntry {
        name: name.to_owned(),
        picture: Some(mini.at("a.png")),
        depth: None,
        pose: files::PoseOf::Known(Ok(POSE)),
        lens,
    };
    let list = vec![entry("a.b"), entry("a b")];
    let files = files::SeparateFiles { list, depth: files::DepthOf::Png(1.0), depth_lens: None };
    let listed = frame::Listed { files: Box::new(files), notes: Vec::new() };
    let mut frames = Frames::new(&mini.at(""), listed).unwrap();
    assert!(
        matches!(frames.read(0).unwrap(), FrameRead::Frame(frame) if frame.camera.name == "a_b.png")
    );
    assert!(chain(&frames.read(1).unwrap_err()).contains("two frames are called \"a_b\""));
}

/// 95 real frames: all are used, and neighbors see the same surface.
#[test]
fn a_real_kitchen() {
    let Some(folder) = scenesplat_test_support::shared("real/kitchen") else { return };
    let mut frames = open_frames(&folder, FrameLayout::Rgbd).unwrap();
    assert_eq!(frames.len(), 95);
    let mut seen = Vec::new();
    for index in [0, 1] {
        let FrameRead::Frame(frame) = frames.read(index).unwrap() else { panic!("skipped") };
        seen.push(*frame);
    }
    assert_eq!(seen[0].camera.name, "frame-000010.jpg");
    assert_eq!(seen[0].picture, std::fs::read(folder.join("frame-000010.color.jpg")).unwrap());
    let depth = |frame: &PosedFrame| match frame.depth.as_ref().unwrap().picture.samples() {
        Samples::Sixteen(values) => values.clone(),
        Samples::Eight(_) => panic!("16 bits"),
    };
    let (near, far) = (depth(&seen[0]), depth(&seen[1]));
    assert!(!near.contains(&u16::MAX) && near.contains(&0));
    // Points of the first frame, as the second sees them: their depths are those that it measured, to within 5 cm.
    let (mut agree, mut all) = (0, 0);
    for at in (0..near.len()).step_by(997).filter(|at| near[*at] > 0) {
        let point = world_point(&seen[0], [(at % 640) as u32, (at / 640) as u32]);
        let Some(pixel) = seen[1].camera.project(point).filter(|p| seen[1].camera.contains(*p))
        else {
            continue;
        };
        let measured = far[pixel[1] as usize * 640 + pixel[0] as usize];
        if measured > 0 {
            all += 1;
            let expected = seen[1].camera.to_camera(point)[2];
            agree += usize::from((expected - f64::from(measured) / 1000.0).abs() < 0.05);
        }
    }
    assert!(all > 100 && agree * 10 > all * 8, "{agree} of {all}");
}
