//! What belongs to scenes and is read by itself: cameras, arrays, labels, names, files of a folder.

use crate::common::colmap::model;
use crate::common::ply::{Encoding, mixed};
use crate::common::{labelled, random_scene, spz, write};
use scenesplat_scene::formats::cameras::{
    read_cameras_json, read_colmap_binary, read_colmap_text, read_transforms_json,
};
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::ply::PlyFile;
use scenesplat_scene::formats::semantics;
use scenesplat_scene::{
    CameraSet, ClassMap, GaussianScene, LabelSet, Policy, ReadOptions, RepairReport, SceneError,
    SceneFormat, TextTable, open_scene,
};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Reads bytes and returns how much it read; `None` if they are refused.
pub type Open = Box<dyn Fn(&[u8]) -> Option<usize>>;

/// How much a file holds; `None` if it is refused.
type Read = fn(&Path) -> Option<usize>;

/// Bytes, and what reads them and gives how much it read.
pub struct Part {
    /// For messages.
    pub name: String,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Reads them; checks that what was read is whole.
    pub open: Open,
}

const ROWS: usize = 200;

/// One of each; files that are read from a folder are put into `folder`.
pub fn all(folder: &Path) -> Vec<Part> {
    let mut all = Vec::new();
    let mut part = |name: &str, bytes: Vec<u8>, open: Open| {
        all.push(Part { name: name.to_owned(), bytes, open });
    };
    let scene = labelled(ROWS, 0);
    let arrays = folder.join("arrays");
    write_npy_folder(&scene, &arrays, false).unwrap();
    for name in ["coord.npy", "color.npy", "lang_code.npy"] {
        part(name, std::fs::read(arrays.join(name)).unwrap(), Box::new(open_npy));
    }
    part("labels", semantics::encode(&scene, None).unwrap(), Box::new(open_labels));
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        part(&format!("{encoding:?} PLY with lists"), mixed(encoding), Box::new(open_ply));
    }
    part("SPZ in gzip", spz::gunzip(&spz::write(&scene, 3)), Box::new(open_gzip));
    cameras(&mut part);
    files(folder, &mut part);
    in_folders(folder, &arrays, &mut part);
    all
}

type Add<'a> = &'a mut dyn FnMut(&str, Vec<u8>, Box<dyn Fn(&[u8]) -> Option<usize>>);

/// Every kind of file of cameras; those of COLMAP beside two that are whole.
fn cameras(part: Add<'_>) {
    let camera = json!({"id": 0, "img_name": "a", "width": 800, "height": 600, "fx": 7.5, "fy": 6.5,
        "position": [1.25, 2.5, 3.75], "rotation": [[0, 0, 1], [1, 0, 0], [0, 1, 0]]});
    let cameras = json!(vec![camera; 20]).to_string().into_bytes();
    part(
        "cameras.json",
        cameras,
        Box::new(|bytes| checked(read_cameras_json(bytes, Path::new("cameras.json")))),
    );
    let frame = json!({"file_path": "a.jpg", "k1": 0.01, "transform_matrix":
        [[0, 0, 1, 1.5], [1, 0, 0, 2.5], [0, 1, 0, 3.5], [0, 0, 0, 1]]});
    let transforms = json!({"w": 8, "h": 6, "fl_x": 7.5, "frames": vec![frame; 20]});
    part(
        "transforms.json",
        transforms.to_string().into_bytes(),
        Box::new(|bytes| checked(read_transforms_json(bytes, Path::new("transforms.json")))),
    );
    for (kind, files) in [("binary", model().binary()), ("text", model().text())] {
        for (i, name) in ["cameras", "images", "points"].into_iter().enumerate() {
            let whole = files.clone();
            let open = move |bytes: &[u8]| {
                let mut files = whole.each_ref().map(Vec::as_slice);
                files[i] = bytes;
                let ([cameras, images, points], path) = (files, Path::new("sparse"));
                if kind == "text" {
                    return checked(read_colmap_text(cameras, images, Some(points), path));
                }
                let read = checked(read_colmap_binary(cameras, images, Some(points), path))?;
                // The file's own count of pictures.
                assert_eq!(read as u64, u64::from_le_bytes(images[..8].try_into().unwrap()));
                Some(read)
            };
            part(&format!("COLMAP {kind}, {name}"), files[i].clone(), Box::new(open));
        }
    }
}

/// Files that are read by their path.
fn files(folder: &Path, part: Add<'_>) {
    let head = br#"{"__metadata__":{"labels":"[\"bed\"]"},"text_embeddings":{"dtype":"F32","shape":[1,2],"data_offsets":[0,8]}}"#;
    let size = (head.len() as u64).to_le_bytes();
    let table = [&size[..], head, &[0, 0, 128, 63, 0, 0, 128, 63]].concat();
    let set = br#"{"classes": ["bed", "sofa"], "labels": []}"#;
    let map = b"Bed = \"bed\"\nSofa = \"sofa\"\n";
    let cloud = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
        property ushort label\nend_header\n1 2 3 4 5 6 7\n1 2 3 4 5 6 65535\n";
    let at = folder.join("file");
    let reads: [(&str, &[u8], Read); 4] = [
        ("text table", &table, |at| Some(TextTable::read(at, None).ok()?.len())),
        ("label set", set, |at| Some(LabelSet::read(at).ok()?.len())),
        ("class map", map, |at| ClassMap::read(at).ok().map(|_| 2)),
        ("labeled cloud", cloud, |at| {
            let (cloud, _) = read_labelled_ply(at, Policy::Repair, None).ok()?;
            assert_eq!(cloud.coord.len(), cloud.segment.len());
            Some(cloud.coord.len())
        }),
    ];
    for (name, bytes, read) in reads {
        let at = at.clone();
        let open = move |bytes: &[u8]| {
            std::fs::write(&at, bytes).unwrap();
            read(&at)
        };
        part(name, bytes.to_vec(), Box::new(open));
    }
}

/// One damaged file of a folder, the others whole.
fn in_folders(folder: &Path, arrays: &Path, part: Add<'_>) {
    let textures = folder.join("textures");
    write(&random_scene(50, 1, 3), &textures.join("meta.json"), SceneFormat::SogFolder);
    let streamed = folder.join("streamed");
    write(&random_scene(50, 0, 3), &streamed.join("lod-meta.json"), SceneFormat::SogStreamed);
    for (folder, name) in [
        (arrays, "coord.npy"),
        (arrays, "segment.npy"),
        (&textures, "meta.json"),
        (&textures, "sh0.webp"),
        (&textures, "shN_labels.webp"),
        (&streamed, "lod-meta.json"),
    ] {
        let at: PathBuf = folder.join(name);
        let (folder, whole) = (folder.to_owned(), std::fs::read(&at).unwrap());
        let bytes = whole.clone();
        let open = move |bytes: &[u8]| {
            std::fs::write(&at, bytes).unwrap();
            let loaded = open_scene(&folder, &ReadOptions::default());
            std::fs::write(&at, &whole).unwrap();
            let loaded = loaded.ok()?;
            loaded.scene.check_rows().unwrap();
            assert_eq!(loaded.scene.len() + loaded.report.dropped_rows, loaded.source_rows());
            Some(loaded.source_rows())
        };
        part(&format!("{name} of a folder"), bytes, Box::new(open));
    }
}

fn open_npy(bytes: &[u8]) -> Option<usize> {
    let file = NpyFile::from_bytes(bytes, Path::new("a.npy")).ok()?;
    let values = file.read_f64().ok()?;
    assert_eq!(values.len(), file.len());
    assert_eq!(values.len(), file.shape().iter().product::<usize>());
    let _ = (file.read_f32(), file.read_i64(), file.read_u8(), file.read_f16());
    Some(values.len())
}

fn open_ply(bytes: &[u8]) -> Option<usize> {
    let file = PlyFile::from_bytes(bytes, Path::new("a.ply")).ok()?;
    for element in file.elements() {
        for property in &element.properties {
            let _ = file.column_i64(&element.name, &property.name);
        }
    }
    Some(file.elements().len())
}

/// The bytes in a container whose checksum is right.
fn open_gzip(bytes: &[u8]) -> Option<usize> {
    let loaded = spz::open(&spz::gzip(bytes)).ok()?;
    let claimed = u32::from_le_bytes(bytes[8..12].try_into().unwrap());
    assert_eq!(loaded.source_rows(), claimed as usize);
    Some(loaded.source_rows())
}

fn open_labels(bytes: &[u8]) -> Option<usize> {
    let mut scene = GaussianScene::default();
    let mut report = RepairReport::default();
    semantics::decode(bytes, ROWS, &mut scene, &mut report, Path::new("a")).ok()?;
    let labels = [&scene.segment, &scene.instance];
    assert!(labels.into_iter().flatten().all(|labels| labels.len() == ROWS));
    assert!(scene.segment_score.is_none_or(|score| score.len() == ROWS));
    Some(ROWS)
}

/// The number of cameras, each with numbers that can be used.
fn checked(set: Result<CameraSet, SceneError>) -> Option<usize> {
    let set = set.ok()?;
    for camera in &set.cameras {
        let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
        let pose = camera.translation.iter().chain(camera.rotation.as_flattened());
        assert!(numbers.iter().chain(pose).all(|v| v.is_finite()));
        assert!(camera.fx > 0.0 && camera.fy > 0.0);
        camera.project([1.0, 2.0, 3.0]);
    }
    if let Some(points) = &set.points {
        assert_eq!(points.coord.len(), points.color.len());
    }
    Some(set.cameras.len())
}
