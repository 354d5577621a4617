//! ScanNet's `.sens`: a header, and frames one behind the other.

use super::depth::DepthMap;
use super::files::MAX_PICTURE;
use super::frame::{FrameFiles, Head, Listed};
use super::lens::{IDENTITY, Lens, Pose, pixels};
use crate::DataError;
use crate::files::bad_file;
use flate2::read::ZlibDecoder;
use scenesplat_scene::SceneError;
use scenesplat_scene::input_file::{open_regular_file, reserve};
use scenesplat_scene::picture::{Channels, MAX_PIXELS, Picture, Samples};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// The version that ScanNet has.
const VERSION: u32 = 4;
/// Bytes of a frame before its pictures: a matrix, two times, two sizes.
const FRAME_HEAD: u64 = 16 * 4 + 4 * 8;
/// Bytes that one byte of a zlib stream unpacks to at most, rounded up.
const MAX_INFLATION: u64 = 1040;
const DAMAGED: &str = "the file is damaged or cut short: fetch it again";

/// Where a frame is.
struct Entry {
    pose: Pose,
    /// Of its first byte of color.
    at: u64,
    color_bytes: u64,
    depth_bytes: u64,
}

struct SensFile {
    reader: Bytes,
    header: Header,
    entries: Vec<Entry>,
}

struct Header {
    color_lens: Lens,
    depth_lens: Lens,
    is_raw_color: bool,
    is_zlib_depth: bool,
    color_size: [u32; 2],
    depth_size: [u32; 2],
    /// Steps of a depth per meter.
    steps: f64,
    frames: u64,
    notes: Vec<String>,
}

pub(super) fn open(path: &Path) -> Result<Listed, DataError> {
    let mut reader = Bytes::open(path)?;
    let mut header = Header::read(&mut reader)?;
    let left = reader.len - reader.at;
    if header.frames > left / FRAME_HEAD {
        let problem =
            format!("says it has {} frames, {left} bytes cannot hold them", header.frames);
        return Err(reader.bad(problem));
    }
    let mut entries = Vec::new();
    reserve(&mut entries, header.frames as usize, path)?;
    for frame in 0..header.frames {
        let what = format!("frame {frame} of {}", header.frames);
        let pose = reader.pose(&what)?;
        let [_, _, color_bytes, depth_bytes] = reader.u64s(&what)?;
        let at = reader.at;
        reader.skip(color_bytes, &what)?;
        reader.skip(depth_bytes, &what)?;
        entries.push(Entry { pose, at, color_bytes, depth_bytes });
    }
    let notes = std::mem::take(&mut header.notes);
    Ok(Listed { files: Box::new(SensFile { reader, header, entries }), notes })
}

impl Header {
    fn read(reader: &mut Bytes) -> Result<Self, DataError> {
        let what = "the header";
        let [version] = reader.u32s(what)?;
        if version != VERSION {
            let problem = format!("begins with {version}, a .sens file of ScanNet with {VERSION}");
            return Err(bad_file(&reader.path, problem, "is it the right file?"));
        }
        let [name] = reader.u64s(what)?;
        reader.skip(name, "the name of the sensor")?;
        let [color, color_place, depth, depth_place] = reader.poses(what)?;
        let [color_kind, depth_kind] = reader.u32s(what)?.map(u32::cast_signed);
        let sizes @ [color_w, color_h, depth_w, depth_h] = reader.u32s(what)?;
        let [steps] = reader.u32s(what)?.map(|bits| f64::from(f32::from_bits(bits)));
        let [frames] = reader.u64s(what)?;
        let (color_size, depth_size) = ([color_w, color_h], [depth_w, depth_h]);
        if [color_size, depth_size].iter().any(|[w, h]| pixels(*w, *h) > MAX_PIXELS) {
            return Err(reader.bad(format!("says its pictures have the sizes {sizes:?}")));
        }
        if !(steps.is_finite() && steps > 0.0) {
            return Err(reader.bad(format!("has {steps} steps of depth per meter")));
        }
        if !(0..=2).contains(&color_kind) || !(0..=1).contains(&depth_kind) {
            let problem =
                format!("has colors of kind {color_kind} and depths of kind {depth_kind}");
            let help = "read are colors of kind 0, 1, 2 (raw, PNG, JPEG) and depths of kind 0, 1 (raw, zlib): export \
                        the scan with ScanNet's tool and give that folder";
            return Err(bad_file(&reader.path, problem, help));
        }
        let lens = |pose: &Pose, size| {
            Lens::of_centre([pose[0][0], pose[1][1], pose[0][2], pose[1][2]], Some(size))
        };
        Ok(Self {
            color_lens: lens(&color, color_size),
            depth_lens: lens(&depth, depth_size),
            is_raw_color: color_kind == 0,
            is_zlib_depth: depth_kind == 1,
            color_size,
            depth_size,
            steps,
            frames,
            notes: notes_of(&color_place, &depth_place),
        })
    }
}

impl SensFile {
    fn bad(&self, index: usize, problem: &str) -> DataError {
        self.reader.bad(format!("frame {index} {problem}"))
    }

    /// A depth of the header's size, two bytes a pixel; never more is unpacked than that.
    fn unpacked(&self, index: usize, packed: Vec<u8>) -> Result<Vec<u8>, DataError> {
        let [width, height] = self.header.depth_size;
        let expected = 2 * pixels(width, height);
        if !self.header.is_zlib_depth {
            return Ok(packed);
        }
        if expected / MAX_INFLATION > packed.len() as u64 {
            let problem = format!("has {} bytes of depth, too few for its size", packed.len());
            return Err(self.bad(index, &problem));
        }
        let mut out = Vec::new();
        reserve(&mut out, expected as usize + 1, &self.reader.path)?;
        let mut stream = ZlibDecoder::new(packed.as_slice()).take(expected + 1);
        stream
            .read_to_end(&mut out)
            .map_err(|e| self.bad(index, &format!("has a depth that cannot be unpacked: {e}")))?;
        Ok(out)
    }
}

impl FrameFiles for SensFile {
    fn len(&self) -> usize {
        self.entries.len()
    }

    fn head(&mut self, index: usize) -> Result<Head, DataError> {
        Ok(Head {
            name: format!("{index:06}"),
            source: self.reader.path.clone(),
            pose: Ok(self.entries[index].pose),
            lens: self.header.color_lens,
            depth_lens: Some(self.header.depth_lens),
        })
    }

    fn picture(&mut self, index: usize) -> Result<Option<Vec<u8>>, DataError> {
        let Entry { at, color_bytes, .. } = self.entries[index];
        if color_bytes == 0 {
            return Ok(None);
        }
        let bytes = self.reader.block(at, color_bytes, index)?;
        if !self.header.is_raw_color {
            return Ok(Some(bytes));
        }
        let [width, height] = self.header.color_size;
        let count = bytes.len();
        let picture = Picture::new(width, height, Channels::Rgb, Samples::Eight(bytes));
        let bad = |problem: String| self.bad(index, &problem);
        let picture = picture.ok_or_else(|| bad(format!("has {count} bytes of raw color")))?;
        picture.encode_png().map(Some).map_err(|e| bad(format!("cannot be written as PNG: {e}")))
    }

    fn depth(&mut self, index: usize) -> Result<Option<DepthMap>, DataError> {
        let Entry { at, color_bytes, depth_bytes, .. } = self.entries[index];
        if depth_bytes == 0 {
            return Ok(None);
        }
        let packed = self.reader.block(at + color_bytes, depth_bytes, index)?;
        let bytes = self.unpacked(index, packed)?;
        let size @ [width, height] = self.header.depth_size;
        let (pairs, rest) = bytes.as_chunks::<2>();
        if pairs.len() as u64 != pixels(width, height) || !rest.is_empty() || pairs.is_empty() {
            let problem = format!("has {} bytes of depth or more, {width} × {height}", bytes.len());
            return Err(self.bad(index, &problem));
        }
        let values = pairs.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
        Ok(Some(DepthMap::of_steps(size, values, self.header.steps)))
    }
}

/// For `map_err`.
fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> SceneError + use<> {
    let path = path.to_owned();
    |source| SceneError::Io { path, action: "cannot read the file", source }
}

/// The file, read from front to back or from a place in it; nothing is reserved before its size allows it.
struct Bytes {
    file: BufReader<File>,
    path: PathBuf,
    at: u64,
    len: u64,
}

impl Bytes {
    fn open(path: &Path) -> Result<Self, DataError> {
        let file = open_regular_file(path)?;
        let about = file.metadata().map_err(unreadable(path))?;
        Ok(Self { file: BufReader::new(file), path: path.to_owned(), at: 0, len: about.len() })
    }

    fn bad(&self, problem: String) -> DataError {
        bad_file(&self.path, problem, DAMAGED)
    }

    /// That so many bytes are left.
    fn need(&self, bytes: u64, what: &str) -> Result<(), DataError> {
        if bytes <= self.len - self.at {
            return Ok(());
        }
        let problem = format!("ends after {} bytes, within {what}", self.len);
        Err(self.bad(format!("{problem}, which has {bytes} from byte {} on", self.at)))
    }

    fn fill(&mut self, out: &mut [u8], what: &str) -> Result<(), DataError> {
        self.need(out.len() as u64, what)?;
        let failed = unreadable(&self.path);
        self.file.read_exact(out).map_err(failed)?;
        self.at += out.len() as u64;
        Ok(())
    }

    fn skip(&mut self, bytes: u64, what: &str) -> Result<(), DataError> {
        self.need(bytes, what)?;
        let step = i64::try_from(bytes).unwrap_or(i64::MAX);
        let failed = unreadable(&self.path);
        self.file.seek_relative(step).map_err(failed)?;
        self.at += bytes;
        Ok(())
    }

    fn u32s<const N: usize>(&mut self, what: &str) -> Result<[u32; N], DataError> {
        let mut out = [0; N];
        for value in &mut out {
            let mut bytes = [0; 4];
            self.fill(&mut bytes, what)?;
            *value = u32::from_le_bytes(bytes);
        }
        Ok(out)
    }

    fn u64s<const N: usize>(&mut self, what: &str) -> Result<[u64; N], DataError> {
        let mut out = [0; N];
        for value in &mut out {
            let mut bytes = [0; 8];
            self.fill(&mut bytes, what)?;
            *value = u64::from_le_bytes(bytes);
        }
        Ok(out)
    }

    fn pose(&mut self, what: &str) -> Result<Pose, DataError> {
        let values = self.u32s::<16>(what)?.map(|bits| f64::from(f32::from_bits(bits)));
        Ok([0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| values[4 * i + j])))
    }

    fn poses<const N: usize>(&mut self, what: &str) -> Result<[Pose; N], DataError> {
        let mut out = [[[0.0; 4]; 4]; N];
        for pose in &mut out {
            *pose = self.pose(what)?;
        }
        Ok(out)
    }

    /// A picture of a frame; where it is was checked when the frames were listed.
    fn block(&mut self, at: u64, bytes: u64, index: usize) -> Result<Vec<u8>, DataError> {
        if bytes > MAX_PICTURE {
            let problem = format!("frame {index} has a picture of {bytes} bytes");
            return Err(self.bad(problem));
        }
        self.file.seek(SeekFrom::Start(at)).map_err(unreadable(&self.path))?;
        self.at = at;
        let mut out = Vec::new();
        reserve(&mut out, bytes as usize, &self.path)?;
        out.resize(bytes as usize, 0);
        self.fill(&mut out, &format!("frame {index}"))?;
        Ok(out)
    }
}

/// What is said where color and depth cameras are at different places.
pub(super) fn not_aligned(what: &str) -> String {
    format!(
        "{what} is not the identity: depth and color cameras are at different places, which is not corrected; \
         expect depths to be off by some pixels"
    )
}

/// What is said of the two extrinsic matrices of a `.sens` file.
fn notes_of(color: &Pose, depth: &Pose) -> Vec<String> {
    let named =
        [("the extrinsic matrix of color", color), ("the extrinsic matrix of depth", depth)];
    let off = named.into_iter().filter(|(_, pose)| **pose != IDENTITY);
    off.map(|(name, _)| not_aligned(name)).collect()
}
