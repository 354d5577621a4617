//! The PLY container: every encoding, and copies that keep everything.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{Encoding, SplitMix, inria_columns, ply_bytes, random_scene};
use scenesplat_scene::formats::ply::{
    ColumnValues, PlyColumn, PlyFile, free_column_name, write_ply_with_columns,
};
use std::path::{Path, PathBuf};

fn write(dir: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Every scalar type, two elements with lists and one without properties, remarks everywhere.
fn mixed(encoding: Encoding) -> Vec<u8> {
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut out = format!(
        "ply\ncomment before the format\nformat {format} 1.0\nobj_info about it\nelement face 2\n\
         property list uchar int vertex_indices\nproperty uint8 flag\ncomment  two  spaces\n\
         element vertex 3\nproperty float x\nproperty double y\nproperty int8 a\n\
         property uchar b\nproperty short c\nproperty uint16 d\nproperty int e\ncomment inside\n\
         property uint32 f\nproperty float32 z\nelement nothing 7\nelement tail 2\n\
         property list ushort float64 w\nobj_info last\nend_header\n"
    )
    .into_bytes();
    let be = encoding == Encoding::Big;
    macro_rules! put {
        ($($value:expr),*) => {{
            $(if encoding == Encoding::Ascii {
                out.extend_from_slice(format!("{} ", $value).as_bytes());
            } else if be {
                out.extend_from_slice(&$value.to_be_bytes());
            } else {
                out.extend_from_slice(&$value.to_le_bytes());
            })*
        }};
    }
    macro_rules! row {
        ($($value:expr),*) => {{
            put!($($value),*);
            if encoding == Encoding::Ascii {
                out.push(b'\n');
            }
        }};
    }
    row!(3u8, 0i32, 1i32, 2i32, 7u8);
    row!(0u8, 9u8);
    row!(0.1f32, 0.1f64, -128i8, 255u8, -32768i16, 65535u16, i32::MIN, u32::MAX, f32::MIN_POSITIVE);
    row!(f32::NAN, f64::INFINITY, 127i8, 0u8, 32767i16, 1u16, i32::MAX, 0u32, f32::NEG_INFINITY);
    row!(-0.0f32, 1e300f64, 0i8, 1u8, 2i16, 3u16, 4i32, 5u32, 1e-45f32);
    row!(1u16, 0.25f64);
    row!(2u16, 1.5f64, -2.5f64);
    out
}

fn check_mixed(file: &PlyFile) {
    let names: Vec<_> = file.elements().iter().map(|e| (e.name.as_str(), e.count)).collect();
    assert_eq!(names, [("face", 2), ("vertex", 3), ("nothing", 7), ("tail", 2)]);
    let x = file.column_f32("vertex", "x").unwrap();
    assert_eq!(x[0].to_bits(), 0.1f32.to_bits());
    assert!(x[1].is_nan());
    assert_eq!(x[2].to_bits(), (-0.0f32).to_bits());
    assert_eq!(file.column_f64("vertex", "y").unwrap(), [0.1, f64::INFINITY, 1e300]);
    assert_eq!(file.column_f32("vertex", "y").unwrap(), [0.1, f32::INFINITY, f32::INFINITY]);
    let z = file.column_f32("vertex", "z").unwrap();
    assert_eq!(z, [f32::MIN_POSITIVE, f32::NEG_INFINITY, 1e-45]);
    for (name, values) in [
        ("a", [-128, 127, 0]),
        ("b", [255, 0, 1]),
        ("c", [-32768, 32767, 2]),
        ("d", [65535, 1, 3]),
        ("e", [i64::from(i32::MIN), i64::from(i32::MAX), 4]),
        ("f", [i64::from(u32::MAX), 0, 5]),
    ] {
        assert_eq!(file.column_i64("vertex", name).unwrap(), values, "{name}");
        assert_eq!(file.column_f64("vertex", name).unwrap(), values.map(|v| v as f64), "{name}");
    }
    assert_eq!(file.column_u8("vertex", "b").unwrap(), [255, 0, 1]);
    assert_eq!(
        file.table_f32("vertex", &["b", "a"]).unwrap(),
        [255.0, -128.0, 0.0, 127.0, 1.0, 0.0]
    );
    let rows = file.rows_f32("vertex", ["d", "b"]).unwrap();
    assert_eq!(rows, [[65535.0, 255.0], [1.0, 0.0], [3.0, 1.0]]);
    assert_eq!(file.trailing_bytes(), 0);
    let comments: Vec<_> = file.comments().collect();
    assert_eq!(comments, ["before the format", " two  spaces", "inside"]);
}

#[test]
fn all_encodings_say_the_same() {
    let dir = tempfile::tempdir().unwrap();
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let path = write(dir.path(), "a.ply", &mixed(encoding));
        check_mixed(&PlyFile::open(&path).unwrap());
    }
}

#[test]
fn columns_that_cannot_be_read_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let file = PlyFile::open(&write(dir.path(), "a.ply", &mixed(Encoding::Little))).unwrap();
    let message = |r: Result<Vec<f32>, scenesplat_scene::SceneError>| r.unwrap_err().to_string();
    assert!(message(file.column_f32("face", "flag")).contains("list property vertex_indices"));
    assert!(message(file.column_f32("vertex", "q")).contains("no property q"));
    assert!(message(file.column_f32("edge", "x")).contains("no element edge"));
    assert!(file.column_i64("vertex", "x").is_err(), "0.1 is not whole");
    assert!(file.column_u8("vertex", "a").is_err(), "char is not uchar");
}

#[test]
fn a_copy_of_any_encoding_is_the_little_endian_file_with_columns() {
    let dir = tempfile::tempdir().unwrap();
    let label = [5, -1, 7];
    let score = [0.5, f32::NAN, 1.0];
    let z = [1.0, 2.0, 3.0];
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let path = write(dir.path(), "in.ply", &mixed(encoding));
        let source = PlyFile::open(&path).unwrap();
        let out = dir.path().join("out.ply");
        // Without changes the copy is, byte for byte, what the little-endian file is.
        write_ply_with_columns(&source, &[], &[], &out).unwrap();
        let canonical = |bytes: Vec<u8>| {
            let mut text = bytes;
            for (from, to) in [
                (&b"uint8 flag"[..], &b"uchar flag"[..]),
                (b"int8 a", b"char a"),
                (b"uint16 d", b"ushort d"),
                (b"uint32 f", b"uint f"),
                (b"float32 z", b"float z"),
                (b"ushort float64 w", b"ushort double w"),
            ] {
                let at = text.windows(from.len()).position(|w| w == from).unwrap();
                text.splice(at..at + from.len(), to.iter().copied());
            }
            text
        };
        assert_eq!(
            std::fs::read(&out).unwrap(),
            canonical(mixed(Encoding::Little)),
            "{encoding:?}"
        );

        let replace = [
            PlyColumn { name: "z", values: ColumnValues::F32(&z) },
            PlyColumn { name: "y", values: ColumnValues::F32(&z) },
        ];
        let append = [
            PlyColumn { name: "label", values: ColumnValues::I32(&label) },
            PlyColumn { name: "score", values: ColumnValues::F32(&score) },
            PlyColumn { name: "shade", values: ColumnValues::U8(&[1, 2, 3]) },
        ];
        write_ply_with_columns(&source, &replace, &append, &out).unwrap();
        let copy = PlyFile::open(&out).unwrap();
        assert_eq!(copy.column_i64("vertex", "label").unwrap(), label.map(i64::from));
        assert!(copy.column_f32("vertex", "score").unwrap()[1].is_nan());
        assert_eq!(copy.column_u8("vertex", "shade").unwrap(), [1, 2, 3]);
        assert_eq!(copy.column_f64("vertex", "y").unwrap(), [1.0, 2.0, 3.0]);
        assert_eq!(copy.column_f32("vertex", "z").unwrap(), z);
        let before = source.table_f32("vertex", &["x", "a", "b", "c", "d", "e", "f"]).unwrap();
        let after = copy.table_f32("vertex", &["x", "a", "b", "c", "d", "e", "f"]).unwrap();
        let bits = |v: Vec<f32>| v.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(before), bits(after));
        assert_eq!(copy.comments().collect::<Vec<_>>(), source.comments().collect::<Vec<_>>());
        assert_eq!(copy.elements()[3], source.elements()[3]);
    }
}

#[test]
fn a_large_binary_file_is_copied_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let mut rng = SplitMix(1);
    // Random bits: NaN payloads and denormals must survive too.
    let columns: Vec<(String, Vec<f32>)> = (0..5)
        .map(|i| {
            (format!("c{i}"), (0..20_001).map(|_| f32::from_bits(rng.next() as u32)).collect())
        })
        .collect();
    let bytes = ply_bytes(&columns, Encoding::Little, "\n");
    let path = write(dir.path(), "in.ply", &bytes);
    let source = PlyFile::open(&path).unwrap();
    // Onto itself: the file is replaced only when the copy is complete.
    let label: Vec<i32> = (0..20_001).collect();
    let append = [PlyColumn { name: "label", values: ColumnValues::I32(&label) }];
    write_ply_with_columns(&source, &[], &append, &path).unwrap();
    let out = std::fs::read(&path).unwrap();
    let body = |b: &[u8]| b.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let (old, new) = (&bytes[body(&bytes)..], &out[body(&out)..]);
    assert_eq!(old.len() / 20 * 24, new.len());
    for (row, (old, new)) in old.chunks_exact(20).zip(new.chunks_exact(24)).enumerate() {
        assert_eq!(old, &new[..20], "row {row}");
        assert_eq!(new[20..], (row as i32).to_le_bytes(), "row {row}");
    }
}

#[test]
fn wrong_columns_are_refused_and_nothing_is_left_behind() {
    let dir = tempfile::tempdir().unwrap();
    let source = PlyFile::open(&write(dir.path(), "in.ply", &mixed(Encoding::Little))).unwrap();
    let out = dir.path().join("out.ply");
    let f32s = |name, values| PlyColumn { name, values: ColumnValues::F32(values) };
    let three = [0.0; 3];
    let cases: [(&str, Vec<PlyColumn<'_>>, Vec<PlyColumn<'_>>); 9] = [
        ("already has a property x", vec![], vec![f32s("x", &three)]),
        ("already has a property new", vec![], vec![f32s("new", &three), f32s("new", &three)]),
        ("2 rows for 3", vec![], vec![f32s("new", &three[..2])]),
        ("2 rows for 3", vec![f32s("x", &three[..2])], vec![]),
        ("no property new to replace", vec![f32s("new", &three)], vec![]),
        ("a is char", vec![f32s("a", &three)], vec![]),
        ("replaced twice", vec![f32s("x", &three), f32s("x", &three)], vec![]),
        ("cannot be the name", vec![], vec![f32s("two words", &three)]),
        ("cannot be the name", vec![], vec![f32s("a\nend_header", &three)]),
    ];
    for (message, replace, append) in cases {
        let error =
            write_ply_with_columns(&source, &replace, &append, &out).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let nowhere = dir.path().join("no/such/folder/out.ply");
    assert!(write_ply_with_columns(&source, &[], &[], &nowhere).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);

    assert_eq!(free_column_name(&source, "label"), "label");
    assert_eq!(free_column_name(&source, "x"), "x_2");
}

#[test]
fn line_ends_and_blank_lines_do_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let scene = random_scene(3, 0, 5);
    let columns = inria_columns(&scene);
    let expected = scene.coord.as_flattened();
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        for line_end in ["\n", "\r\n"] {
            let path = write(dir.path(), "a.ply", &ply_bytes(&columns, encoding, line_end));
            let file = PlyFile::open(&path).unwrap();
            assert_eq!(file.table_f32("vertex", &["x", "y", "z"]).unwrap(), expected);
        }
    }
    let text = "ply\nformat ascii 1.0\n\nelement vertex 2\nproperty float x\nproperty int i\nend_header\n\n  1 2.0  \n\n\t-nan(ind) 3e0\n \n";
    let file = PlyFile::open(&write(dir.path(), "a.ply", text.as_bytes())).unwrap();
    assert!(file.column_f32("vertex", "x").unwrap()[1].is_nan());
    assert_eq!(file.column_i64("vertex", "i").unwrap(), [2, 3]);
    assert_eq!(file.trailing_bytes(), 0);
}

#[test]
fn ascii_floats_are_rounded_once() {
    let dir = tempfile::tempdir().unwrap();
    // Just above the middle of two f32: rounding to f64 first gives the middle, then the even one.
    let word = "1.00000005960464477540";
    let text =
        format!("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n{word}\n");
    let file = PlyFile::open(&write(dir.path(), "a.ply", text.as_bytes())).unwrap();
    assert_eq!(file.column_f32("vertex", "x").unwrap(), [1.0f32.next_up()]);
    assert_ne!(word.parse::<f64>().unwrap() as f32, 1.0f32.next_up(), "the case is a case");
}

#[test]
fn bad_headers_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    for (message, text) in [
        ("does not begin with `ply`", "plyx\n"),
        ("no `format` line", "ply\nend_header\n"),
        ("unknown encoding", "ply\nformat binary_middle_endian 1.0\nend_header\n"),
        ("unknown version", "ply\nformat ascii 2.0\nend_header\n"),
        ("second format", "ply\nformat ascii 1.0\nformat ascii 1.0\nend_header\n"),
        ("not a count", "ply\nformat ascii 1.0\nelement vertex -1\nend_header\n"),
        ("not a count", "ply\nformat ascii 1.0\nelement vertex 99999999999999999999\nend_header\n"),
        ("before any element", "ply\nformat ascii 1.0\nproperty float x\nend_header\n"),
        ("unknown type", "ply\nformat ascii 1.0\nelement v 1\nproperty half x\nend_header\n"),
        (
            "list lengths",
            "ply\nformat ascii 1.0\nelement v 1\nproperty list float int x\nend_header\n",
        ),
        ("second element", "ply\nformat ascii 1.0\nelement v 1\nelement v 1\nend_header\n"),
        (
            "second property",
            "ply\nformat ascii 1.0\nelement v 1\nproperty int x\nproperty int x\nend_header\n",
        ),
        ("not understood", "ply\nformat ascii 1.0\nelephant v 1\nend_header\n"),
        ("no `end_header`", "ply\nformat ascii 1.0\n"),
    ] {
        let error = PlyFile::open(&write(dir.path(), "a.ply", text.as_bytes())).err().unwrap();
        assert!(error.to_string().contains(message), "{error}");
    }
    let mut long = b"ply\nformat ascii 1.0\n".to_vec();
    long.resize(3 << 20, b'c');
    let error = PlyFile::open(&write(dir.path(), "a.ply", &long)).err().unwrap().to_string();
    assert!(error.contains("does not end within"), "{error}");
    // Within a megabyte: found out line by line these took seconds.
    let elements: String = (0..50_000).map(|i| format!("element e{i} 0\n")).collect();
    let columns: String = (0..50_000).map(|i| format!("property int p{i}\n")).collect();
    for (text, message) in [
        (elements, "more than 1024 elements"),
        (format!("element vertex 1\n{columns}"), "more than 16384 properties"),
    ] {
        let text = format!("ply\nformat ascii 1.0\n{text}end_header\n");
        assert!(text.len() < 1 << 20);
        let error = PlyFile::from_bytes(text.as_bytes(), Path::new("a.ply")).err().unwrap();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn lists_cut_anywhere_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    for encoding in [Encoding::Little, Encoding::Big] {
        let bytes = mixed(encoding);
        for length in 0..bytes.len() {
            let file = PlyFile::open(&write(dir.path(), "a.ply", &bytes[..length]));
            assert!(file.is_err(), "{encoding:?} cut at {length} of {}", bytes.len());
        }
    }
}
