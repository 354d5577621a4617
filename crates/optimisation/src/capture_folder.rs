//! Frames from files: cameras, pictures, depths and masks of the same names.

use crate::error::OptimiseError;
use crate::frame::{Colors, TrainingFrame};
use rayon::prelude::*;
use scenesplat_rasterizer::View;
use scenesplat_scene::formats::depth_map::read_depth;
use scenesplat_scene::frame_files::{DEPTHS, FoundFiles, FrameFiles, PICTURES, frame_names};
use scenesplat_scene::picture::{Channels, Samples, is_scaled, nearest, read_picture};
use scenesplat_scene::{Camera, CameraSet};
use std::path::{Path, PathBuf};

/// Where the files of a capture are, each found by its camera's name: [the rule](scenesplat_scene::frame_files).
#[derive(Debug, Clone, Copy)]
pub struct CaptureFolder<'a> {
    /// Pictures: PNG or JPEG. Where one is transparent, nothing is there.
    pub images: &'a Path,
    /// Depths along the camera's axis: gray PNG of 16 bits, or `.npy`, `[H, W]`; of another size than the picture
    /// they are taken by nearest pixel.
    pub depth: Option<&'a Path>,
    /// Masks: PNG or JPEG, black does not count; of another size as depths.
    pub masks: Option<&'a Path>,
    /// Steps per unit of the scene in 16-bit depths: 1000 for millimeters.
    pub depth_scale: f64,
}

/// What was read.
#[derive(Debug, Clone, Default)]
pub struct Capture {
    /// Frames in the order of the cameras; no two have one name.
    pub frames: Vec<TrainingFrame>,
    /// Number of each frame's camera.
    pub cameras: Vec<usize>,
    /// What was looked for and how much of it is there: pictures of all cameras, depths and masks of the pictures.
    pub found: Vec<(&'static str, FoundFiles)>,
    /// What to know about it.
    pub notes: Vec<String>,
}

/// Files of one frame.
struct FrameSource<'a> {
    camera: &'a Camera,
    name: String,
    picture: PathBuf,
    depth: Option<PathBuf>,
    mask: Option<PathBuf>,
}

fn bad(path: &Path, problem: String, help: &'static str) -> OptimiseError {
    OptimiseError::Frame { frame: path.display().to_string(), problem, help }
}

impl CaptureFolder<'_> {
    /// Reads all frames whose picture is there.
    ///
    /// A picture of another size than its camera says is taken if it has the same shape: the camera is
    /// scaled to it.
    ///
    /// # Errors
    /// If no camera has a picture, or no picture a depth or a mask where their folder is given; if it is not clear
    /// whose a file is; if a lens is distorted, or a file is damaged or of a wrong size.
    pub fn read(&self, set: &CameraSet) -> Result<Capture, OptimiseError> {
        let all: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
        let mut out = Capture { notes: set.notes.clone(), ..Capture::default() };
        let pictures = found("picture", self.images, PICTURES, &all, &mut out)?;
        out.cameras = (0..all.len()).filter(|&i| pictures[i].is_some()).collect();
        let names: Vec<&str> = out.cameras.iter().map(|&i| all[i]).collect();
        let mut beside = |what, folder: Option<&Path>, endings| match folder {
            Some(folder) => found(what, folder, endings, &names, &mut out),
            None => Ok(vec![None; names.len()]),
        };
        let depths = beside("depth", self.depth, DEPTHS)?;
        let masks = beside("mask", self.masks, PICTURES)?;
        let unique = frame_names(out.cameras.iter().map(|&i| (i, all[i])));
        let numbered = out.cameras.iter().zip(unique).zip(depths.into_iter().zip(masks));
        let sources: Vec<FrameSource<'_>> = numbered
            .filter_map(|((&i, name), (depth, mask))| {
                let picture = pictures[i].clone()?;
                Some(FrameSource { camera: &set.cameras[i], name, picture, depth, mask })
            })
            .collect();
        let frames: Result<_, _> = sources.par_iter().map(|source| self.frame(source)).collect();
        out.frames = frames?;
        let empty = |frame: &&TrainingFrame| {
            frame.alpha.as_ref().is_some_and(|alpha| alpha.iter().all(|a| *a == 0))
        };
        let nothing = out.frames.iter().filter(empty).count();
        if nothing > 0 {
            let all = out.frames.len();
            out.notes.push(format!("{nothing} of {all} pictures are transparent everywhere"));
        }
        Ok(out)
    }

    fn frame(&self, source: &FrameSource<'_>) -> Result<TrainingFrame, OptimiseError> {
        let path = &source.picture;
        let picture = read_picture(path)?;
        let sixteen = matches!(picture.samples(), Samples::Sixteen(_));
        if sixteen && matches!(picture.channels(), Channels::Gray | Channels::GrayAlpha) {
            let problem = "is a gray picture of 16 bits, which is how depth is stored".to_owned();
            return Err(bad(path, problem, "give the folder of color pictures as --images"));
        }
        let size = [picture.width(), picture.height()];
        let view = View::from_camera(&scaled(source.camera, size, path)?)?;
        let depth = source.depth.as_ref();
        Ok(TrainingFrame {
            name: source.name.clone(),
            view,
            rgb: Colors::Bytes(picture.over_black().pixels().as_flattened().to_vec()),
            alpha: picture.alpha8(),
            depth: depth.map(|path| read_depth(path, size, self.depth_scale)).transpose()?,
            mask: source.mask.as_ref().map(|path| mask_of(path, size)).transpose()?,
        })
    }
}

/// The files of cameras in a folder, and the count.
fn found(
    what: &'static str,
    folder: &Path,
    endings: &[&str],
    cameras: &[&str],
    out: &mut Capture,
) -> Result<Vec<Option<PathBuf>>, OptimiseError> {
    let files = FrameFiles::open(folder, endings)?;
    let found = files.find(cameras)?;
    if found.num_found() == 0 {
        let problem = format!(
            "{} has no {what} of any of the {} cameras, the first of which is {:?}",
            folder.display(),
            cameras.len(),
            cameras.first().unwrap_or(&"")
        );
        let help =
            "files have to be called as the cameras; endings may differ, and folders be left out";
        return Err(OptimiseError::NoFrames { problem, help });
    }
    let paths = found.files.iter().map(|file| file.map(|file| files.path(file))).collect();
    out.found.push((what, found));
    Ok(paths)
}

/// The camera of a picture of that size.
fn scaled(camera: &Camera, size: [u32; 2], path: &Path) -> Result<Camera, OptimiseError> {
    if !is_scaled([camera.width, camera.height], size) {
        let problem = format!(
            "is {} × {}, its camera {} × {}: another shape",
            size[0], size[1], camera.width, camera.height
        );
        return Err(bad(path, problem, "give the pictures that the cameras were computed with"));
    }
    Ok(camera.resized(size))
}

/// 1 where a mask is not black.
fn mask_of(path: &Path, size: [u32; 2]) -> Result<Vec<u8>, OptimiseError> {
    let picture = read_picture(path)?;
    let from = [picture.width(), picture.height()];
    let on = picture.to_rgb8().pixels().iter().map(|p| u8::from(*p != [0; 3])).collect();
    nearest(on, from, size).ok_or_else(|| {
        let problem =
            format!("is {} × {}, its picture {} × {}", from[0], from[1], size[0], size[1]);
        let help = "masks may be smaller or larger than their pictures, but have to have their shape, to within 1 %";
        bad(path, problem, help)
    })
}
