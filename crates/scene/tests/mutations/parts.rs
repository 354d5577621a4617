//! What belongs to scenes and is read by itself: cameras, arrays of a folder, blocks of labels.

use crate::common::{language_code, random_scene};
use scenesplat_scene::formats::cameras::{
    read_cameras_json, read_colmap_binary, read_colmap_text, read_transforms_json,
};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::semantics;
use scenesplat_scene::{GaussianScene, RepairReport};
use std::path::Path;

/// Bytes and the reader they are for, which gives how much it read.
pub struct Part {
    /// For messages.
    pub name: &'static str,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Reads them; checks that what was read is whole.
    pub open: fn(&[u8]) -> Option<usize>,
}

const ROWS: usize = 200;

/// One of each.
pub fn all() -> Vec<Part> {
    let mut scene = random_scene(ROWS, 0, 3);
    scene.segment = Some(vec![2; ROWS]);
    scene.segment_score = Some(vec![0.5; ROWS]);
    scene.lang_code = Some(language_code(ROWS, 4, 16));
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    write_npy_folder(&scene, &folder, false).unwrap();
    let npy = |name: &str| std::fs::read(folder.join(format!("{name}.npy"))).unwrap();
    vec![
        Part { name: "coord.npy", bytes: npy("coord"), open: open_npy },
        Part { name: "color.npy", bytes: npy("color"), open: open_npy },
        Part { name: "lang_code.npy", bytes: npy("lang_code"), open: open_npy },
        Part { name: "labels", bytes: semantics::encode(&scene, None).unwrap(), open: open_labels },
        Part { name: "cameras.json", bytes: cameras_json(), open: open_cameras_json },
        Part { name: "transforms.json", bytes: transforms_json(), open: open_transforms_json },
        Part { name: "COLMAP binary", bytes: colmap_binary(), open: open_colmap_binary },
        Part { name: "COLMAP text", bytes: colmap_text(), open: open_colmap_text },
    ]
}

fn open_npy(bytes: &[u8]) -> Option<usize> {
    let file = NpyFile::from_bytes(bytes, Path::new("a.npy")).ok()?;
    let values = file.read_f64().ok()?;
    assert_eq!(values.len(), file.len());
    assert_eq!(values.len(), file.shape().iter().product::<usize>());
    Some(values.len())
}

fn open_labels(bytes: &[u8]) -> Option<usize> {
    let mut scene = GaussianScene {
        coord: vec![[0.0; 3]; ROWS],
        log_scale: vec![[0.0; 3]; ROWS],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; ROWS],
        opacity_logit: vec![0.0; ROWS],
        sh_dc: vec![[0.0; 3]; ROWS],
        ..GaussianScene::default()
    };
    let mut report = RepairReport::default();
    semantics::decode(bytes, ROWS, &mut scene, &mut report, Path::new("a")).ok()?;
    scene.check_rows().unwrap();
    Some(ROWS)
}

fn cameras_json() -> Vec<u8> {
    let camera = |i: usize| {
        format!(
            r#"{{"id":{i},"img_name":"{i}.png","width":640,"height":480,"position":[{i}.5,0,1],
               "rotation":[[1,0,0],[0,1,0],[0,0,1]],"fx":500.0,"fy":501.5}}"#
        )
    };
    let all: Vec<String> = (0..20).map(camera).collect();
    format!("[{}]", all.join(",")).into_bytes()
}

fn open_cameras_json(bytes: &[u8]) -> Option<usize> {
    let set = read_cameras_json(bytes, Path::new("cameras.json")).ok()?;
    Some(set.cameras.len())
}

fn transforms_json() -> Vec<u8> {
    let frame = |i: usize| {
        format!(
            r#"{{"file_path":"{i}.png","transform_matrix":[[1,0,0,{i}],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
        )
    };
    let all: Vec<String> = (0..20).map(frame).collect();
    format!(
        r#"{{"w":640,"h":480,"fl_x":500.0,"fl_y":500.0,"cx":320,"cy":240,"frames":[{}]}}"#,
        all.join(",")
    )
    .into_bytes()
}

fn open_transforms_json(bytes: &[u8]) -> Option<usize> {
    let set = read_transforms_json(bytes, Path::new("transforms.json")).ok()?;
    Some(set.cameras.len())
}

/// Three files behind each other, after two lengths.
fn together(cameras: &[u8], images: &[u8], points: &[u8]) -> Vec<u8> {
    let mut out = (cameras.len() as u32).to_le_bytes().to_vec();
    out.extend((images.len() as u32).to_le_bytes());
    [cameras, images, points].iter().for_each(|part| out.extend_from_slice(part));
    out
}

fn apart(bytes: &[u8]) -> Option<[&[u8]; 3]> {
    let (head, rest) = bytes.split_first_chunk::<8>()?;
    let length = |at: usize| u32::from_le_bytes(head[at..at + 4].try_into().unwrap()) as usize;
    let (cameras, rest) = rest.split_at_checked(length(0))?;
    let (images, points) = rest.split_at_checked(length(4))?;
    Some([cameras, images, points])
}

fn colmap_binary() -> Vec<u8> {
    let f64s = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend(1i32.to_le_bytes());
    cameras.extend(1i32.to_le_bytes());
    cameras.extend(640u64.to_le_bytes());
    cameras.extend(480u64.to_le_bytes());
    cameras.extend(f64s(&[500.0, 500.0, 320.0, 240.0]));
    let mut images = 5u64.to_le_bytes().to_vec();
    for id in 1..=5i32 {
        images.extend(id.to_le_bytes());
        images.extend(f64s(&[1.0, 0.0, 0.0, 0.0, f64::from(id), 0.0, 0.0]));
        images.extend(1i32.to_le_bytes());
        images.extend(format!("{id}.png\0").bytes());
        images.extend(1u64.to_le_bytes());
        images.extend(f64s(&[10.0, 20.0]));
        images.extend(1i64.to_le_bytes());
    }
    let mut points = 1u64.to_le_bytes().to_vec();
    points.extend(1u64.to_le_bytes());
    points.extend(f64s(&[1.0, 2.0, 3.0]));
    points.extend([9, 8, 7]);
    points.extend(f64s(&[0.5]));
    points.extend(1u64.to_le_bytes());
    points.extend(1i32.to_le_bytes());
    points.extend(0i32.to_le_bytes());
    together(&cameras, &images, &points)
}

fn open_colmap_binary(bytes: &[u8]) -> Option<usize> {
    let [cameras, images, points] = apart(bytes)?;
    let set = read_colmap_binary(cameras, images, Some(points), Path::new("sparse")).ok()?;
    // The file's own count of pictures.
    let claimed = u64::from_le_bytes(images[..8].try_into().unwrap());
    assert_eq!(set.cameras.len() as u64, claimed);
    Some(set.cameras.len())
}

fn colmap_text() -> Vec<u8> {
    let image = |i: usize| format!("{i} 1 0 0 0 {i} 0 0 1 {i}.png\n10 20 1\n");
    let images: String = (1..=5).map(image).collect();
    together(b"1 PINHOLE 640 480 500 500 320 240\n", images.as_bytes(), b"1 1 2 3 9 8 7 0.5 1 0\n")
}

fn open_colmap_text(bytes: &[u8]) -> Option<usize> {
    let [cameras, images, points] = apart(bytes)?;
    let set = read_colmap_text(cameras, images, Some(points), Path::new("sparse")).ok()?;
    Some(set.cameras.len())
}
