//! The pictures of a `render`, and the cameras of a file.

use super::Args;
use crate::error::WrongUse;
use anyhow::Result;
use scenesplat::preview::Ceiling;
use scenesplat::rasterizer::View;
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::{Camera, open_cameras};
use std::collections::HashSet;
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
    let mut taken = HashSet::new();
    let list = cameras
        .into_iter()
        .map(|(index, camera)| {
            let mut name = picture_name(&camera.name, index);
            if !taken.insert(name.clone()) {
                // Folders of several lenses often number their pictures alike.
                name = format!("{name}_{index:05}");
                taken.insert(name.clone());
            }
            let camera = args.size.map_or(camera.clone(), |size| camera.resized(size));
            Shot { name, camera, index }
        })
        .collect();
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

/// Endings of pictures; whatever else follows a dot is part of a name (`frame.0001`).
const PICTURE_ENDINGS: [&str; 12] =
    ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "exr", "heic", "dng", "gif", "ppm"];

fn without_ending(file: &str) -> &str {
    match file.rsplit_once('.') {
        Some((stem, ending)) if PICTURE_ENDINGS.iter().any(|e| ending.eq_ignore_ascii_case(e)) => {
            stem
        }
        _ => file,
    }
}

/// The name of a picture without folder and ending, fit for a file name.
pub fn picture_name(name: &str, index: usize) -> String {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let fit = |c: char| if c.is_control() || ":*?\"<>|".contains(c) { '_' } else { c };
    let name: String = without_ending(file).chars().map(fit).collect();
    if name.chars().all(|c| c == '.') { format!("camera_{index:05}") } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_into_a_folder() {
        assert_eq!(picture_name("images/left/0001.jpg", 4), "0001");
        assert_eq!(picture_name("..", 4), "camera_00004");
        assert_eq!(picture_name("", 12), "camera_00012");
        assert_eq!(picture_name("a:b\\c?.png", 0), "c_");
        assert_eq!(picture_name("left/frame.0001", 0), "frame.0001");
        assert_eq!(picture_name("frame.0001.JPEG", 0), "frame.0001");
        assert_eq!(picture_name("v1.2/scan.left.png", 0), "scan.left");
    }
}
