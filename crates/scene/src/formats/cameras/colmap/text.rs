//! The text files: one thing a line, an image on two; lines that begin with `#` are comments.

use super::models::{self, Lens};
use super::{CameraKind, CameraSet, MEND, Picture, SparsePoints, join};
use crate::SceneError;
use std::path::Path;
use std::str::{FromStr, SplitWhitespace};

/// Reads `cameras.txt`, `images.txt` and, if given, `points3D.txt`. `folder` is for messages.
///
/// Cameras are in the order of the images. Where a comment says how many there are, as COLMAP
/// writes it, that many must be there.
///
/// # Errors
/// If a line is not as it must be, with its number, if some are missing, or if a camera is not
/// usable.
pub fn read_colmap_text(
    cameras: &[u8],
    images: &[u8],
    points: Option<&[u8]>,
    folder: &Path,
) -> Result<CameraSet, SceneError> {
    let lenses = read_cameras(Lines::new(cameras, folder, "cameras.txt")?)?;
    let pictures = read_images(Lines::new(images, folder, "images.txt")?)?;
    let points = points.map(|points| read_points(Lines::new(points, folder, "points3D.txt")?));
    join(lenses, pictures, points.transpose()?, CameraKind::ColmapText, folder, "txt")
}

/// A file and how far it was read.
struct Lines<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// Number of the present line, from 1.
    number: usize,
    folder: &'a Path,
    name: &'static str,
    /// From a comment.
    count: Option<u64>,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8], folder: &'a Path, name: &'static str) -> Result<Self, SceneError> {
        let text = std::str::from_utf8(bytes).map_err(|e| {
            SceneError::format(&folder.join(name), format!("is no UTF-8 text: {e}"), MEND)
        })?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        Ok(Self { lines: text.lines().enumerate(), number: 0, folder, name, count: None })
    }

    /// The error for the present line.
    fn bad(&self, problem: impl std::fmt::Display) -> SceneError {
        let problem = format!("line {}: {problem}", self.number);
        SceneError::format(&self.folder.join(self.name), problem, MEND)
    }

    /// The next line, whatever is on it.
    fn any(&mut self) -> Option<&'a str> {
        let (index, line) = self.lines.next()?;
        self.number = index + 1;
        Some(line.trim())
    }

    /// The next line that is neither empty nor a comment.
    fn next(&mut self) -> Option<&'a str> {
        while let Some(line) = self.any() {
            if let Some(comment) = line.strip_prefix('#') {
                self.count = self.count.or(count_in(comment));
            } else if !line.is_empty() {
                return Some(line);
            }
        }
        None
    }

    fn value<T: FromStr>(
        &self,
        fields: &mut SplitWhitespace<'_>,
        what: &str,
    ) -> Result<T, SceneError> {
        let Some(field) = fields.next() else {
            return Err(self.bad(format!("{what} is missing")));
        };
        field.parse().map_err(|_| {
            let field: String = field.chars().take(40).collect();
            self.bad(format!("{what} is {field:?}"))
        })
    }

    fn values<const N: usize>(
        &self,
        fields: &mut SplitWhitespace<'_>,
        what: &str,
    ) -> Result<[f64; N], SceneError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.value(fields, what)?;
        }
        Ok(values)
    }

    /// Compares with the number that a comment gives.
    fn check_count(&self, read: usize) -> Result<(), SceneError> {
        match self.count {
            Some(count) if count != read as u64 => {
                let problem = format!("its comment says {count}, but {read} were found");
                let file = self.folder.join(self.name);
                Err(SceneError::format(&file, problem, "correct the file, or remove the comment"))
            }
            _ => Ok(()),
        }
    }
}

/// `Number of cameras: 3`.
fn count_in(comment: &str) -> Option<u64> {
    let (of, rest) = comment.trim().strip_prefix("Number of ")?.split_once(':')?;
    if !matches!(of, "cameras" | "images" | "points") {
        return None;
    }
    rest.split(',').next()?.trim().parse().ok()
}

fn read_cameras(mut file: Lines<'_>) -> Result<Vec<Lens>, SceneError> {
    let mut lenses = Vec::new();
    while let Some(line) = file.next() {
        let mut fields = line.split_whitespace();
        let id = file.value(&mut fields, "the camera's id")?;
        let name = fields.next().unwrap_or_default();
        let Some(model) = models::by_name(name) else {
            let name: String = name.chars().take(40).collect();
            return Err(file.bad(format!("the lens model {name:?} is unknown")));
        };
        let width = file.value(&mut fields, "the width")?;
        let height = file.value(&mut fields, "the height")?;
        let mut params = Vec::with_capacity(model.params);
        for _ in 0..model.params {
            params.push(file.value(&mut fields, "a parameter")?);
        }
        if fields.next().is_some() {
            let problem = format!("{} has {} parameters, there are more", model.name, model.params);
            return Err(file.bad(problem));
        }
        lenses.push(Lens { id, model, width, height, params });
    }
    file.check_count(lenses.len())?;
    Ok(lenses)
}

fn read_images(mut file: Lines<'_>) -> Result<Vec<Picture>, SceneError> {
    let mut pictures = Vec::new();
    while let Some(line) = file.next() {
        let mut fields = line.split_whitespace();
        file.value::<u32>(&mut fields, "the image's id")?;
        let quat = file.values(&mut fields, "the rotation")?;
        let translation = file.values(&mut fields, "the translation")?;
        let lens = file.value(&mut fields, "the image's camera")?;
        // The rest of the line: names may have spaces.
        let name = after_fields(line, 9).to_owned();
        pictures.push(Picture { name, lens, quat, translation });
        // The points are on a line of their own, which is there even if it is empty.
        if let Some(points) = file.any() {
            let fields = points.split_whitespace().count();
            if points.starts_with('#') || fields % 3 != 0 {
                let problem = "every image needs a second line with its points, x y id each; it may \
                               be empty";
                return Err(file.bad(problem));
            }
        }
    }
    file.check_count(pictures.len())?;
    Ok(pictures)
}

fn read_points(mut file: Lines<'_>) -> Result<SparsePoints, SceneError> {
    let mut points = SparsePoints::default();
    while let Some(line) = file.next() {
        let mut fields = line.split_whitespace();
        file.value::<u64>(&mut fields, "the point's id")?;
        points.coord.push(file.values(&mut fields, "the position")?);
        let mut color = [0u8; 3];
        for channel in &mut color {
            *channel = file.value(&mut fields, "the colour")?;
        }
        points.color.push(color);
        file.value::<f64>(&mut fields, "the error")?;
        if fields.count() % 2 != 0 {
            return Err(file.bad("the track is no pairs of image and point"));
        }
    }
    file.check_count(points.coord.len())?;
    Ok(points)
}

/// What follows the first `count` fields.
fn after_fields(line: &str, count: usize) -> &str {
    let mut rest = line.trim_start();
    for _ in 0..count {
        let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
        rest = rest[end..].trim_start();
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_in_comments() {
        assert_eq!(count_in(" Number of images: 12, mean observations per image: 3.5"), Some(12));
        assert_eq!(count_in(" Number of cameras: 1"), Some(1));
        assert_eq!(count_in("   IMAGE_ID, QW, QX"), None);
        assert_eq!(count_in(" Number of thoughts: 4"), None);
    }

    #[test]
    fn names_may_have_spaces() {
        assert_eq!(after_fields("1  2 3 my  image.jpg", 3), "my  image.jpg");
        assert_eq!(after_fields("1 2", 3), "");
    }
}
