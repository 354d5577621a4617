//! Damaged and hostile files: an error each, quickly, never a panic.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use crate::common::{Encoding, SplitMix, inria_columns, npy_bytes, ply_bytes, random_scene};
use scenesplat_scene::formats::labelled_ply::read_labelled_ply;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::ply::{PlyFile, write_ply_with_columns};
use scenesplat_scene::{ClassMap, LabelSet, Policy, ReadOptions, TextTable, open_scene};
use std::path::{Path, PathBuf};

fn save(dir: &Path, bytes: &[u8]) -> PathBuf {
    let path = dir.join("a.ply");
    std::fs::write(&path, bytes).unwrap();
    path
}

fn body_start(bytes: &[u8]) -> usize {
    bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11
}

/// A compressed file of `n` Gaussians with coefficients of degree 1.
fn compressed(n: usize, bounds: usize) -> Vec<u8> {
    let chunks = n.div_ceil(256);
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n");
    let corners = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];
    for names in &corners[..bounds / 6] {
        for end in ["min", "max"] {
            names.iter().for_each(|name| out += &format!("property float {end}_{name}\n"));
        }
    }
    out += &format!("element vertex {n}\n");
    for name in ["position", "rotation", "scale", "color"] {
        out += &format!("property uint packed_{name}\n");
    }
    out += &format!("element sh {n}\n");
    (0..9).for_each(|i| out += &format!("property uchar f_rest_{i}\n"));
    out += "end_header\n";
    let mut out = out.into_bytes();
    for _ in 0..chunks * bounds / 6 {
        for v in [-1.0f32, -1.0, -1.0, 1.0, 2.0, 3.0] {
            out.extend_from_slice(&v.to_le_bytes());
        }
    }
    let mut rng = SplitMix(n as u64);
    for _ in 0..n {
        out.extend_from_slice(&rng.next().to_le_bytes());
        out.extend_from_slice(&rng.next().to_le_bytes());
    }
    for _ in 0..n * 9 {
        out.push(rng.next() as u8);
    }
    out
}

#[test]
fn compressed_files_of_both_versions() {
    let dir = tempfile::tempdir().unwrap();
    for bounds in [12, 18] {
        let scene =
            open_scene(&save(dir.path(), &compressed(300, bounds)), &ReadOptions::default());
        let scene = scene.unwrap().scene;
        assert_eq!((scene.len(), scene.sh_degree, scene.sh_rest.len()), (300, 1, 2700));
        let in_bounds = |p: &[f32; 3]| (0..3).all(|i| (-1.0..=[1.0, 2.0, 3.0][i]).contains(&p[i]));
        assert!(scene.coord.iter().all(in_bounds) && scene.log_scale.iter().all(in_bounds));
        let color = |dc: f32| 0.5 + dc * scenesplat_scene::gaussian_scene::SH_C0;
        let outside =
            scene.sh_dc.iter().flatten().any(|&dc| !(-1e-6..1.000_001).contains(&color(dc)));
        assert_eq!(outside, bounds == 18, "without bounds colours are 0 to 1");
    }
}

#[test]
fn compressed_files_whose_parts_do_not_match() {
    let dir = tempfile::tempdir().unwrap();
    let text = |bytes: Vec<u8>, from: &str, to: &str| {
        let start = body_start(&bytes);
        let head = String::from_utf8(bytes[..start].to_vec()).unwrap();
        assert!(head.contains(from));
        [head.replace(from, to).as_bytes(), &bytes[start..]].concat()
    };
    for (from, to, message) in [
        ("element chunk 2", "element chunk 1", "1 chunks for 300 vertices"),
        ("element sh 300", "element sh 299", "299 rows"),
        ("property uchar f_rest_8\n", "", "8 coefficients"),
        ("uchar f_rest_8", "uchar f_rest_9", "f_rest_8"),
        ("element chunk", "element lump", "no element chunk"),
        ("float max_x", "float max_q", "no property max_x"),
        ("uint packed_scale", "uint packed_size", "packed_scale"),
        ("uint packed_scale", "list uchar uint packed_scale", ""),
    ] {
        let bytes = text(compressed(300, 18), from, to);
        let error = open_scene(&save(dir.path(), &bytes), &ReadOptions::default()).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn files_cut_anywhere_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let columns = inria_columns(&random_scene(4, 1, 2));
    for (name, bytes) in [
        ("little", ply_bytes(&columns, Encoding::Little, "\n")),
        ("big", ply_bytes(&columns, Encoding::Big, "\n")),
        ("ascii", ply_bytes(&columns, Encoding::Ascii, "\n")),
        ("compressed", compressed(5, 18)),
    ] {
        let whole = open_scene(&save(dir.path(), &bytes), &ReadOptions::default()).unwrap();
        // The last number of an ascii file may lose digits unnoticed: stop before its line.
        let end = if name == "ascii" {
            bytes[..bytes.len() - 1].iter().rposition(|&b| b == b'\n').unwrap()
        } else {
            bytes.len() - 1
        };
        for length in 0..=end {
            let cut = open_scene(&save(dir.path(), &bytes[..length]), &ReadOptions::default());
            assert!(cut.is_err(), "{name} cut at {length} of {}", bytes.len());
        }
        assert!(whole.scene.len() >= 4);
    }
}

#[test]
fn counts_that_lie() {
    let dir = tempfile::tempdir().unwrap();
    let columns = inria_columns(&random_scene(4, 0, 2));
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        let bytes = ply_bytes(&columns, encoding, "\n");
        let start = body_start(&bytes);
        let head = String::from_utf8(bytes[..start].to_vec()).unwrap();
        let with_count = |count: &str| {
            let head = head.replace("element vertex 4", &format!("element vertex {count}"));
            [head.as_bytes(), &bytes[start..]].concat()
        };
        for count in ["5", "1099511627776", "18446744073709551615", "4611686018427387904"] {
            let error = open_scene(&save(dir.path(), &with_count(count)), &ReadOptions::default());
            let error = error.unwrap_err().to_string();
            assert!(error.contains("vertex") && error.contains(count), "{error}");
            // Found from the length of the file, not by failing to reserve that much.
            assert!(count == "5" || error.contains("should have"), "{error}");
        }
        // One row too few is found by what is left over.
        let path = save(dir.path(), &with_count("3"));
        let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
        assert_eq!(loaded.scene.len(), 3);
        assert!(!loaded.report.is_clean(), "{encoding:?}");
    }
    // Elements that need no bytes, and lists that promise too many.
    for text in [
        "ply\nformat binary_little_endian 1.0\nelement nothing 18446744073709551615\nend_header\n",
        "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nend_header\n",
    ] {
        let file = PlyFile::open(&save(dir.path(), text.as_bytes())).unwrap();
        let out = dir.path().join("out.ply");
        assert!(write_ply_with_columns(&file, &[], &[], &out).is_err(), "there is no vertex");
        let path = save(dir.path(), text.replace("nothing", "vertex").as_bytes());
        assert!(open_scene(&path, &ReadOptions::default()).is_err());
        let file = PlyFile::open(&path).unwrap();
        assert_eq!(file.table_f32("vertex", &[]).unwrap(), [0.0f32; 0]);
    }
    for (ty, value) in [("uint", &[255u8; 4][..]), ("int", &[255; 4]), ("uchar", &[200])] {
        let head = format!(
            "ply\nformat binary_big_endian 1.0\nelement face 1\nproperty list {ty} double v\nend_header\n"
        );
        let path = save(dir.path(), &[head.as_bytes(), value].concat());
        assert!(PlyFile::open(&path).is_err(), "{ty}");
    }
    let text = "ply\nformat ascii 1.0\nelement face 1\nproperty list uint int v\nend_header\n4000000000 1 2\n";
    assert!(PlyFile::open(&save(dir.path(), text.as_bytes())).is_err());
}

#[test]
fn ascii_rows_that_do_not_fit() {
    let dir = tempfile::tempdir().unwrap();
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
        let error = PlyFile::open(&save(dir.path(), text.as_bytes())).err().unwrap().to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn lists_among_the_vertices_are_refused_and_elsewhere_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let list = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty list uchar int n\nend_header\n1 2 3 1 4\n";
    let error = open_scene(&save(dir.path(), list.as_bytes()), &ReadOptions::default());
    assert!(error.unwrap_err().to_string().contains("list property n"));
    let faces = "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int n\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n3 0 0 0\n0\n1 2 3\n";
    let loaded = open_scene(&save(dir.path(), faces.as_bytes()), &ReadOptions::default()).unwrap();
    assert_eq!(loaded.scene.coord, [[1.0, 2.0, 3.0]]);
}

#[test]
fn what_is_no_scene() {
    let dir = tempfile::tempdir().unwrap();
    let mut rng = SplitMix(3);
    let garbage: Vec<u8> = (0..4096).map(|_| rng.next() as u8).collect();
    for bytes in [&garbage[..], b"", b"ply", b"PLY\n", b"\0\0\0\0"] {
        let error = open_scene(&save(dir.path(), bytes), &ReadOptions::default()).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("supported are ") && error.contains(".ply") && error.contains(".spz"),
            "{error}"
        );
    }
    for path in [dir.path().to_owned(), dir.path().join("missing.ply")] {
        assert!(open_scene(&path, &ReadOptions::default()).is_err());
    }
    let npy = npy_bytes(1, "{}", &[]);
    let error = open_scene(&save(dir.path(), &npy), &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("give the folder"), "{error}");
}

/// Changes a file at random: single bytes in place, or also its length and the order of its parts.
fn mutate(bytes: &mut Vec<u8>, rng: &mut SplitMix) {
    if rng.below(2) == 0 {
        // Past the header, so that many of these files are still scenes.
        let at = bytes.len() / 2 + rng.below(bytes.len().div_ceil(2));
        bytes[at] = rng.next() as u8;
        return;
    }
    for _ in 0..rng.below(3) + 1 {
        if bytes.is_empty() {
            return;
        }
        // Headers are small beside the data but decide more.
        let reach = if rng.below(2) == 0 { bytes.len() } else { bytes.len().min(400) };
        let at = rng.below(reach);
        match rng.below(6) {
            0 => bytes[at] = rng.next() as u8,
            1 => bytes[at] = b"0123456789 -.\n"[rng.below(14)],
            2 => bytes.truncate(at),
            3 => {
                bytes.remove(at);
            }
            4 => bytes.insert(at, b"0123456789 -.\n"[rng.below(14)]),
            _ => {
                let end = (at + rng.below(40)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                let to = rng.below(bytes.len());
                bytes.splice(to..to, piece);
            }
        }
    }
}

#[test]
fn random_damage_never_panics() {
    let dir = tempfile::tempdir().unwrap();
    let columns = inria_columns(&random_scene(9, 1, 2));
    let mixed = "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int n\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty ushort label\nend_header\n3 0 0 0\n0\n1 2 3 4 5 6 7\n1 2 3 4 5 6 65535\n";
    let fixtures = [
        ply_bytes(&columns, Encoding::Little, "\n"),
        ply_bytes(&columns, Encoding::Big, "\r\n"),
        ply_bytes(&columns, Encoding::Ascii, "\n"),
        mixed.as_bytes().to_vec(),
        compressed(30, 18),
        npy_bytes(1, "{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }", &[1; 24]),
    ];
    let mut rng = SplitMix(20_24);
    let (mut read, mut refused) = (0, 0);
    let out = dir.path().join("out.ply");
    for round in 0..3000 {
        let mut bytes = fixtures[round % fixtures.len()].clone();
        mutate(&mut bytes, &mut rng);
        let path = save(dir.path(), &bytes);
        let result = std::panic::catch_unwind(|| {
            let ok = open_scene(&path, &ReadOptions::default()).is_ok();
            let _ = read_labelled_ply(&path, Policy::Repair, None);
            if let Ok(file) = PlyFile::open(&path) {
                for element in file.elements() {
                    for property in &element.properties {
                        let _ = file.column_i64(&element.name, &property.name);
                    }
                }
                // Writing makes a file durable, which is slow: not in every round.
                if round % 50 == 0 {
                    let _ = write_ply_with_columns(&file, &[], &[], &out);
                }
            }
            if let Ok(file) = NpyFile::open(&path) {
                let _ = (file.read_f32(), file.read_i64(), file.read_u8(), file.read_f16());
            }
            ok
        });
        match result {
            Ok(true) => read += 1,
            Ok(false) => refused += 1,
            Err(_) => panic!("round {round}: {:?}", String::from_utf8_lossy(&bytes)),
        }
    }
    assert!(read > 300 && refused > 300, "{read} read and {refused} refused: both are exercised");
}

#[test]
fn random_damage_to_folders_and_lists_never_panics() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("scene");
    let mut scene = random_scene(6, 0, 8);
    scene.normal = Some(vec![[0.0, 0.0, 1.0]; 6]);
    scene.segment = Some(vec![1; 6]);
    let values = vec![half::f16::ONE; 12];
    scene.lang_feat = Some(scenesplat_scene::LanguageFeatures { values, dim: 2 });
    write_npy_folder(&scene, &folder, false).unwrap();
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let mut rng = SplitMix(7);
    let mut read = 0;
    for round in 0..800 {
        let path = &files[round % files.len()];
        let old = std::fs::read(path).unwrap();
        let mut bytes = old.clone();
        mutate(&mut bytes, &mut rng);
        std::fs::write(path, &bytes).unwrap();
        let open = || open_scene(&folder, &ReadOptions::default()).is_ok();
        let ok = std::panic::catch_unwind(open);
        read += usize::from(ok.unwrap_or_else(|_| panic!("round {round}: {}", path.display())));
        std::fs::write(path, old).unwrap();
    }
    assert!((100..700).contains(&read), "{read} of 800 were read: both ways are exercised");

    let head = br#"{"__metadata__":{"labels":"[\"bed\"]"},"text_embeddings":{"dtype":"F32","shape":[1,2],"data_offsets":[0,8]}}"#;
    let mut table = (head.len() as u64).to_le_bytes().to_vec();
    table.extend_from_slice(head);
    table.extend_from_slice(&[0, 0, 128, 63, 0, 0, 128, 63]);
    let path = save(dir.path(), &table);
    assert_eq!(TextTable::read(&path, None).unwrap().names, ["bed"]);
    let json = br#"{"classes": ["bed", "sofa"], "labels": []}"#.to_vec();
    let toml = b"Bed = \"bed\"\nSofa = \"sofa\"\n".to_vec();
    for round in 0..600 {
        let mut bytes = [&table, &json, &toml][round % 3].clone();
        mutate(&mut bytes, &mut rng);
        let path = save(dir.path(), &bytes);
        let result = std::panic::catch_unwind(|| {
            let _ = TextTable::read(&path, None);
            let _ = LabelSet::read(&path);
            let _ = ClassMap::read(&path);
        });
        assert!(result.is_ok(), "round {round}: {:?}", String::from_utf8_lossy(&bytes));
    }
}
