//! Labeled point clouds.

use scenesplat_scene::formats::labelled_ply::{LabelledCloud, read_labelled_ply};
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{Policy, RepairReport, SceneError};

fn read(text: &str, policy: Policy) -> Result<(LabelledCloud, RepairReport), SceneError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.ply");
    std::fs::write(&path, text).unwrap();
    read_labelled_ply(&path, policy, None)
}

fn cloud(properties: &str, rows: &[&str]) -> String {
    let count = rows.len();
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {count}\n");
    for property in properties.split(", ") {
        text += &format!("property {property}\n");
    }
    text + "end_header\n" + &rows.join("\n") + "\n"
}

const XYZ: &str = "float x, float y, float z";

#[test]
fn every_column_is_read() {
    let text = cloud(
        &format!(
            "{XYZ}, float nx, float ny, float nz, uchar red, uchar green, uchar blue, ushort label, ushort instance"
        ),
        &[
            "1 2 3 0 0 1 10 20 30 4 5",
            "4 5 6 0 1 0 255 0 1 65535 65535",
            "7 8 9 1 0 0 0 0 0 65534 0",
        ],
    );
    let (cloud, report) = read(&text, Policy::Strict).unwrap();
    assert_eq!(cloud.coord, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
    assert_eq!(cloud.normal.as_ref().unwrap()[1], [0.0, 1.0, 0.0]);
    assert_eq!(cloud.color.as_ref().unwrap()[..2], [[10, 20, 30], [255, 0, 1]]);
    assert_eq!(cloud.segment, [4, -1, 65_534]);
    assert_eq!(cloud.instance.as_deref(), Some(&[5, -1, 0][..]));
    assert_eq!(report.count(Rule::SegmentNone), 1);
    assert_eq!(report.count(Rule::InstanceNone), 1);
    let points = cloud.clone().into_points([0.0; 3]);
    assert_eq!((points.coord, points.segment), (cloud.coord, Some(cloud.segment)));
}

#[test]
fn labels_go_by_several_names_and_types() {
    for (property, row, label) in [
        ("int label", "0 0 0 -7", -1),
        ("int segment", "0 0 0 65535", 65_535),
        ("uchar semantic", "0 0 0 255", 255),
        ("uint class", "0 0 0 4294967295", -1),
        ("float label", "0 0 0 3", 3),
    ] {
        let text = cloud(&format!("{XYZ}, {property}"), &[row]);
        assert_eq!(read(&text, Policy::Repair).unwrap().0.segment, [label], "{property}");
    }
    let error = read(&cloud(XYZ, &["0 0 0"]), Policy::Repair).unwrap_err().to_string();
    assert!(error.contains("no labels") && error.contains("segment"), "{error}");
    let error =
        read(&cloud("float x, int label", &["0 0"]), Policy::Repair).unwrap_err().to_string();
    assert!(error.contains("no position"), "{error}");
}

#[test]
fn points_without_a_position_are_left_out_of_every_array() {
    let properties = format!("{XYZ}, int label, int instance, uchar red, uchar green, uchar blue");
    let rows = ["0 0 nan 1 1 1 1 1", "2 2 2 2 2 2 2 2", "inf 0 0 3 3 3 3 3"];
    let text = cloud(&properties, &rows);
    let (cloud_, report) = read(&text, Policy::Repair).unwrap();
    assert_eq!(cloud_.coord, [[2.0; 3]]);
    assert_eq!((cloud_.segment, cloud_.instance), (vec![2], Some(vec![2])));
    assert_eq!(cloud_.color, Some(vec![[2; 3]]));
    assert_eq!((report.dropped_rows, report.source_rows), (2, 3));
    assert_eq!(report.finding(Rule::PointNotFinite).unwrap().first_element, 0);
    assert!(read(&text, Policy::Strict).unwrap_err().to_string().contains("element 0"));
    let error = read(&cloud(&properties, &rows[..1]), Policy::Repair).unwrap_err().to_string();
    assert!(error.contains("no point"), "{error}");
}
