//! Truncated, lying, empty and hostile files: a clear error or a documented repair, never a panic.

use crate::support::*;
use std::path::{Path, PathBuf};
use std::process::Output;

const PROPERTIES: [&str; 14] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
];

fn header(count: &str) -> String {
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n");
    for p in PROPERTIES {
        text += &format!("property float {p}\n");
    }
    text + "end_header\n"
}

/// A good Gaussian at a place.
fn gaussian(x: f32, y: f32, z: f32) -> [f32; 14] {
    [x, y, z, 0.1, 0.2, 0.3, 1.0, -4.0, -4.0, -5.0, 1.0, 0.0, 0.0, 0.0]
}

fn write(path: &Path, rows: &[[f32; 14]]) {
    let mut bytes = header(&rows.len().to_string()).into_bytes();
    for row in rows {
        row.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    std::fs::write(path, bytes).unwrap();
}

fn some_rows() -> Vec<[f32; 14]> {
    (0..60)
        .map(|i| gaussian((i % 5) as f32 * 0.03, (i / 5 % 4) as f32 * 0.03, (i / 20) as f32 * 0.03))
        .collect()
}

struct Case(Folder);

impl Case {
    fn new() -> Self {
        Self(Folder::new())
    }
    fn scene(&self) -> PathBuf {
        self.0.path("scene.ply")
    }
    fn out(&self, file: &str) -> PathBuf {
        self.0.path("out").join(file)
    }
    fn run(&self, more: &[&str]) -> Output {
        tiny("features", &self.scene(), &self.out(""), more)
    }
    /// Expects exit code 1 and all of these words; no result may be left behind.
    fn refuses(&self, words: &[&str]) {
        // Whatever an earlier run of the case left.
        let _ = std::fs::remove_dir_all(self.out(""));
        refused(&self.run(&[]), 1, words);
        assert!(!self.out("features.npy").exists());
    }
    /// Expects success with so many finite rows and a report with these words.
    fn repairs(&self, rows: usize, words: &[&str]) -> Vec<f32> {
        has(&told(&self.run(&[])), words);
        assert_eq!(npy(self.out("features.npy")).shape(), [rows, 64]);
        let values = floats(self.out("features.npy"));
        assert!(values.iter().all(|v| v.is_finite()));
        values
    }
}

#[test]
fn lying_and_truncated_headers() {
    let case = Case::new();
    for (count, words) in
        [("1099511627776", "1099511627776"), ("-3", "-3"), ("many", "many"), ("61", "61")]
    {
        let mut bytes = header(count).into_bytes();
        for row in some_rows() {
            row.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        }
        std::fs::write(case.scene(), bytes).unwrap();
        case.refuses(&["scene.ply", words]);
    }
    let whole = bytes(asset("room.ply"));
    for cut in [0, 3, 50, 300, 700, 5000, whole.len() - 1] {
        std::fs::write(case.scene(), &whole[..cut]).unwrap();
        case.refuses(&["scene.ply"]);
    }
}

#[test]
fn empty_scenes_and_other_files() {
    let case = Case::new();
    write(&case.scene(), &[]);
    case.refuses(&["scene.ply"]);
    std::fs::write(case.scene(), b"").unwrap();
    case.refuses(&["scene.ply"]);
    std::fs::write(case.scene(), vec![7u8; 4000]).unwrap();
    case.refuses(&["scene.ply", "supported"]);
}

#[test]
fn list_properties_are_refused() {
    let case = Case::new();
    let text = header("1").replace("property float opacity", "property list uchar float opacity");
    std::fs::write(case.scene(), text + &"0".repeat(300)).unwrap();
    case.refuses(&["scene.ply", "opacity"]);
}

#[test]
fn bad_values_are_repaired_and_reported() {
    let nan = f32::NAN;
    for (field, value, words) in [
        (0, nan, "x"),
        (1, f32::INFINITY, "y"),
        (6, nan, "opacity"),
        (7, nan, "scale"),
        (8, f32::INFINITY, "scale"),
        (3, nan, "color"),
    ] {
        let case = Case::new();
        let mut rows = some_rows();
        rows[7][field] = value;
        write(&case.scene(), &rows);
        let values = case.repairs(60, &[words]);
        let dropped = values[7 * 64..8 * 64].iter().all(|v| *v == 0.0);
        assert_eq!(dropped, field != 3, "field {field}: left out rows have no feature");
        // And the strict policy refuses, naming element, field and value.
        refused(&case.run(&["--strict"]), 1, &["7"]);
    }
}

#[test]
fn zero_quaternions_and_half_turns() {
    let case = Case::new();
    let mut rows = some_rows();
    rows[3][10..].copy_from_slice(&[0.0; 4]);
    rows[4][10..].copy_from_slice(&[0.0, 1.0, 0.0, 0.0]);
    rows[5][10..].copy_from_slice(&[0.0, 0.0, 2e-20, 0.0]);
    write(&case.scene(), &rows);
    let values = case.repairs(60, &["quat"]);
    // A half turn (w = 0) is legal: it must not fall together with the identity.
    let mut same = some_rows();
    same[3][10..].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    same[4][10..].copy_from_slice(&[0.0, 1.0, 0.0, 0.0]);
    same[5][10..].copy_from_slice(&[0.0, 0.0, 1.0, 0.0]);
    write(&case.scene(), &same);
    assert_eq!(values, case.repairs(60, &[]), "zero becomes the identity, lengths do not matter");
    same[4][10..].copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    write(&case.scene(), &same);
    assert_ne!(values, case.repairs(60, &[]));
}

#[test]
fn one_gaussian_one_voxel_and_two() {
    let case = Case::new();
    write(&case.scene(), &[gaussian(1.0, 2.0, 3.0)]);
    let one = case.repairs(1, &[]);
    assert!((one.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
    write(&case.scene(), &vec![gaussian(1.0, 2.0, 3.0); 5000]);
    let many = case.repairs(5000, &["1 voxels"]);
    assert_eq!(many[..64], one[..], "copies in one voxel are one voxel");
    write(&case.scene(), &[gaussian(0.0, 0.0, 0.0), gaussian(0.5, 0.0, 0.0)]);
    case.repairs(2, &["2 voxels"]);
}

#[test]
fn far_outliers_keep_the_scene_or_are_named() {
    let case = Case::new();
    let mut rows = some_rows();
    rows.push(gaussian(1000.0, 0.0, 0.0));
    write(&case.scene(), &rows);
    case.repairs(61, &[]);
    // 2²¹ voxels of 2 cm are 42 km.
    rows.push(gaussian(1e6, 0.0, 0.0));
    write(&case.scene(), &rows);
    case.refuses(&["61", "1000000"]);
}

#[test]
fn a_memory_limit_that_cannot_be_kept_is_named() {
    let case = Case::new();
    std::fs::copy(asset("room.ply"), case.scene()).unwrap();
    refused(&case.run(&["--max-memory", "20MB"]), 1, &["allow at least"]);
}

#[test]
fn a_labelled_cloud_with_a_bad_point_keeps_its_rows_in_step() {
    let case = Case::new();
    let mut cloud = b"ply\nformat binary_little_endian 1.0\nelement vertex 40\nproperty float x\n\
        property float y\nproperty float z\nproperty ushort label\nend_header\n"
        .to_vec();
    for i in 0..40 {
        let x = if i == 11 { f32::NAN } else { i as f32 * 0.05 };
        for v in [x, (i % 3) as f32 * 0.05, 0.0] {
            cloud.extend(v.to_le_bytes());
        }
        cloud.extend((i as u16 % 4).to_le_bytes());
    }
    std::fs::write(case.scene(), cloud).unwrap();
    let values = case.repairs(40, &["point cloud"]);
    for (row, feat) in values.chunks_exact(64).enumerate() {
        assert_eq!(feat.iter().all(|v| *v == 0.0), row == 11, "row {row}");
    }
    assert_eq!(case.run(&["--format", "safetensors"]).status.code(), Some(0));
    let file = bytes(case.out("features.safetensors"));
    let parsed = safetensors::SafeTensors::deserialize(&file).unwrap();
    assert_eq!(parsed.tensor("features").unwrap().shape(), [40, 64]);
    let colored =
        scenesplat::scene::formats::ply::PlyFile::open(&case.out("features.ply")).unwrap();
    let rows = colored.column_i64("vertex", "source_row").unwrap();
    assert_eq!(rows.len(), 39);
    assert!(rows[10] == 10 && rows[11] == 12);
}
