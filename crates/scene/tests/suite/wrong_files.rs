//! Files and folders that are no scene are called what they are.

use crate::common::ply::{Encoding, inria_columns, ply_bytes};
use crate::common::{npy_bytes, random_scene};
use flate2::Compression;
use flate2::write::GzEncoder;
use scenesplat_scene::{ReadOptions, SceneFormat, open_scene};
use std::io::Write;
use std::path::Path;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

fn refusal(path: &Path) -> String {
    open_scene(path, &ReadOptions::default()).unwrap_err().to_string()
}

fn zip_of(names: &[&str]) -> Vec<u8> {
    let mut zip = ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for name in names {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(b"something").unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn scene_bytes(rows: usize) -> Vec<u8> {
    ply_bytes(&inria_columns(&random_scene(rows, 0, 1)), Encoding::Little, "\n")
}

/// Whatever their names are.
#[test]
fn files_are_named_by_their_content() {
    let tileset = r#"{"asset":{"version":"1.1"},"geometricError":70,"root":{"content":{"uri":
        "tiles/0.b3dm"},"children":[{"contents":[{"uri":"tiles/1.glb"}]}]}}"#;
    let lcc = r#"{"version":"5.0","guid":"x","totalSplats":7,"totalLevel":2,"indexDataSize":60}"#;
    let checkpoint = zip_of(&["model/data.pkl", "model/data/0", "model/version"]);
    let mut tar = vec![0; 512];
    tar[257..262].copy_from_slice(b"ustar");
    let cases: &[(&[u8], &str, &str)] = &[
        (&checkpoint, "is a PyTorch checkpoint", "export the scene"),
        // Its directory is missing.
        (&checkpoint[..60], "is a PyTorch checkpoint", "export the scene"),
        (b"\x80\x02\x8a\x0alF\xf9 j", "is a Python pickle (a PyTorch checkpoint", "as PLY"),
        (&zip_of(&["coord.npy", "color.npy"]), "is a NumPy archive (.npz)", "coord.npy"),
        (&zip_of(&["scenes/a.ply", "read.me"]), "is a zip archive", "scenes/a.ply"),
        (&zip_of(&["read.me"]), "is a zip archive that is cut short, or without", "supported"),
        (lcc.as_bytes(), "is the description of an LCC scene", "PLY"),
        (tileset.as_bytes(), "is the index of 3D Tiles", "tiles/1.glb"),
        (&gzip(&scene_bytes(9)), "is a gzip-compressed PLY file", "gunzip"),
        (&gzip(&tar), "is a gzip-compressed tar archive", "unpack"),
        (&gzip(b"no scene at all"), "is gzip-compressed, but no .spz file", "unpack"),
        (&zstd::encode_all(&scene_bytes(9)[..], 1).unwrap(), "is a zstd-compressed PLY", "unzstd"),
        (&tar, "is a tar archive", "unpack"),
        (
            &npy_bytes(1, "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), }", &[0; 4]),
            "is a single .npy array",
            "folder",
        ),
        (b"<!DOCTYPE html>\n<p>Sign in", "is a web page", "download"),
        (b"b3dm\x01\0\0\0", "is a tile of 3D Tiles", ".glb"),
        (b"LASF\0\0\0\0", "is a LAS point cloud", "PLY"),
        (b"{\"a\": 1}", "is JSON, but neither glTF nor SOG", "supported"),
        (b"", "is empty", "supported"),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (bytes, what, help) in cases {
        let path = folder.path().join("file.bin");
        std::fs::write(&path, bytes).unwrap();
        let error = refusal(&path);
        assert!(error.contains("file.bin: ") && error.contains(what), "{what}: {error}");
        assert!(error.contains(help), "{what}: {error}");
    }
}

/// A stream that never ends in a little is looked at no further than its beginning.
#[test]
fn a_compressed_file_is_not_unpacked_to_be_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.splat.gz");
    std::fs::write(&path, gzip(&vec![7; 64 << 20])).unwrap();
    let error = refusal(&path);
    assert!(error.contains("is a gzip-compressed .splat file"), "{error}");
}

#[test]
fn the_newest_iteration_of_a_trainers_folder_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let save = |name: &str, rows: usize| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, scene_bytes(rows)).unwrap();
    };
    save("output/point_cloud/iteration_7000/point_cloud.ply", 7);
    save("output/point_cloud/iteration_30000/point_cloud.ply", 30);
    save("output/point_cloud/iteration_best/point_cloud.ply", 9);
    save("output/input.ply", 3);
    // Begun, and never saved.
    std::fs::create_dir_all(folder.path().join("output/point_cloud/iteration_40000")).unwrap();
    let open = |name: &str| {
        let loaded = open_scene(&folder.path().join(name), &ReadOptions::default()).unwrap();
        (loaded.scene.len(), loaded.report.notes[0].clone(), loaded.path, loaded.kind)
    };
    for start in ["output", "output/point_cloud"] {
        let (rows, note, path, kind) = open(start);
        assert_eq!((rows, kind), (30, SceneFormat::Ply));
        assert!(note.contains("iteration_30000") && note.contains("7000, 30000"), "{note}");
        assert!(path.ends_with("point_cloud/iteration_30000/point_cloud.ply"));
    }
    assert_eq!(open("output/point_cloud/iteration_7000").0, 7);
    save("results/ply/point_cloud_6999.ply", 6);
    save("results/ply/point_cloud_29999.ply", 29);
    assert_eq!(open("results").0, 29);
    // The folder above names those in it.
    let error = refusal(folder.path());
    assert!(error.contains("give one of: output"), "{error}");
}

#[test]
fn folders_are_named_by_what_is_in_them() {
    for (file, what, help) in [
        ("meta.lcc", "is a folder of an LCC scene", "PLY"),
        ("tileset.json", "is a folder of 3D Tiles", ".glb"),
        ("ckpt_29999_rank0.pt", "is a folder of checkpoints", "PLY"),
        ("room.spz", "is a folder without coord.npy", "give one of: room.spz"),
        ("read.me", "is a folder without coord.npy", "supported"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(file), "x").unwrap();
        let error = refusal(folder.path());
        assert!(error.contains(what) && error.contains(help), "{file}: {error}");
    }
}
