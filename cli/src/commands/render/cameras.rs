//! The pictures of a `render`, and the cameras of a file.

use super::Args;
use crate::error::WrongUse;
use anyhow::Result;
use scenesplat::preview::Ceiling;
use scenesplat::rasterizer::View;
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::frame_files::{frame_names, without_ending};
use scenesplat::scene::{Camera, open_cameras};
use std::path::Path;

/// A camera and the name of its picture.
pub(super) struct Shot {
    pub(super) name: String,
    pub(super) camera: Camera,
    /// Its number among all cameras, chosen or not.
    pub(super) index: usize,
}

/// All pictures to take.
pub(super) struct Shots {
    pub(super) list: Vec<Shot>,
    /// Depth at which the near walls of a room end.
    pub(super) near: Option<f64>,
    pub(super) ceiling: Option<Ceiling>,
    pub(super) notes: Vec<String>,
}

impl Shots {
    /// The pictures of a scene from whose positions `origin` is subtracted.
    pub(super) fn relative_to(mut self, origin: [f64; 3]) -> Self {
        self.list.iter_mut().for_each(|shot| shot.camera = shot.camera.relative_to(origin));
        self
    }
}

/// The chosen cameras of a file.
pub(super) fn read(path: &Path, args: &Args) -> Result<Shots> {
    let set = open_cameras(path)?;
    let mut cameras = Vec::new();
    if args.chosen.is_empty() {
        cameras.extend(set.cameras.iter().enumerate());
    }
    for wanted in &args.chosen {
        cameras.push(find(&set.cameras, wanted, path)?);
    }
    for (_, camera) in &cameras {
        // Lenses that cannot be drawn are said before a large scene is read.
        View::from_camera(camera)?;
    }
    let names = frame_names(cameras.iter().map(|(index, camera)| (*index, camera.name.as_str())));
    let shot = |((index, camera), name): ((usize, &Camera), String)| {
        let camera = args.size.map_or(camera.clone(), |size| camera.resized(size));
        Shot { name, camera, index }
    };
    let list = cameras.into_iter().zip(names).map(shot).collect();
    Ok(Shots { list, near: None, ceiling: None, notes: set.notes })
}

/// Writes the cameras of the pictures, by the names of these, in the coordinates of the scene's file.
pub(super) fn write(shots: &[Shot], origin: [f64; 3], path: &Path) -> Result<()> {
    let back = origin.map(|v| -v);
    let named = |shot: &Shot| Camera { name: shot.name.clone(), ..shot.camera.relative_to(back) };
    let cameras: Vec<Camera> = shots.iter().map(named).collect();
    Ok(write_cameras_json(&cameras, path)?)
}

/// A camera by the name of its picture, with or without folder and ending, or by its number.
fn find<'a>(cameras: &'a [Camera], wanted: &str, path: &Path) -> Result<(usize, &'a Camera)> {
    let of_name = |name: &str| {
        let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
        [name, file, without_ending(file)].contains(&wanted)
    };
    let by_name = cameras.iter().enumerate().find(|(_, camera)| of_name(&camera.name));
    let by_number = || wanted.parse().ok().and_then(|i: usize| Some((i, cameras.get(i)?)));
    by_name.or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = cameras.iter().take(3).map(|c| c.name.as_str()).collect();
        let text = format!(
            "--camera {wanted}: {} has {} cameras, numbers from 0, names such as {}",
            path.display(),
            cameras.len(),
            names.join(", ")
        );
        WrongUse(text).into()
    })
}
