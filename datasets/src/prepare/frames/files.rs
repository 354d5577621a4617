//! Frames whose pictures, depths and perhaps poses are files of their own: most layouts.

use super::depth::{DepthMap, read_distance, read_pgm_depth, read_png_depth};
use super::frame::{FrameFiles, Head, SkipReason};
use super::lens::{Lens, Pose};
use super::text::{Key, keyed, pose_file};
use crate::DataError;
use scenesplat_scene::input_file::read_file;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Largest file of a picture that is read.
pub(super) const MAX_PICTURE: u64 = 1 << 28;

/// Endings of pictures in the order in which they are looked for.
pub(super) const PICTURES: [&str; 5] = [".jpg", ".jpeg", ".png", ".JPG", ".PNG"];

/// Where a pose is.
pub(super) enum PoseOf {
    Known(Result<Pose, SkipReason>),
    /// A text file of 16 numbers.
    File(PathBuf),
}

/// How depths are stored.
pub(super) enum DepthOf {
    /// Gray PNG with so many steps per meter.
    Png(f64),
    /// Binary PGM with so many steps per meter.
    Pgm(f64),
    /// Hypersim's distances from the camera.
    Distance,
}

/// The files of a frame.
pub(super) struct FrameEntry {
    pub(super) name: String,
    pub(super) picture: Option<PathBuf>,
    pub(super) depth: Option<PathBuf>,
    pub(super) pose: PoseOf,
    pub(super) lens: Lens,
}

/// All of them.
pub(super) struct SeparateFiles {
    pub(super) list: Vec<FrameEntry>,
    pub(super) depth: DepthOf,
    pub(super) depth_lens: Option<Lens>,
}

impl FrameFiles for SeparateFiles {
    fn len(&self) -> usize {
        self.list.len()
    }

    fn head(&mut self, index: usize) -> Result<Head, DataError> {
        let entry = &self.list[index];
        let pose = match &entry.pose {
            PoseOf::Known(pose) => *pose,
            PoseOf::File(path) => pose_file(path)?,
        };
        // Without a picture nothing else is read, so nothing is said of it.
        let (name, source) = (entry.name.clone(), entry.picture.clone().unwrap_or_default());
        Ok(Head { name, source, pose, lens: entry.lens, depth_lens: self.depth_lens })
    }

    fn picture(&mut self, index: usize) -> Result<Option<Vec<u8>>, DataError> {
        let path = self.list[index].picture.as_ref().filter(|path| path.is_file());
        Ok(path.map(|path| read_file(path, MAX_PICTURE)).transpose()?)
    }

    fn depth(&mut self, index: usize) -> Result<Option<DepthMap>, DataError> {
        let entry = &self.list[index];
        let Some(path) = entry.depth.as_ref().filter(|path| path.is_file()) else {
            return Ok(None);
        };
        let map = match self.depth {
            DepthOf::Png(steps) => read_png_depth(path, steps),
            DepthOf::Pgm(steps) => read_pgm_depth(path, steps),
            DepthOf::Distance => read_distance(path, entry.lens),
        };
        map.map(Some)
    }
}

/// The files of one kind: their folder, what their names begin with, and how they may end.
pub(super) struct Kind<'a>(pub(super) PathBuf, pub(super) &'a str, pub(super) &'a [&'a str]);

/// Frames by what pictures and poses have in common in their names; each of a pose without a picture, too, so that it
/// is counted.
pub(super) fn paired(
    [pictures, depths, poses]: [Kind<'_>; 3],
    name: impl Fn(&str) -> String,
    lens: Lens,
) -> Result<Vec<FrameEntry>, DataError> {
    let found = |kind: &Kind<'_>| keyed(&kind.0, kind.1, kind.2);
    let (pictures, poses, depths) = (found(&pictures)?, found(&poses)?, found_depths(&depths)?);
    let keys: BTreeSet<&Key> = pictures.keys().chain(poses.keys()).collect();
    let entry = |key: &Key| FrameEntry {
        name: name(&key.1),
        picture: pictures.get(key).cloned(),
        depth: depths.get(key).cloned(),
        pose: match poses.get(key) {
            Some(path) => PoseOf::File(path.clone()),
            None => PoseOf::Known(Err(SkipReason::NoPose)),
        },
        lens,
    };
    Ok(keys.into_iter().map(entry).collect())
}

/// Depths may be missing altogether.
fn found_depths(kind: &Kind<'_>) -> Result<BTreeMap<Key, PathBuf>, DataError> {
    match kind.0.is_dir() {
        true => keyed(&kind.0, kind.1, kind.2),
        false => Ok(BTreeMap::new()),
    }
}

/// The first of these that is a folder.
pub(super) fn first_folder(candidates: impl IntoIterator<Item = PathBuf>) -> Option<PathBuf> {
    candidates.into_iter().find(|path| path.is_dir())
}

/// The picture of a name with one of the endings, if it is there.
pub(super) fn picture_at(folder: &Path, stem: &str) -> Option<PathBuf> {
    PICTURES.iter().map(|ending| folder.join(format!("{stem}{ending}"))).find(|p| p.is_file())
}
