//! Cameras, their segments and depths, picture by picture.

use super::args::{Args, DepthArg, LiftArgs};
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::rasterizer::View;
use scenesplat::rasterizer::lifting::LabelledPicture;
use scenesplat::rasterizer::segments::{
    CameraMatches, FrameSegments, SegmentFolder, SegmentOptions,
};
use scenesplat::scene::formats::depth_map::read_depth;
use scenesplat::scene::frame_files::DEPTHS;
use scenesplat::scene::{Camera, open_cameras};
use std::path::{Path, PathBuf};

impl Args {
    /// Cameras and the frames that belong to them.
    pub(super) fn pictures(
        &self,
        session: &Session<'_>,
    ) -> Result<(Vec<Camera>, SegmentFolder, CameraMatches)> {
        let _stage = session.receipt.stage("pictures");
        let set = open_cameras(&self.cameras)?;
        for note in &set.notes {
            session.progress.say(note);
        }
        let options =
            SegmentOptions { levels: self.level.clone(), png_no_segment: self.no_segment };
        let folder = SegmentFolder::open(&self.segments, options)?;
        let names: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
        let matches = folder.match_cameras(&names)?;
        let text = format!(
            "{} cameras, {} frames, {} with both",
            names.len(),
            folder.len(),
            matches.num_matched()
        );
        session.progress.say(&text);
        if let Some(frame) = matches.without_camera.first() {
            let count = matches.without_camera.len();
            session.warn(format!("{count} frames have no camera ({frame}, …)"));
        }
        session.tell_found("map of segments", &matches.found);
        session.receipt.setting("pictures", matches.num_matched(), "cameras with segments");
        Ok((set.cameras, folder, matches))
    }
}

/// The views of the cameras that have a frame.
pub(super) fn views(
    cameras: &[Camera],
    matches: &CameraMatches,
    path: &Path,
) -> Result<Vec<Option<View>>> {
    let view = |(camera, frame): (&Camera, &Option<usize>)| {
        let view = frame.map(|_| View::from_camera(camera)).transpose();
        view.with_context(|| format!("{}: camera {:?}", path.display(), camera.name))
    };
    cameras.iter().zip(matches.frames()).map(view).collect()
}

/// Those with their frames.
pub(super) fn paired<'a>(
    views: &'a [Option<View>],
    matches: &CameraMatches,
) -> Vec<(&'a View, usize)> {
    let pairs = views.iter().zip(matches.frames());
    pairs.filter_map(|(view, frame)| view.as_ref().zip(*frame)).collect()
}

/// The pictures that are read one by one.
pub(super) struct Pictures<'a> {
    folder: &'a SegmentFolder,
    /// Cameras and the numbers of their frames.
    views: Vec<(&'a View, usize)>,
    depths: MeasuredDepths,
}

/// Files of depths, one for each picture, if it has one.
pub(super) struct MeasuredDepths {
    files: Vec<Option<PathBuf>>,
    /// Steps per unit of PNGs.
    scale: f64,
}

/// One of them.
pub(super) struct Picture<'a> {
    pub(super) name: String,
    view: &'a View,
    pub(super) segments: FrameSegments,
    depth: Option<Vec<f32>>,
}

impl<'a> Pictures<'a> {
    pub(super) fn new(
        folder: &'a SegmentFolder,
        views: Vec<(&'a View, usize)>,
        depths: MeasuredDepths,
    ) -> Self {
        Self { folder, views, depths }
    }

    pub(super) fn len(&self) -> usize {
        self.views.len()
    }

    pub(super) fn read(&self, number: usize) -> Result<Picture<'a>> {
        let (view, frame) = self.views[number];
        let name = self.folder.name(frame);
        let segments = self.folder.read(frame, view.width, view.height)?;
        let read = |path| read_depth(path, [view.width, view.height], self.depths.scale);
        let depth = self.depths.files[number].as_deref().map(read).transpose()?;
        Ok(Picture { name, view, segments, depth })
    }
}

impl Picture<'_> {
    pub(super) fn labelled(&self) -> LabelledPicture<'_> {
        LabelledPicture {
            view: self.view,
            levels: &self.segments.levels,
            features: &self.segments.features,
            depth: self.depth.as_deref(),
        }
    }

    /// Checks that features are as wide as those before.
    pub(super) fn check_dim(&self, dim: usize) -> Result<()> {
        let (name, mine) = (&self.name, self.segments.dim);
        anyhow::ensure!(
            mine == dim,
            "{name}: its features have {mine} values, those before it {dim}"
        );
        Ok(())
    }
}

impl LiftArgs {
    /// The measured depths of cameras, where there is a folder of them.
    pub(super) fn measured_depths(
        &self,
        session: &Session<'_>,
        cameras: &[&str],
    ) -> Result<MeasuredDepths> {
        let DepthArg::Folder(folder) = &self.depth else {
            return Ok(MeasuredDepths {
                files: vec![None; cameras.len()],
                scale: self.depth_scale,
            });
        };
        let files = session.files_of_cameras(("--depth", folder), ("depth", DEPTHS), cameras)?;
        Ok(MeasuredDepths { files, scale: self.depth_scale })
    }
}
