//! Names of cameras: their folders, their endings, and what files of their own are called.

use std::collections::HashSet;

/// Endings of pictures; whatever else follows a dot is part of a name (`frame.0001`).
const PICTURE_ENDINGS: [&str; 12] =
    ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "exr", "heic", "dng", "gif", "ppm"];

/// A file's name without the ending of a picture.
pub fn without_ending(file: &str) -> &str {
    match file.rsplit_once('.') {
        Some((stem, ending)) if PICTURE_ENDINGS.iter().any(|e| ending.eq_ignore_ascii_case(e)) => {
            stem
        }
        _ => file,
    }
}

/// The folders of a name and its last part; `/` and `\` separate them, `.` is no folder.
pub(super) fn split(name: &str) -> (Vec<&str>, &str) {
    let mut parts: Vec<&str> =
        name.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".").collect();
    let file = parts.pop().unwrap_or_default();
    (parts, file)
}

/// The name of a camera's picture without folder and ending, fit for a file name; `index` is the camera's number.
pub fn frame_name(name: &str, index: usize) -> String {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let fit = |c: char| if c.is_control() || ":*?\"<>|".contains(c) { '_' } else { c };
    let name: String = without_ending(file).chars().map(fit).collect();
    if name.chars().all(|c| c == '.') { format!("camera_{index:05}") } else { name }
}

/// [`frame_name`] of cameras with their numbers, no two alike: folders of several lenses often number their
/// pictures alike, and all but the first then have the camera's number behind their name.
pub fn frame_names<'a>(cameras: impl IntoIterator<Item = (usize, &'a str)>) -> Vec<String> {
    let mut taken = HashSet::new();
    let unique = |(index, camera): (usize, &str)| {
        let mut name = frame_name(camera, index);
        while !taken.insert(name.clone()) {
            name = format!("{name}_{index:05}");
        }
        name
    };
    cameras.into_iter().map(unique).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_into_a_folder() {
        assert_eq!(frame_name("images/left/0001.jpg", 4), "0001");
        assert_eq!(frame_name("..", 4), "camera_00004");
        assert_eq!(frame_name("", 12), "camera_00012");
        assert_eq!(frame_name("a:b\\c?.png", 0), "c_");
        assert_eq!(frame_name("left/frame.0001", 0), "frame.0001");
        assert_eq!(frame_name("frame.0001.JPEG", 0), "frame.0001");
        assert_eq!(frame_name("v1.2/scan.left.png", 0), "scan.left");
    }

    #[test]
    fn no_two_names_are_alike() {
        let cameras = ["left/1.jpg", "right/1.jpg", "1_00001", "up/1.png"];
        let names = frame_names(cameras.iter().copied().enumerate());
        assert_eq!(names, ["1", "1_00001", "1_00001_00002", "1_00003"]);
        assert_eq!(split(r".\a//b/c.jpg"), (vec!["a", "b"], "c.jpg"));
        assert_eq!(split(""), (vec![], ""));
    }
}
