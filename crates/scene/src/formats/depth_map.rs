//! Measured depths: one value a pixel, along the camera's axis.

use super::npy::NpyFile;
use crate::SceneError;
use crate::picture::{Channels, Samples, nearest, read_png};
use std::path::Path;

/// Reads the depth of a picture of `size` (width, height): `.npy`, `[H, W]`, in units of the scene, or a gray PNG of
/// 16 bits with `steps` per unit (1000 for millimeters). 0 is unknown.
///
/// A depth of another size is taken by [nearest pixel](nearest).
///
/// # Shapes
/// `[H, W]` of the picture, units of the scene
///
/// # Errors
/// If the file cannot be read, holds something else, or is of another shape than the picture.
pub fn read_depth(path: &Path, size: [u32; 2], steps: f64) -> Result<Vec<f32>, SceneError> {
    let is_npy = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy"));
    let (from, values) = if is_npy { of_npy(path)? } else { of_png(path, steps)? };
    nearest(values, from, size).ok_or_else(|| {
        let [width, height] = size;
        let problem = format!("is {} × {}, its picture {width} × {height}", from[0], from[1]);
        let help = "depth may be smaller or larger than its picture, but has to have its shape, to within 1 %";
        SceneError::format(path, problem, help)
    })
}

fn of_npy(path: &Path) -> Result<([u32; 2], Vec<f32>), SceneError> {
    let file = NpyFile::open(path)?;
    let sides = match *file.shape() {
        [height, width] => u32::try_from(width).ok().zip(u32::try_from(height).ok()),
        _ => None,
    };
    let Some((width, height)) = sides else {
        let problem = format!("holds an array of shape {:?}", file.shape());
        return Err(SceneError::format(path, problem, "depth is [height, width]"));
    };
    Ok(([width, height], file.read_f32()?))
}

fn of_png(path: &Path, steps: f64) -> Result<([u32; 2], Vec<f32>), SceneError> {
    let picture = read_png(path)?;
    let size = [picture.width(), picture.height()];
    match (picture.channels(), picture.into_samples()) {
        (Channels::Gray, Samples::Sixteen(values)) => {
            let unit = 1.0 / steps;
            Ok((size, values.iter().map(|v| (f64::from(*v) * unit) as f32).collect()))
        }
        (channels, samples) => {
            let bits = if matches!(samples, Samples::Eight(_)) { 8 } else { 16 };
            let problem = format!("holds {channels:?} pixels of {bits} bits");
            let help = "write depth as gray PNG of 16 bits, or as .npy";
            Err(SceneError::format(path, problem, help))
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::formats::npy_writer::write_npy;
    use crate::picture::Picture;

    #[test]
    fn depths_of_both_formats_and_of_other_sizes() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let png = |name: &str, channels, samples| {
            let picture = Picture::new(4, 3, channels, samples).unwrap();
            std::fs::write(at(name), picture.encode_png().unwrap()).unwrap();
        };
        png("a.png", Channels::Gray, Samples::Sixteen((0..12).map(|v| 500 * v).collect()));
        write_npy(&at("a.npy"), &[3, 4], &(0..12).map(|v| 0.5 * v as f32).collect::<Vec<_>>())
            .unwrap();
        let want: Vec<f32> = (0..12).map(|v| 0.5 * v as f32).collect();
        for name in ["a.png", "a.npy"] {
            assert_eq!(read_depth(&at(name), [4, 3], 1000.0).unwrap(), want);
            let large = read_depth(&at(name), [8, 6], 1000.0).unwrap();
            assert_eq!((large.len(), &large[..5]), (48, &[0.0, 0.0, 0.5, 0.5, 1.0][..]));
            let error = read_depth(&at(name), [8, 3], 1000.0).unwrap_err().to_string();
            assert!(
                error.contains(name) && error.contains("is 4 × 3, its picture 8 × 3"),
                "{error}"
            );
        }
        assert_eq!(read_depth(&at("a.png"), [4, 3], 500.0).unwrap()[1], 1.0);
        png("b.png", Channels::Gray, Samples::Eight(vec![1; 12]));
        png("c.png", Channels::Rgb, Samples::Eight(vec![1; 36]));
        write_npy(&at("d.npy"), &[12], &want).unwrap();
        for (name, part) in [("b.png", "Gray pixels of 8"), ("c.png", "Rgb"), ("d.npy", "[12]")] {
            let error = read_depth(&at(name), [4, 3], 1000.0).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(part), "{error}");
        }
    }
}
