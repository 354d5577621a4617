//! A photo made to fit its camera.

use crate::CollectError;
use scenesplat_scene::Camera;
use scenesplat_scene::input_file::read_file;
use scenesplat_scene::picture::{RgbPicture, decode_picture, is_scaled, orientation};
use std::path::Path;

/// Largest file of a photo that is read: 1 GiB.
const MAX_BYTES: u64 = 1 << 30;

/// What was done to a photo or its camera, or was left undone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PhotoRemark {
    /// The photo was turned by its Exif mark: only so it fits its camera.
    Turned(u8),
    /// The photo has an Exif mark, and fits its camera as it is stored: it was left so.
    MarkIgnored(u8),
    /// The photo is larger or smaller than the camera says by one factor: the camera was scaled.
    CameraScaled,
}

/// Reads a photo and makes photo and camera of one size.
///
/// - A photo of the camera's size is used as it is stored, whatever its Exif mark says: cameras were computed on stored
///   pixels then.
/// - A photo that fits only when it is turned by its Exif mark is turned.
/// - A photo that is the camera's picture at another scale (both sides by one factor, to within a pixel) keeps its
///   pixels, and the camera is scaled.
///
/// Of 16 bits the nearest of 8 are kept. Where a photo is transparent nothing is there: it is put on black.
///
/// # Errors
/// If it cannot be read, or does not fit; names the file and both sizes.
pub fn fit_photo(
    path: &Path,
    camera: &Camera,
) -> Result<(RgbPicture, Camera, Vec<PhotoRemark>), CollectError> {
    let bytes = read_file(path, MAX_BYTES)?;
    let stored = decode_picture(&bytes, path)?.over_black();
    let mark = orientation(&bytes).filter(|mark| *mark != 1);
    let size = [stored.width(), stored.height()];
    let turned_size = if mark.is_some_and(|mark| mark >= 5) { [size[1], size[0]] } else { size };
    if let Some(camera_at) = scaled(camera, size) {
        let mut remarks: Vec<_> = mark.map(PhotoRemark::MarkIgnored).into_iter().collect();
        if size != [camera.width, camera.height] {
            remarks.push(PhotoRemark::CameraScaled);
        }
        return Ok((stored, camera_at, remarks));
    }
    if let (Some(mark), Some(camera_at)) = (mark, scaled(camera, turned_size)) {
        let mut remarks = vec![PhotoRemark::Turned(mark)];
        if turned_size != [camera.width, camera.height] {
            remarks.push(PhotoRemark::CameraScaled);
        }
        return Ok((turned(&stored, mark), camera_at, remarks));
    }
    let problem = format!(
        "is {}×{}, its camera {:?} is {}×{}",
        size[0], size[1], camera.name, camera.width, camera.height
    );
    let help = "photos have the size of their cameras, or are scaled as a whole; cut ones need cameras of their own";
    Err(CollectError::file(path, problem, help))
}

/// The camera with a picture of another size; `None` unless both sides were scaled by one factor.
fn scaled(camera: &Camera, [width, height]: [u32; 2]) -> Option<Camera> {
    if [width, height] == [camera.width, camera.height] {
        return Some(camera.clone());
    }
    if width == 0 || height == 0 {
        return None;
    }
    is_scaled([camera.width, camera.height], [width, height])
        .then(|| camera.resized([width, height]))
}

/// The picture turned and mirrored as an Exif mark says.
fn turned(picture: &RgbPicture, mark: u8) -> RgbPicture {
    let (width, height) = (picture.width(), picture.height());
    let (to_width, to_height) = if mark >= 5 { (height, width) } else { (width, height) };
    RgbPicture::from_fn(to_width, to_height, |x, y| {
        let (u, v) = match mark {
            2 => (width - 1 - x, y),
            3 => (width - 1 - x, height - 1 - y),
            4 => (x, height - 1 - y),
            5 => (y, x),
            6 => (y, height - 1 - x),
            7 => (width - 1 - y, height - 1 - x),
            8 => (width - 1 - y, x),
            _ => (x, y),
        };
        picture.get(u, v).unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use scenesplat_scene::Distortion;

    fn camera(width: u32, height: u32) -> Camera {
        Camera {
            name: "a".to_owned(),
            width,
            height,
            fx: 100.0,
            fy: 100.0,
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
            distortion: Distortion::None,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        }
    }

    /// A PNG with an Exif mark.
    fn write(path: &Path, picture: &RgbPicture, mark: Option<u8>) {
        let png = picture.encode_png().unwrap();
        let mut out = png[..33].to_vec();
        if let Some(mark) = mark {
            let mut block = b"eXIfMM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
            block.extend([mark, 0, 0]);
            out.extend((block.len() as u32 - 4).to_be_bytes());
            let crc = crc(&block);
            out.extend(block);
            out.extend(crc.to_be_bytes());
        }
        out.extend(&png[33..]);
        std::fs::write(path, out).unwrap();
    }

    fn crc(bytes: &[u8]) -> u32 {
        let mut c = u32::MAX;
        for b in bytes {
            c ^= u32::from(*b);
            for _ in 0..8 {
                c = if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 };
            }
        }
        !c
    }

    #[test]
    fn photos_that_fit_stay_and_others_are_turned_scaled_or_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let photo = RgbPicture::from_fn(6, 4, |x, y| [10 * x as u8, 10 * y as u8, 0]);
        write(&path, &photo, Some(3));
        let (found, _, remarks) = fit_photo(&path, &camera(6, 4)).unwrap();
        assert_eq!((found, remarks), (photo.clone(), vec![PhotoRemark::MarkIgnored(3)]));
        // Stored lying, the camera stands: a quarter turn clockwise brings its left column up.
        write(&path, &photo, Some(6));
        let (found, at, remarks) = fit_photo(&path, &camera(4, 6)).unwrap();
        assert_eq!(remarks, [PhotoRemark::Turned(6)]);
        assert_eq!((found.width(), found.height(), at.width), (4, 6, 4));
        // The lower left corner is at the upper left now, the upper left one at the upper right.
        assert_eq!(found.get(0, 0), Some([0, 30, 0]));
        assert_eq!(found.get(3, 0), Some([0, 0, 0]));
        assert_eq!(found.get(0, 5), Some([50, 30, 0]));
        write(&path, &photo, None);
        let (found, at, remarks) = fit_photo(&path, &camera(12, 8)).unwrap();
        assert_eq!((found, remarks), (photo, vec![PhotoRemark::CameraScaled]));
        assert_eq!((at.width, at.fx, at.cx, at.cy), (6, 50.0, 3.0, 2.0));
        let error = fit_photo(&path, &camera(4, 6)).unwrap_err().to_string();
        assert!(
            error.contains("a.png") && error.contains("6×4") && error.contains("4×6"),
            "{error}"
        );
    }

    #[test]
    fn marks_turn_as_exif_says() {
        // Where each mark brings the letter F: its stored first row, by hand from the Exif standard.
        let stored = RgbPicture::from_fn(3, 2, |x, y| [(3 * y + x) as u8; 3]);
        let rows = |mark: u8| {
            let t = turned(&stored, mark);
            t.pixels().iter().map(|p| p[0]).collect::<Vec<_>>()
        };
        assert_eq!(rows(1), [0, 1, 2, 3, 4, 5]);
        assert_eq!(rows(2), [2, 1, 0, 5, 4, 3]);
        assert_eq!(rows(3), [5, 4, 3, 2, 1, 0]);
        assert_eq!(rows(4), [3, 4, 5, 0, 1, 2]);
        assert_eq!(rows(5), [0, 3, 1, 4, 2, 5]);
        assert_eq!(rows(6), [3, 0, 4, 1, 5, 2]);
        assert_eq!(rows(7), [5, 2, 4, 1, 3, 0]);
        assert_eq!(rows(8), [2, 5, 1, 4, 0, 3]);
    }

    #[test]
    fn marks_from_5_on_exchange_the_sides_of_a_photo_and_the_others_do_not() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let photo = RgbPicture::from_fn(6, 4, |x, y| [10 * x as u8, 10 * y as u8, 0]);
        // What the Exif standard says the upper left and the upper right pixel of the turned photo were as stored:
        // column and row.
        for (mark, left, right) in
            [(5, [0, 0], [0, 3]), (6, [0, 3], [0, 0]), (7, [5, 3], [5, 0]), (8, [5, 0], [5, 3])]
        {
            write(&path, &photo, Some(mark));
            let (found, at, remarks) = fit_photo(&path, &camera(4, 6)).unwrap();
            assert_eq!(remarks, [PhotoRemark::Turned(mark)]);
            assert_eq!((found.width(), found.height(), at.width, at.height), (4, 6, 4, 6));
            for (x, [column, row]) in [(0, left), (3, right)] {
                assert_eq!(found.get(x, 0), Some([10 * column, 10 * row, 0]), "mark {mark}");
            }
        }
        for mark in 1..=4 {
            write(&path, &photo, Some(mark));
            assert!(fit_photo(&path, &camera(4, 6)).is_err(), "mark {mark}");
        }
    }

    #[test]
    fn photos_are_turned_and_cameras_scaled_at_once_where_both_are_needed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let photo = RgbPicture::from_fn(6, 4, |x, y| [10 * x as u8, 10 * y as u8, 0]);
        let fit = |mark, camera: &Camera| {
            write(&path, &photo, mark);
            let (found, at, remarks) = fit_photo(&path, camera).unwrap();
            ((found.width(), found.height(), found.get(0, 0).unwrap()), at, remarks)
        };
        use PhotoRemark::{CameraScaled, MarkIgnored, Turned};
        // Four times as large and standing: turned by a quarter, and the camera is a quarter of itself.
        let large = Camera { fy: 80.0, cx: 7.0, ..camera(16, 24) };
        let (seen, at, remarks) = fit(Some(6), &large);
        assert_eq!((seen, remarks), ((4, 6, [0, 30, 0]), vec![Turned(6), CameraScaled]));
        assert_eq!(
            (at.width, at.height, at.fx, at.fy, at.cx, at.cy),
            (4, 6, 25.0, 20.0, 1.75, 3.0)
        );
        // Lying it fits as it is stored; a mark that turns by a half is not needed either.
        let (seen, at, remarks) = fit(Some(3), &camera(12, 8));
        assert_eq!((seen, remarks), ((6, 4, [0; 3]), vec![MarkIgnored(3), CameraScaled]));
        assert_eq!((at.width, at.fx), (6, 50.0));
        // The mark of a picture that lies as it was taken says nothing.
        assert_eq!(fit(Some(1), &camera(6, 4)).2, []);
        // A square fits as it is stored whatever its mark says.
        let error = fit_photo(&path, &camera(9, 4)).unwrap_err().to_string();
        assert!(error.contains("is 6×4, its camera \"a\" is 9×4"), "{error}");
        assert!(fit_photo(&dir.path().join("none.png"), &camera(6, 4)).is_err());
    }
}
