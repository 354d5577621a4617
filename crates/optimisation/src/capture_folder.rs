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

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::picture::Picture;
    use scenesplat_scene::{CameraKind, Distortion};

    fn camera(name: &str, x: f64) -> Camera {
        Camera {
            name: name.to_owned(),
            width: 4,
            height: 3,
            fx: 5.0,
            fy: 6.0,
            cx: 1.5,
            cy: 2.0,
            distortion: Distortion::None,
            rotation: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [x, 2.0, 3.0],
        }
    }

    fn set() -> CameraSet {
        let cameras = [("left/a.png", 1.0), ("none.png", 2.0), ("b.png", 3.0), ("c.png", 4.0)];
        CameraSet {
            cameras: cameras.map(|(name, x)| camera(name, x)).to_vec(),
            points: None,
            kind: CameraKind::ColmapText,
            notes: vec!["noted".to_owned()],
        }
    }

    fn put(folder: &Path, name: &str, size: [u32; 2], channels: Channels, samples: Samples) {
        std::fs::create_dir_all(folder).unwrap();
        let picture = Picture::new(size[0], size[1], channels, samples).unwrap();
        std::fs::write(folder.join(name), picture.encode_png().unwrap()).unwrap();
    }

    /// Pictures of three cameras, the second transparent and twice as large, the third transparent everywhere;
    /// depths of two, a mask of one.
    fn written(root: &Path) -> [PathBuf; 3] {
        let [images, depth, masks] = ["images", "depth", "masks"].map(|name| root.join(name));
        let bytes = |n: u8| Samples::Eight((0..n).collect());
        put(&images, "a.png", [4, 3], Channels::Rgb, bytes(36));
        let rgba = (0..48).flat_map(|i: u8| [200, 100, i, if i < 24 { 255 } else { 51 }]).collect();
        put(&images, "b.png", [8, 6], Channels::Rgba, Samples::Eight(rgba));
        put(&images, "c.png", [4, 3], Channels::Rgba, Samples::Eight([9, 9, 9, 0].repeat(12)));
        put(
            &depth,
            "a.png",
            [4, 3],
            Channels::Gray,
            Samples::Sixteen((0..12).map(|v| 500 * v).collect()),
        );
        let values: Vec<f32> = (0..12).map(|v| v as f32).collect();
        scenesplat_scene::formats::npy_writer::write_npy(&depth.join("b.npy"), &[3, 4], &values)
            .unwrap();
        // Not black is on, in whatever channel.
        let mask =
            (0..12).flat_map(|i: u8| [[0, 0, 0], [0, 0, 1], [255, 0, 0]][usize::from(i % 3)]);
        put(&masks, "b.png", [4, 3], Channels::Rgb, Samples::Eight(mask.collect()));
        [images, depth, masks]
    }

    #[test]
    fn files_of_a_camera_become_its_frame() {
        let root = tempfile::tempdir().unwrap();
        let [images, depth, masks] = written(root.path());
        let folder = CaptureFolder {
            images: &images,
            depth: Some(&depth),
            masks: Some(&masks),
            depth_scale: 250.0,
        };
        let capture = folder.read(&set()).unwrap();
        assert_eq!(capture.cameras, [0, 2, 3]);
        let names: Vec<&str> = capture.frames.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c"]);
        let found: Vec<_> =
            capture.found.iter().map(|(what, f)| (*what, f.files.len(), f.num_found())).collect();
        assert_eq!(found, [("picture", 4, 3), ("depth", 3, 2), ("mask", 3, 1)]);
        assert_eq!(capture.notes, ["noted", "1 of 3 pictures are transparent everywhere"]);
        let [a, b, c] = &capture.frames[..] else { panic!("{}", capture.frames.len()) };
        capture.frames.iter().for_each(|f| f.check().unwrap());
        assert_eq!((&a.rgb, &a.alpha, &a.mask), (&Colors::Bytes((0..36).collect()), &None, &None));
        let want: Vec<f32> = (0..12).map(|v| 2.0 * v as f32).collect();
        assert_eq!(a.depth.as_ref().unwrap(), &want);
        let rows = [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0]];
        assert_eq!(a.view.world_to_camera, rows);
        let lens = |v: &View| ([v.fx, v.fy, v.cx, v.cy], [v.width, v.height]);
        assert_eq!(lens(&a.view), ([5.0, 6.0, 1.5, 2.0], [4, 3]));
        // A picture of twice the size has the camera, depth and mask of that.
        assert_eq!(lens(&b.view), ([10.0, 12.0, 3.0, 4.0], [8, 6]));
        assert_eq!(b.view.world_to_camera[0][3], 3.0);
        assert_eq!(b.alpha.as_ref().unwrap()[23..25], [255, 51]);
        // On black: a fifth of 200 and 100.
        assert_eq!(
            (b.rgb.at(0), b.rgb.at(3 * 24), b.rgb.at(3 * 24 + 1)),
            (200.0 / 255.0, 40.0 / 255.0, 20.0 / 255.0)
        );
        let depths = b.depth.as_ref().unwrap();
        assert_eq!((depths[0], depths[7], depths[8 * 5 + 2]), (0.0, 3.0, 9.0));
        let of_b: Vec<u8> = (0..8).map(|x| b.mask.as_ref().unwrap()[8 * 2 + x]).collect();
        // Of the second row: pixels 4 to 7, of which 6 is black.
        assert_eq!(of_b, [1, 1, 1, 1, 0, 0, 1, 1]);
        assert!(
            c.depth.is_none()
                && c.mask.is_none()
                && c.alpha.as_ref().unwrap().iter().all(|a| *a == 0)
        );
        let plain = CaptureFolder { depth: None, masks: None, ..folder }.read(&set()).unwrap();
        assert_eq!((plain.found.len(), plain.frames.len()), (1, 3));
        assert!(plain.frames.iter().all(|f| f.depth.is_none() && f.mask.is_none()));
    }

    #[test]
    fn what_is_not_a_capture_is_refused_by_name() {
        let root = tempfile::tempdir().unwrap();
        let [images, depth, masks] = written(root.path());
        let folder =
            CaptureFolder { images: &images, depth: None, masks: None, depth_scale: 1000.0 };
        let refused =
            |folder: CaptureFolder<'_>, set: &CameraSet| folder.read(set).unwrap_err().to_string();
        let mut others = set();
        others.cameras.iter_mut().for_each(|c| c.name = format!("z{}", c.name.replace('/', "")));
        let error = refused(folder, &others);
        assert!(
            error.contains(
                "has no picture of any of the 4 cameras, the first of which is \"zlefta.png\""
            ),
            "{error}"
        );
        let empty = root.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        let error = refused(CaptureFolder { masks: Some(&empty), ..folder }, &set());
        assert!(
            error.contains(
                "has no mask of any of the 3 cameras, the first of which is \"left/a.png\""
            ),
            "{error}"
        );
        put(&masks, "b.png", [3, 4], Channels::Gray, Samples::Eight(vec![1; 12]));
        let error = refused(CaptureFolder { masks: Some(&masks), ..folder }, &set());
        assert!(
            error.contains("is 3 × 4, its picture 8 × 6") && error.contains("masks may be"),
            "{error}"
        );
        let mut long = set();
        long.cameras[0].width = 8;
        let error = refused(folder, &long);
        assert!(
            error.contains("a.png") && error.contains("is 4 × 3, its camera 8 × 3: another shape"),
            "{error}"
        );
        let error = refused(CaptureFolder { images: &depth, ..folder }, &set());
        assert!(
            error.contains("is a gray picture of 16 bits, which is how depth is stored"),
            "{error}"
        );
        // Gray of eight bits is a picture.
        put(&images, "a.png", [4, 3], Channels::Gray, Samples::Eight((0..12).collect()));
        let gray = folder.read(&set()).unwrap().frames.remove(0);
        assert_eq!((gray.rgb.at(3), gray.rgb.at(5)), (1.0 / 255.0, 1.0 / 255.0));
    }
}
