//! From pictures to the segments and features of each.

use super::args::{Args, CompatArg, FRAMES};
use super::cache::{FrameCache, FrameRecord, Made, sha256};
use super::frames::{Frame, Remarks};
use super::sources::{Labeler, Sources};
use crate::receipt::sha256_of;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::collection::{DescribeSettings, PosedPicture, describe};
use scenesplat::preview::{rendered_picture, solid_depth};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render,
};
use scenesplat::scene::Camera;
use scenesplat::scene::picture::RgbPicture;
use serde_json::json;
use std::path::Path;

/// Everything that 2D work needs.
pub(super) struct Work<'a> {
    pub(super) session: &'a Session<'a>,
    pub(super) args: &'a Args,
    pub(super) sources: &'a Sources,
    pub(super) gaussians: &'a Gaussians,
    /// How the scene is drawn.
    pub(super) raster: RasterSettings,
}

impl Work<'_> {
    /// Makes what is not there yet; gives the cameras of the frames, named like these.
    pub(super) fn run(&self, frames: &[Frame]) -> Result<Vec<Camera>> {
        let (session, folder) = (self.session, self.args.lifting.shared.out.join(FRAMES));
        let cache = FrameCache::open(&folder)?;
        let mut remarks = Remarks::default();
        let mut cameras = Vec::with_capacity(frames.len());
        let mut all: Vec<FrameRecord> = Vec::with_capacity(frames.len());
        let (mut found, mut stale) = (0, 0);
        for (number, frame) in frames.iter().enumerate() {
            session.check_stop()?;
            session.progress.advance("pictures", number as f64 / frames.len() as f64);
            let key = self.key(frame)?;
            let (record, camera) = match cache.find(&frame.name, &key) {
                Some(record) => {
                    found += 1;
                    let camera = frame.camera.resized(record.size);
                    (record, camera)
                }
                None => {
                    stale += usize::from(cache.has(&frame.name));
                    self.make(&cache, frame, &key, &mut remarks)
                        .with_context(|| format!("frame {}", frame.name))?
                }
            };
            cameras.push(Camera { name: frame.name.clone(), ..camera });
            all.push(record);
        }
        session.progress.finish();
        remarks.tell(session);
        self.tell(&all, found, stale)?;
        Ok(cameras)
    }

    /// Hash of all that segments and features of a frame depend on.
    fn key(&self, frame: &Frame) -> Result<String> {
        let _stage = self.session.receipt.stage("cache");
        let is_read = self.sources.wants_depth() || frame.photo.is_none();
        let scene = is_read.then(|| self.session.receipt.sha256_of_role("input")).flatten();
        let hash = |path: Option<&Path>| -> Result<Option<String>> {
            Ok(path.map(sha256_of).transpose()?.map(|(hash, _)| hash))
        };
        let mask = self.sources.mask(&frame.name);
        let (segmenter, encoder) = match &self.sources.labeler {
            Labeler::Pair { segmenter, encoder } => (segmenter.name(), encoder.name()),
            Labeler::Teacher { teacher, .. } => (teacher.name(), String::new()),
        };
        let text = json!({
            "version": 1,
            "segmenter": segmenter,
            "encoder": encoder,
            "original": self.is_original(),
            "camera": frame.camera,
            "photo": hash(frame.photo.as_deref())?,
            "mask": hash(mask)?,
            "scene": scene,
            "source": scene.as_ref().map(|_| format!("{:?}", self.args.read_options())),
            "antialiased": scene.as_ref().map(|_| self.raster.antialiased),
        });
        Ok(sha256(text.to_string().as_bytes()))
    }

    fn is_original(&self) -> bool {
        self.args.compat == Some(CompatArg::Original)
    }

    /// Segments and features of a frame.
    fn make(
        &self,
        cache: &FrameCache,
        frame: &Frame,
        key: &str,
        remarks: &mut Remarks,
    ) -> Result<(FrameRecord, Camera)> {
        let receipt = &self.session.receipt;
        let stage = receipt.stage("pictures");
        let (picture, camera) = match &frame.photo {
            Some(path) => remarks.read(frame, path)?,
            None => (self.drawn(&frame.camera)?, frame.camera.clone()),
        };
        let view = View::from_camera(&camera)?;
        let depth = self.sources.wants_depth().then(|| self.depth(&view)).transpose()?;
        drop(stage);
        let stage = receipt.stage("segments");
        let posed = PosedPicture {
            name: &frame.name,
            picture: &picture,
            view: &view,
            depth: depth.as_deref(),
        };
        let (segmented, features, dim, single_segment) = match &self.sources.labeler {
            Labeler::Pair { segmenter, encoder } => {
                let segmented = segmenter.segment(&posed)?;
                drop(stage);
                let _stage = receipt.stage("features");
                let settings = DescribeSettings { original: self.is_original() };
                let described = describe(&picture, &segmented.map, encoder.as_ref(), settings)?;
                (segmented, described.features, encoder.width(), described.single_segment)
            }
            Labeler::Teacher { teacher, .. } => {
                let taught = teacher.teach(&posed)?;
                (taught.segmented, taught.features, teacher.width(), false)
            }
        };
        let _stage = receipt.stage("cache");
        let made = Made {
            map: &segmented.map,
            features: &features,
            dim,
            left_out: segmented.left_out,
            single_segment,
        };
        Ok((cache.keep(&frame.name, key, &made)?, camera))
    }

    /// The scene as a camera sees it.
    fn drawn(&self, camera: &Camera) -> Result<RgbPicture> {
        let view = View::from_camera(camera)?;
        let rendered = render(self.gaussians, &view, &self.raster, &RenderRequest::rgb())?;
        rendered_picture(&rendered).context("colours were asked for")
    }

    /// The scene's own depth, 0 where it is thin.
    fn depth(&self, view: &View) -> Result<Vec<f32>> {
        let depth = DepthRequest { expected: true, ..DepthRequest::default() };
        let request = RenderRequest { depth, ..RenderRequest::default() };
        let rendered = render(self.gaussians, view, &self.raster, &request)?;
        solid_depth(&rendered).context("a depth was asked for")
    }

    /// Says and notes what there is.
    fn tell(&self, all: &[FrameRecord], found: usize, stale: usize) -> Result<()> {
        let (session, receipt) = (self.session, &self.session.receipt);
        let segments: usize = all.iter().map(|r| r.segments).sum();
        session.progress.say(format!(
            "{} pictures, {segments} segments; {found} pictures were done before",
            all.len()
        ));
        receipt.setting("pictures", all.len(), "with segments and features in frames");
        receipt.setting("pictures_done_before", found, "taken from frames as they are");
        receipt.setting("picture_segments", segments, "with a feature each");
        if stale > 0 {
            let text = format!(
                "{stale} pictures in frames were made from other files or settings, or are damaged: they were \
                 made anew"
            );
            session.warn(text);
        }
        let count = |of: fn(&FrameRecord) -> bool| all.iter().filter(|r| of(r)).count();
        let empty = count(|r| r.segments == 0);
        if empty > 0 {
            session.warn(format!("{empty} pictures have no segment"));
        }
        let single = count(|r| r.single_segment);
        if single > 0 {
            let what = if self.is_original() {
                "the feature of the frame"
            } else {
                "a feature of its own"
            };
            session.warn(format!("{single} pictures have a single segment, which got {what}"));
        }
        let left_out: usize = all.iter().map(|r| r.left_out).sum();
        if left_out > 0 {
            receipt.setting("segments_left_out", left_out, "covered by others, or too small");
        }
        anyhow::ensure!(segments > 0, "no picture has a segment");
        Ok(())
    }
}
