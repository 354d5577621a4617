//! Nodes that move Gaussians.

use super::placement::{TO_CANONICAL, check_moved, shine, times};
use crate::common::gltf::Doc;
use crate::common::random_scene;
use scenesplat_scene::value_policy::Rule;
use serde_json::{Value, json};

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
