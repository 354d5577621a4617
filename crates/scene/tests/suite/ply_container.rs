//! The PLY container: every encoding, and copies that keep everything.

use crate::common::ply::{Encoding, body_start, inria_columns, mixed, ply_bytes, with_header};
use crate::common::{SplitMix, random_scene, save};
use scenesplat_scene::formats::ply::{
    ColumnValues, PlyColumn, PlyFile, free_column_name, write_ply_with_columns,
};
use scenesplat_scene::{LoadedScene, ReadOptions, SceneError, open_scene_bytes};
use std::path::Path;

fn parse(bytes: &[u8]) -> Result<PlyFile, SceneError> {
    PlyFile::from_bytes(bytes, Path::new("a.ply"))
}

fn read(bytes: &[u8]) -> Result<LoadedScene, SceneError> {
    open_scene_bytes(bytes, Path::new("a.ply"), &ReadOptions::default())
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
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        check_mixed(&parse(&mixed(encoding)).unwrap());
    }
}

#[test]
fn columns_that_cannot_be_read_are_errors() {
    let file = parse(&mixed(Encoding::Little)).unwrap();
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
        let bytes = mixed(encoding);
        let source = parse(&bytes).unwrap();
        let out = dir.path().join("out.ply");
        // Without changes the copy is, byte for byte, what the little-endian file is.
        write_ply_with_columns(&source, &[], &[], &[], &out).unwrap();
        let renamed = [
            ("uint8 flag", "uchar flag"),
            ("int8 a", "char a"),
            ("uint16 d", "ushort d"),
            ("uint32 f", "uint f"),
            ("float32 z", "float z"),
            ("ushort float64 w", "ushort double w"),
        ];
        let little = mixed(Encoding::Little);
        let due = renamed.iter().fold(little, |file, (from, to)| with_header(&file, from, to));
        assert_eq!(std::fs::read(&out).unwrap(), due, "{encoding:?}");

        let replace = [
            PlyColumn { name: "z", values: ColumnValues::F32(&z) },
            PlyColumn { name: "y", values: ColumnValues::F32(&z) },
        ];
        let append = [
            PlyColumn { name: "label", values: ColumnValues::I32(&label) },
            PlyColumn { name: "score", values: ColumnValues::F32(&score) },
            PlyColumn { name: "shade", values: ColumnValues::U8(&[1, 2, 3]) },
        ];
        write_ply_with_columns(&source, &replace, &append, &[], &out).unwrap();
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
fn warnings_are_comments_and_those_of_an_earlier_copy_go() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = mixed(Encoding::Ascii);
    let source = parse(&bytes).unwrap();
    let own: Vec<String> = source.comments().collect();
    let copy = |source: &PlyFile, warnings: &[&str], name: &str| {
        let out = dir.path().join(name);
        let warnings: Vec<String> = warnings.iter().map(|text| (*text).to_owned()).collect();
        write_ply_with_columns(source, &[], &[], &warnings, &out).unwrap();
        PlyFile::open(&out).unwrap()
    };
    let comments = |file: &PlyFile| file.comments().collect::<Vec<_>>();
    // A line break would end the header's line.
    let first = copy(&source, &["up is unclear", "a\nelement face 9"], "first.ply");
    let warned = ["up is unclear", "a element face 9"].map(|t| format!("scenesplat warning: {t}"));
    // They follow the line of the format, which a comment of the source stands before.
    assert_eq!(comments(&first), [&own[..1], &warned, &own[1..]].concat());
    assert_eq!(first.elements(), source.elements());
    let second = copy(&first, &["seeded"], "second.ply");
    let warned = ["scenesplat warning: seeded".to_owned()];
    assert_eq!(comments(&second), [&own[..1], &warned, &own[1..]].concat());
    assert_eq!(comments(&copy(&second, &[], "third.ply")), own);
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
    let path = save(dir.path(), "in.ply", &bytes);
    let source = PlyFile::open(&path).unwrap();
    // Onto itself: the file is replaced only when the copy is complete.
    let label: Vec<i32> = (0..20_001).collect();
    let append = [PlyColumn { name: "label", values: ColumnValues::I32(&label) }];
    write_ply_with_columns(&source, &[], &append, &[], &path).unwrap();
    let out = std::fs::read(&path).unwrap();
    let (old, new) = (&bytes[body_start(&bytes)..], &out[body_start(&out)..]);
    assert_eq!(old.len() / 20 * 24, new.len());
    for (row, (old, new)) in old.chunks_exact(20).zip(new.chunks_exact(24)).enumerate() {
        assert_eq!(old, &new[..20], "row {row}");
        assert_eq!(new[20..], (row as i32).to_le_bytes(), "row {row}");
    }
}

#[test]
fn wrong_columns_are_refused_and_nothing_is_left_behind() {
    let dir = tempfile::tempdir().unwrap();
    let source = PlyFile::open(&save(dir.path(), "in.ply", &mixed(Encoding::Little))).unwrap();
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
            write_ply_with_columns(&source, &replace, &append, &[], &out).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
    let nowhere = dir.path().join("no/such/folder/out.ply");
    assert!(write_ply_with_columns(&source, &[], &[], &[], &nowhere).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);

    assert_eq!(free_column_name(&source, "label"), "label");
    assert_eq!(free_column_name(&source, "x"), "x_2");
}

#[test]
fn line_ends_and_blank_lines_do_not_matter() {
    let scene = random_scene(3, 0, 5);
    let columns = inria_columns(&scene);
    let expected = scene.coord.as_flattened();
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        for line_end in ["\n", "\r\n"] {
            let bytes = ply_bytes(&columns, encoding, line_end);
            let file = parse(&bytes).unwrap();
            assert_eq!(file.table_f32("vertex", &["x", "y", "z"]).unwrap(), expected);
        }
    }
    let text = "ply\nformat ascii 1.0\n\nelement vertex 2\nproperty float x\nproperty int i\nend_header\n\n  1 2.0  \n\n\t-nan(ind) 3e0\n \n";
    let file = parse(text.as_bytes()).unwrap();
    assert!(file.column_f32("vertex", "x").unwrap()[1].is_nan());
    assert_eq!(file.column_i64("vertex", "i").unwrap(), [2, 3]);
    assert_eq!(file.trailing_bytes(), 0);
}

#[test]
fn ascii_floats_are_rounded_once() {
    // Just above the middle of two f32: rounding to f64 first gives the middle, then the even one.
    let word = "1.00000005960464477540";
    let text =
        format!("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n{word}\n");
    let file = parse(text.as_bytes()).unwrap();
    assert_eq!(file.column_f32("vertex", "x").unwrap(), [1.0f32.next_up()]);
    assert_ne!(word.parse::<f64>().unwrap() as f32, 1.0f32.next_up(), "the case is a case");
}

#[test]
fn bad_headers_are_errors() {
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
        let error = parse(text.as_bytes()).err().unwrap();
        assert!(error.to_string().contains(message), "{error}");
    }
    let mut long = b"ply\nformat ascii 1.0\n".to_vec();
    long.resize(3 << 20, b'c');
    let error = parse(&long).err().unwrap().to_string();
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
        let error = parse(text.as_bytes()).err().unwrap();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn wrong_counts_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let columns = inria_columns(&random_scene(4, 0, 2));
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let bytes = ply_bytes(&columns, encoding, "\n");
        let with_count = |count: &str| {
            with_header(&bytes, "element vertex 4", &format!("element vertex {count}"))
        };
        for count in ["5", "1099511627776", "18446744073709551615", "4611686018427387904"] {
            let error = read(&with_count(count));
            let error = error.unwrap_err().to_string();
            assert!(error.contains("vertex") && error.contains(count), "{error}");
            // Found from the length of the file, not by failing to reserve that much.
            assert!(count == "5" || error.contains("should have"), "{error}");
        }
        // One row too few is found by what is left over.
        let loaded = read(&with_count("3")).unwrap();
        assert_eq!(loaded.scene.len(), 3);
        assert!(!loaded.report.is_clean(), "{encoding:?}");
    }
    // Elements that need no bytes, and lists that promise too many.
    for text in [
        "ply\nformat binary_little_endian 1.0\nelement nothing 18446744073709551615\nend_header\n",
        "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nend_header\n",
    ] {
        let file = parse(text.as_bytes()).unwrap();
        let out = dir.path().join("out.ply");
        assert!(write_ply_with_columns(&file, &[], &[], &[], &out).is_err(), "there is no vertex");
        let text = text.replace("nothing", "vertex");
        assert!(read(text.as_bytes()).is_err());
        let file = parse(text.as_bytes()).unwrap();
        assert_eq!(file.table_f32("vertex", &[]).unwrap(), [0.0f32; 0]);
    }
    for (ty, value) in [("uint", &[255u8; 4][..]), ("int", &[255; 4]), ("uchar", &[200])] {
        let head = format!(
            "ply\nformat binary_big_endian 1.0\nelement face 1\nproperty list {ty} double v\nend_header\n"
        );
        assert!(parse(&[head.as_bytes(), value].concat()).is_err(), "{ty}");
    }
    let text = "ply\nformat ascii 1.0\nelement face 1\nproperty list uint int v\nend_header\n4000000000 1 2\n";
    assert!(parse(text.as_bytes()).is_err());
}

#[test]
fn ascii_rows_that_do_not_fit() {
    let head =
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty uchar b\nend_header\n";
    for (rows, message) in [
        ("1 2\n3\n", "row 1: no value for property b"),
        ("1 2 3\n4 5\n", "row 0: more values"),
        ("1 2\n", "row 1: the file ends here"),
        ("1 2\nx 4\n", "holds \"x\""),
        ("1 2\n3 256\n", "holds \"256\""),
        ("1 2\n3 -1\n", "holds \"-1\""),
        ("1 2\n3 1.5\n", "holds \"1.5\""),
        ("1 2\n3 nan\n", "holds \"nan\""),
        ("1 2\n\u{fffd} 4\n", "row 1"),
    ] {
        // Padding keeps the file long enough for the check of its size.
        let text = format!("{head}{rows}           ");
        let error = parse(text.as_bytes()).err().unwrap().to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn lists_among_the_vertices_are_refused_and_elsewhere_skipped() {
    let list = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty list uchar int n\nend_header\n1 2 3 1 4\n";
    let error = read(list.as_bytes());
    assert!(error.unwrap_err().to_string().contains("list property n"));
    let faces = "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int n\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n3 0 0 0\n0\n1 2 3\n";
    let loaded = read(faces.as_bytes()).unwrap();
    assert_eq!(loaded.scene.coord, [[1.0, 2.0, 3.0]]);
}
