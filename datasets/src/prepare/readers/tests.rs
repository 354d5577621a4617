//! Each layout on a miniature made to the benchmark's own documentation.
#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

mod marks;

use super::*;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::formats::{SceneFormat, WriteOptions, write_scene};
use serde_json::json;
use std::path::PathBuf;
use tempfile::TempDir;

/// A floor of two triangles, a square beside it, and a vertex alone: seven vertices, three faces.
const VERTICES: [[f32; 3]; 7] = [
    [0., 0., 0.],
    [1., 0., 0.],
    [1., 1., 0.],
    [0., 1., 0.],
    [2., 0., 0.],
    [2., 1., 0.],
    [5., 5., 1.],
];

struct Mini(TempDir);

impl Mini {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }

    fn json(&self, name: &str, value: &serde_json::Value) {
        std::fs::write(self.at(name), value.to_string()).unwrap();
    }

    /// A PLY mesh as text; `vertex` and `face`: a further column of each, with its declaration.
    fn mesh(&self, name: &str, vertex: Option<(&str, [i64; 7])>, face: Option<(&str, [i64; 3])>) {
        let mut text =
            "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\n\
                        property float z\n"
                .to_owned();
        if let Some((column, _)) = vertex {
            text += &format!("property {column}\n");
        }
        text += "element face 3\nproperty list uchar int vertex_indices\n";
        if let Some((column, _)) = face {
            text += &format!("property {column}\n");
        }
        text += "end_header\n";
        for (i, p) in VERTICES.iter().enumerate() {
            text += &format!("{} {} {}", p[0], p[1], p[2]);
            if let Some((_, values)) = vertex {
                text += &format!(" {}", values[i]);
            }
            text.push('\n');
        }
        for (i, corners) in ["3 0 1 2", "3 0 2 3", "4 1 4 5 2"].iter().enumerate() {
            text += corners;
            if let Some((_, values)) = face {
                text += &format!(" {}", values[i]);
            }
            text.push('\n');
        }
        std::fs::write(self.at(name), text).unwrap();
    }
}

/// The name of each vertex.
fn named(scan: &ScanPoints) -> Vec<&str> {
    let name = |raw: &i32| usize::try_from(*raw).map_or("-", |raw| scan.names[raw].as_str());
    scan.raw.iter().map(name).collect()
}

fn refused(path: &Path, layout: ScanLayout, parts: &[&str]) {
    let error = read_scan(path, layout).unwrap_err();
    let mut text = error.to_string();
    let mut source = std::error::Error::source(&error);
    while let Some(inner) = source {
        text += &format!(": {inner}");
        source = inner.source();
    }
    assert!(parts.iter().all(|part| text.contains(part)), "{parts:?}: {text}");
}

#[test]
fn scannet() {
    let mini = Mini::new();
    let folder = mini.0.path().join("scene0000_00");
    mini.mesh("scene0000_00/scene0000_00_vh_clean_2.ply", None, None);
    // Without annotations, as the test scans: points without labels.
    let bare = read_scan(&folder, ScanLayout::Scannet).unwrap();
    assert_eq!((bare.raw, bare.instance), (vec![-1; 7], vec![-1; 7]));
    assert_eq!(bare.normal.unwrap()[0], [0.0, 0.0, 1.0]);
    let segments = "scene0000_00/scene0000_00_vh_clean_2.0.010000.segs.json";
    mini.json(
        segments,
        &json!({"params": {"kThresh": "0.0001"}, "sceneId": "scene0000_00",
        "segIndices": [11, 11, 15, 15, 20, 20, 99]}),
    );
    refused(&folder, ScanLayout::Scannet, &["scene0000_00.aggregation.json"]);
    mini.json(
        "scene0000_00/scene0000_00.aggregation.json",
        &json!({"sceneId": "scannet.scene0000_00",
        "appId": "x", "segGroups": [
            {"id": 0, "objectId": 0, "segments": [11, 15], "label": "floor"},
            {"id": 1, "objectId": 4, "segments": [20], "label": "coffee table"}],
        "segmentsFile": "x"}),
    );
    let scan = read_scan(&folder, ScanLayout::Scannet).unwrap();
    let table = "coffee table";
    assert_eq!(named(&scan), ["floor", "floor", "floor", "floor", table, table, "-"]);
    assert_eq!(scan.instance, [0, 0, 0, 0, 4, 4, -1]);
    mini.json(segments, &json!({"segIndices": [1, 2]}));
    refused(&folder, ScanLayout::Scannet, &["segs.json", "of 2 vertices", "has 7"]);
    mini.json(segments, &json!({"segIndices": [1, "two"]}));
    refused(&folder, ScanLayout::Scannet, &["segs.json", "segIndices"]);
    std::fs::write(mini.at(segments), "{").unwrap();
    refused(&folder, ScanLayout::Scannet, &["segs.json", "no JSON"]);
    refused(mini.0.path(), ScanLayout::Scannet, &["_vh_clean_2.ply"]);
}

#[test]
fn scannetpp() {
    let mini = Mini::new();
    let folder = mini.0.path().join("0a7cc12c0e");
    mini.mesh("0a7cc12c0e/scans/mesh_aligned_0.05.ply", None, None);
    mini.json("0a7cc12c0e/scans/segments.json", &json!({"segIndices": [0, 1, 2, 3, 4, 5, 6]}));
    // A vertex in two objects belongs to the smaller one.
    mini.json(
        "0a7cc12c0e/scans/segments_anno.json",
        &json!({"segGroups": [
        {"objectId": 1, "label": "table", "segments": [0, 1, 2, 3]},
        {"objectId": 2, "label": "book", "segments": [3]},
        {"objectId": 3, "label": "wall", "segments": [4, 5]}]}),
    );
    let scan = read_scan(&folder, ScanLayout::ScannetPp).unwrap();
    assert_eq!(named(&scan), ["table", "table", "table", "book", "wall", "wall", "-"]);
    assert_eq!(scan.instance, [1, 1, 1, 2, 3, 3, -1]);
}

#[test]
fn matterport3d() {
    let mini = Mini::new();
    let region = mini.0.path().join("17DRP5sb8fy/region_segmentations/region3.ply");
    mini.mesh("17DRP5sb8fy/region_segmentations/region3.ply", None, None);
    let at = "17DRP5sb8fy/region_segmentations/region3";
    mini.json(&format!("{at}.fsegs.json"), &json!({"segIndices": [7, 7, 9]}));
    mini.json(
        &format!("{at}.semseg.json"),
        &json!({"segGroups": [
        {"id": 0, "objectId": 0, "label": "floor", "segments": [7]},
        {"id": 1, "objectId": 1, "label": "rug", "segments": [9]}]}),
    );
    let scan = read_scan(&region, ScanLayout::Matterport3d).unwrap();
    // Vertex 1 is in one face of each: the object that comes first; 2 is in two of the floor's, one of the rug's.
    assert_eq!(named(&scan), ["floor", "floor", "floor", "floor", "rug", "rug", "-"]);
    assert_eq!(scan.instance, [0, 0, 0, 0, 1, 1, -1]);
    // A segment of no object says nothing.
    mini.json(&format!("{at}.fsegs.json"), &json!({"segIndices": [7, 7, 11]}));
    let scan = read_scan(&region, ScanLayout::Matterport3d).unwrap();
    assert_eq!(named(&scan), ["floor", "-", "floor", "floor", "-", "-", "-"]);
    mini.json(&format!("{at}.fsegs.json"), &json!({"segIndices": [7, 7]}));
    refused(&region, ScanLayout::Matterport3d, &["fsegs.json", "of 2 faces"]);
}

#[test]
fn replica() {
    let mini = Mini::new();
    let folder = mini.0.path().join("room_0");
    mini.mesh("room_0/habitat/mesh_semantic.ply", None, Some(("int object_id", [3, 3, 8])));
    mini.json(
        "room_0/habitat/info_semantic.json",
        &json!({
        "classes": [{"id": 40, "name": "floor"}, {"id": 70, "name": "sofa"}],
        "id_to_label": [-1, -1, -1, 40], "objects": [
            {"id": 3, "class_id": 40, "class_name": "floor"}]}),
    );
    let scan = read_scan(&folder, ScanLayout::Replica).unwrap();
    assert_eq!(named(&scan), ["floor", "floor", "floor", "floor", "-", "-", "-"]);
    assert_eq!(scan.instance, [3, 3, 3, 3, -1, -1, -1]);
    mini.mesh("room_0/habitat/mesh_semantic.ply", None, None);
    refused(&folder, ScanLayout::Replica, &["mesh_semantic.ply", "object_id"]);
    mini.json("room_0/habitat/info_semantic.json", &json!({"objects": [{"id": 3}]}));
    refused(&folder, ScanLayout::Replica, &["info_semantic.json", "objects[0] has no class_name"]);
}

#[test]
fn three_r_scan() {
    for version in ["", ".v2"] {
        let mini = Mini::new();
        let folder = mini.0.path().join("scan");
        let ids = [2, 2, 2, 2, 31, 31, 0];
        let ply = format!("scan/labels.instances.annotated{version}.ply");
        mini.mesh(&ply, Some(("ushort objectId", ids)), None);
        mini.json(
            &format!("scan/semseg{version}.json"),
            &json!({"segGroups": [
            {"id": 2, "objectId": 2, "segments": [1], "label": "floor"},
            {"id": 31, "objectId": 31, "segments": [4], "label": "couch"}]}),
        );
        let scan = read_scan(&folder, ScanLayout::ThreeRScan).unwrap();
        assert_eq!(named(&scan), ["floor", "floor", "floor", "floor", "couch", "couch", "-"]);
        assert_eq!(scan.instance, [2, 2, 2, 2, 31, 31, -1]);
        mini.mesh(&ply, None, None);
        refused(&folder, ScanLayout::ThreeRScan, &["annotated", "objectId"]);
    }
}

#[test]
fn arkitscenes() {
    let mini = Mini::new();
    let folder = mini.0.path().join("41069021");
    mini.mesh("41069021/41069021_3dod_mesh.ply", None, None);
    let annotation = "41069021/41069021_3dod_annotation.json";
    let item = |label: &str, centroid: [f64; 3], lengths: [f64; 3], axes: serde_json::Value| {
        json!({"uid": label, "label": label, "segments": {"obbAligned": {
            "centroid": centroid, "axesLengths": lengths, "normalizedAxes": axes}}})
    };
    // The first box holds the first four vertices, the second, inside of it, is turned by 45° about z and holds one.
    let h = std::f64::consts::FRAC_1_SQRT_2;
    let straight = json!([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let turned = json!([[h, h, 0.0], [-h, h, 0.0], [0.0, 0.0, 1.0]]);
    mini.json(
        annotation,
        &json!({"skipped": false, "data": [
        item("table", [0.5, 0.5, 0.0], [1.1, 1.1, 1.0], straight),
        // Long along (1, 1): reaches (1, 1), thin across.
        item("stool", [0.75, 0.75, 0.0], [0.8, 0.1, 0.5], turned)]}),
    );
    let scan = read_scan(&folder, ScanLayout::Arkitscenes).unwrap();
    assert_eq!(named(&scan), ["table", "table", "stool", "table", "-", "-", "-"]);
    assert_eq!(scan.instance, [0, 0, 1, 0, -1, -1, -1]);
    mini.json(annotation, &json!({"data": [item("bed", [0.0; 3], [1.0; 3], json!([1, 0]))]}));
    refused(&folder, ScanLayout::Arkitscenes, &["data[0] has no normalizedAxes"]);
}

#[test]
fn interiorgs() {
    let mini = Mini::new();
    let folder = mini.0.path().join("0001_839920");
    // Two Gaussians in a table, one of them in the cup on it, one on the edge of the table, one outside.
    let scene = GaussianScene {
        coord: vec![[1.0, 1.0, 0.3], [1.0, 1.0, 0.75], [2.005, 1.0, 0.3], [3.0, 1.0, 0.3]],
        log_scale: vec![[-4.0; 3]; 4],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        opacity_logit: vec![2.0; 4],
        sh_dc: vec![[0.5; 3]; 4],
        ..GaussianScene::default()
    };
    std::fs::create_dir_all(&folder).unwrap();
    let (path, options) = (folder.join("3dgs_compressed.ply"), WriteOptions::default());
    write_scene(&scene, &path, SceneFormat::CompressedPly, &options, &mut |_| true).unwrap();
    let labels = "0001_839920/labels.json";
    // Corners of upright boxes in no order, turned about z; a picture is flat.
    let item = |label: &str, center: [f64; 2], half: [f64; 2], z: [f64; 2], turn: f64| {
        let corner = |i: usize| {
            let [x, y] = [0, 1].map(|k| if i >> k & 1 == 1 { half[k] } else { -half[k] });
            let (sin, cos) = turn.sin_cos();
            json!({"x": center[0] + cos * x - sin * y, "y": center[1] + sin * x + cos * y, "z": z[i >> 2]})
        };
        let corners: Vec<_> = [5, 0, 3, 6, 1, 7, 2, 4].map(corner).to_vec();
        json!({"ins_id": "7", "label": label, "bounding_box": corners})
    };
    mini.json(
        labels,
        &json!([
            item("table", [1.0, 1.0], [1.0, 0.5], [0.0, 0.8], 0.0),
            // Long along (1, 1): holds what is in its middle alone.
            item("cup", [1.0, 1.0], [0.4, 0.02], [0.7, 0.8], std::f64::consts::FRAC_PI_4),
            item("picture", [3.0, 1.0], [0.3, 0.0], [0.0, 0.8], 0.3)
        ]),
    );
    let scan = read_scan(&folder, ScanLayout::InteriorGs).unwrap();
    assert_eq!(named(&scan), ["table", "cup", "table", "picture"]);
    assert_eq!(scan.instance, [0, 1, 0, 2]);
    assert_eq!(scan.names, ["table", "cup", "picture"]);
    let mut skewed = item("bed", [0.0; 2], [1.0; 2], [0.0, 1.0], 0.0);
    skewed["bounding_box"][3]["x"] = json!(1.5);
    mini.json(labels, &json!([skewed]));
    refused(&folder, ScanLayout::InteriorGs, &["labels.json", "bed", "not those of a box"]);
    mini.json(labels, &json!([{"label": "bed", "bounding_box": [{"x": 0, "y": 0, "z": 0}]}]));
    refused(&folder, ScanLayout::InteriorGs, &["labels[0] has no bounding_box of eight corners"]);
}

/// A copy of the miniature that the HDF5 library wrote (`benches/pytorch/hypersim_miniature.py`).
fn hypersim_copy(mini: &Mini) -> PathBuf {
    fn copy(from: &Path, to: &Path) {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap().flatten() {
            let target = to.join(entry.file_name());
            match entry.path().is_dir() {
                true => copy(&entry.path(), &target),
                false => {
                    std::fs::copy(entry.path(), target).unwrap();
                }
            }
        }
    }
    let from =
        scenesplat_test_support::repository().join("datasets/tests/data/hypersim/ai_000_001");
    let to = mini.at("ai_000_001");
    copy(&from, &to);
    to
}

#[test]
fn hypersim() {
    let mini = Mini::new();
    let folder = hypersim_copy(&mini);
    let scan = read_scan(&folder, ScanLayout::Hypersim).unwrap();
    // 24 pixels of which one shows nothing; the three pictures fall into the same cubes.
    assert_eq!(scan.coord.len(), 23);
    assert_eq!(named(&scan)[..6], ["floor", "floor", "floor", "floor", "table", "floor"]);
    assert_eq!(scan.instance[..6], [1, 1, 1, 1, 4, 1]);
    // The pixel without a label, in the last row.
    assert_eq!((named(&scan)[17], scan.instance[17]), ("-", -1));
    assert_eq!(scan.names, ["floor", "table"]);
    // Half meters; the mean of two pictures 5 mm apart, of the table of three.
    let near = |p: [f32; 3], q: [f64; 3]| (0..3).all(|k| (f64::from(p[k]) - q[k]).abs() < 1e-6);
    assert!(near(scan.coord[0], [0.5125, 0.01, 0.01]), "{:?}", scan.coord[0]);
    assert!(near(scan.coord[4], [2.51 + 0.0025 / 3.0, 0.01, 0.01]), "{:?}", scan.coord[4]);
    assert_eq!(scan.normal.as_ref().unwrap()[4], [0.0, 0.0, 1.0]);

    // What a partial download and damaged files say.
    let of = |frame: &str| folder.join(format!("images/scene_cam_00_geometry_hdf5/{frame}.hdf5"));
    let layout = ScanLayout::Hypersim;
    std::fs::remove_file(of("frame.0003.normal_world")).unwrap();
    assert_eq!(read_scan(&folder, layout).unwrap().normal, None);
    let whole = std::fs::read(of("frame.0003.semantic")).unwrap();
    std::fs::remove_file(of("frame.0003.semantic")).unwrap();
    refused(&folder, layout, &["frame.0003.semantic.hdf5"]);
    for bytes in [&whole[..whole.len() / 2], b"no HDF5", b""] {
        std::fs::write(of("frame.0003.semantic"), bytes).unwrap();
        refused(&folder, layout, &["frame.0003.semantic.hdf5", "HDF5", "fetch it again"]);
    }
    // A picture where a map is expected, and maps of another size.
    std::fs::copy(of("frame.0003.position"), of("frame.0003.semantic")).unwrap();
    refused(&folder, layout, &["frame.0003.semantic.hdf5", "[4, 6, 3]", "[4, 6]"]);
    let mut other = hdf5_pure::FileBuilder::new();
    other.create_dataset("dataset").with_data(&[2i16; 10]).with_shape(&[2, 5]);
    other.write(of("frame.0003.semantic")).unwrap();
    refused(&folder, layout, &["frame.0003.semantic.hdf5", "[2, 5]", "[4, 6]"]);
    std::fs::write(of("frame.0003.semantic"), &whole).unwrap();
    let csv = folder.join("_detail/metadata_scene.csv");
    for (text, part) in [("a,b\n", "no row"), ("meters_per_asset_unit,nan\n", "\"nan\"")] {
        std::fs::write(&csv, text).unwrap();
        refused(&folder, layout, &["metadata_scene.csv", "meters_per_asset_unit", part]);
    }
    std::fs::write(&csv, "meters_per_asset_unit,1e30\n").unwrap();
    refused(&folder, layout, &["position.hdf5", "meters_per_asset_unit"]);
    std::fs::remove_dir_all(folder.join("images")).unwrap();
    std::fs::write(&csv, "meters_per_asset_unit,0.01\n").unwrap();
    refused(&folder, layout, &["images"]);
}

#[test]
fn points_and_damaged_meshes() {
    let mini = Mini::new();
    let labels = [4, 4, -1, 0, 0, 2, 2];
    mini.mesh("a.ply", Some(("int segment", labels)), None);
    let path = mini.at("a.ply");
    let scan = read_scan(&path, ScanLayout::Points).unwrap();
    assert_eq!(named(&scan), ["4", "4", "-", "0", "0", "2", "2"]);
    mini.mesh("a.ply", None, None);
    refused(&path, ScanLayout::Points, &["a.ply", "no labels", "segment or label"]);
    mini.mesh("a.ply", Some(("int segment", labels)), None);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("4 1 4 5 2", "4 1 4 5 9")).unwrap();
    refused(&path, ScanLayout::Points, &["a face names vertex 9, there are 7"]);
    std::fs::write(&path, text.replace("5 5 1 2", "nan 5 1 2")).unwrap();
    refused(&path, ScanLayout::Points, &["vertex 6", "NaN"]);
    std::fs::write(&path, &text[..text.len() - 20]).unwrap();
    assert!(read_scan(&path, ScanLayout::Points).is_err());
}
