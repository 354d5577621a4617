//! The pictures that labels come from.

use super::args::Args;
use crate::error::refuse;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::collection::{PhotoRemark, fit_photo};
use scenesplat::rasterizer::View;
use scenesplat::scene::frame_files::{PICTURES, frame_names};
use scenesplat::scene::picture::RgbPicture;
use scenesplat::scene::{Camera, open_cameras};
use std::path::{Path, PathBuf};

/// One picture to be.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    /// Of its files; no two are alike.
    pub(super) name: String,
    /// As its file says it.
    pub(super) camera: Camera,
    /// Its photo; `None`: the scene itself is rendered.
    pub(super) photo: Option<PathBuf>,
}

/// The cameras of a file that have photos.
pub(super) fn of_photos(session: &Session<'_>, args: &Args) -> Result<Vec<Frame>> {
    let _stage = session.receipt.stage("frames");
    let (Some(file), Some(folder)) = (&args.cameras, &args.images) else {
        refuse!("--cameras and --images go together");
    };
    let set = open_cameras(file)?;
    for note in &set.notes {
        session.progress.say(note);
    }
    anyhow::ensure!(folder.is_dir(), "--images {}: is no folder", folder.display());
    for camera in &set.cameras {
        // Lenses that cannot be drawn are said before anything else.
        View::from_camera(camera).with_context(|| file.display().to_string())?;
    }
    let names: Vec<&str> = set.cameras.iter().map(|camera| camera.name.as_str()).collect();
    let photos = session.files_of_cameras(("--images", folder), ("photo", PICTURES), &names)?;
    let photos = photos.into_iter().enumerate().filter_map(|(i, file)| Some((i, file?)));
    let photos: Vec<(usize, PathBuf)> = photos.collect();
    let unique = frame_names(photos.iter().map(|(i, _)| (*i, names[*i])));
    let frame = |((i, photo), name): ((usize, PathBuf), String)| Frame {
        name,
        camera: set.cameras[i].clone(),
        photo: Some(photo),
    };
    Ok(photos.into_iter().zip(unique).map(frame).collect())
}

/// What was done to photos, counted.
#[derive(Debug, Default)]
pub(super) struct Remarks {
    turned: Vec<String>,
    ignored: Vec<String>,
    scaled: Vec<String>,
}

impl Remarks {
    /// The photo of a frame, and its camera at that size.
    pub(super) fn read(&mut self, frame: &Frame, path: &Path) -> Result<(RgbPicture, Camera)> {
        let (photo, camera, remarks) = fit_photo(path, &frame.camera)?;
        for remark in remarks {
            match remark {
                PhotoRemark::Turned(_) => self.turned.push(frame.name.clone()),
                PhotoRemark::MarkIgnored(_) => self.ignored.push(frame.name.clone()),
                PhotoRemark::CameraScaled => self.scaled.push(frame.name.clone()),
            }
        }
        Ok((photo, camera))
    }

    /// Says what there was.
    pub(super) fn tell(&self, session: &Session<'_>) {
        let say = |frames: &[String], text: &str| {
            if let Some(first) = frames.first() {
                session.warn(format!("{} photos ({first}, …) {text}", frames.len()));
            }
        };
        say(&self.turned, "were turned by their Exif mark: only so they fit their cameras");
        say(
            &self.ignored,
            "have an Exif mark to turn them by, and fit their cameras as they are stored: they were left so",
        );
        say(&self.scaled, "are of another scale than their cameras: the cameras were scaled");
    }
}
