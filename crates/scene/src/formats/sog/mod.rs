//! SOG: attributes as lossless WebP textures with codebooks, in a folder or a zip archive.
//!
//! Versions 1 and 2, and streamed scenes (`lod-meta.json`) of several levels of detail. Gaussian
//! `i` is texel `i` of every texture, row by row; `meta.json` says how bytes become values:
//!
//! | texture | bytes | value |
//! |---|---|---|
//! | `means_l`, `means_u` | low and high byte, per axis | 65,536 steps in `sign(p) · ln(1 + abs(p))` |
//! | `quats` | three components and which is missing | `−1/√2..=1/√2` in 256 steps |
//! | `scales` | codes of one codebook | logarithm of the scale |
//! | `sh0` | codes of one codebook, alpha | DC coefficients, opacity `0..=1` |
//! | `shN_labels`, `shN_centroids` | palette index; its coefficients as codes | bands 1 to 3 |
//!
//! Labels and language codes are a file of their own among the textures, named in `meta.json` under
//! the key `scenesplat`, which other programs pass over.
//!
//! # Source
//! The layout is PlayCanvas's; written anew from its description and held against its files.

mod cluster;
mod codebook;
mod codes;
mod folder;
mod json;
mod levels;
mod meta;
mod order;
mod palette;
mod reader;
mod source;
mod streamed;
mod streamed_writer;
mod texture;
mod ticker;
mod writer;

pub use meta::is_sog_meta_json;
pub use source::is_sog_archive;
pub use streamed::is_lod_meta_json;
pub(super) use streamed_writer::write_sog_streamed;
pub(super) use writer::{write_sog, write_sog_folder};

use super::scene_blocks::zero_scene;
use super::{LoadedScene, ReadOptions, SceneFormat, semantics};
use crate::input_file::InputFile;
use crate::{RepairReport, SceneError};
use reader::OpenSog;
use source::Source;
use std::path::{Path, PathBuf};

const META_NAME: &str = "meta.json";
const LOD_META_NAME: &str = "lod-meta.json";

/// The description in a folder: `meta.json` of one scene, else `lod-meta.json` of a streamed one.
fn description_in(folder: &Path) -> Option<PathBuf> {
    let holds = |name: &str, test: fn(&[u8]) -> bool| {
        let path = folder.join(name);
        let found = path.is_file() && InputFile::open(&path).is_ok_and(|f| test(f.bytes()));
        found.then_some(path)
    };
    holds(META_NAME, is_sog_meta_json).or_else(|| holds(LOD_META_NAME, is_lod_meta_json))
}

/// Whether a folder holds a scene of textures, or a streamed one.
pub fn is_sog_folder(path: &Path) -> bool {
    path.is_dir() && description_in(path).is_some()
}

/// Reads a scene from a folder with `meta.json` or `lod-meta.json`, from such a file, or from a
/// bundled `.sog` archive; by content, whatever the names.
///
/// Of a streamed scene, level `options.lod` is read: in each leaf of the tree that level or, where
/// the leaf lacks it, the nearest coarser, else the nearest finer one. Its backdrop is not read.
/// Alpha 0 and 255 become the logits ±inf, which is what they say.
///
/// # Errors
/// As [`super::open_scene`]; also if files that `meta.json` names are missing, are no lossless
/// WebP images or are too small for the number of Gaussians; if a level is asked for that does not
/// exist, or whose files are not all there.
pub fn read_sog(path: &Path, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    let description = if path.is_dir() {
        description_in(path).ok_or_else(|| {
            let problem = format!("is a folder without the {META_NAME} of a scene");
            SceneError::format(path, problem, "give a folder of textures as SOG exporters write it")
        })?
    } else {
        path.to_owned()
    };
    let file = InputFile::open(&description)?;
    if file.bytes().starts_with(b"PK") {
        return read_sog_archive(file.bytes(), path, options);
    }
    if is_lod_meta_json(file.bytes()) {
        drop(file);
        return streamed::read_streamed(&description, options);
    }
    read_one(&Source::beside(&description), &description, options)
}

/// Reads a scene from the bytes of a `.sog` archive; `path` is for messages.
///
/// # Errors
/// As [`read_sog`].
pub fn read_sog_archive(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    read_one(&Source::archive(bytes, path)?, path, options)
}

fn read_one(
    source: &Source<'_>,
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let sog = OpenSog::open(source, options.sh_rest)?;
    let rows = sog.meta.count;
    let mut scene = zero_scene(rows, sog.sh_degree());
    scene.antialiased = sog.meta.antialiased;
    let mut report = RepairReport::default();
    let all = 0..rows;
    sog.decode(std::slice::from_ref(&all), &mut scene, 0)?;
    if let Some(name) = &sog.meta.labels {
        let (path, block) = source.part(name, labels_limit(rows))?;
        semantics::decode(block.bytes(), rows, &mut scene, &mut report, &path)?;
    }
    LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Sog)
}

/// Longest block of labels that is unpacked: some codebook, and a code of up to 500 numbers a row.
fn labels_limit(rows: usize) -> usize {
    rows.saturating_mul(1024).saturating_add(64 << 20)
}
