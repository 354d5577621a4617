//! A folder of segments.

use super::feature_table::{FeatureTable, read_feature_table};
use super::id_map::read_id_png;
use super::langsplat::{MAX_LEVELS, read_id_maps};
use crate::lifting::{LiftError, SegmentMap};
use scenesplat_scene::frame_files::{EXACT_PICTURES, FoundFiles, FrameFiles, without_ending};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What to do about a folder that is none.
const LAYOUTS: &str = "see the layouts of segment folders: <frame>_s.npy with <frame>_f.npy, or <frame>.png with \
                       <frame>.npy or features.npy";

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
    /// Value of PNG pixels without a segment; by default 255, or 65535 of 16 bits.
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
    /// The maps.
    files: FrameFiles,
    /// Of each map.
    frames: Vec<Frame>,
    shared: Option<FeatureTable>,
}

#[derive(Debug, Clone)]
struct Frame {
    map: PathBuf,
    /// None where one table serves all.
    table: Option<PathBuf>,
}

/// Which frame belongs to which camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraMatches {
    /// Frame of each camera, if it has one.
    pub found: FoundFiles,
    /// Names of frames without a camera.
    pub without_camera: Vec<String>,
}

impl CameraMatches {
    /// Frame of each camera, if it has one.
    pub fn frames(&self) -> &[Option<usize>] {
        &self.found.files
    }

    /// Cameras that have a frame.
    pub fn num_matched(&self) -> usize {
        self.found.num_found()
    }
}

impl SegmentFolder {
    /// Finds the frames of a folder; reads a table that serves all of them.
    ///
    /// A folder with any `<frame>_s.npy` has the layout of `.npy` files, and pictures in it are
    /// previews. Folders below are looked into if there is no map beside them.
    ///
    /// # Errors
    /// If the folder cannot be read, holds no maps, or a map has no feature table; if levels are
    /// asked for that cannot be there.
    pub fn open(path: &Path, options: SegmentOptions) -> Result<Self, LiftError> {
        check_levels(&options)?;
        let maps = FrameFiles::open(path, &["_s.npy"])?.at_top();
        if !maps.is_empty() {
            let frame = |i: usize| {
                let map = maps.path(i);
                let name = file_stem(&maps, i);
                let table = beside(&map, &[format!("{name}_f.npy")]);
                let Some(table) = table else {
                    let problem = format!("has no {name}_f.npy beside it");
                    return Err(LiftError::file(&map, problem, LAYOUTS));
                };
                Ok(Frame { map, table: Some(table) })
            };
            let frames = (0..maps.len()).map(frame).collect::<Result<_, _>>()?;
            let layout = SegmentLayout::Npy;
            return Ok(Self {
                path: path.to_owned(),
                layout,
                options,
                files: maps,
                frames,
                shared: None,
            });
        }
        Self::of_pictures(path, options)
    }

    fn of_pictures(path: &Path, options: SegmentOptions) -> Result<Self, LiftError> {
        let maps = FrameFiles::open(path, EXACT_PICTURES)?.at_top();
        if maps.is_empty() {
            return Err(LiftError::file(path, "holds no maps of segments", LAYOUTS));
        }
        if options.levels != [0] {
            let problem = format!("levels {:?} of PNG maps, which have level 0", options.levels);
            return Err(LiftError::argument("level", problem));
        }
        let shared = beside(&path.join("maps"), &tables_of("features"));
        let shared = shared.map(|file| read_feature_table(&file)).transpose()?;
        let frame = |i: usize| {
            let map = maps.path(i);
            let name = file_stem(&maps, i);
            // COLMAP's NAME.jpg.png may have NAME.npy beside it.
            let names = [tables_of(&name), tables_of(without_ending(&name))].concat();
            let table = if shared.is_some() { None } else { beside(&map, &names) };
            if table.is_none() && shared.is_none() {
                return Err(LiftError::file(&map, "has no feature table beside it", LAYOUTS));
            }
            Ok(Frame { map, table })
        };
        let frames = (0..maps.len()).map(frame).collect::<Result<_, _>>()?;
        let layout =
            if shared.is_some() { SegmentLayout::PngSharedTable } else { SegmentLayout::Png };
        Ok(Self { path: path.to_owned(), layout, options, files: maps, frames, shared })
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

    /// Name of a frame: that of its map without its ending, behind the folders below this one.
    pub fn name(&self, frame: usize) -> String {
        self.files.stem(frame)
    }

    /// Finds the frame of each camera by the names, as of [all files of cameras](scenesplat_scene::frame_files).
    ///
    /// # Errors
    /// If two cameras mean one frame, or no camera has any.
    pub fn match_cameras(&self, cameras: &[&str]) -> Result<CameraMatches, LiftError> {
        let found = self.files.find(cameras)?;
        let mut taken = BTreeSet::new();
        if let Some(twice) = found.files.iter().flatten().find(|frame| !taken.insert(**frame)) {
            let problem =
                format!("frame {:?} belongs to two cameras of one name", self.name(*twice));
            return Err(LiftError::file(&self.path, problem, "give pictures names of their own"));
        }
        if taken.is_empty() {
            let problem = format!(
                "none of its {} frames ({:?}, …) has the name of one of the {} cameras ({:?}, …)",
                self.len(),
                self.name(0),
                cameras.len(),
                cameras.first().unwrap_or(&"")
            );
            return Err(LiftError::file(&self.path, problem, "name frames as their pictures"));
        }
        let others = (0..self.len()).filter(|frame| !taken.contains(frame));
        let without_camera = others.map(|frame| self.name(frame)).collect();
        Ok(CameraMatches { found, without_camera })
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

/// The name of a map without its ending and its folders.
fn file_stem(maps: &FrameFiles, i: usize) -> String {
    let stem = maps.stem(i);
    stem.rsplit('/').next().unwrap_or(&stem).to_owned()
}

fn tables_of(name: &str) -> Vec<String> {
    ["npy", "safetensors"].map(|ending| format!("{name}.{ending}")).to_vec()
}

/// The first of these files that is in the folder of another.
fn beside(file: &Path, names: &[String]) -> Option<PathBuf> {
    names.iter().map(|name| file.with_file_name(name)).find(|path| path.is_file())
}
