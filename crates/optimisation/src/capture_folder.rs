//! Frames from files: cameras, pictures, depths and masks of the same names.

use crate::error::OptimiseError;
use crate::frame::{Colors, TrainingFrame};
use rayon::prelude::*;
use scenesplat_rasterizer::View;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::picture::{Channels, Picture, Samples, read_picture};
use scenesplat_scene::{Camera, CameraSet};
use std::path::{Path, PathBuf};

/// Where the files of a capture are.
#[derive(Debug, Clone, Copy)]
pub struct CaptureFolder<'a> {
    /// Pictures, NAME.png or NAME.jpg.
    pub images: &'a Path,
    /// Depths along the camera's axis: NAME.png of 16 bits, or NAME.npy, `[H, W]`.
    pub depth: Option<&'a Path>,
    /// Masks, NAME.png: black does not count.
    pub masks: Option<&'a Path>,
    /// Steps per unit of the scene in 16-bit depths: 1000 for millimeters.
    pub depth_scale: f64,
}

/// What was read.
#[derive(Debug, Clone, Default)]
pub struct Capture {
    /// Frames in the order of the cameras.
    pub frames: Vec<TrainingFrame>,
    /// Cameras without a picture.
    pub without_picture: Vec<String>,
    /// What to know about it.
    pub notes: Vec<String>,
}

const PICTURES: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];
/// How far the shape of a picture may be from its camera's, pixels of the picture.
const SHAPE: f64 = 1.0;

fn bad(path: &Path, problem: String, help: &'static str) -> OptimiseError {
    OptimiseError::Frame { frame: path.display().to_string(), problem, help }
}

/// A name without folder and without the ending of a picture.
pub fn stem(name: &str) -> &str {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    match file.rsplit_once('.') {
        Some((stem, end)) if PICTURES.iter().any(|e| e.eq_ignore_ascii_case(end)) => stem,
        _ => file,
    }
}

/// The picture of a camera: its name as it is, or by its stem.
fn find(folder: &Path, name: &str, endings: &[&str]) -> Option<PathBuf> {
    use std::path::Component::{CurDir, Normal};
    let below = Path::new(name).components().all(|c| matches!(c, CurDir | Normal(_)));
    let whole =
        Path::new(name).extension().and_then(|e| e.to_str()).is_some_and(|e| endings.contains(&e));
    let as_is = (below && whole && !name.is_empty()).then(|| folder.join(name));
    let by_stem = endings.iter().map(|e| folder.join(format!("{}.{e}", stem(name))));
    as_is.into_iter().chain(by_stem).find(|path| path.is_file())
}

impl CaptureFolder<'_> {
    /// Reads all frames whose picture is there.
    ///
    /// A picture of another size than its camera says is taken if it has the same shape: the camera is
    /// scaled to it.
    ///
    /// # Errors
    /// If no camera has a picture, a lens is distorted, or a file is damaged or of a wrong size.
    pub fn read(&self, set: &CameraSet) -> Result<Capture, OptimiseError> {
        let found: Vec<_> =
            set.cameras.iter().map(|c| (c, find(self.images, &c.name, &PICTURES))).collect();
        let mut out = Capture { notes: set.notes.clone(), ..Capture::default() };
        let missing = found.iter().filter(|(_, path)| path.is_none());
        out.without_picture = missing.map(|(camera, _)| camera.name.clone()).collect();
        if out.without_picture.len() == found.len() {
            let name = out.without_picture.first().cloned().unwrap_or_default();
            let problem = format!(
                "{} has no picture of any of the {} cameras, the first of which is {name:?}",
                self.images.display(),
                found.len()
            );
            let help = "pictures have to be called as the cameras, with .png or .jpg";
            return Err(OptimiseError::NoFrames { problem, help });
        }
        let read: Result<Vec<_>, _> = found
            .par_iter()
            .filter_map(|(camera, path)| path.as_ref().map(|path| self.frame(camera, path)))
            .collect();
        out.frames = read?;
        let count = out.without_picture.len();
        if let Some(name) = out.without_picture.first() {
            let text = format!("{count} of {} cameras have no picture ({name}, …)", found.len());
            out.notes.push(text);
        }
        if self.depth.is_some() {
            let without = out.frames.iter().filter(|f| f.depth.is_none()).count();
            if without > 0 {
                out.notes.push(format!("{without} of {} frames have no depth", out.frames.len()));
            }
        }
        Ok(out)
    }

    fn frame(&self, camera: &Camera, path: &Path) -> Result<TrainingFrame, OptimiseError> {
        let picture = read_picture(path)?;
        let sixteen = matches!(picture.samples(), Samples::Sixteen(_));
        if sixteen && matches!(picture.channels(), Channels::Gray | Channels::GrayAlpha) {
            let problem = "is a gray picture of 16 bits, which is how depth is stored".to_owned();
            return Err(bad(path, problem, "give the folder of color pictures as --images"));
        }
        let size = [picture.width(), picture.height()];
        let view = View::from_camera(&scaled(camera, size, path)?)?;
        let alpha = picture.is_transparent().then(|| alpha_mask(&picture)).flatten();
        let mask = match self.masks.and_then(|folder| find(folder, &camera.name, &PICTURES)) {
            Some(path) => Some(mask_of(&path, size)?),
            None => alpha,
        };
        let rgb = Colors::Bytes(picture.to_rgb8().pixels().as_flattened().to_vec());
        let depth = self.depth_of(camera, size)?;
        Ok(TrainingFrame { name: stem(&camera.name).to_owned(), view, rgb, depth, mask })
    }

    fn depth_of(&self, camera: &Camera, size: [u32; 2]) -> Result<Option<Vec<f32>>, OptimiseError> {
        let Some(folder) = self.depth else { return Ok(None) };
        let name = stem(&camera.name);
        let path = folder.join(format!("{name}.npy"));
        if path.is_file() {
            let file = NpyFile::open(&path)?;
            let expected = [size[1] as usize, size[0] as usize];
            if file.shape() != expected {
                let problem = format!("is {:?}, its picture {expected:?}", file.shape());
                return Err(bad(&path, problem, "depth has to have the size of the picture"));
            }
            return Ok(Some(file.read_f32()?));
        }
        let path = folder.join(format!("{name}.png"));
        if !path.is_file() {
            return Ok(None);
        }
        let picture = read_sized(&path, size, "depth has to have the size of the picture")?;
        match (picture.channels(), picture.into_samples()) {
            (Channels::Gray, Samples::Sixteen(values)) => {
                let unit = 1.0 / self.depth_scale;
                Ok(Some(values.iter().map(|v| (f64::from(*v) * unit) as f32).collect()))
            }
            (channels, _) => {
                let problem = format!("is no 16-bit gray picture ({channels:?})");
                Err(bad(&path, problem, "write depth as 16-bit gray PNG, or as .npy"))
            }
        }
    }
}

/// Depth or a mask, of the size of its picture.
fn read_sized(path: &Path, size: [u32; 2], help: &'static str) -> Result<Picture, OptimiseError> {
    let picture = read_picture(path)?;
    let got = [picture.width(), picture.height()];
    if got != size {
        let problem = format!("is {} × {}, its picture {} × {}", got[0], got[1], size[0], size[1]);
        return Err(bad(path, problem, help));
    }
    Ok(picture)
}

/// The camera of a picture of that size.
fn scaled(
    camera: &Camera,
    [width, height]: [u32; 2],
    path: &Path,
) -> Result<Camera, OptimiseError> {
    let x = f64::from(width) / f64::from(camera.width);
    let y = f64::from(height) / f64::from(camera.height);
    if (x * f64::from(camera.height) - f64::from(height)).abs() > SHAPE
        && (y * f64::from(camera.width) - f64::from(width)).abs() > SHAPE
    {
        let problem = format!(
            "is {width} × {height}, its camera {} × {}: another shape",
            camera.width, camera.height
        );
        return Err(bad(path, problem, "give the pictures that the cameras were computed with"));
    }
    Ok(camera.resized([width, height]))
}

/// What is less than half opaque does not count.
fn alpha_mask(picture: &Picture) -> Option<Vec<u8>> {
    let n = picture.channels().count();
    Some(match picture.samples() {
        Samples::Eight(v) => v.chunks_exact(n).map(|p| u8::from(p[n - 1] >= 128)).collect(),
        Samples::Sixteen(v) => v.chunks_exact(n).map(|p| u8::from(p[n - 1] >= 1 << 15)).collect(),
    })
}

fn mask_of(path: &Path, size: [u32; 2]) -> Result<Vec<u8>, OptimiseError> {
    let picture = read_sized(path, size, "masks have to have the size of the picture")?;
    Ok(picture.to_rgb8().pixels().iter().map(|p| u8::from(*p != [0; 3])).collect())
}
