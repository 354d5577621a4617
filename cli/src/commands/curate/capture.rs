//! The frames of a capture.

use super::Args;
use crate::error::refuse;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::metrics::image::frame_filter::FrameFilter;
use scenesplat::optimisation::curation::{Coverage, FrameReport, coverage, judge_frames};
use scenesplat::optimisation::{CaptureFolder, TrainingFrame};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::{Camera, open_cameras};
use serde_json::json;

/// A capture with what was found out about it.
pub(super) struct Judged {
    pub(super) frames: Vec<TrainingFrame>,
    pub(super) report: FrameReport,
    pub(super) coverage: Option<Coverage>,
}

impl Args {
    /// Judges all frames, and writes those that are kept.
    pub(super) fn judge(&self, session: &Session<'_>) -> Result<Judged> {
        let _stage = session.receipt.stage("frames");
        let (Some(cameras), Some(images)) = (&self.cameras, &self.images) else {
            refuse!("give --cameras and --images, or --scenes for a table");
        };
        let set = open_cameras(cameras)?;
        let folder = CaptureFolder {
            images,
            depth: self.depth.as_deref(),
            masks: None,
            depth_scale: self.depth_scale,
        };
        let capture = folder.read(&set)?;
        for (what, found) in &capture.found {
            session.tell_found(what, found);
        }
        for note in &capture.notes {
            session.warn(note);
        }
        let filter = FrameFilter { sharpness_share: self.blur_share, ..FrameFilter::default() };
        let report = judge_frames(&capture.frames, &filter).context("--blur-share")?;
        let seen = coverage(&capture.frames);
        print(&format!(
            "{} of {} frames kept: {} blurred, {} blurred but kept for coverage, {} duplicates, {} bad \
             poses, {} black",
            report.kept,
            report.frames.len(),
            report.blurred,
            report.kept_for_coverage,
            report.duplicates,
            report.bad_poses,
            report.black
        ));
        if report.frames.len() < self.min_frames {
            session.warn(format!("{} frames, fewer than {}", report.frames.len(), self.min_frames));
        }
        if let Some(c) = seen {
            print(&format!(
                "{:.1} % of the surface is seen well, {:.1} % by fewer than 3 views",
                100.0 * c.well_seen,
                100.0 * c.holes
            ));
        }
        let judged = capture.cameras.iter().zip(&report.frames).filter(|(_, frame)| frame.kept);
        let cameras: Vec<Camera> = judged.map(|(&i, _)| set.cameras[i].clone()).collect();
        if cameras.is_empty() {
            session.warn("no frame is kept: cameras.json is not written");
        } else {
            session.write("cameras.json", |path| write_cameras_json(&cameras, path))?;
        }
        let text = json!({ "report": report, "coverage": seen });
        let text = serde_json::to_string_pretty(&text)? + "\n";
        session.write_text("frames.json", &text)?;
        Ok(Judged { frames: capture.frames, report, coverage: seen })
    }
}
