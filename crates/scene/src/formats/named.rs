//! What a file or folder that is no scene seems to be, and what to give instead.
//!
//! By content, as scenes are; the name counts only where the content says nothing.

use super::json_text::{is_json, without_mark};
use super::table::{FORMATS, SceneFormat, supported};
use super::{cameras, splat};
use flate2::bufread::GzDecoder;
use serde_json::Value;
use std::io::{Cursor, Read};
use std::path::Path;
use zip::ZipArchive;

/// Decompressed bytes that are looked at: a tar archive says so at byte 257.
const HEAD_BYTES: u64 = 512;
/// Longest JSON that is looked into.
const MAX_JSON_BYTES: usize = 16 << 20;
/// Most names of files that a message lists.
const MAX_NAMES: usize = 3;

/// What something seems to be, and what to do.
pub(super) struct Named {
    /// To follow its path: `is a …`.
    pub(super) problem: String,
    /// What to give instead.
    pub(super) help: String,
}

fn named(problem: impl Into<String>, help: impl Into<String>) -> Named {
    Named { problem: problem.into(), help: help.into() }
}

const CHECKPOINT: &str = "export the scene from the trainer as PLY (the original trainer writes \
                          point_cloud/iteration_N/point_cloud.ply, gsplat has --save-ply, \
                          Nerfstudio has ns-export gaussian-splat)";
/// What their names end in.
const CHECKPOINTS: [&str; 3] = [".pth", ".pt", ".ckpt"];
const LCC: &str = "export the scene as PLY from the program that made it, or convert it with \
                   splat-transform";
const UNPACK: &str = "unpack it and give the file of the scene in it";

/// What files of other kinds begin with, what these are, and what to do about it.
const SIGNATURES: [(&[u8], &str, &str); 18] = [
    (b"\x89HDF", "is an HDF5 file", "export the scene as PLY"),
    (b"LASF", "is a LAS point cloud, not a Gaussian scene", "convert the points to PLY"),
    (b"# .PCD", "is a PCD point cloud, not a Gaussian scene", "convert the points to PLY"),
    (b"ASTM-E57", "is an E57 point cloud, not a Gaussian scene", "convert the points to PLY"),
    (b"b3dm", "is a tile of 3D Tiles with a mesh (b3dm), not Gaussians", "give a .glb tile"),
    (b"i3dm", "is a tile of 3D Tiles with copies of a mesh (i3dm)", "give a .glb tile"),
    (b"pnts", "is a tile of 3D Tiles with points (pnts), not Gaussians", "give a .glb tile"),
    (b"cmpt", "is a tile of 3D Tiles made of others (cmpt)", "give a .glb tile"),
    (b"subt", "is a subtree of 3D Tiles, which holds no Gaussians itself", "give a .glb tile"),
    (b"7z\xbc\xaf\x27\x1c", "is a 7z archive", UNPACK),
    (b"Rar!\x1a\x07", "is a RAR archive", UNPACK),
    (b"\xfd7zXZ\0", "is xz-compressed", UNPACK),
    (b"BZh", "is bzip2-compressed", UNPACK),
    (b"SQLite format 3\0", "is an SQLite database (COLMAP's, perhaps)", "give the scene itself"),
    (b"\x89PNG", "is a picture", "give the scene itself"),
    (b"\xff\xd8\xff", "is a picture", "give the scene itself"),
    (b"<!doctype html", "is a web page, not a file of a scene", "download the file itself"),
    (b"<html", "is a web page, not a file of a scene", "download the file itself"),
];

/// What a file that no reader knows seems to be.
pub(super) fn file(path: &Path, bytes: &[u8]) -> Named {
    let start = &bytes[..bytes.len().min(64)].to_ascii_lowercase();
    let signature = SIGNATURES.iter().find(|(mark, _, _)| {
        bytes.starts_with(mark) || (mark.starts_with(b"<") && start.starts_with(mark))
    });
    if let Some((_, problem, help)) = signature {
        return named(*problem, *help);
    }
    match bytes {
        [] => named("is empty", supported()),
        [b'p', b'l', b'y', ..] => {
            named("begins like a PLY file, but its first line is not `ply`", supported())
        }
        [0x1f, 0x8b, ..] => packed(path, "gzip", &head_of(GzDecoder::new(bytes))),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => {
            let head = zstd::stream::read::Decoder::with_buffer(bytes).map(head_of);
            packed(path, "zstd", &head.unwrap_or_default())
        }
        [b'P', b'K', 3 | 5, ..] => archive(bytes),
        [b'P', b'X', b'R', b'-', b'U', b'S', b'D', b'C', ..] => {
            named("is binary USD", super::usd::CONVERT)
        }
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => {
            named("is a single .npy array", "give the folder that holds coord.npy")
        }
        // Protocols 2 to 5 of Python's pickle, in which checkpoints before 2020 and any others are.
        [0x80, 2..=5, ..] => {
            named("is a Python pickle (a PyTorch checkpoint, perhaps)", CHECKPOINT)
        }
        _ if is_tar(bytes) => named("is a tar archive", UNPACK),
        _ if is_json(bytes) => json(path, bytes),
        _ => named(by_name(path, bytes), supported()),
    }
}

/// What a folder that no reader knows seems to be.
pub(super) fn folder(path: &Path) -> Named {
    if cameras::is_colmap_folder(path) {
        return named("is a folder of COLMAP cameras, not of a scene", supported());
    }
    let mut names: Vec<String> = std::fs::read_dir(path)
        .map(|list| list.flatten().filter_map(|e| e.file_name().into_string().ok()).collect())
        .unwrap_or_default();
    names.sort();
    if names.iter().any(|name| name.ends_with(".lcc")) {
        return named("is a folder of an LCC scene", LCC);
    }
    if names.iter().any(|name| name == "tileset.json") {
        return named("is a folder of 3D Tiles", "give a .glb tile of it");
    }
    let problem = "is a folder without coord.npy, meta.json or \
                   point_cloud/iteration_*/point_cloud.ply";
    let is_model = |name: &&String| path.join(name).join("point_cloud").is_dir();
    let is_file = |name: &&String| SceneFormat::is_scene_file_name(name);
    let scenes: Vec<String> =
        names.iter().filter(|name| is_file(name) || is_model(name)).cloned().collect();
    if !scenes.is_empty() {
        return named(problem, give(&scenes));
    }
    let is_checkpoint = |name: &String| CHECKPOINTS.iter().any(|end| name.ends_with(end));
    if names.iter().any(is_checkpoint) {
        return named("is a folder of checkpoints", CHECKPOINT);
    }
    named(problem, supported())
}

/// `give a.ply, b.ply, …`.
fn give(names: &[String]) -> String {
    let more = if names.len() > MAX_NAMES { ", …" } else { "" };
    format!("give one of: {}{more}", names[..names.len().min(MAX_NAMES)].join(", "))
}

/// The first bytes that a decoder gives.
fn head_of(decoder: impl Read) -> Vec<u8> {
    let mut head = Vec::new();
    // What comes before damage is enough.
    let _ = decoder.take(HEAD_BYTES).read_to_end(&mut head);
    head
}

fn is_tar(bytes: &[u8]) -> bool {
    bytes.get(257..262) == Some(b"ustar")
}

/// A compressed file that is no `.spz`, by the beginning of what is in it.
fn packed(path: &Path, method: &str, head: &[u8]) -> Named {
    let content = match head {
        head if super::ply::is_ply(head) => "PLY file",
        head if is_tar(head) => "tar archive",
        head if head.starts_with(b"PK") => "zip archive",
        head if head.starts_with(b"\x93NUMPY") => ".npy array",
        head if is_json(head) => "JSON file",
        _ => match path.file_stem().and_then(|stem| Path::new(stem).extension()?.to_str()) {
            Some("splat") => ".splat file",
            Some("ksplat") => ".ksplat file",
            _ => return named(format!("is {method}-compressed, but no .spz file"), UNPACK),
        },
    };
    let program = if method == "gzip" { "gunzip" } else { "unzstd" };
    let help = format!("unpack it (`{program} -k FILE`) and give what is in it");
    named(format!("is a {method}-compressed {content}"), help)
}

/// A zip archive that is no SOG scene, by the names of its entries.
fn archive(bytes: &[u8]) -> Named {
    let first = first_entry(bytes).map(str::to_owned);
    let names: Vec<String> = match ZipArchive::new(Cursor::new(bytes)) {
        Ok(zip) => {
            let names = zip.file_names_raw();
            names.map(|name| String::from_utf8_lossy(name).into_owned()).collect()
        }
        // Cut short: the names are in the part that is missing, but for this.
        Err(_) => first.into_iter().collect(),
    };
    let any = |is: &dyn Fn(&str) -> bool| names.iter().any(|name| is(name));
    if any(&|name| name == "data.pkl" || name.ends_with("/data.pkl")) {
        return named("is a PyTorch checkpoint", CHECKPOINT);
    }
    if !names.is_empty() && names.iter().all(|name| name.ends_with(".npy")) {
        let help = "save its arrays as a folder of .npy files with coord.npy (meters), and, as far as \
                    there are any, color, opacity, scale and quat; or export the scene as PLY";
        return named("is a NumPy archive (.npz)", help);
    }
    let mut scenes = names;
    scenes.retain(|name| SceneFormat::is_scene_file_name(name));
    scenes.sort();
    if scenes.is_empty() {
        let problem = "is a zip archive that is cut short, or without a meta.json of SOG";
        return named(problem, supported());
    }
    named("is a zip archive of files", format!("unpack it and {}", give(&scenes)))
}

/// The name of the entry that a zip archive begins with.
fn first_entry(bytes: &[u8]) -> Option<&str> {
    let length = u16::from_le_bytes(*bytes.get(26..)?.first_chunk::<2>()?);
    std::str::from_utf8(bytes.get(30..30 + usize::from(length))?).ok()
}

fn json(path: &Path, bytes: &[u8]) -> Named {
    if cameras::is_cameras_json(bytes) {
        return named("holds the cameras of a scene, not the scene", supported());
    }
    if cameras::is_transforms_json(bytes) {
        let problem = "holds the cameras of a scene (transforms.json), not the scene";
        return named(problem, supported());
    }
    let value = match bytes.len() {
        0..=MAX_JSON_BYTES => serde_json::from_slice(without_mark(bytes)).unwrap_or(Value::Null),
        _ => Value::Null,
    };
    if is_lcc(&value) || path.extension().is_some_and(|e| e.eq_ignore_ascii_case("lcc")) {
        return named("is the description of an LCC scene", LCC);
    }
    if is_tileset(&value) {
        let mut tiles = Vec::new();
        tiles_of(&value["root"], &mut tiles);
        let help = if tiles.is_empty() { "give a .glb tile".to_owned() } else { give(&tiles) };
        return named("is the index of 3D Tiles, which holds no Gaussians itself", help);
    }
    named("is JSON, but neither glTF nor SOG", supported())
}

/// Whether JSON describes a scene of XGRIDS' format.
fn is_lcc(value: &Value) -> bool {
    let has = |key: &str| value.get(key).is_some();
    has("totalSplats") && ["totalLevel", "indexDataSize", "cellLengthX"].into_iter().any(has)
}

/// Whether JSON is the index of 3D Tiles, whose `asset` is like that of glTF.
fn is_tileset(value: &Value) -> bool {
    value["asset"].is_object() && value["root"].is_object()
}

/// The files of a tile and those below it that may hold Gaussians, a few of them.
fn tiles_of(tile: &Value, into: &mut Vec<String>) {
    let several = tile["contents"].as_array().into_iter().flatten();
    for content in several.chain([&tile["content"]]) {
        // `url` is the word of a draft that many tools still write.
        let uri = content["uri"].as_str().or(content["url"].as_str());
        into.extend(
            uri.filter(|uri| uri.ends_with(".glb") || uri.ends_with(".gltf")).map(str::to_owned),
        );
    }
    for child in tile["children"].as_array().into_iter().flatten() {
        if into.len() > MAX_NAMES {
            return;
        }
        tiles_of(child, into);
    }
}

/// The last resort: what the name promises.
fn by_name(path: &Path, bytes: &[u8]) -> String {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let extension = extension.to_ascii_lowercase();
    let of_a_scene = FORMATS.iter().flat_map(|row| row.endings);
    match extension.as_str() {
        "splat" => splat::splat_problem(bytes)
            .unwrap_or_else(|| "is a .splat file by its name only".to_owned()),
        "ksplat" => "is a .ksplat file by its name, but its header is not".to_owned(),
        "spz" => "is an .spz file by its name, but does not begin like one".to_owned(),
        "pth" | "pt" | "ckpt" => "is a checkpoint by its name, not by its content".to_owned(),
        _ if of_a_scene.into_iter().any(|e| e.strip_prefix('.') == Some(&extension)) => {
            format!("is a .{extension} file by its name, but does not begin like one")
        }
        _ => "is no scene that can be recognized".to_owned(),
    }
}
