//! The binary files: little endian, each begins with a count of 64 bits.

use super::models::{self, Lens};
use super::{CameraKind, CameraSet, MEND, Picture, SparsePoints, join};
use crate::SceneError;
use std::path::Path;

/// Bytes of an image without its name and points, and of a point without its track.
const IMAGE_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
/// Bytes of a camera of the model with the fewest parameters.
const CAMERA_BYTES: usize = 4 + 4 + 8 + 8 + 2 * 8;

/// Reads `cameras.bin`, `images.bin` and, if given, `points3D.bin`. `folder` is for messages.
///
/// Cameras are in the order of the images.
///
/// # Errors
/// If a count or a length is beyond the end of its file, if bytes are left over, or if a camera is
/// not usable.
pub fn read_colmap_binary(
    cameras: &[u8],
    images: &[u8],
    points: Option<&[u8]>,
    folder: &Path,
) -> Result<CameraSet, SceneError> {
    let lenses = read_cameras(Bytes::new(cameras, folder, "cameras.bin"))?;
    let pictures = read_images(Bytes::new(images, folder, "images.bin"))?;
    let points = points.map(|points| read_points(Bytes::new(points, folder, "points3D.bin")));
    join(lenses, pictures, points.transpose()?, CameraKind::ColmapBinary, folder, "bin")
}

/// A file and how far it was read.
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
    folder: &'a Path,
    name: &'static str,
}

impl<'a> Bytes<'a> {
    fn new(all: &'a [u8], folder: &'a Path, name: &'static str) -> Self {
        Self { all, at: 0, folder, name }
    }

    fn bad(&self, problem: impl std::fmt::Display) -> SceneError {
        SceneError::format(&self.folder.join(self.name), problem.to_string(), MEND)
    }

    fn left(&self) -> usize {
        self.all.len() - self.at
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], SceneError> {
        let Some(bytes) = self.all[self.at..].first_chunk::<N>() else {
            let (at, left) = (self.at, self.left());
            return Err(self.bad(format!("ends at byte {at}: {N} bytes are due, {left} are left")));
        };
        self.at += N;
        Ok(*bytes)
    }

    fn u64(&mut self) -> Result<u64, SceneError> {
        Ok(u64::from_le_bytes(self.take()?))
    }

    fn i32(&mut self) -> Result<i32, SceneError> {
        Ok(i32::from_le_bytes(self.take()?))
    }

    fn u32(&mut self) -> Result<u32, SceneError> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], SceneError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.take()?);
        }
        Ok(values)
    }

    /// A count of things that take at least `each` bytes.
    fn count(&mut self, of: &str, each: usize) -> Result<usize, SceneError> {
        let (at, count) = (self.at, self.u64()?);
        let fits = usize::try_from(count).ok().filter(|&n| n <= self.left() / each);
        fits.ok_or_else(|| {
            let left = self.left();
            self.bad(format!("counts {count} {of} at byte {at}, but only {left} bytes follow"))
        })
    }

    /// Goes over `count` things of `each` bytes.
    fn skip(&mut self, of: &str, each: usize) -> Result<(), SceneError> {
        // Fits: the count was compared with the bytes left.
        self.at += self.count(of, each)? * each;
        Ok(())
    }

    fn end(&self) -> Result<(), SceneError> {
        match self.left() {
            0 => Ok(()),
            left => Err(self.bad(format!("has {left} bytes more than it counts"))),
        }
    }
}

fn read_cameras(mut file: Bytes<'_>) -> Result<Vec<Lens>, SceneError> {
    let count = file.count("cameras", CAMERA_BYTES)?;
    let mut lenses = Vec::with_capacity(count);
    for _ in 0..count {
        let id = file.u32()?;
        let model = file.i32()?;
        let Some(model) = models::by_id(model) else {
            return Err(file.bad(format!("has camera {id} of the unknown lens model {model}")));
        };
        let (width, height) = (file.u64()?, file.u64()?);
        let mut params = Vec::with_capacity(model.params);
        for _ in 0..model.params {
            params.push(f64::from_le_bytes(file.take()?));
        }
        lenses.push(Lens { id, model, width, height, params });
    }
    file.end()?;
    Ok(lenses)
}

fn read_images(mut file: Bytes<'_>) -> Result<Vec<Picture>, SceneError> {
    let count = file.count("images", IMAGE_BYTES)?;
    let mut pictures = Vec::with_capacity(count);
    for _ in 0..count {
        let id = file.u32()?;
        let (quat, translation) = (file.f64s()?, file.f64s()?);
        let lens = file.u32()?;
        let rest = &file.all[file.at..];
        let Some(length) = rest.iter().position(|&byte| byte == 0) else {
            return Err(file.bad(format!("ends inside the name of image {id}")));
        };
        let name = String::from_utf8_lossy(&rest[..length]).into_owned();
        file.at += length + 1;
        file.skip("points of an image", 2 * 8 + 8)?;
        pictures.push(Picture { name, lens, quat, translation });
    }
    file.end()?;
    Ok(pictures)
}

fn read_points(mut file: Bytes<'_>) -> Result<SparsePoints, SceneError> {
    let count = file.count("points", POINT_BYTES)?;
    let mut points =
        SparsePoints { coord: Vec::with_capacity(count), color: Vec::with_capacity(count) };
    for _ in 0..count {
        file.u64()?;
        points.coord.push(file.f64s()?);
        points.color.push(file.take()?);
        file.take::<8>()?;
        file.skip("images of a point", 4 + 4)?;
    }
    file.end()?;
    Ok(points)
}
