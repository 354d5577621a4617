//! Red, green and blue in every range and under every name are the same colors.

use crate::common::npy_bytes;
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::value_policy::Rule;
use scenesplat_scene::{Policy, ReadOptions, open_scene};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Colors in bytes; every reader has to come to these.
const BYTES: [[u8; 3]; 4] = [[0, 51, 255], [102, 153, 204], [1, 0, 254], [85, 170, 255]];

/// An ascii file of points with these colors, in units of `full`.
fn ply(
    names: &str,
    ty: &str,
    full: f64,
    labels: bool,
    change: impl Fn(usize, f64) -> f64,
) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", BYTES.len());
    for name in ["x", "y", "z"] {
        writeln!(text, "property float {name}").unwrap();
    }
    names.split(' ').for_each(|name| writeln!(text, "property {ty} {name}").unwrap());
    text.push_str(if labels { "property int label\nend_header\n" } else { "end_header\n" });
    for (row, color) in BYTES.iter().enumerate() {
        write!(text, "{row} 0 {}", row * row).unwrap();
        for (channel, byte) in color.iter().enumerate() {
            write!(text, " {}", change(3 * row + channel, f64::from(*byte) / 255.0 * full))
                .unwrap();
        }
        text.push_str(if labels { " 3\n" } else { "\n" });
    }
    text
}

fn file(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("points.ply");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn every_range_and_name_gives_the_same_colors() {
    let folder = tempfile::tempdir().unwrap();
    let as_is = |_: usize, v: f64| v;
    for names in ["red green blue", "r g b", "diffuse_red diffuse_green diffuse_blue", "R G B"] {
        for (ty, full) in [
            ("uchar", 255.0),
            ("ushort", 65535.0),
            ("ushort", 255.0),
            ("int", 255.0),
            ("float", 1.0),
            ("float", 255.0),
            ("double", 1.0),
            ("double", 65535.0),
        ] {
            let case = format!("{names} {ty} {full}");
            let path = file(folder.path(), &ply(names, ty, full, false, as_is));
            let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
            for (row, color) in BYTES.iter().enumerate() {
                for (channel, byte) in color.iter().enumerate() {
                    let got = 0.5 + 0.282_094_8 * loaded.scene.sh_dc[row][channel];
                    let due = f32::from(*byte) / 255.0;
                    assert!((got - due).abs() < 1e-4, "{case}: row {row}, {got} instead of {due}");
                }
            }
            assert_eq!(loaded.report.count(Rule::ColorClipped), 0, "{case}");
            let note = loaded.report.notes.iter().any(|n| n.contains(&format!("0 to {full}")));
            assert_eq!(note, ty != "uchar", "{case}: {:?}", loaded.report.notes);

            let path = file(folder.path(), &ply(names, ty, full, true, as_is));
            let (cloud, _) = read_labelled_ply(&path, Policy::Repair, None).unwrap();
            assert_eq!(cloud.color.unwrap(), BYTES, "{case}");
        }
    }
}

#[test]
fn what_is_outside_is_clipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let change = |at: usize, v: f64| match at {
        0 => -3.0,
        5 => 301.5,
        _ => v,
    };
    let path = file(folder.path(), &ply("red green blue", "float", 255.0, false, change));
    let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
    assert_eq!(loaded.report.count(Rule::ColorClipped), 2);
    assert_eq!(loaded.report.finding(Rule::ColorClipped).unwrap().example, "-3");
    assert_eq!(
        [loaded.scene.color_u8(0), loaded.scene.color_u8(1)],
        [[0, 51, 255], [102, 153, 255]]
    );
}

/// A folder of `.npy` files is read as a PLY file is.
#[test]
fn arrays_of_colors_are_read_alike() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, descr: &str, data: &[u8]| {
        let dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (4, 3), }}");
        std::fs::write(folder.path().join(name), npy_bytes(1, &dict, data)).unwrap();
    };
    write(
        "coord.npy",
        "<f4",
        &(0..12u8).flat_map(|i| f32::from(i).to_le_bytes()).collect::<Vec<_>>(),
    );
    let values = BYTES.as_flattened();
    let f4 = |full: f32| -> Vec<u8> {
        values.iter().flat_map(|&b| (f32::from(b) / 255.0 * full).to_le_bytes()).collect()
    };
    let u2: Vec<u8> = values.iter().flat_map(|&b| (u16::from(b) * 257).to_le_bytes()).collect();
    let i8: Vec<u8> = values.iter().flat_map(|&b| i64::from(b).to_le_bytes()).collect();
    for (descr, data) in
        [("|u1", values.to_vec()), ("<u2", u2), ("<i8", i8), ("<f4", f4(1.0)), ("<f4", f4(255.0))]
    {
        write("color.npy", descr, &data);
        let loaded = open_scene(folder.path(), &ReadOptions::default()).unwrap();
        for (row, color) in BYTES.iter().enumerate() {
            let got = loaded.scene.sh_dc[row].map(|v| ((0.5 + 0.282_094_8 * v) * 255.0).round());
            assert_eq!(got, color.map(f32::from), "{descr}");
        }
    }
}
