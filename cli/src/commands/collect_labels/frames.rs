//! The pictures that labels come from.

use super::args::Args;
use crate::commands::render::picture_name;
use crate::error::refuse;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::collection::{PhotoRemark, fit_photo};
use scenesplat::rasterizer::View;
use scenesplat::scene::picture::RgbPicture;
use scenesplat::scene::{Camera, open_cameras};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Endings of photos, in the order in which they are looked for.
const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

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
    let count = set.cameras.len();
    let (mut frames, mut missing, mut taken) = (Vec::new(), Vec::new(), HashSet::new());
    for (index, camera) in set.cameras.into_iter().enumerate() {
        // Lenses that cannot be drawn are said before anything else.
        View::from_camera(&camera).with_context(|| file.display().to_string())?;
        let mut name = picture_name(&camera.name, index);
        let Some(photo) = photo_of(folder, &camera.name, &name) else {
            missing.push(camera.name);
            continue;
        };
        if !taken.insert(name.clone()) {
            // Folders of several lenses often number their pictures alike.
            name = format!("{name}_{index:05}");
            taken.insert(name.clone());
        }
        frames.push(Frame { name, camera, photo: Some(photo) });
    }
    anyhow::ensure!(
        !frames.is_empty(),
        "--images {}: holds the photo of none of the {count} cameras ({:?}, …)",
        folder.display(),
        missing.first().map_or("", String::as_str)
    );
    if let Some(first) = missing.first() {
        session.warn(format!("{} of {count} cameras have no photo ({first}, …)", missing.len()));
    }
    Ok(frames)
}

/// The photo of a camera: by its name as the file says it, without its folders, or with another ending.
fn photo_of(folder: &Path, name: &str, frame: &str) -> Option<PathBuf> {
    let plain = name.replace('\\', "/");
    let file = plain.rsplit('/').next().unwrap_or(&plain);
    // Names come from a file: they stay inside the folder.
    let is_inside = |name: &str| {
        let mut parts = Path::new(name).components();
        parts.all(|p| matches!(p, std::path::Component::Normal(_) | std::path::Component::CurDir))
    };
    let stem = plain.strip_suffix(file).unwrap_or("");
    let named = [plain.as_str(), file].map(str::to_owned);
    let ended = ENDINGS.iter().flat_map(|e| [format!("{stem}{frame}.{e}"), format!("{frame}.{e}")]);
    let found = named.into_iter().chain(ended).filter(|n| !n.is_empty() && is_inside(n));
    found.map(|name| folder.join(name)).find(|path| path.is_file())
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
