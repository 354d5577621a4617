//! Cameras from every kind of file: the same camera is the same, and damaged files are refused.

use crate::common::colmap::{Lens, MODELS, Model, Picture, model};
use crate::common::{SplitMix, shared};
use scenesplat_scene::formats::cameras::{
    is_cameras_json, is_colmap_folder, is_transforms_json, read_cameras_json, read_colmap_binary,
    read_colmap_text, read_transforms_json, write_cameras_json,
};
use scenesplat_scene::{Camera, CameraKind, CameraSet, Distortion, SceneError, open_cameras};
use serde_json::{Value, json};
use std::io::Read;
use std::path::Path;

fn here() -> &'static Path {
    Path::new("model")
}

fn from_binary([cameras, images, points]: &[Vec<u8>; 3]) -> Result<CameraSet, SceneError> {
    read_colmap_binary(cameras, images, Some(points), here())
}

fn from_text([cameras, images, points]: &[Vec<u8>; 3]) -> Result<CameraSet, SceneError> {
    read_colmap_text(cameras, images, Some(points), here())
}

#[test]
fn both_encodings_of_colmap_are_equal() {
    let model = model();
    let (binary, text) = (from_binary(&model.binary()).unwrap(), from_text(&model.text()).unwrap());
    assert_eq!((binary.kind, text.kind), (CameraKind::ColmapBinary, CameraKind::ColmapText));
    assert_eq!(binary.cameras, text.cameras);
    assert_eq!(binary.points, text.points);
    assert_eq!((binary.cameras.len(), binary.points.as_ref().unwrap().coord.len()), (11, 20));
    assert_eq!(binary.points.unwrap().color[3], [3, 6, 252]);
    for (camera, picture) in binary.cameras.iter().zip(&model.pictures) {
        assert_eq!((camera.name.as_str(), camera.translation), (picture.name, picture.translation));
        assert_eq!((camera.width, camera.height, camera.cx, camera.cy), (640, 480, 320.7, 240.3));
    }
    let kinds: Vec<&str> = binary
        .cameras
        .iter()
        .map(|camera| match camera.distortion {
            Distortion::None => "none",
            Distortion::OpenCv { .. } => "cv",
            Distortion::Fisheye { .. } => "fish",
            Distortion::Polynomial { .. } => "polynomial",
        })
        .collect();
    let due = ["none", "none", "cv", "cv", "cv", "fish", "cv", "fish", "fish", "fish", "fish"];
    assert_eq!(kinds, due);
    // FULL_OPENCV has its tangential terms between the radial ones.
    let params = &model.lenses[6].params[4..];
    let k = [params[0], params[1], params[4], params[5], params[6], params[7]];
    assert_eq!(binary.cameras[6].distortion, Distortion::OpenCv { k, p: [params[2], params[3]] });
    // Points are not needed.
    let [cameras, images, _] = model.binary();
    assert_eq!(read_colmap_binary(&cameras, &images, None, here()).unwrap().points, None);
}

#[test]
fn lenses_that_cannot_be_held_are_named() {
    for i in [7usize, 10, 11, 12, 13, 16, 17] {
        let mut model = model();
        model.pictures[0].lens = 40 - i as u32;
        for result in [from_binary(&model.binary()), from_text(&model.text())] {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(MODELS[i].1), "{error}");
        }
    }
}

/// A camera in general position, and the same in the convention of every file.
struct Everywhere {
    centre: [f64; 3],
    /// Columns: right, down, forward in the world.
    axes: [[f64; 3]; 3],
    quat: [f64; 4],
}

fn everywhere() -> Everywhere {
    // World to camera: w, x, y, z = (4, 2, −5, 2) / 7.
    let quat = [4.0 / 7.0, 2.0 / 7.0, -5.0 / 7.0, 2.0 / 7.0];
    let [w, x, y, z] = quat;
    let axes = [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z],
    ];
    Everywhere { centre: [1.5, -0.5, 2.0], axes, quat }
}

/// `width 800, height 600, fx 700, fy 690, cx 410, cy 290`; the last two only if not in the middle.
fn in_all_files(lens: &Value, middle: bool) -> Vec<CameraSet> {
    let Everywhere { centre, axes, .. } = everywhere();
    let center = if middle { [400.0, 300.0] } else { [410.0, 290.0] };
    let mut all = Vec::from(in_colmap_files(lens, center));
    all.extend(in_transforms_json(lens, center));
    if ["k1", "k2", "p1", "p2"].iter().all(|k| lens[k].is_null()) {
        let mut camera = json!({"id": 0, "img_name": "a.jpg", "width": 800, "height": 600,
                                "position": centre, "rotation": axes, "fy": 690.0, "fx": 700.0});
        if !middle {
            (camera["cx"], camera["cy"]) = (json!(center[0]), json!(center[1]));
        }
        let bytes = serde_json::to_vec(&json!([camera])).unwrap();
        assert!(is_cameras_json(&bytes) && !is_transforms_json(&bytes));
        all.push(read_cameras_json(&bytes, Path::new("cameras.json")).unwrap());
    }
    all
}

/// As a binary model and as text.
fn in_colmap_files(lens: &Value, [cx, cy]: [f64; 2]) -> [CameraSet; 2] {
    let Everywhere { centre, axes, quat } = everywhere();
    let translation = [0, 1, 2].map(|j| -(0..3).map(|i| axes[i][j] * centre[i]).sum::<f64>());
    let params = [700.0, 690.0, cx, cy];
    let k: Vec<f64> = ["k1", "k2", "p1", "p2"].iter().filter_map(|k| lens[k].as_f64()).collect();
    let model = Model {
        lenses: vec![Lens {
            id: 1,
            model: if k.is_empty() { 1 } else { 4 },
            size: [800, 600],
            params: params.into_iter().chain(k.iter().copied()).collect(),
        }],
        pictures: vec![Picture {
            id: 1,
            quat,
            translation,
            lens: 1,
            name: "a.jpg",
            points: vec![],
        }],
        points: vec![],
    };
    [from_binary(&model.binary()).unwrap(), from_text(&model.text()).unwrap()]
}

/// With the intrinsics of all frames, of the frame alone, and as angles.
fn in_transforms_json(lens: &Value, [cx, cy]: [f64; 2]) -> [CameraSet; 3] {
    let Everywhere { centre, axes, .. } = everywhere();
    let matrix: Vec<Vec<f64>> = (0..3)
        .map(|i| vec![axes[i][0], -axes[i][1], -axes[i][2], centre[i]])
        .chain([vec![0.0, 0.0, 0.0, 1.0]])
        .collect();
    let intrinsics = json!({"w": 800, "h": 600.0, "fl_x": 700.0, "fl_y": 690, "cx": cx, "cy": cy});
    let merged = |levels: &[&Value]| {
        let mut out = json!({});
        for level in levels {
            for (key, value) in level.as_object().unwrap() {
                out[key] = value.clone();
            }
        }
        out
    };
    let frame = json!({"file_path": "a.jpg", "transform_matrix": matrix});
    let wrong = json!({"w": 5, "fl_x": 3.0, "cx": 99.0, "k1": 0.3});
    let zero = json!({"k1": 0.0});
    let angles = json!({"camera_angle_x": 2.0 * (400.0f64 / 700.0).atan(),
                        "camera_angle_y": 2.0 * (300.0f64 / 690.0).atan(),
                        "w": 800, "h": 600, "cx": cx, "cy": cy});
    [
        (merged(&[&intrinsics, lens]), frame.clone()),
        (wrong, merged(&[&frame, &zero, &intrinsics, lens])),
        (merged(&[&angles, lens]), frame),
    ]
    .map(|(top, frame)| {
        let file = merged(&[&top, &json!({"frames": [frame]})]);
        let bytes = serde_json::to_vec(&file).unwrap();
        assert!(is_transforms_json(&bytes) && !is_cameras_json(&bytes));
        read_transforms_json(&bytes, Path::new("transforms.json")).unwrap()
    })
}

#[test]
fn one_camera_in_every_file_sees_the_same() {
    let Everywhere { centre, axes, .. } = everywhere();
    let lens = json!({"k1": -0.1, "k2": 0.02, "p1": 0.003, "p2": -0.004});
    for (lens, middle) in [(json!({}), true), (json!({}), false), (lens, false)] {
        for set in in_all_files(&lens, middle) {
            let [camera] = &set.cameras[..] else { panic!("{set:?}") };
            assert_eq!(camera.name, "a.jpg", "{:?}", set.kind);
            for (a, b) in camera.centre().iter().zip(centre) {
                assert!((a - b).abs() < 1e-12, "{:?}", set.kind);
            }
            // Points by the axes: x, y to the right and down at distance z.
            for [x, y, z] in [[0.0, 0.0, 1.0], [0.4, -0.2, 2.0], [-1.0, 1.0, 3.0]] {
                let point =
                    [0, 1, 2].map(|i| centre[i] + axes[i][0] * x + axes[i][1] * y + axes[i][2] * z);
                let number = |k: &str| lens[k].as_f64().unwrap_or(0.0);
                let (u, v) = (x / z, y / z);
                let r2 = u * u + v * v;
                let radial = 1.0 + number("k1") * r2 + number("k2") * r2 * r2;
                let (p1, p2) = (number("p1"), number("p2"));
                let du = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u);
                let dv = v * radial + 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v);
                let (cx, cy) = if middle { (400.0, 300.0) } else { (410.0, 290.0) };
                let due = [700.0 * du + cx, 690.0 * dv + cy];
                let got = camera.project(point).unwrap();
                let off = (got[0] - due[0]).abs().max((got[1] - due[1]).abs());
                assert!(off < 1e-9, "{:?}: {got:?} {due:?}", set.kind);
                let behind = [0, 1, 2].map(|i| 2.0 * centre[i] - point[i]);
                assert_eq!(camera.project(behind), None);
            }
        }
    }
}

#[test]
fn a_real_cameras_json() {
    let Some(path) = shared("real/scenes/arkit_brush/cameras.json") else { return };
    let set = open_cameras(&path).unwrap();
    assert_eq!((set.cameras.len(), set.kind), (45, CameraKind::CamerasJson));
    assert!(is_cameras_json(&std::fs::read(&path).unwrap()));
    let first = &set.cameras[0];
    assert_eq!((first.name.as_str(), first.width, first.height), ("frame_00000.jpg", 1440, 1920));
    assert_eq!((first.fx, first.cx, first.cy), (1_804.160_522_460_937_5, 720.0, 960.0));
    let position =
        [0.440_141_588_449_478_15, 0.733_888_924_121_856_7, -0.000_410_641_048_802_062_87];
    assert!(first.centre().iter().zip(position).all(|(a, b)| (a - b).abs() < 1e-7));
    // The phone's own pose of that frame, camera to world with axes right, up, back, four digits
    // as the authors of the file document it. They turn the world and the camera half round x.
    let phone = [[-0.0358, 0.9932, -0.1098], [-0.7628, 0.0437, 0.6450], [0.6455, 0.1069, 0.7561]];
    let half = [1.0, -1.0, -1.0];
    let to_world = first.camera_to_world();
    for i in 0..3 {
        for j in 0..3 {
            let due = half[i] * phone[i][j] * half[j];
            assert!((to_world[i][j] - due).abs() < 1.5e-4, "{to_world:?}");
        }
    }
    // The trainer of these cameras moved and scaled the world: their mean is 0, the largest
    // coordinate 1. The scene beside the file was trained by another program without that, so
    // the two do not fit each other and nothing can be said about where its Gaussians appear.
    let centres: Vec<[f64; 3]> = set.cameras.iter().map(Camera::centre).collect();
    for i in 0..3 {
        assert!(centres.iter().map(|c| c[i]).sum::<f64>().abs() < 1e-4);
    }
    let largest = centres.iter().flatten().fold(0.0f64, |most, v| most.max(v.abs()));
    assert!((largest - 1.0).abs() < 1e-6);
}

/// The quaternion `w, x, y, z` of a rotation matrix whose trace is not near −1.
fn quat_of(r: &[[f64; 3]; 3]) -> [f64; 4] {
    let w = (1.0 + r[0][0] + r[1][1] + r[2][2]).sqrt() / 2.0;
    assert!(w > 0.05);
    let part = |i: usize, j: usize| (r[i][j] - r[j][i]) / (4.0 * w);
    [w, part(2, 1), part(0, 2), part(1, 0)]
}

#[test]
fn a_real_scene_is_where_its_cameras_look() {
    let Some(path) = shared("real/posed/test_garden.npz") else { return };
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        archive.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
        // Version 1 of the format with a header of 118 bytes.
        assert_eq!(bytes[..10], *b"\x93NUMPY\x01\x00v\x00");
        bytes.split_off(128)
    };
    let mut floats = |name: &str| -> Vec<f64> {
        array(name).as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
    };
    let [points, views, ks] = ["means3d.npy", "viewmats.npy", "Ks.npy"].map(&mut floats);
    let size =
        ["width.npy", "height.npy"].map(|n| u64::from(array(n)[0]) + 256 * u64::from(array(n)[1]));
    assert_eq!((size, points.len(), views.len(), ks.len()), ([648, 420], 3 * 138_766, 48, 27));

    // World to camera, right, down, forward: written as every kind of file.
    let (mut model, mut frames, mut list) = (Model::default(), vec![], vec![]);
    for (i, (view, k)) in views.chunks_exact(16).zip(ks.chunks_exact(9)).enumerate() {
        let r: [[f64; 3]; 3] = [0, 1, 2].map(|i| [view[4 * i], view[4 * i + 1], view[4 * i + 2]]);
        let t = [view[3], view[7], view[11]];
        let params = vec![k[0], k[4], k[2], k[5]];
        model.lenses.push(Lens { id: i as u32, model: 1, size, params });
        let (id, quat, points) = (i as u32, quat_of(&r), vec![]);
        model.pictures.push(Picture { id, quat, translation: t, lens: id, name: "", points });
        let centre = [0, 1, 2].map(|j| -(0..3).map(|i| r[i][j] * t[i]).sum::<f64>());
        let rows = [0, 1, 2].map(|i| [r[0][i], r[1][i], r[2][i]]);
        list.push(json!({"width": size[0], "height": size[1], "fx": k[0], "fy": k[4], "cx": k[2],
                         "cy": k[5], "position": centre, "rotation": rows}));
        let rows = [0, 1, 2].map(|i| [r[0][i], -r[1][i], -r[2][i], centre[i]]);
        frames.push(json!({"w": size[0], "h": size[1], "fl_x": k[0], "fl_y": k[4], "cx": k[2],
                           "cy": k[5], "transform_matrix": rows}));
    }
    let here = Path::new("garden");
    for set in [
        from_binary(&model.binary()).unwrap(),
        from_text(&model.text()).unwrap(),
        read_cameras_json(json!(list).to_string().as_bytes(), here).unwrap(),
        read_transforms_json(json!({"frames": frames}).to_string().as_bytes(), here).unwrap(),
    ] {
        let points = points.as_chunks::<3>().0.iter().step_by(50);
        let (seen, all) = points.fold((0, 0), |(seen, all), point| {
            (seen + usize::from(is_seen(&set, *point, &views, &ks)), all + 1)
        });
        // With camera axes right, up, back it would be 4 of 100.
        assert!(seen * 100 > all * 65, "{:?}: {seen} of {all}", set.kind);
    }
}

/// Whether a camera sees a point; all of them see it where the matrices have it, which are of 16 and of 9 numbers.
fn is_seen(set: &CameraSet, point: [f64; 3], views: &[f64], ks: &[f64]) -> bool {
    let mut seen = false;
    let matrices = views.chunks_exact(16).zip(ks.chunks_exact(9));
    for (camera, (view, k)) in set.cameras.iter().zip(matrices) {
        let row = |i: usize| {
            let m = &view[4 * i..4 * i + 4];
            m[0] * point[0] + m[1] * point[1] + m[2] * point[2] + m[3]
        };
        let (x, y, z) = (row(0), row(1), row(2));
        let Some(got) = camera.project(point) else {
            assert!(z <= 1e-6, "{z}");
            continue;
        };
        // The matrices are of f32, orthonormal to 7 digits; the cameras to 15. That
        // turns directions by as much, which shows in pixels far outside only.
        let due = [k[0] * x / z + k[2], k[4] * y / z + k[5]];
        if camera.contains(due) {
            let off = (got[0] - due[0]).abs().max((got[1] - due[1]).abs());
            assert!(off < 1e-3, "{got:?} {due:?}");
        }
        seen |= camera.contains(got);
    }
    seen
}

#[test]
fn written_cameras_are_a_fixed_point() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.json", "b.json"].map(|name| folder.path().join(name));
    let mut rng = SplitMix(3);
    let mut cameras = Vec::new();
    let [lenses, images, _] = model().binary();
    let base = read_colmap_binary(&lenses, &images, None, here()).unwrap().cameras.remove(1);
    for i in 0..500 {
        let mut model = Model::default();
        model.lenses.push(Lens { id: 1, model: 1, size: [640, 480], params: vec![500.0; 4] });
        model.pictures.push(Picture {
            id: 1,
            quat: [(); 4].map(|()| f64::from(rng.float())),
            translation: [(); 3].map(|()| f64::from(rng.float()) * 10f64.powi(i % 12 - 3)),
            lens: 1,
            name: "x.jpg",
            points: vec![],
        });
        cameras.extend(from_binary(&model.binary()).unwrap().cameras);
    }
    write_cameras_json(&cameras, &a).unwrap();
    let again = open_cameras(&a).unwrap();
    assert_eq!(again.cameras.len(), 500);
    write_cameras_json(&again.cameras, &b).unwrap();
    assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap());
    for (a, b) in again.cameras.iter().zip(&cameras) {
        assert_eq!((a.cx, a.cy), (500.0, 500.0));
        let size = 1.0 + b.translation.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12 * size;
        assert!(a.translation.iter().zip(&b.translation).all(near));
    }
    let lens = Camera { distortion: Distortion::Fisheye { k: [0.0; 4] }, ..base };
    let error = write_cameras_json(&[lens], &a).unwrap_err().to_string();
    assert!(error.contains("distortion"), "{error}");
}

#[test]
fn folders_are_recognised() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    assert!(open_cameras(root).unwrap_err().to_string().contains("without cameras"));
    let model = model();
    let save = |place: &Path, ending: &str, files: [Vec<u8>; 3]| {
        std::fs::create_dir_all(place).unwrap();
        for (stem, bytes) in ["cameras", "images", "points3D"].into_iter().zip(files) {
            std::fs::write(place.join(format!("{stem}.{ending}")), bytes).unwrap();
        }
    };
    let due = from_binary(&model.binary()).unwrap();
    let lenses = json!({"w": 8, "h": 6, "fl_x": 7.0});
    let mut transforms = lenses;
    transforms["frames"] =
        json!([{"transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]}]);
    std::fs::write(root.join("transforms.json"), transforms.to_string()).unwrap();
    let set = open_cameras(root).unwrap();
    assert_eq!(set.kind, CameraKind::TransformsJson);
    assert_eq!((set.cameras[0].centre(), set.cameras[0].fy), ([1.0, 2.0, 3.0], 7.0));
    assert!(!is_colmap_folder(root));
    let sparse = root.join("sparse/0");
    save(&sparse, "txt", model.text());
    assert!(is_colmap_folder(root) && is_colmap_folder(&sparse));
    assert_eq!(open_cameras(root).unwrap().kind, CameraKind::ColmapText);
    save(&sparse, "bin", model.binary());
    for path in [root.to_owned(), sparse.clone(), sparse.join("images.bin")] {
        let set = open_cameras(&path).unwrap();
        assert_eq!((set.kind, &set.cameras), (CameraKind::ColmapBinary, &due.cameras));
    }
    let other = root.join("other");
    std::fs::write(&other, "ply").unwrap();
    assert!(open_cameras(&other).unwrap_err().to_string().contains("no file of cameras"));
    // Sizes from the picture, whose name lacks its ending, as in Blender's scenes.
    std::fs::create_dir(root.join("train")).unwrap();
    let mut blender = json!({"camera_angle_x": 0.8, "frames": [{"file_path": "./train/r_0",
        "transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]}]});
    let path = root.join("transforms_train.json");
    std::fs::write(&path, blender.to_string()).unwrap();
    let png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\x03\x20\0\0\x02\x58";
    // A segment of another kind, filling, and the frame of a progressive picture.
    let jpeg = b"\xff\xd8\xff\xe0\0\x04ab\xff\xff\xc2\0\x11\x08\x02\x58\x03\x20\x03\
        \x01\x22\0\x02\x11\x01\x03\x11\x01";
    for (ending, head) in [("png", &png[..]), ("jpg", &jpeg[..])] {
        let picture = root.join(format!("train/r_0.{ending}"));
        for cut in 0..head.len() {
            std::fs::write(&picture, &head[..cut]).unwrap();
            assert!(open_cameras(&path).is_err(), "{ending} cut at {cut}");
        }
        std::fs::write(&picture, head).unwrap();
        let camera = &open_cameras(&path).unwrap().cameras[0];
        assert_eq!((camera.width, camera.height, camera.cx), (800, 600, 400.0), "{ending}");
        assert!((camera.fx - 400.0 / 0.4f64.tan()).abs() < 1e-9 && camera.fx == camera.fy);
        std::fs::remove_file(&picture).unwrap();
    }
    std::fs::write(root.join("train/r_0.png"), png).unwrap();
    blender["frames"][0]["file_path"] = json!("../train/r_0");
    std::fs::write(&path, blender.to_string()).unwrap();
    assert!(open_cameras(&path).unwrap_err().to_string().contains("no w and h"));
}

#[test]
fn transformations_of_nerfstudio_are_told() {
    let file = json!({"w": 8, "h": 6, "fl_x": 7.0, "camera_model": "OPENCV_FISHEYE", "k1": 0.1,
        "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "applied_scale": 0.5,
        "frames": [{"transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]}]});
    let set = read_transforms_json(file.to_string().as_bytes(), Path::new("t")).unwrap();
    assert_eq!(set.cameras[0].distortion, Distortion::Fisheye { k: [0.1, 0.0, 0.0, 0.0] });
    assert_eq!(set.cameras[0].centre(), [1.0, 2.0, 3.0]);
    assert!(set.notes[0].contains("transformed") && set.notes[1].contains("0.5"));
    for (field, value, due) in [
        ("camera_model", json!("EQUIRECTANGULAR"), "EQUIRECTANGULAR"),
        ("w", json!(8.5), "8.5 pixels"),
        ("fl_x", json!(-7.0), "fx"),
        ("fl_x", json!(null), "fl_x"),
        ("w", json!(null), "no w and h"),
        ("frames", json!([]), "no cameras"),
        ("frames", json!([{}]), "transform_matrix"),
        ("frames", json!([{"transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 2]]}]), "no pose"),
        (
            "frames",
            json!([{"transform_matrix": [[2, 0, 0, 1], [0, 2, 0, 2], [0, 0, 2, 0]]}]),
            "no rotation",
        ),
        (
            "frames",
            json!([{"transform_matrix": [[-1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 0]]}]),
            "no rotation",
        ),
    ] {
        let mut file = file.clone();
        file[field] = value;
        let error = read_transforms_json(file.to_string().as_bytes(), Path::new("t")).unwrap_err();
        assert!(error.to_string().contains(due), "{error}");
    }
    let mut file = file;
    file["camera_model"] = json!("OPENCV");
    file["k4"] = json!(0.25);
    let set = read_transforms_json(file.to_string().as_bytes(), Path::new("t")).unwrap();
    let k = [0.1, 0.0, 0.0, 0.25];
    assert_eq!(set.cameras[0].distortion, Distortion::Polynomial { k, p: [0.0; 2] });
}

/// A change and what the error must name.
type Spoiled = (fn(&mut Model), &'static str);

#[test]
fn bad_numbers_are_refused() {
    let spoil: [Spoiled; 9] = [
        (|m| m.pictures[0].quat[1] = f64::NAN, "rotation"),
        (|m| m.pictures[0].quat = [0.0; 4], "rotation"),
        (|m| m.pictures[0].translation[2] = f64::INFINITY, "translation"),
        (|m| m.lenses[0].params[0] = 0.0, "fx"),
        (|m| m.lenses[0].params[0] = -5.0, "fx"),
        (|m| m.lenses[0].params[2] = f64::NAN, "cx"),
        (|m| m.lenses[0].size[0] = 0, "0 × 480"),
        (|m| m.lenses[0].size[1] = u64::MAX, "pixels"),
        (|m| m.pictures[3].lens = 99, "camera 99"),
    ];
    for (spoil, due) in spoil {
        let mut model = model();
        spoil(&mut model);
        for result in [from_binary(&model.binary()), from_text(&model.text())] {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(due), "{due}: {error}");
        }
    }
    let mut twice = model();
    twice.lenses[1].id = twice.lenses[0].id;
    assert!(from_text(&twice.text()).unwrap_err().to_string().contains("two cameras"));
    // A point without a position is left out, and a note says so.
    let mut model = model();
    model.points[4].at[1] = f64::NAN;
    let set = from_binary(&model.binary()).unwrap();
    assert_eq!(set.points.as_ref().unwrap().color.len(), 19);
    assert!(set.notes[0].contains("1 points"), "{:?}", set.notes);
    assert_eq!(set.points, from_text(&model.text()).unwrap().points);
}

#[test]
fn counts_that_lie() {
    let honest = model().binary();
    for file in 0..3 {
        for count in [0u64, 1, 12, 21, 1 << 20, 1 << 32, 1 << 60, u64::MAX] {
            let mut files = honest.clone();
            if files[file][..8] == count.to_le_bytes() {
                continue;
            }
            files[file][..8].copy_from_slice(&count.to_le_bytes());
            let error = from_binary(&files).unwrap_err().to_string();
            assert!(error.contains(["cameras.bin", "images.bin", "points3D.bin"][file]), "{error}");
        }
    }
    // Points of an image, and the track of a point.
    let name = honest[1].windows(6).position(|w| w == b"a.jpg\0").unwrap() + 6;
    for (file, at) in [(1, name), (2, 8 + 8 + 24 + 3 + 8)] {
        for count in [1u64, 1 << 59, u64::MAX / 24, u64::MAX] {
            let mut files = honest.clone();
            files[file][at..at + 8].copy_from_slice(&count.to_le_bytes());
            assert!(from_binary(&files).is_err());
        }
    }
    // A text file that lost its end at the end of a line.
    let text = model().text();
    for file in 0..3 {
        let mut files = text.clone();
        let lines: Vec<&[u8]> = files[file].split_inclusive(|&b| b == b'\n').collect();
        files[file] = lines[..lines.len() - 2].concat();
        let error = from_text(&files).unwrap_err().to_string();
        assert!(error.contains("comment says"), "{error}");
    }
    // Images whose lines of points were left out.
    let mut files = text;
    files[1] = b"1 1 0 0 0 0 0 0 40 a.jpg\n2 1 0 0 0 0 0 0 40 b.jpg\n".to_vec();
    assert!(from_text(&files).unwrap_err().to_string().contains("line 2"));
    let braces = format!("{{\"frames\":[{}{{}}]}}", "{},".repeat(100_000));
    let error = read_transforms_json(braces.as_bytes(), Path::new("t")).unwrap_err();
    assert!(error.to_string().contains("objects"));
}

/// A file with its parser, which gives the number of cameras.
type Parser<'a> = (Vec<u8>, Box<dyn Fn(&[u8]) -> Option<usize> + 'a>);

#[test]
fn files_cut_anywhere_are_errors() {
    let (binary, text) = (model().binary(), model().text());
    let [cb, ib, pb] = &binary;
    let [ct, it, pt] = &text;
    let count = |set: Result<CameraSet, SceneError>| set.ok().map(|set| set.cameras.len());
    let camera = json!({"id": 0, "img_name": "a", "width": 800, "height": 600, "fx": 7.5, "fy": 6.5,
        "position": [1.25, 2.5, 3.75], "rotation": [[0, 0, 1], [1, 0, 0], [0, 1, 0]]});
    let cameras = json!([camera, camera, camera]).to_string().into_bytes();
    let frame = json!({"file_path": "a.jpg", "k1": 0.01, "transform_matrix":
        [[0, 0, 1, 1.5], [1, 0, 0, 2.5], [0, 1, 0, 3.5], [0, 0, 0, 1]]});
    let transforms = json!({"w": 8, "h": 6, "fl_x": 7.5, "frames": [frame, frame]});
    let transforms = transforms.to_string().into_bytes();
    let parsers: Vec<Parser<'_>> = vec![
        (cb.clone(), Box::new(|b| count(read_colmap_binary(b, ib, Some(pb), here())))),
        (ib.clone(), Box::new(|b| count(read_colmap_binary(cb, b, Some(pb), here())))),
        (pb.clone(), Box::new(|b| count(read_colmap_binary(cb, ib, Some(b), here())))),
        (ct.clone(), Box::new(|b| count(read_colmap_text(b, it, Some(pt), here())))),
        (it.clone(), Box::new(|b| count(read_colmap_text(ct, b, Some(pt), here())))),
        (pt.clone(), Box::new(|b| count(read_colmap_text(ct, it, Some(b), here())))),
        (cameras, Box::new(|b| count(read_cameras_json(b, Path::new("c"))))),
        (transforms, Box::new(|b| count(read_transforms_json(b, Path::new("t"))))),
    ];
    let due = [11, 11, 11, 11, 11, 11, 3, 2];
    for (i, ((bytes, parse), due)) in parsers.iter().zip(due).enumerate() {
        assert_eq!(parse(bytes), Some(due));
        let is_text = (3..6).contains(&i);
        for cut in 0..bytes.len() {
            let left = parse(&bytes[..cut]);
            // A text may lose its last signs and be another text; never a record.
            assert!(left.is_none() || is_text && left == Some(due), "{i}: cut at {cut}: {left:?}");
        }
    }
}
