//! A folder of segments.

use super::feature_table::{FeatureTable, read_feature_table};
use super::id_map::read_id_png;
use super::langsplat::{MAX_LEVELS, read_id_maps};
use crate::lifting::{LiftError, SegmentMap};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// How a folder's files are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentLayout {
    /// `<frame>_s.npy` and `<frame>_f.npy`.
    Npy,
    /// `<frame>.png` with a feature table each.
    Png,
    /// `<frame>.png` with one feature table for all.
    PngSharedTable,
}

/// What to read of a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SegmentOptions {
    /// Granularities, in the order wanted; level 0 is all that PNG maps have. At most 4.
    pub levels: Vec<usize>,
    /// Value of PNG pixels without a segment; by default the largest, 255 or 65535.
    pub png_no_segment: Option<u16>,
}

impl Default for SegmentOptions {
    fn default() -> Self {
        Self { levels: vec![0], png_no_segment: None }
    }
}

/// The segments of one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameSegments {
    /// A map per level asked for, ids are rows of `features`.
    pub levels: Vec<SegmentMap>,
    /// `[S, dim]`, all finite, any norm.
    pub features: Vec<f32>,
    /// Values per feature.
    pub dim: usize,
}

/// A folder whose files have been found, not read.
#[derive(Debug, Clone)]
pub struct SegmentFolder {
    path: PathBuf,
    layout: SegmentLayout,
    options: SegmentOptions,
    /// In alphabetical order.
    frames: Vec<Frame>,
    shared: Option<FeatureTable>,
}

#[derive(Debug, Clone)]
struct Frame {
    name: String,
    map: PathBuf,
    /// None where one table serves all.
    table: Option<PathBuf>,
}

/// Which frame belongs to which camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraMatches {
    /// Frame of each camera, if it has one.
    pub frames: Vec<Option<usize>>,
    /// Names of frames without a camera.
    pub without_camera: Vec<String>,
}

impl CameraMatches {
    /// Cameras that have a frame.
    pub fn num_matched(&self) -> usize {
        self.frames.iter().flatten().count()
    }
}

impl SegmentFolder {
    /// Finds the frames of a folder; reads a table that serves all of them.
    ///
    /// A folder with any `<frame>_s.npy` has the layout of `.npy` files, and pictures in it are
    /// previews.
    ///
    /// # Errors
    /// If the folder cannot be read, holds no maps, or a map has no feature table; if levels are
    /// asked for that cannot be there.
    pub fn open(path: &Path, options: SegmentOptions) -> Result<Self, LiftError> {
        check_levels(&options)?;
        let names = file_names(path)?;
        let help = "see the layouts of segment folders: <frame>_s.npy with <frame>_f.npy, or \
                     <frame>.png with <frame>.npy or features.npy";
        let maps: Vec<&str> = names.iter().filter_map(|n| n.strip_suffix("_s.npy")).collect();
        if !maps.is_empty() {
            let frame = |name: &&str| {
                let table = format!("{name}_f.npy");
                if !names.contains(&table) {
                    let map = path.join(format!("{name}_s.npy"));
                    return Err(LiftError::file(&map, format!("has no {table} beside it"), help));
                }
                let map = path.join(format!("{name}_s.npy"));
                Ok(Frame { name: (*name).to_owned(), map, table: Some(path.join(table)) })
            };
            let frames = maps.iter().map(frame).collect::<Result<_, _>>()?;
            let layout = SegmentLayout::Npy;
            return Ok(Self { path: path.to_owned(), layout, options, frames, shared: None });
        }
        let maps: Vec<&str> = names.iter().filter_map(|n| n.strip_suffix(".png")).collect();
        if maps.is_empty() {
            return Err(LiftError::file(path, "holds no maps of segments", help));
        }
        if options.levels != [0] {
            let problem = format!("levels {:?} of PNG maps, which have level 0", options.levels);
            return Err(LiftError::argument("level", problem));
        }
        let table_of = |name: &str| {
            let mut endings = ["npy", "safetensors"].iter().map(|e| format!("{name}.{e}"));
            endings.find(|file| names.contains(file)).map(|file| path.join(file))
        };
        let shared = table_of("features").map(|file| read_feature_table(&file)).transpose()?;
        let frame = |name: &&str| {
            let map = path.join(format!("{name}.png"));
            let table = if shared.is_some() { None } else { table_of(name) };
            if table.is_none() && shared.is_none() {
                return Err(LiftError::file(&map, "has no feature table beside it", help));
            }
            Ok(Frame { name: (*name).to_owned(), map, table })
        };
        let frames = maps.iter().map(frame).collect::<Result<_, _>>()?;
        let layout =
            if shared.is_some() { SegmentLayout::PngSharedTable } else { SegmentLayout::Png };
        Ok(Self { path: path.to_owned(), layout, options, frames, shared })
    }

    /// How its files are laid out.
    pub fn layout(&self) -> SegmentLayout {
        self.layout
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is no frame; never, of an open folder.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Name of a frame.
    pub fn name(&self, frame: usize) -> &str {
        &self.frames[frame].name
    }

    /// Finds the frame of each camera by name: the camera's file name, without its last ending, or up
    /// to its first dot; folders in it do not count.
    ///
    /// # Errors
    /// If two cameras mean one frame, or no camera has any.
    pub fn match_cameras(&self, cameras: &[&str]) -> Result<CameraMatches, LiftError> {
        let by_name: BTreeMap<&str, usize> =
            self.frames.iter().enumerate().map(|(i, f)| (f.name.as_str(), i)).collect();
        let mut taken: BTreeMap<usize, &str> = BTreeMap::new();
        let mut frames = Vec::with_capacity(cameras.len());
        for &camera in cameras {
            let file = camera.rsplit(['/', '\\']).next().unwrap_or(camera);
            let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
            let start = file.split('.').next().unwrap_or(file);
            let found = [file, stem, start].iter().find_map(|name| by_name.get(name)).copied();
            if let Some(frame) = found
                && let Some(other) = taken.insert(frame, camera)
            {
                let problem = format!(
                    "frame {:?} belongs to two cameras, {other:?} and {camera:?}",
                    self.frames[frame].name
                );
                return Err(LiftError::file(
                    &self.path,
                    problem,
                    "give pictures names of their own",
                ));
            }
            frames.push(found);
        }
        if taken.is_empty() {
            let problem = format!(
                "none of its {} frames ({:?}, …) has the name of one of the {} cameras ({:?}, …)",
                self.len(),
                self.frames[0].name,
                cameras.len(),
                cameras.first().unwrap_or(&"")
            );
            return Err(LiftError::file(&self.path, problem, "name frames as their pictures"));
        }
        let without_camera = (self.frames.iter().enumerate())
            .filter(|(i, _)| !taken.contains_key(i))
            .map(|(_, frame)| frame.name.clone())
            .collect();
        Ok(CameraMatches { frames, without_camera })
    }

    /// Reads a frame, at the size of its picture.
    ///
    /// # Errors
    /// If a file cannot be read or holds what it should not: names the file, the place and the value;
    /// if a map has another shape than the picture.
    pub fn read(&self, frame: usize, width: u32, height: u32) -> Result<FrameSegments, LiftError> {
        let frame = &self.frames[frame];
        let own = frame.table.as_deref().map(read_feature_table).transpose()?;
        let Some(table) = own.as_ref().or(self.shared.as_ref()) else {
            return Err(LiftError::file(&frame.map, "has no feature table", "write one beside it"));
        };
        let maps = match self.layout {
            SegmentLayout::Npy => read_id_maps(&frame.map, &self.options.levels, table.rows())?,
            SegmentLayout::Png | SegmentLayout::PngSharedTable => {
                vec![read_id_png(&frame.map, table.rows(), self.options.png_no_segment)?]
            }
        };
        let fit = |map: SegmentMap| {
            map.resized(width, height).ok_or_else(|| {
                let problem =
                    format!("is {}×{}, its camera {width}×{height}", map.width(), map.height());
                let help = "maps have the size of their pictures, or are scaled as a whole";
                LiftError::file(&frame.map, problem, help)
            })
        };
        let levels = maps.into_iter().map(fit).collect::<Result<_, _>>()?;
        let dim = table.dim;
        let features = own.as_ref().map_or_else(|| table.values.clone(), |t| t.values.clone());
        Ok(FrameSegments { levels, features, dim })
    }
}

fn check_levels(options: &SegmentOptions) -> Result<(), LiftError> {
    let levels = &options.levels;
    let distinct: BTreeSet<usize> = levels.iter().copied().collect();
    if levels.is_empty()
        || distinct.len() != levels.len()
        || levels.iter().any(|l| *l >= MAX_LEVELS)
    {
        let problem = format!("{levels:?}; up to 4 different levels of 0 to 3 are expected");
        return Err(LiftError::argument("level", problem));
    }
    Ok(())
}

/// Names of the files in a folder; names that are no Unicode cannot be those of frames.
fn file_names(path: &Path) -> Result<BTreeSet<String>, LiftError> {
    let failed = || LiftError::spool(path, "cannot read the folder of segments");
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(path).map_err(failed())? {
        if let Ok(name) = entry.map_err(failed())?.file_name().into_string() {
            names.insert(name);
        }
    }
    Ok(names)
}
