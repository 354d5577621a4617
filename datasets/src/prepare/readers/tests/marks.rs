//! What the layouts say of single vertices: which name, object and normal, and of two that claim one, which.

use super::super::boxes::{Box3, label};
use super::super::majority;
use super::*;
use hdf5_pure::FileBuilder;
use scenesplat_scene::formats::ply::PlyLists;

/// An ASCII cloud: names of whole-number columns, and rows of a place and those numbers.
fn cloud(columns: &[&str], rows: &[&str]) -> String {
    let columns: String = columns.iter().map(|name| format!("property int {name}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         {columns}end_header\n{}\n",
        rows.len(),
        rows.join("\n")
    )
}

#[test]
fn layouts_have_their_names_and_vertices_the_most_frequent_face() {
    let names =
        "scannet scannetpp matterport3d replica 3rscan arkitscenes hypersim interiorgs points";
    assert_eq!(ScanLayout::ALL.map(ScanLayout::name).join(" "), names);
    // Vertex 0 is in two faces of 5 and one of 3, vertex 1 in one each of 5, 9 and 3, vertex 4 in none.
    let faces =
        PlyLists { offsets: vec![0, 3, 5, 7], values: vec![0, 1, 2, 0, 1, 0, 1], columns: vec![] };
    let found = majority(5, &faces, |face| [5, 5, 3][face]);
    assert_eq!(found, [Some(5), Some(5), Some(5), None, None]);
    let found = majority(5, &faces, |face| [9, 3, 5][face]);
    assert_eq!(found, [Some(3), Some(3), Some(9), None, None]);
}

#[test]
fn a_point_is_of_the_smallest_box_that_holds_it_and_of_equal_ones_of_the_first() {
    let own = |center: [f64; 3], half: [f64; 3], name| Box3 {
        center,
        half,
        axes: [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]],
        name,
    };
    // The second is long along its first side, (3, 4) / 5, and thin along the others.
    let boxes = [
        own([0.0; 3], [5.0; 3], 7),
        own([1.0, 2.0, 3.0], [2.0, 0.5, 0.25], 3),
        own([1.0, 2.0, 3.0], [0.5, 2.0, 0.25], 5),
        own([9.0, 0.0, 0.0], [1.0; 3], 2),
    ];
    let along = |first: f64, second: f64, up: f64| {
        [0.6 * first - 0.8 * second + 1.0, 0.8 * first + 0.6 * second + 2.0, up + 3.0]
            .map(|v| v as f32)
    };
    let points = [
        along(1.9, 0.4, 0.2),
        along(-1.9, -0.4, -0.2),
        along(1.9, 0.6, 0.2),
        along(0.4, 1.9, 0.2),
        along(0.4, 0.4, 0.25),
        along(0.4, 0.4, 0.26),
        along(2.1, 0.0, 0.0),
        [9.0, 0.0, 1.0],
        [9.0, 0.0, 1.1],
    ];
    let (names, numbers) = label(&points, &boxes);
    assert_eq!(names, [3, 3, 7, 5, 3, 7, 7, 2, -1]);
    assert_eq!(numbers, [1, 1, 0, 2, 1, 0, 0, 3, -1]);
}

#[test]
fn segments_that_are_objects_have_the_benchmarks_own_numbers() {
    let mini = Mini::new();
    let folder = mini.0.path().join("s");
    mini.mesh("s/s_vh_clean_2.ply", None, None);
    let segments = "s/s_vh_clean_2.0.010000.segs.json";
    mini.json(segments, &json!({"segIndices": [1, 1, 2, 2, 3, 4, -5]}));
    // Equal names have one number; a number of an object that no i32 holds is none; of objects of equal size the
    // first has the segment; without objectId the id counts.
    let groups = |first: i64| {
        json!({"segGroups": [
            {"objectId": first, "id": 70, "segments": [1], "label": " chair\t"},
            {"id": 8, "segments": [2, 3], "label": "table"},
            {"id": 9, "segments": [4], "label": "chair"},
            {"id": 10, "segments": [4], "label": "lamp"},
            {"id": 11, "segments": [-5, 66], "label": "rug"}]})
    };
    mini.json("s/s.aggregation.json", &groups(6));
    let scan = read_scan(&folder, ScanLayout::Scannet).unwrap();
    assert_eq!(named(&scan), ["chair", "chair", "table", "table", "table", "chair", "rug"]);
    assert_eq!(scan.instance, [6, 6, 8, 8, 8, 9, 11]);
    assert_eq!(scan.names, ["chair", "table", "lamp", "rug"]);
    assert_eq!(scan.coord, VERTICES);
    mini.json("s/s.aggregation.json", &groups(1 << 40));
    assert_eq!(read_scan(&folder, ScanLayout::Scannet).unwrap().instance[..3], [-1, -1, 8]);
    for (group, part) in [
        (json!({"label": "a", "segments": [1]}), "segGroups[0] has no objectId"),
        (json!({"id": 1, "segments": [1]}), "segGroups[0] has no label"),
        (json!({"id": 1, "label": "a", "segments": [1.5]}), "has no list segments of whole"),
    ] {
        mini.json("s/s.aggregation.json", &json!({"segGroups": [group]}));
        refused(&folder, ScanLayout::Scannet, &["s.aggregation.json", part]);
    }
    mini.json("s/s.aggregation.json", &json!({}));
    refused(&folder, ScanLayout::Scannet, &["has no list segGroups"]);
    // One of the two files alone is not the hidden test set.
    std::fs::remove_file(mini.at(segments)).unwrap();
    refused(&folder, ScanLayout::Scannet, &["segs.json"]);

    // Matterport3D's faces: numbers of objects, not of groups, and a normal at each vertex.
    let region = mini.0.path().join("region0.ply");
    mini.mesh("region0.ply", None, None);
    mini.json("region0.fsegs.json", &json!({"segIndices": [3, 3, 4]}));
    mini.json(
        "region0.semseg.json",
        &json!({"segGroups": [
        {"objectId": 12, "segments": [4], "label": "rug"},
        {"objectId": 5, "segments": [3], "label": "floor"}]}),
    );
    let scan = read_scan(&region, ScanLayout::Matterport3d).unwrap();
    // Vertex 1 is in one face of each: of the group that comes first in the file.
    assert_eq!(named(&scan), ["floor", "rug", "floor", "floor", "rug", "rug", "-"]);
    assert_eq!(scan.instance, [5, 12, 5, 5, 12, 12, -1]);
    let up = [0.0, 0.0, 1.0];
    let normals = vec![up, up, up, up, up, up, [0.0; 3]];
    assert_eq!(scan.normal, Some(normals.clone()));

    // Replica: vertex 1 is in a face of 8 and one of 3, the smaller number; names in the order of the list.
    let folder = mini.0.path().join("r");
    mini.mesh("r/habitat/mesh_semantic.ply", None, Some(("int object_id", [8, 8, 3])));
    let object = |id, name: &str| json!({"id": id, "class_name": name});
    mini.json(
        "r/habitat/info_semantic.json",
        &json!({"objects": [object(8, "sofa"), object(3, "rug"), object(4, "sofa")]}),
    );
    let scan = read_scan(&folder, ScanLayout::Replica).unwrap();
    assert_eq!(named(&scan), ["sofa", "rug", "sofa", "sofa", "rug", "rug", "-"]);
    assert_eq!((&scan.instance[..2], scan.names.len()), (&[8, 3][..], 2));
    assert_eq!(scan.normal, Some(normals));
}

#[test]
fn points_say_their_numbers_by_the_first_column_that_is_there() {
    let mini = Mini::new();
    let path = mini.at("a.ply");
    let rows = ["0 0 0 7 8 9 1 2", "1 2 3 -3 5 6 -4 3"];
    let read = |columns: &[&str]| {
        let rows: Vec<String> = rows
            .iter()
            .map(|row| row.split(' ').take(3 + columns.len()).collect::<Vec<_>>().join(" "))
            .collect();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        std::fs::write(&path, cloud(columns, &rows)).unwrap();
        read_scan(&path, ScanLayout::Points).unwrap()
    };
    let all = ["semantic", "label", "segment", "objectId", "instance"];
    let scan = read(&all);
    assert_eq!((named(&scan), scan.instance.as_slice()), (vec!["9", "6"], &[2, 3][..]));
    assert_eq!((scan.coord[1], scan.normal), ([1.0, 2.0, 3.0], None));
    let scan = read(&["semantic", "label", "a", "objectId"]);
    assert_eq!((named(&scan), scan.instance.as_slice()), (vec!["8", "5"], &[1, -4][..]));
    let scan = read(&["semantic"]);
    assert_eq!((named(&scan), scan.instance.as_slice()), (vec!["7", "-"], &[-1, -1][..]));
    std::fs::write(&path, cloud(&["label"], &[])).unwrap();
    refused(&path, ScanLayout::Points, &["has no vertices"]);
    // A face may name its corners under the other word, and none before the first vertex.
    mini.mesh("b.ply", Some(("int label", [3; 7])), None);
    let path = mini.at("b.ply");
    let text = std::fs::read_to_string(&path).unwrap().replace("vertex_indices", "vertex_index");
    std::fs::write(&path, &text).unwrap();
    let normals = read_scan(&path, ScanLayout::Points).unwrap().normal.unwrap();
    assert_eq!((normals[5], normals[6]), ([0.0, 0.0, 1.0], [0.0; 3]));
    std::fs::write(&path, text.replace("4 1 4 5 2", "4 1 4 -1 2")).unwrap();
    refused(&path, ScanLayout::Points, &["a face names vertex -1, there are 7"]);

    // 3RScan: the second version counts where both are; the vertices' column under either name.
    for name in ["objectId", "object_id"] {
        let rows = ["0 0 0 4", "0 0 1 -2", "0 1 0 6"];
        std::fs::write(mini.at("t/labels.instances.annotated.v2.ply"), cloud(&[name], &rows))
            .unwrap();
        std::fs::write(mini.at("t/labels.instances.annotated.ply"), "old").unwrap();
        mini.json("t/semseg.json", &json!({"segGroups": []}));
        let group = |id, label: &str| json!({"id": id, "label": label});
        mini.json(
            "t/semseg.v2.json",
            &json!({"segGroups": [group(6, " bed "), group(4, "bed"), group(-2, "box")]}),
        );
        let scan = read_scan(&mini.at("t"), ScanLayout::ThreeRScan).unwrap();
        assert_eq!(
            (named(&scan), &scan.instance[..]),
            (vec!["bed", "box", "bed"], &[4, -2, 6][..])
        );
        assert_eq!((scan.names, scan.normal), (vec!["bed".to_owned(), "box".to_owned()], None));
    }
}

#[test]
fn boxes_of_files_are_read_side_by_side() {
    let mini = Mini::new();
    mini.mesh("v/v_3dod_mesh.ply", None, None);
    let annotation = "v/v_3dod_annotation.json";
    // Of unequal lengths: from (0.4, −0.1, −0.1) to (2.6, 0.3, 0.1) along upright sides.
    let item = |axes: serde_json::Value, centroid: serde_json::Value| {
        json!({"data": [{"label": " bench ", "segments": {"obbAligned": {
            "centroid": centroid, "axesLengths": [2.2, 0.4, 0.2], "normalizedAxes": axes}}}]})
    };
    let straight = json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    mini.json(annotation, &item(straight.clone(), json!([1.5, 0.1, 0.0])));
    let (folder, layout) = (mini.at("v"), ScanLayout::Arkitscenes);
    let scan = read_scan(&folder, layout).unwrap();
    assert_eq!(named(&scan), ["-", "bench", "-", "-", "bench", "-", "-"]);
    assert_eq!(
        (scan.names.as_slice(), scan.normal.unwrap()[1]),
        (&["bench".to_owned()][..], [0.0, 0.0, 1.0])
    );
    // Its first side along y.
    mini.json(annotation, &item(json!([0, 1, 0, 1, 0, 0, 0, 0, 1]), json!([1.0, 0.5, 0.0])));
    assert_eq!(named(&read_scan(&folder, layout).unwrap())[..5], ["-", "bench", "bench", "-", "-"]);
    mini.json(annotation, &item(straight, json!([1.5, 0.1])));
    refused(&folder, layout, &["data[0] has no centroid of three numbers"]);
    mini.json(annotation, &json!({"data": [{"label": "a", "segments": {}}]}));
    refused(&folder, layout, &["data[0] has no segments.obbAligned"]);

    // InteriorGS: boxes are in the file's coordinates, which start far from 0, and are grown by 1 cm.
    let x = [0.0, 1.0, 1.509, 1.511, -0.009, -0.011].map(|x| 500.0 + x);
    let z = [0.0, 0.2, 0.1, 0.1, 0.1, 0.1];
    let scene = GaussianScene {
        coord: x.iter().zip(z).map(|(x, z)| [*x as f32, 40.0, z]).collect(),
        log_scale: vec![[-4.0; 3]; 6],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; 6],
        opacity_logit: vec![2.0; 6],
        sh_dc: vec![[0.5; 3]; 6],
        ..GaussianScene::default()
    };
    let path = mini.at("i/3dgs_compressed.ply");
    // The reader goes by the header, not by the name.
    write_scene(&scene, &path, SceneFormat::Ply, &WriteOptions::default(), &mut |_| true).unwrap();
    let corner = |i: usize| {
        let (x, y, z) = ([500.0, 501.5][i & 1], [39.8, 40.3][i >> 1 & 1], [0.0, 0.15][i >> 2]);
        json!({"x": x, "y": y, "z": z})
    };
    let corners: Vec<_> = [3, 0, 6, 5, 1, 2, 7, 4].map(corner).to_vec();
    mini.json("i/labels.json", &json!({"labels": [{"label": " tv ", "bounding_box": corners}]}));
    let scan = read_scan(&mini.at("i"), ScanLayout::InteriorGs).unwrap();
    assert_eq!(named(&scan), ["tv", "-", "tv", "-", "tv", "-"]);
    assert!((0..6).all(|i| (f64::from(scan.coord[i][0]) - x[i]).abs() < 1e-4), "{:?}", scan.coord);
    for (value, part) in [
        (json!({"label": "a", "bounding_box": corners[..7]}), "bounding_box of eight corners"),
        (json!({"bounding_box": corners}), "labels[0] has no label"),
        (json!({"label": "a", "bounding_box": vec![corner(0); 8]}), "not those of a box"),
    ] {
        mini.json("i/labels.json", &json!([value]));
        refused(&mini.at("i"), ScanLayout::InteriorGs, &[part]);
    }
}

#[test]
fn cubes_of_pixels_say_what_most_of_them_say() {
    let mini = Mini::new();
    let folder = mini.at("ai");
    std::fs::create_dir_all(folder.join("_detail")).unwrap();
    std::fs::write(folder.join("_detail/metadata_scene.csv"), "a,b\nmeters_per_asset_unit , 0.5\n")
        .unwrap();
    type Pixel = ([f32; 3], i16, i32, [f32; 3]);
    let picture = |camera: &str, frame: &str, pixels: &[Pixel], normals: bool| {
        let at = |what: &str| {
            mini.at(&format!("ai/images/scene_{camera}_geometry_hdf5/{frame}.{what}.hdf5"))
        };
        let n = pixels.len() as u64;
        let write = |what: &str, fill: &dyn Fn(&mut FileBuilder)| {
            let mut file = FileBuilder::new();
            fill(&mut file);
            file.write(at(what)).unwrap();
        };
        let three = |of: fn(&Pixel) -> [f32; 3]| pixels.iter().flat_map(of).collect::<Vec<f32>>();
        write("position", &|f| {
            f.create_dataset("dataset").with_data(&three(|p| p.0)).with_shape(&[1, n, 3]);
        });
        let labels: Vec<i16> = pixels.iter().map(|p| p.1).collect();
        write("semantic", &|f| {
            f.create_dataset("dataset").with_data(&labels).with_shape(&[1, n]);
        });
        let objects: Vec<i32> = pixels.iter().map(|p| p.2).collect();
        write("semantic_instance", &|f| {
            f.create_dataset("dataset").with_data(&objects).with_shape(&[1, n]);
        });
        if normals {
            write("normal_world", &|f| {
                f.create_dataset("dataset").with_data(&three(|p| p.3)).with_shape(&[1, n, 3]);
            });
        }
    };
    let nan = f32::NAN;
    let (up, side) = ([0.0, 0.0, 1.0], [0.0, 2.0, 0.0]);
    // In units of half a meter: cubes of 0.04. NYU40's 5 is a chair, 2 the floor, 41 nothing.
    picture(
        "cam_00",
        "frame.0000",
        &[
            ([1.001, 0.0, 0.0], 5, 9, up),
            ([1.003, 0.01, 0.02], 2, 4, side),
            ([nan, 0.0, 0.0], 3, 3, up),
            ([-0.001, 0.0, 0.0], -1, 6, up),
            ([-0.003, 0.0, 0.0], 2, 7, [nan, 0.0, 0.0]),
        ],
        true,
    );
    // The second picture decides the first cube; in the third cube two say none, and one the floor.
    picture(
        "cam_01",
        "frame.0007",
        &[
            ([1.005, 0.02, 0.01], 2, 4, side),
            ([3.0, 0.0, 0.0], 41, -1, up),
            ([3.0, 0.0, 0.0], 41, -1, up),
            ([3.0, 0.0, 0.0], 2, 1, up),
        ],
        true,
    );
    // Folders and files of other kinds are passed over.
    std::fs::create_dir_all(folder.join("images/scene_cam_00_final_hdf5")).unwrap();
    std::fs::write(folder.join("images/scene_cam_00_final_hdf5/frame.0000.position.hdf5"), "")
        .unwrap();
    let scan = read_scan(&folder, ScanLayout::Hypersim).unwrap();
    // The second cube has a vote each: the one with a label wins.
    assert_eq!(named(&scan), ["floor", "floor", "-"]);
    assert_eq!(scan.instance, [4, 7, -1]);
    let near = |p: [f32; 3], q: [f64; 3]| (0..3).all(|k| (f64::from(p[k]) - q[k]).abs() < 1e-6);
    assert!(near(scan.coord[0], [0.5015, 0.005, 0.005]), "{:?}", scan.coord);
    assert!(near(scan.coord[1], [-0.001, 0.0, 0.0]) && near(scan.coord[2], [1.5, 0.0, 0.0]));
    // (0, 4, 1) at unit length; what is not finite says nothing.
    let normals = scan.normal.unwrap();
    let length = 17f64.sqrt();
    assert!(near(normals[0], [0.0, 4.0 / length, 1.0 / length]), "{normals:?}");
    assert_eq!(normals[1..], [up, up]);
    // One picture without normals: none at all.
    picture("cam_01", "frame.0008", &[([7.0, 0.0, 0.0], 1, 1, up)], false);
    let scan = read_scan(&folder, ScanLayout::Hypersim).unwrap();
    assert_eq!((scan.normal.as_ref(), named(&scan)[3]), (None, "wall"));
    std::fs::remove_dir_all(folder.join("images")).unwrap();
    picture("cam_00", "frame.0000", &[([nan, 0.0, 0.0], 1, 1, up)], false);
    refused(&folder, ScanLayout::Hypersim, &["none of the 1 pictures shows anything"]);
    std::fs::remove_dir_all(folder.join("images/scene_cam_00_geometry_hdf5")).unwrap();
    refused(&folder, ScanLayout::Hypersim, &["holds no picture"]);
    for value in ["0", "-1", "inf"] {
        let text = format!("meters_per_asset_unit,{value}\n");
        std::fs::write(folder.join("_detail/metadata_scene.csv"), text).unwrap();
        refused(&folder, ScanLayout::Hypersim, &["meters_per_asset_unit is"]);
    }
}
