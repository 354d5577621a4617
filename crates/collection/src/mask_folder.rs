//! Segments from files: a picture of ids for each frame.

use crate::{CollectError, PosedPicture, Segmented, Segmenter};
use scenesplat_rasterizer::lifting::{NO_SEGMENT, SegmentMap};
use scenesplat_rasterizer::segments::read_ids;
use scenesplat_scene::frame_files::{EXACT_PICTURES, FoundFiles, FrameFiles};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A folder of `<frame>.png`: gray of up to 16 bits, each value an id, or with a palette, each index an id; 255 (of 16
/// bits 65535), or another that is given, is no segment. Ids need not begin at 0 nor follow each other.
///
/// A map that is smaller or larger than its picture, but of its shape, is used by nearest pixel.
#[derive(Debug, Clone)]
pub struct MaskFolder {
    path: PathBuf,
    no_segment: Option<u16>,
    files: FrameFiles,
    of_frames: BTreeMap<String, PathBuf>,
}

impl MaskFolder {
    /// Looks whether there are such files.
    ///
    /// # Errors
    /// If the folder cannot be read or has no `.png`.
    pub fn open(path: &Path, no_segment: Option<u16>) -> Result<Self, CollectError> {
        let files = FrameFiles::open(path, EXACT_PICTURES)?;
        if files.is_empty() {
            let help = "a folder of id maps is expected: <frame>.png, gray or with a palette";
            return Err(CollectError::file(path, "holds no .png", help));
        }
        Ok(Self { path: path.to_owned(), no_segment, files, of_frames: BTreeMap::new() })
    }

    /// Finds the maps of frames, each with its name and that of its camera, by the rule of
    /// [all files of cameras](scenesplat_scene::frame_files).
    ///
    /// # Errors
    /// If cameras of different names mean one map, or maps in different folders fit one camera.
    pub fn assign(&mut self, frames: &[[&str; 2]]) -> Result<FoundFiles, CollectError> {
        let cameras: Vec<&str> = frames.iter().map(|[_, camera]| *camera).collect();
        let found = self.files.find(&cameras)?;
        let named = frames.iter().zip(&found.files);
        let file = |([name, _], file): (&[&str; 2], &Option<usize>)| {
            Some(((*name).to_owned(), self.files.path((*file)?)))
        };
        self.of_frames = named.filter_map(file).collect();
        Ok(found)
    }

    /// Where the map of a frame is, if it has one.
    pub fn file(&self, frame: &str) -> Option<&Path> {
        self.of_frames.get(frame).map(PathBuf::as_path)
    }
}

impl Segmenter for MaskFolder {
    fn name(&self) -> String {
        let none = self.no_segment.map_or(String::new(), |v| format!(" without {v}"));
        format!("masks{none}")
    }

    fn segment(&self, picture: &PosedPicture<'_>) -> Result<Segmented, CollectError> {
        picture.check()?;
        let Some(path) = self.file(picture.name) else {
            let help =
                "every frame needs its map; leave the frame out, or make one without segments";
            let path = self.path.join(format!("{}.png", picture.name));
            return Err(CollectError::file(&path, "is missing", help));
        };
        let (width, height, values, default) = read_ids(path)?;
        let none = self.no_segment.unwrap_or(default);
        // 65535 is an id where another value means none; dense ids never are 65535.
        let some = |&v: &u16| (v != none).then_some(u32::from(v));
        let mut ids: Vec<Option<u32>> = values.iter().map(some).collect();
        let mut known: Vec<u32> = ids.iter().flatten().copied().collect();
        known.sort_unstable();
        known.dedup();
        let (to_width, to_height) = (picture.view.width, picture.view.height);
        if (width, height) != (to_width, to_height) {
            // Through a map of places, which knows what fits.
            let dense = Segmented::dense(width, height, &ids, known.len())?.map;
            let resized = dense.resized(to_width, to_height).ok_or_else(|| {
                let problem = format!("is {width}×{height}, its picture {to_width}×{to_height}");
                let help = "maps have the size of their pictures, or are scaled as a whole";
                CollectError::file(path, problem, help)
            })?;
            ids = from_map(&resized);
        }
        Segmented::dense(to_width, to_height, &ids, known.len())
    }
}

fn from_map(map: &SegmentMap) -> Vec<Option<u32>> {
    map.ids().iter().map(|&id| (id != NO_SEGMENT).then_some(u32::from(id))).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::segmenter::tests::view;
    use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};

    fn write(path: &Path, width: u32, height: u32, channels: Channels, samples: Samples) {
        let picture = Picture::new(width, height, channels, samples).unwrap();
        std::fs::write(path, picture.encode_png().unwrap()).unwrap();
    }

    #[test]
    fn ids_of_8_and_16_bits_become_dense() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let ids = vec![7, 7, 255, 3, 3, 3];
        write(&at("a.png"), 3, 2, Channels::Gray, Samples::Eight(ids));
        let ids = vec![700, 700, 255, 65535, 3, 3];
        write(&at("b.png"), 3, 2, Channels::Gray, Samples::Sixteen(ids));
        let rgb = vec![0; 18];
        write(&at("c.png"), 3, 2, Channels::Rgb, Samples::Eight(rgb));
        let view = view(3, 2);
        let picture = RgbPicture::filled(3, 2, [5; 3]);
        let of = |name| PosedPicture { name, picture: &picture, view: &view, depth: None };
        let open = |none| {
            let mut folder = MaskFolder::open(dir.path(), none).unwrap();
            let frames = ["a", "b", "c", "d"].map(|name| [name, name]);
            assert_eq!(folder.assign(&frames).unwrap().missing, ["d"]);
            folder
        };
        let folder = open(None);
        let none = NO_SEGMENT;
        assert_eq!(folder.segment(&of("a")).unwrap().map.ids(), [1, 1, none, 0, 0, 0]);
        assert_eq!(folder.segment(&of("b")).unwrap().map.ids(), [2, 2, 1, none, 0, 0]);
        let other = open(Some(3));
        assert_eq!(other.segment(&of("a")).unwrap().map.ids(), [0, 0, 1, none, none, none]);
        assert_ne!(other.name(), folder.name());
        for (frame, part) in [("c", "Rgb"), ("d", "is missing")] {
            let error = folder.segment(&of(frame)).unwrap_err().to_string();
            assert!(error.contains(&format!("{frame}.png")) && error.contains(part), "{error}");
        }
        // Twice as large is used, of another shape is not.
        let large = crate::segmenter::tests::view(6, 4);
        let picture = RgbPicture::filled(6, 4, [5; 3]);
        let of = |name| PosedPicture { name, picture: &picture, view: &large, depth: None };
        let found = folder.segment(&of("a")).unwrap().map;
        assert_eq!(found.ids()[..6], [1, 1, 1, 1, none, none]);
        let wide = crate::segmenter::tests::view(9, 2);
        let picture = RgbPicture::filled(9, 2, [5; 3]);
        let of = |name| PosedPicture { name, picture: &picture, view: &wide, depth: None };
        let error = folder.segment(&of("a")).unwrap_err().to_string();
        assert!(error.contains("is 3×2, its picture 9×2"), "{error}");
        let empty = tempfile::tempdir().unwrap();
        assert!(MaskFolder::open(empty.path(), None).is_err());
    }

    #[test]
    fn maps_are_known_by_the_names_of_frames_not_of_cameras() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        write(&at("a.png"), 2, 1, Channels::Gray, Samples::Eight(vec![4, 255]));
        write(&at("b.png"), 2, 1, Channels::Gray, Samples::Eight(vec![255, 4]));
        let mut folder = MaskFolder::open(dir.path(), None).unwrap();
        // The first frame was taken by camera b, the second one by camera a.
        folder.assign(&[["first", "b"], ["second", "a"]]).unwrap();
        assert_eq!(folder.file("first"), Some(at("b.png").as_path()));
        assert_eq!(folder.file("second"), Some(at("a.png").as_path()));
        assert_eq!((folder.file("a"), folder.file("b")), (None, None));
        let (view, picture) = (view(2, 1), RgbPicture::filled(2, 1, [5; 3]));
        let posed = PosedPicture { name: "first", picture: &picture, view: &view, depth: None };
        assert_eq!(folder.segment(&posed).unwrap().map.ids(), [NO_SEGMENT, 0]);
    }

    #[test]
    fn ids_that_a_smaller_picture_does_not_show_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        // Of four by two the nearest pixels of two by one are columns 1 and 3 of the last row, or 0 and 2 of the first.
        let ids = vec![8, 8, 5, 5, 8, 8, 5, 5];
        write(&dir.path().join("a.png"), 4, 2, Channels::Gray, Samples::Eight(ids));
        let ids = vec![255, 6, 6, 6, 6, 6, 6, 6];
        write(&dir.path().join("b.png"), 4, 2, Channels::Gray, Samples::Eight(ids));
        let open = |none| {
            let mut folder = MaskFolder::open(dir.path(), none).unwrap();
            folder.assign(&[["a", "a"], ["b", "b"]]).unwrap();
            folder
        };
        let (view, picture) = (view(2, 1), RgbPicture::filled(2, 1, [5; 3]));
        let of = |name| PosedPicture { name, picture: &picture, view: &view, depth: None };
        let found = open(None).segment(&of("a")).unwrap();
        assert_eq!((found.map.ids(), found.left_out), (&[1, 0][..], 0));
        // With 6 as none 255 is an id: of one pixel, which the small picture may miss. It is found either way.
        let found = open(Some(6)).segment(&of("b")).unwrap();
        let shown = found.map.ids().iter().filter(|id| **id != NO_SEGMENT).count();
        assert_eq!(shown + found.left_out, 1);
        assert_eq!(
            (open(None).name(), open(Some(6)).name()),
            ("masks".into(), "masks without 6".into())
        );
        assert!(!open(None).wants_depth());
        let other = RgbPicture::filled(3, 1, [5; 3]);
        assert!(open(None).segment(&PosedPicture { picture: &other, ..of("a") }).is_err());
        let empty = tempfile::tempdir().unwrap();
        let error = MaskFolder::open(empty.path(), None).unwrap_err().to_string();
        assert!(error.contains("holds no .png (a folder of id maps"), "{error}");
    }
}
