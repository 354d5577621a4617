//! Gaussians in glTF files: attributes, containers, nodes, and damaged files.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod common;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use common::{SplitMix, random_scene, shared};
use scenesplat_scene::formats::gltf::{is_glb, is_gltf_json, read_gltf};
use scenesplat_scene::gaussian_scene::{SH_C0, dc_to_u8, sigmoid};
use scenesplat_scene::spherical_harmonics::rest_basis;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{
    Frame, GaussianScene, LoadedScene, Policy, ReadOptions, SceneFormat, WriteOptions, open_scene,
    write_scene,
};
use serde_json::{Value, json};
use std::path::Path;

type Matrix4 = [[f64; 4]; 4];

const FLOAT: u32 = 5126;
const PREFIX: &str = "KHR_gaussian_splatting:";

/// A document under construction, with its bytes.
struct Doc {
    json: Value,
    bin: Vec<u8>,
}

impl Doc {
    fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "meshes": [],
            "nodes": [], "scene": 0, "scenes": [{"nodes": []}],
        });
        Self { json, bin: Vec::new() }
    }

    fn push(&mut self, list: &str, entry: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(entry);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0xee);
        }
        let offset = self.bin.len();
        self.bin.extend_from_slice(bytes);
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()});
        self.push("bufferViews", view)
    }

    fn accessor(&mut self, bytes: &[u8], component: u32, shape: &str, count: usize) -> usize {
        let view = self.view(bytes);
        let normalized = component != FLOAT;
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count,
                   "normalized": normalized}),
        )
    }

    fn floats(&mut self, values: &[f32], shape: &str, count: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, FLOAT, shape, count)
    }

    /// A mesh of one primitive with the present attribute names.
    fn mesh(&mut self, scene: &GaussianScene, log_scale: bool) -> usize {
        let n = scene.len();
        let mut attributes = json!({});
        let mut set = |name: String, index: usize| attributes[name] = json!(index);
        let index = self.floats(scene.coord.as_flattened(), "VEC3", n);
        set("POSITION".into(), index);
        let quat: Vec<f32> = scene.quat.iter().flat_map(|q| [q[1], q[2], q[3], q[0]]).collect();
        let index = self.floats(&quat, "VEC4", n);
        set(format!("{PREFIX}ROTATION"), index);
        let size = |s: f32| if log_scale { s } else { f64::from(s).exp() as f32 };
        let scale: Vec<f32> = scene.log_scale.as_flattened().iter().map(|&s| size(s)).collect();
        let index = self.floats(&scale, "VEC3", n);
        set(format!("{PREFIX}SCALE"), index);
        let opacity: Vec<f32> = scene.opacity_logit.iter().map(|&v| sigmoid(v)).collect();
        let index = self.floats(&opacity, "SCALAR", n);
        set(format!("{PREFIX}OPACITY"), index);
        let index = self.floats(scene.sh_dc.as_flattened(), "VEC3", n);
        set(format!("{PREFIX}SH_DEGREE_0_COEF_0"), index);
        let k = scene.sh_rest_len();
        for l in 1..=usize::from(scene.sh_degree) {
            for c in 0..=2 * l {
                let at = (l * l - 1 + c) * 3;
                let rows = scene.sh_rest.chunks_exact(3 * k);
                let values: Vec<f32> = rows.flat_map(|row| row[at..at + 3].to_vec()).collect();
                let index = self.floats(&values, "VEC3", n);
                set(format!("{PREFIX}SH_DEGREE_{l}_COEF_{c}"), index);
            }
        }
        let about = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"});
        let primitive = json!({"attributes": attributes, "mode": 0,
                               "extensions": {"KHR_gaussian_splatting": about}});
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    /// A node; shown by the scene if `root`.
    fn node(&mut self, node: Value, root: bool) -> usize {
        let index = self.push("nodes", node);
        if root {
            self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(index));
        }
        index
    }

    fn gltf(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&self.bin));
        json["buffers"] = json!([{"uri": uri, "byteLength": self.bin.len()}]);
        serde_json::to_vec(&json).unwrap()
    }

    fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut out = b"glTF".to_vec();
        let total = 12 + 8 + text.len() + 8 + bin.len();
        for word in [2, total as u32, text.len() as u32] {
            out.extend_from_slice(&word.to_le_bytes());
        }
        out.extend_from_slice(b"JSON");
        out.extend_from_slice(&text);
        out.extend_from_slice(&(bin.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(&bin);
        out
    }

    fn read(&self) -> LoadedScene {
        read(&self.glb())
    }

    fn error(&self) -> String {
        let options = ReadOptions::default();
        read_gltf(&self.glb(), Path::new("a.glb"), &options).unwrap_err().to_string()
    }
}

fn read(bytes: &[u8]) -> LoadedScene {
    read_gltf(bytes, Path::new("a.glb"), &ReadOptions::default()).unwrap()
}

fn close(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b} within {tolerance}");
    }
}

fn times(a: &Matrix4, b: &Matrix4) -> Matrix4 {
    let cell = |i: usize, j: usize| (0..4).map(|k| a[i][k] * b[k][j]).sum();
    std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j)))
}

/// From right-handed y-up with +z towards the viewer's front to right, down, forward.
const TO_CANONICAL: Matrix4 =
    [[-1., 0., 0., 0.], [0., -1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];

fn covariance(scene: &GaussianScene, row: usize) -> [[f64; 3]; 3] {
    let [w, x, y, z] = scene.quat[row].map(f64::from);
    let norm = w * w + x * x + y * y + z * z;
    let r = [
        [
            1. - 2. * (y * y + z * z) / norm,
            2. * (x * y - w * z) / norm,
            2. * (x * z + w * y) / norm,
        ],
        [
            2. * (x * y + w * z) / norm,
            1. - 2. * (x * x + z * z) / norm,
            2. * (y * z - w * x) / norm,
        ],
        [
            2. * (x * z - w * y) / norm,
            2. * (y * z + w * x) / norm,
            1. - 2. * (x * x + y * y) / norm,
        ],
    ];
    let variance = scene.log_scale[row].map(|s| (2.0 * f64::from(s)).exp());
    std::array::from_fn(|i| {
        std::array::from_fn(|j| (0..3).map(|k| r[i][k] * variance[k] * r[j][k]).sum())
    })
}

/// Positions and covariances of `after` are those of `before` under the matrix.
fn check_moved(before: &GaussianScene, after: &GaussianScene, by: &Matrix4) {
    assert_eq!(before.len(), after.len());
    for row in 0..before.len() {
        let p = before.coord[row].map(f64::from);
        let sigma = covariance(before, row);
        let got = covariance(after, row);
        let size = (0..3).map(|i| got[i][i]).sum::<f64>();
        for i in 0..3 {
            let due = (0..3).map(|k| by[i][k] * p[k]).sum::<f64>() + by[i][3];
            let is = f64::from(after.coord[row][i]);
            assert!((is - due).abs() <= 1e-6 * (1.0 + due.abs()), "row {row}: {is} {due}");
            for j in 0..3 {
                let terms = (0..9).map(|n| by[i][n / 3] * sigma[n / 3][n % 3] * by[j][n % 3]);
                let due: f64 = terms.sum();
                assert!((got[i][j] - due).abs() <= 2e-6 * size, "row {row}: {got:?}");
            }
        }
        let q = after.quat[row];
        let norm: f32 = q.iter().map(|v| v * v).sum();
        assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0, "{q:?}");
    }
}

/// The harmonics of one colour channel in direction `d`.
fn shine(scene: &GaussianScene, row: usize, channel: usize, d: [f64; 3]) -> f64 {
    let width = scene.sh_rest_len() * 3;
    let rest = &scene.sh_rest[row * width..(row + 1) * width];
    let values = rest.iter().skip(channel).step_by(3);
    values.zip(rest_basis(d)).map(|(&v, y)| f64::from(v) * y).sum()
}

#[test]
fn the_file_of_cesium() {
    let Some(path) = shared("real/fixtures/cesium_synthetic_legacy.gltf") else { return };
    let bytes = std::fs::read(&path).unwrap();
    assert!(is_gltf_json(&bytes) && !is_glb(&bytes));
    let strict = ReadOptions { policy: Policy::Strict, ..ReadOptions::default() };
    let loaded = read_gltf(&bytes, &path, &strict).unwrap();
    let scene = &loaded.scene;
    assert_eq!((scene.len(), loaded.kind, scene.sh_degree), (5, SceneFormat::Gltf, 0));
    // The node takes (x, y, z) to (x, z, −y) + (2, 12, −7), the frame then negates x and y.
    for (row, at) in [-2.0, -1.0, 0.0, 1.0, 2.0].into_iter().enumerate() {
        close(&scene.coord[row], &[-(at + 2.0), -(at + 12.0), -at - 7.0], 1e-6);
        // The sizes are the powers of e from 1.0 to 1.4.
        close(&scene.log_scale[row], &[1.0 + 0.1 * row as f32; 3], 1e-6);
    }
    assert_eq!(scene.sh_dc[0].map(dc_to_u8), [127, 199, 255]);
    assert_eq!(scene.sh_dc[4].map(dc_to_u8), [156, 228, 255]);
    let alpha: Vec<u8> =
        scene.opacity_logit.iter().map(|&v| (sigmoid(v) * 255.0).round() as u8).collect();
    assert_eq!(alpha, [140, 152, 164, 175, 186]);
    // No rotation of its own; node and frame together are half a turn about (0, 1, −1).
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let [w, x, y, z] = scene.quat[0];
    close(&[w, x, y.abs(), z.abs()], &[0.0, 0.0, half, half], 1e-6);
    assert!(y * z < 0.0);
    // x, y, z, w = (1, 2, 3, 10) / √114, times that half turn.
    let norm = 114f32.sqrt();
    // (0, v) · (10, u) with v = (0, 1, −1), u = (1, 2, 3): −v·u, and 10 v + v × u.
    let due = [1.0, 5.0, 9.0, -11.0].map(|v| v * half / norm);
    let q = scene.quat[1];
    let dot: f32 = q.iter().zip(due).map(|(a, b)| a * b).sum();
    assert!((dot.abs() - 1.0).abs() < 1e-5, "{q:?} {due:?}");
    assert!(loaded.report.notes.iter().any(|n| n.contains("standard deviations")));
}

#[test]
fn containers_hold_the_same_scene() {
    let scene = random_scene(300, 3, 1);
    let mut doc = Doc::new();
    let mesh = doc.mesh(&scene, false);
    doc.node(json!({"mesh": mesh}), true);
    let glb = doc.glb();
    assert!(is_glb(&glb) && !is_gltf_json(&glb));
    let loaded = read(&glb);
    assert_eq!(loaded.scene.sh_degree, 3);
    check_moved(&scene, &loaded.scene, &TO_CANONICAL);
    // Axis flips change signs only.
    for (a, b) in loaded.scene.coord.iter().zip(&scene.coord) {
        assert_eq!(*a, [-b[0], -b[1], b[2]]);
    }
    assert_eq!(loaded.scene.sh_dc, scene.sh_dc);
    for row in 0..scene.len() {
        let (a, b) = (
            shine(&loaded.scene, row, 1, [-0.6, -0.0, 0.8]),
            shine(&scene, row, 1, [0.6, 0.0, 0.8]),
        );
        assert!((a - b).abs() < 1e-6);
        assert!((loaded.scene.opacity_logit[row] - scene.opacity_logit[row]).abs() < 1e-3);
    }

    let text = doc.gltf();
    assert!(is_gltf_json(&text));
    assert_eq!(read(&text).scene, loaded.scene);
    assert_eq!(read(&[b"\xef\xbb\xbf", &text[..]].concat()).scene, loaded.scene);

    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("sub dir")).unwrap();
    std::fs::write(folder.path().join("sub dir/a.bin"), &doc.bin).unwrap();
    let mut json = doc.json.clone();
    json["buffers"] = json!([{"uri": "sub%20dir/a.bin", "byteLength": doc.bin.len()}]);
    let path = folder.path().join("a.gltf");
    let options = ReadOptions::default();
    let open = |json: &Value| read_gltf(&serde_json::to_vec(json).unwrap(), &path, &options);
    assert_eq!(open(&json).unwrap().scene, loaded.scene);
    for uri in ["../a.bin", "/etc/passwd", "http://a/b", "sub dir/../../a.bin", "%2e%2e/a.bin"] {
        json["buffers"][0]["uri"] = json!(uri);
        let error = open(&json).unwrap_err().to_string();
        assert!(error.contains("buffer 0"), "{error}");
    }
    for uri in ["none.bin", "sub dir"] {
        json["buffers"][0]["uri"] = json!(uri);
        let error = open(&json).unwrap_err().to_string();
        assert!(error.contains(uri), "{error}");
    }
    // Without harmonics.
    let options = ReadOptions { sh_rest: false, ..options };
    let bare = read_gltf(&glb, Path::new("a.glb"), &options).unwrap().scene;
    assert_eq!((bare.sh_degree, bare.sh_rest.len()), (0, 0));
    assert_eq!(bare.coord, loaded.scene.coord);
}

#[test]
fn any_number_of_threads_gives_the_same() {
    let scene = random_scene(10_000, 1, 2);
    let mut doc = Doc::new();
    let mesh = doc.mesh(&scene, true);
    doc.node(
        json!({"mesh": mesh, "scale": [1.0, 2.0, 3.0], "rotation": [0.1, 0.2, 0.3, 0.9]}),
        true,
    );
    let glb = doc.glb();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| read(&glb))
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn primitives_are_joined_and_nodes_move_them() {
    let (a, b) = (random_scene(40, 3, 3), random_scene(30, 1, 4));
    let mut doc = Doc::new();
    let (mesh_a, mesh_b) = (doc.mesh(&a, true), doc.mesh(&b, true));
    // A triangle mesh and a plain point cloud, to be left out.
    let plain = doc.push(
        "meshes",
        json!({"primitives": [
        {"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 0}, "mode": 0}]}),
    );
    let q = [0.5f64, -0.5, 0.5, 0.5];
    let leaf = doc.node(json!({"mesh": mesh_a, "scale": [-2.0, -2.0, -2.0]}), false);
    let mid = doc.node(json!({"rotation": q, "children": [leaf], "translation": [1, 2, 3]}), false);
    let m = [0.0, 3.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 5.0, 6.0, 7.0, 1.0];
    doc.node(json!({"matrix": m, "children": [mid], "mesh": plain}), true);
    doc.node(json!({"mesh": mesh_b, "translation": [0.0, 0.0, -4.0]}), true);
    doc.node(json!({"mesh": mesh_b}), false);
    let loaded = doc.read();
    assert_eq!((loaded.scene.len(), loaded.scene.sh_degree), (70, 3));
    let notes = loaded.report.notes.join("\n");
    assert!(notes.contains("2 primitives that are no Gaussians"), "{notes}");
    assert!(notes.contains("several degrees") && notes.contains("logarithms"), "{notes}");

    let outer = [[0., 3., 0., 5.], [3., 0., 0., 6.], [0., 0., 3., 7.], [0., 0., 0., 1.]];
    // x, y, z, w = (1, −1, 1, 1) / 2 takes x to z, z to −y and y to −x.
    let middle = [[0., -1., 0., 1.], [0., 0., -1., 2.], [1., 0., 0., 3.], [0., 0., 0., 1.]];
    let inner = [[-2., 0., 0., 0.], [0., -2., 0., 0.], [0., 0., -2., 0.], [0., 0., 0., 1.]];
    let by = times(&TO_CANONICAL, &times(&outer, &times(&middle, &inner)));
    let first = loaded.scene.select_rows(&(0..40).collect::<Vec<_>>()).unwrap();
    check_moved(&a, &first, &by);
    let d = [0.48, 0.6, 0.64];
    let turned: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| by[i][j] / 6.0 * d[j]).sum());
    for row in 0..40 {
        assert!((shine(&first, row, 2, turned) - shine(&a, row, 2, d)).abs() < 1e-5, "row {row}");
    }
    let second = loaded.scene.select_rows(&(40..70).collect::<Vec<_>>()).unwrap();
    let mut by = TO_CANONICAL;
    by[2][3] = -4.0;
    check_moved(&b, &second, &by);
    assert!(second.sh_rest.chunks_exact(45).all(|rest| rest[9..].iter().all(|&v| v == 0.0)));

    // Without a scene the roots are all nodes that are no child.
    doc.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(doc.read().scene.len(), 70);
    doc.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(doc.read().scene.len(), 100);
}

#[test]
fn stretched_gaussians_have_the_covariance_they_should() {
    let mut scene = random_scene(500, 2, 5);
    // Flat ones, needles, a ball, and one without any thickness.
    for row in 0..100 {
        scene.log_scale[row][row % 3] -= 9.0;
        scene.log_scale[row][(row + row / 10) % 3] += 3.0;
    }
    scene.log_scale[100] = [-3.0; 3];
    scene.log_scale[101] = [f32::NEG_INFINITY, -3.0, -4.0];
    scene.log_scale[102] = [f32::NEG_INFINITY, -3.0, f32::NEG_INFINITY];
    let mut doc = Doc::new();
    let mesh = doc.mesh(&scene, true);
    let child = doc.node(json!({"mesh": mesh, "rotation": [0.0, 0.6, 0.0, 0.8]}), false);
    doc.node(
        json!({"scale": [2.0, -0.5, 1.0], "children": [child], "translation": [1, 0, 0]}),
        true,
    );
    let loaded = doc.read();
    assert!(loaded.report.notes.iter().any(|n| n.contains("stretched")), "{}", loaded.report);
    // A half angle with sine 0.6: cos = 0.28, sin = 0.96.
    let turn = [[0.28, 0., 0.96, 0.], [0., 1., 0., 0.], [-0.96, 0., 0.28, 0.], [0., 0., 0., 1.]];
    let scale = [[2., 0., 0., 1.], [0., -0.5, 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];
    let by = times(&TO_CANONICAL, &times(&scale, &turn));
    check_moved(&scene, &loaded.scene, &by);
    // The determinant of the map is 1, so volumes stay: also those of the thinnest keep digits.
    for row in 0..500 {
        let sum = |s: [f32; 3]| s.iter().map(|&v| f64::from(v)).sum::<f64>();
        let (a, b) = (sum(scene.log_scale[row]), sum(loaded.scene.log_scale[row]));
        assert!(a == b || (a - b).abs() < 1e-5, "row {row}: {a} {b}");
    }
    let sorted = |s: &[f32; 3]| s[0] >= s[1] && s[1] >= s[2];
    assert!(loaded.scene.log_scale.iter().all(sorted));
    // Harmonics follow the nearest orthogonal matrix: the rotation, and the flip of y.
    let flip = [[1., 0., 0., 0.], [0., -1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];
    // scale · turn = (scale · |scale|⁻¹) · |scale| · turn, whose polar factor is flip · turn.
    let rigid = times(&TO_CANONICAL, &times(&flip, &turn));
    let d = [0.48, 0.6, 0.64];
    let turned: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| rigid[i][j] * d[j]).sum());
    for row in 0..500 {
        let (a, b) = (shine(&loaded.scene, row, 0, turned), shine(&scene, row, 0, d));
        assert!((a - b).abs() < 1e-5, "row {row}: {a} {b}");
    }
}

#[test]
fn nodes_that_make_no_sense() {
    let scene = random_scene(3, 0, 6);
    let doc = |node: Value| {
        let mut doc = Doc::new();
        doc.mesh(&scene, true);
        doc.node(node, true);
        doc
    };
    for (node, due) in [
        (json!({"mesh": 0, "scale": [1, 0, 1]}), "without inverse"),
        (json!({"mesh": 0, "scale": [1e200, 1e200, 1e-200]}), "without inverse"),
        (json!({"mesh": 0, "rotation": [0, 0, 0, 0]}), "rotation"),
        (
            json!({"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1]}),
            "last row",
        ),
        (json!({"mesh": 7}), "mesh 7"),
        (json!({"children": [0], "mesh": 0}), "node 0 is in the scene more than once"),
        (json!({"children": [4]}), "node 4 is missing"),
        (json!({}), "shows no Gaussians"),
        (json!({"mesh": 0, "translation": [1, 2]}), "no glTF document"),
    ] {
        let error = doc(node.clone()).error();
        assert!(error.contains(due), "{node}: {error}");
    }
    let mut twice = doc(json!({"mesh": 0}));
    twice.json["scenes"][0]["nodes"] = json!([0, 0]);
    assert!(twice.error().contains("more than once"));
    twice.json["scene"] = json!(3);
    assert!(twice.error().contains("scene 3"));
    // Quaternions without direction are reported as what they are, also below a turned node.
    let mut scene = random_scene(3, 0, 6);
    (scene.quat[1], scene.quat[2]) = ([0.0; 4], [2.0, 0.0, 0.0, 0.0]);
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0, "rotation": [0.6, 0, 0, 0.8]}), true);
    let loaded = doc.read();
    let count = |rule| loaded.report.count(rule);
    let counts = (count(Rule::QuatZero), count(Rule::QuatNotUnit), count(Rule::QuatNotFinite));
    assert_eq!(counts, (1, 1, 0), "{}", loaded.report);
    let equal = loaded.scene.quat[1].iter().zip(&loaded.scene.quat[2]);
    assert!(equal.into_iter().all(|(a, b)| (a - b).abs() < 1e-6));
}

#[test]
fn integers_strides_and_colours() {
    let mut doc = Doc::new();
    // Interleaved: a position of three u16 (not normalized), 2 bytes nothing, four i8.
    let mut bytes = Vec::new();
    for (p, q) in [([1u16, 2, 3], [0i8, 0, 0, 127]), ([400, 500, 600], [-128, 0, 0, 0])] {
        p.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        bytes.extend_from_slice(&[0xaa, 0xbb]);
        q.iter().for_each(|v| bytes.push(*v as u8));
    }
    let view = doc.view(&bytes);
    doc.json["bufferViews"][view]["byteStride"] = json!(12);
    let position = doc.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5123, "type": "VEC3", "count": 2}),
    );
    let rotation = doc.push(
        "accessors",
        json!({"bufferView": view, "byteOffset": 8, "componentType": 5120, "type": "VEC4",
               "count": 2, "normalized": true}),
    );
    let i16s = |values: &[i16]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let scale = doc.accessor(&i16s(&[32767, 0, 3277, 1, 2, 3]), 5122, "VEC3", 2);
    let color = doc.accessor(&i16s(&[-1, 0, 13107, -1, 0, -1, 0, 0]), 5123, "VEC4", 2);
    let attributes = json!({"POSITION": position, "_ROTATION": rotation, "_SCALE": scale,
                            "COLOR_0": color});
    doc.push("meshes", json!({"primitives": [{"attributes": attributes, "mode": 0}]}));
    doc.node(json!({"mesh": 0}), true);
    let scene = doc.read().scene;
    assert_eq!(scene.coord, [[-1.0, -2.0, 3.0], [-400.0, -500.0, 600.0]]);
    assert_eq!(scene.quat[0], [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(scene.quat[1].map(f32::abs), [0.0, 1.0, 0.0, 0.0]);
    close(&scene.log_scale[0][..1], &[0.0], 0.0);
    assert_eq!(scene.log_scale[0][1], f32::NEG_INFINITY);
    close(&scene.log_scale[1], &[1.0f32, 2.0, 3.0].map(|v| (v / 32767.0).ln()), 1e-6);
    close(&scene.sh_dc[0], &[0.5 / SH_C0, -0.5 / SH_C0, -0.3 / SH_C0], 1e-6);
    assert_eq!(scene.opacity_logit, [f32::INFINITY, f32::NEG_INFINITY]);

    // Every byte of a colour comes back, normalized or not; three channels leave alpha missing.
    let mut doc = Doc::new();
    let base = random_scene(256, 0, 7);
    doc.mesh(&base, false);
    doc.node(json!({"mesh": 0}), true);
    let bytes: Vec<u8> = (0..=255).flat_map(|v| [v, 255 - v, 7]).collect();
    let color = doc.accessor(&bytes, 5121, "VEC3", 256);
    let attributes = &mut doc.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["COLOR_0"] = json!(color);
    let attributes = attributes.as_object_mut().unwrap();
    attributes.remove(&format!("{PREFIX}SH_DEGREE_0_COEF_0"));
    let opacity = attributes.remove(&format!("{PREFIX}OPACITY")).unwrap();
    for normalized in [true, false] {
        doc.json["accessors"][color]["normalized"] = json!(normalized);
        let loaded = doc.read();
        for (v, dc) in loaded.scene.sh_dc.iter().enumerate() {
            assert_eq!(dc.map(dc_to_u8), [v as u8, 255 - v as u8, 7]);
        }
        assert_eq!(loaded.report.count(Rule::OpacityMissing), 256);
    }
    // Probabilities outside 0 to 1 are reported and clipped.
    let values: Vec<f32> = (0..256).map(|i| (i as f32 - 10.0) / 200.0).collect();
    let bad = doc.floats(&values, "SCALAR", 256);
    assert_ne!(json!(bad), opacity);
    let attributes = &mut doc.json["meshes"][0]["primitives"][0]["attributes"];
    attributes[format!("{PREFIX}OPACITY")] = json!(bad);
    let loaded = doc.read();
    assert_eq!(loaded.report.count(Rule::OpacityOutside), 10 + 45);
    assert_eq!(loaded.scene.opacity_logit[0], f32::NEG_INFINITY);
    assert_eq!(loaded.scene.opacity_logit[255], f32::INFINITY);
}

#[test]
fn sparse_accessors_replace_elements() {
    let scene = random_scene(5000, 0, 8);
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0}), true);
    let before = doc.read().scene;
    let rows: [u16; 4] = [0, 4095, 4096, 4999];
    let values: Vec<f32> = (0..12).map(|v| v as f32).collect();
    let indices = doc.view(&rows.map(u16::to_le_bytes).concat());
    let values = doc.view(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
    doc.json["accessors"][0]["sparse"] = json!({"count": 4,
        "indices": {"bufferView": indices, "componentType": 5123},
        "values": {"bufferView": values}});
    let after = doc.read().scene;
    let mut due = before;
    for (i, row) in rows.into_iter().enumerate() {
        let at = 3.0 * i as f32;
        due.coord[usize::from(row)] = [-at, -(at + 1.0), at + 2.0];
    }
    assert_eq!(after, due);
    // Without bytes of its own every other element is 0.
    doc.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    let zeros = doc.read().scene;
    assert_eq!(zeros.coord[1], [0.0; 3]);
    assert_eq!(zeros.coord[4999], due.coord[4999]);
    for (field, value, due) in [
        ("count", json!(5), "replaces 5 elements"),
        ("count", json!(u64::MAX), "replaces"),
        ("count", json!(6000), "replaces 6000 elements of 5000"),
        ("indices", json!({"bufferView": indices, "componentType": 5126}), "type 5126"),
        ("indices", json!({"bufferView": 0, "componentType": 5123}), "after"),
        ("indices", json!({"bufferView": 99, "componentType": 5123}), "buffer view 99"),
    ] {
        let mut broken = Doc { json: doc.json.clone(), bin: doc.bin.clone() };
        broken.json["accessors"][0]["sparse"][field] = value;
        let error = broken.error();
        assert!(error.contains(due), "{field}: {error}");
    }
}

#[test]
fn linear_colours_become_srgb() {
    let mut scene = random_scene(50, 1, 9);
    scene.sh_dc[0] = [0.0, (1.0 - 0.5) / SH_C0, (0.0 - 0.5) / SH_C0];
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0}), true);
    let plain = doc.read().scene;
    let about = &mut doc.json["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"];
    about["colorSpace"] = json!("lin_rec709_display");
    let loaded = doc.read();
    assert!(loaded.report.notes.iter().any(|n| n.contains("sRGB")));
    let color = loaded.scene.sh_dc[0].map(|dc| 0.5 + SH_C0 * dc);
    close(&color, &[0.735_357, 1.0, 0.0], 1e-5);
    // Slope of the transfer function at 0.5, and in its linear part.
    close(&[loaded.scene.sh_rest[0] / plain.sh_rest[0]], &[0.658_631], 1e-4);
    close(&[loaded.scene.sh_rest[2] / plain.sh_rest[2]], &[12.92], 1e-3);
}

#[test]
fn spz_inside_is_the_same_gaussians() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.spz");
    let mut scene = random_scene(50, 2, 21);
    scene.segment = Some(vec![3; 50]);
    let options = WriteOptions::default();
    write_scene(&scene, &path, SceneFormat::Spz, &options, &mut |_| true).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let alone = open_scene(&path, &ReadOptions::default()).unwrap().scene;
    let plain = {
        let mut doc = Doc::new();
        // The mesh is written in glTF's frame, so the alone scene goes there first.
        let mut there = alone;
        there.change_frame(Frame::CANONICAL, Frame::LUF);
        let mesh = doc.mesh(&there, true);
        doc.node(json!({"mesh": mesh, "translation": [1, 2, 3]}), true);
        doc.read().scene
    };
    for nested in [true, false] {
        let mut doc = Doc::new();
        let view = doc.view(&bytes);
        let about = json!({"bufferView": view});
        let extensions = if nested {
            let inner = json!({"KHR_gaussian_splatting_compression_spz_2": about});
            json!({"KHR_gaussian_splatting": {"extensions": inner}})
        } else {
            json!({"KHR_spz_gaussian_splats_compression": about})
        };
        let primitive = json!({"attributes": {}, "mode": 0, "extensions": extensions});
        let mesh = doc.push("meshes", json!({"primitives": [primitive]}));
        doc.node(json!({"mesh": mesh, "translation": [1, 2, 3]}), true);
        let read = doc.read().scene;
        assert_eq!(read.len(), 50);
        close(read.coord.as_flattened(), plain.coord.as_flattened(), 1e-5);
        close(&read.sh_rest, &plain.sh_rest, 1e-6);
        for (a, b) in read.quat.iter().zip(&plain.quat) {
            let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 1e-6, "{a:?} {b:?}");
        }
        // Damage inside is damage of the whole.
        let at = doc.bin.len() / 2;
        doc.bin[at..].fill(0x55);
        assert!(doc.error().contains("a.glb"), "{}", doc.error());
    }
}

/// The bytes of a scene as an SPZ file.
fn spz_bytes(scene: &GaussianScene) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.spz");
    write_scene(scene, &path, SceneFormat::Spz, &WriteOptions::default(), &mut |_| true).unwrap();
    std::fs::read(&path).unwrap()
}

/// A document with a mesh that is an SPZ file.
fn doc_of_spz(bytes: &[u8]) -> Doc {
    let mut doc = Doc::new();
    let view = doc.view(bytes);
    let inner = json!({"KHR_gaussian_splatting_compression_spz_2": {"bufferView": view}});
    let extensions = json!({"KHR_gaussian_splatting": {"extensions": inner}});
    let primitive = json!({"attributes": {}, "mode": 0, "extensions": extensions});
    doc.push("meshes", json!({"primitives": [primitive]}));
    doc
}

#[test]
fn spz_grows_no_more_than_attributes() {
    // 64 KiB of text and a few bytes of Gaussians would be a million of them.
    let equal = random_scene(1, 0, 4).select_rows(&vec![0; 5000]).unwrap();
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    for _ in 0..200 {
        doc.node(json!({"mesh": 0}), true);
    }
    let error = doc.error();
    assert!(error.contains("shows 1000000 Gaussians in 200 primitives"), "{error}");
    // So would many meshes with a view each of the same bytes.
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    for i in 1..200 {
        let view = doc.json["bufferViews"][0].clone();
        doc.push("bufferViews", view);
        let mut mesh = doc.json["meshes"][0].clone();
        mesh["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["extensions"]["KHR_gaussian_splatting_compression_spz_2"]
            ["bufferView"] = json!(i);
        doc.push("meshes", mesh);
    }
    for mesh in 0..200 {
        doc.node(json!({"mesh": mesh}), true);
    }
    assert!(doc.error().contains("can hold"));
    // An attribute without harmonics gets the degree of the SPZ beside it.
    let mut doc = doc_of_spz(&spz_bytes(&random_scene(1, 4, 4)));
    doc.mesh(&random_scene(60_000, 0, 5), false);
    doc.node(json!({"mesh": 0}), true);
    doc.node(json!({"mesh": 1}), true);
    assert_eq!(doc.read().scene.sh_rest.len(), 60_001 * 72);
    // Harmonics that are 0 take no room in the file, and are nothing to be suspicious of.
    let mut dark = random_scene(60_000, 4, 6);
    dark.sh_rest.fill(0.0);
    let mut doc = doc_of_spz(&spz_bytes(&dark));
    doc.node(json!({"mesh": 0}), true);
    assert_eq!(doc.read().scene.len(), 60_000);
    // Where harmonics are not asked for, they do not count.
    let mut doc = doc_of_spz(&spz_bytes(&equal));
    (0..50).for_each(|_| {
        doc.node(json!({"mesh": 0}), true);
    });
    assert_eq!(doc.read().scene.len(), 250_000);
}

#[test]
fn spz_shown_by_several_nodes_is_read_once() {
    let scene = random_scene(30, 1, 8);
    let mut bytes = spz_bytes(&scene);
    bytes.extend_from_slice(b"more");
    let mut doc = doc_of_spz(&bytes);
    let alone = {
        doc.node(json!({"mesh": 0}), true);
        doc.read().scene
    };
    doc.mesh(&random_scene(3, 2, 9), true);
    doc.node(json!({"mesh": 1}), true);
    doc.node(json!({"mesh": 0, "translation": [1, 0, 0]}), true);
    doc.node(json!({"mesh": 0}), true);
    let loaded = doc.read();
    assert_eq!(loaded.report.count(Rule::FileTrailing), 1, "{}", loaded.report);
    let rows = |from: usize| {
        let mut part = loaded.scene.select_rows(&(from..from + 30).collect::<Vec<_>>()).unwrap();
        part.sh_rest = part.sh_rest.chunks(24).flat_map(|rest| rest[..9].to_vec()).collect();
        part.sh_degree = 1;
        part
    };
    assert_eq!(loaded.scene.len(), 93);
    assert_eq!(rows(0), alone);
    assert_eq!(rows(63), alone);
    let moved = rows(33);
    for (a, b) in moved.coord.iter().zip(&alone.coord) {
        close(a, &[b[0] - 1.0, b[1], b[2]], 1e-5);
    }
    assert_eq!((moved.sh_rest, moved.sh_dc), (alone.sh_rest, alone.sh_dc));
}

#[test]
fn what_is_not_read_is_named() {
    let scene = random_scene(3, 1, 10);
    let mut base = Doc::new();
    base.mesh(&scene, true);
    base.node(json!({"mesh": 0}), true);
    let with = |change: &dyn Fn(&mut Value)| {
        let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
        change(&mut doc.json);
        doc.error()
    };
    let attribute = |name: &'static str| {
        move |json: &mut Value| {
            let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
            attributes.as_object_mut().unwrap().remove(name);
        }
    };
    let error = with(&|json| json["extensionsRequired"] = json!(["EXT_meshopt_compression"]));
    assert!(error.contains("EXT_meshopt_compression"), "{error}");
    let error = with(&|json| {
        json["bufferViews"][0]["extensions"] = json!({"EXT_meshopt_compression": {"buffer": 0}});
    });
    assert!(error.contains("EXT_meshopt_compression"), "{error}");
    assert!(with(&attribute("POSITION")).contains("POSITION"));
    let error = with(&attribute("KHR_gaussian_splatting:SH_DEGREE_1_COEF_1"));
    assert!(error.contains("SH_DEGREE_1_COEF_1"), "{error}");
    let error = with(&|json| json["accessors"][0]["count"] = json!(2));
    assert!(error.contains("has 3 elements, POSITION 2"), "{error}");
    let error = with(&|json| json["accessors"][1]["type"] = json!("VEC3"));
    assert!(error.contains("ROTATION has 3 components"), "{error}");
    let error = with(&|json| json["accessors"][1]["componentType"] = json!(5124));
    assert!(error.contains("component type 5124"), "{error}");
    let error = with(&|json| {
        json["accessors"][1].as_object_mut().unwrap().remove("bufferView");
    });
    assert!(error.contains("has no bytes"), "{error}");
}

#[test]
fn counts_and_lengths_that_lie() {
    let scene = random_scene(10, 1, 11);
    let mut base = Doc::new();
    base.mesh(&scene, true);
    base.node(json!({"mesh": 0}), true);
    for huge in [11u64, 1 << 20, u64::from(u32::MAX), 1 << 40, u64::MAX] {
        for accessors in [0..1, 0..20] {
            let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
            for accessor in accessors {
                if let Some(accessor) = doc.json["accessors"].get_mut(accessor) {
                    accessor["count"] = json!(huge);
                }
            }
            doc.error();
        }
        for field in ["byteLength", "byteOffset", "byteStride"] {
            let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
            doc.json["bufferViews"][0][field] = json!(huge.saturating_mul(100));
            doc.error();
        }
        // Elements that are all 0 cost no bytes.
        let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
        let accessors = doc.json["accessors"].as_array_mut().unwrap();
        for accessor in accessors.iter_mut() {
            accessor["count"] = json!(huge.max(1 << 20));
            accessor.as_object_mut().unwrap().remove("bufferView");
            accessor["sparse"] = json!({"count": 0, "indices": {"bufferView": 0,
                "componentType": 5121}, "values": {"bufferView": 0}});
        }
        assert!(doc.error().contains("can hold"));
    }
    // One mesh under very many nodes.
    let mut doc = Doc { json: base.json.clone(), bin: base.bin.clone() };
    for _ in 0..70_000 {
        doc.node(json!({"mesh": 0}), true);
    }
    assert!(doc.error().contains("primitives"));
    // A document of nothing but braces.
    let braces = format!("{{\"asset\":{{}},\"nodes\":[{}{{}}]}}", "{},".repeat(1 << 20));
    let error = read_gltf(braces.as_bytes(), Path::new("a"), &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("objects"));
    let deep = "[".repeat(100_000);
    let deep = format!("{{\"asset\":{{}},\"extras\":{deep}");
    assert!(read_gltf(deep.as_bytes(), Path::new("a"), &ReadOptions::default()).is_err());
    assert!(!is_gltf_json(deep.as_bytes()));
}

#[test]
fn damaged_files_are_refused_without_panic() {
    let scene = random_scene(9, 1, 12);
    let mut doc = Doc::new();
    doc.mesh(&scene, true);
    doc.node(json!({"mesh": 0, "scale": [1, 2, 1]}), true);
    let options = ReadOptions::default();
    let (glb, text) = (doc.glb(), doc.gltf());
    for cut in 0..glb.len() {
        assert!(read_gltf(&glb[..cut], Path::new("a"), &options).is_err(), "cut at {cut}");
    }
    for cut in 0..text.len() {
        assert!(read_gltf(&text[..cut], Path::new("a"), &options).is_err(), "cut at {cut}");
    }
    let body = glb.windows(4).position(|w| w == b"BIN\0").unwrap() + 4;
    let mut rng = SplitMix(13);
    for (file, seeds) in [(&glb, 2000), (&text, 2000)] {
        for _ in 0..seeds {
            let mut bytes = file.clone();
            let mut only_body = std::ptr::eq(file, &glb);
            for _ in 0..=rng.below(3) {
                let at = rng.below(bytes.len());
                only_body &= at >= body;
                bytes[at] = match rng.below(3) {
                    0 => rng.next() as u8,
                    1 => bytes[at] ^ 1 << rng.below(8),
                    _ => b"0123456789-,[]{}\"e"[rng.below(18)],
                };
            }
            match read_gltf(&bytes, Path::new("a"), &options) {
                Ok(loaded) => {
                    loaded.scene.check_rows().unwrap();
                    assert_eq!(loaded.source_rows(), 9);
                }
                // Numbers can be spoilt so that no row is usable, but never the structure.
                Err(error) => {
                    assert!(!only_body || error.to_string().contains("usable"), "{error}");
                }
            }
        }
    }
}

#[test]
fn what_is_written_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let [first, second] = ["a.glb", "b.glb"].map(|name| dir.path().join(name));
    let options = WriteOptions::default();
    for degree in 0..=4 {
        let mut scene = common::random_scene(500, degree, 11);
        scene.segment = Some((0..500).map(|i| i % 7 - 1).collect());
        (scene.opacity_logit[3], scene.opacity_logit[4]) = (f32::INFINITY, f32::NEG_INFINITY);
        let overwrite = WriteOptions { overwrite: true, ..options.clone() };
        let write = |scene: &GaussianScene, path: &Path| {
            write_scene(scene, path, SceneFormat::Glb, &overwrite, &mut |_| true).unwrap()
        };
        let report = write(&scene, &first);
        assert!(report.limits.is_empty(), "{report}");
        let back = open_scene(&first, &ReadOptions::default()).unwrap();
        assert_eq!((back.kind, back.scene.sh_degree), (SceneFormat::Gltf, degree));
        let back = back.scene;
        // Bit for bit, but for what passes through an exponential.
        assert_eq!((&back.coord, &back.quat), (&scene.coord, &scene.quat));
        assert_eq!((&back.sh_dc, &back.sh_rest), (&scene.sh_dc, &scene.sh_rest));
        assert_eq!(back.segment, scene.segment);
        for (a, b) in back.log_scale.iter().flatten().zip(scene.log_scale.iter().flatten()) {
            assert!((a - b).abs() < 2e-6, "{a} {b}");
        }
        for (a, b) in back.opacity_logit.iter().zip(&scene.opacity_logit) {
            assert!(a == b || (a - b).abs() < 1e-3 * b.abs().max(1.0), "{a} {b}");
        }
        write(&back, &second);
        assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap());
    }
    // In the file the frame is glTF's: left, up, forward.
    let scene = common::random_scene(1, 0, 2);
    let overwrite = WriteOptions { overwrite: true, ..options };
    write_scene(&scene, &first, SceneFormat::Glb, &overwrite, &mut |_| true).unwrap();
    let bytes = std::fs::read(&first).unwrap();
    let length = u32::from_le_bytes(*bytes[12..].first_chunk().unwrap()) as usize;
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let [x, y, z] = scene.coord[0];
    for end in ["min", "max"] {
        let value = |a: usize| json["accessors"][0][end][a].as_f64().unwrap() as f32;
        assert_eq!([0, 1, 2].map(value), [-x, -y, z]);
    }
    assert_eq!((bytes.len() % 4, length % 4), (0, 0));
}
