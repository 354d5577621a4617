//! One frame at a time, checked.

use super::depth::{DepthMap, FrameDepth};
use super::lens::{IDENTITY, Lens, Pose, is_finite, pixels};
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::Camera;
use scenesplat_scene::formats::cameras::picture_size;
use scenesplat_scene::picture::MAX_PIXELS;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Why a frame is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum SkipReason {
    /// Its picture is not there.
    NoPicture,
    /// Nothing says where its camera is.
    NoPose,
    /// The pose has a value that is NaN or infinite: tracking was lost.
    PoseNotFinite,
    /// The pose mirrors, scales or shears, or is farther away than numbers reach.
    PoseNotRigid,
    /// Nothing says what its lens is.
    NoIntrinsics,
    /// The benchmark itself marks it as bad.
    MarkedBad,
}

impl SkipReason {
    /// In words, for reports.
    pub fn text(self) -> &'static str {
        match self {
            Self::NoPicture => "no picture",
            Self::NoPose => "no pose",
            Self::PoseNotFinite => "pose not finite",
            Self::PoseNotRigid => "pose no rigid motion",
            Self::NoIntrinsics => "no intrinsics",
            Self::MarkedBad => "marked bad",
        }
    }
}

/// A posed picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedFrame {
    /// A pinhole in the world of the capture; its name is that of the picture's file, with its ending.
    pub camera: Camera,
    /// The file of the picture, PNG or JPEG, as it is.
    pub picture: Vec<u8>,
    /// If there is one.
    pub depth: Option<FrameDepth>,
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameRead {
    /// It can be used.
    Frame(Box<PosedFrame>),
    /// It cannot.
    Skipped {
        /// What it is called.
        name: String,
        /// Why.
        reason: SkipReason,
    },
}

/// What a layout knows of a frame before its pictures are read.
pub(super) struct Head {
    pub(super) name: String,
    /// The file of the picture, or what holds it, for messages.
    pub(super) source: PathBuf,
    pub(super) pose: Result<Pose, SkipReason>,
    pub(super) lens: Lens,
    /// Of the depth, where it has its own.
    pub(super) depth_lens: Option<Lens>,
}

/// A layout's frames.
pub(super) trait FrameFiles: Send {
    fn len(&self) -> usize;
    fn head(&mut self, index: usize) -> Result<Head, DataError>;
    /// The bytes of the picture's file; `None` if there is none.
    fn picture(&mut self, index: usize) -> Result<Option<Vec<u8>>, DataError>;
    /// The depth in millimeters; `None` if there is none.
    fn depth(&mut self, index: usize) -> Result<Option<DepthMap>, DataError>;
}

/// Frames of a layout, with what is to be known about all of them.
pub(super) struct Listed {
    pub(super) files: Box<dyn FrameFiles>,
    pub(super) notes: Vec<String>,
}

/// The frames of a scan in their order; each is read when it is asked for.
pub struct Frames {
    files: Box<dyn FrameFiles>,
    notes: Vec<String>,
    names: HashSet<String>,
    /// Of pictures whose lens does not say their size: that of the first.
    size: Option<[u32; 2]>,
}

impl std::fmt::Debug for Frames {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Frames({})", self.files.len())
    }
}

impl Frames {
    pub(super) fn new(path: &Path, Listed { files, notes }: Listed) -> Result<Self, DataError> {
        if files.len() == 0 {
            return Err(bad_file(path, "has no frames", "is it the right folder and --layout?"));
        }
        Ok(Self { files, notes, names: HashSet::new(), size: None })
    }

    /// How many there are, usable or not.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there are none; never, after [`open_frames`](super::open_frames).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What is to be known about all of them.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Reads a frame, each at most once.
    ///
    /// # Errors
    /// If one of its files is damaged or of a wrong size, or if its name was there before.
    ///
    /// # Panics
    /// If `index` is not below [`len`](Self::len).
    pub fn read(&mut self, index: usize) -> Result<FrameRead, DataError> {
        let Head { name, source, pose, lens, depth_lens } = self.files.head(index)?;
        let name = file_name(&name);
        let skipped = |name, reason| Ok(FrameRead::Skipped { name, reason });
        let pose = match pose {
            Ok(pose) if !is_finite(&pose) => return skipped(name, SkipReason::PoseNotFinite),
            Ok(pose) => pose,
            Err(reason) => return skipped(name, reason),
        };
        let Some(picture) = self.files.picture(index)? else {
            return skipped(name, SkipReason::NoPicture);
        };
        let (ending, size) = picture_kind(&picture, &source)?;
        let expected = lens.size.unwrap_or(*self.size.get_or_insert(size));
        if size != expected {
            let [[w, h], [want_w, want_h]] = [size, expected];
            let problem = format!("is {w} × {h}, its camera is for {want_w} × {want_h}");
            let help = "pictures of another size have other intrinsics: give those of one size";
            return Err(bad_file(&source, problem, help));
        }
        // What is wrong with the lens is wrong with all frames; what remains is the pose.
        lens.camera(name.clone(), size, &IDENTITY).check(&source)?;
        let mut camera = lens.camera(format!("{name}.{ending}"), size, &pose);
        if pose[3] != IDENTITY[3] || camera.check(&source).is_err() {
            return skipped(name, SkipReason::PoseNotRigid);
        }
        let depth = match self.files.depth(index)? {
            Some(map) => Some(map.fit(lens.upright(size), depth_lens, &source)?),
            None => None,
        };
        if !self.names.insert(name.clone()) {
            let problem = format!("two frames are called {name:?}");
            return Err(bad_file(&source, problem, "give every picture a name of its own"));
        }
        Ok(FrameRead::Frame(Box::new(PosedFrame { camera, picture, depth })))
    }
}

/// A name without what is special in file names or could be taken for an ending.
fn file_name(name: &str) -> String {
    let fit = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' };
    name.chars().map(fit).collect()
}

/// The ending and the size of a picture.
fn picture_kind(bytes: &[u8], path: &Path) -> Result<(&'static str, [u32; 2]), DataError> {
    let ending = match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("png"),
        [0xff, 0xd8, 0xff, ..] => Some("jpg"),
        _ => None,
    };
    let size = picture_size(bytes).filter(|(w, h)| (1..=MAX_PIXELS).contains(&pixels(*w, *h)));
    ending.zip(size.map(|(w, h)| [w, h])).ok_or_else(|| {
        let problem = format!("holds {} bytes that are no PNG or JPEG picture", bytes.len());
        bad_file(path, problem, "the file is damaged or cut short: fetch it again")
    })
}
