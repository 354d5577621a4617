//! What cuts a picture into segments.

use crate::CollectError;
use scenesplat_rasterizer::View;
use scenesplat_rasterizer::lifting::{NO_SEGMENT, SegmentMap};
use scenesplat_scene::picture::RgbPicture;

/// A picture and where it was taken from.
#[derive(Debug, Clone, Copy)]
pub struct PosedPicture<'a> {
    /// Of its frame: the picture's file name without folder and ending.
    pub name: &'a str,
    /// The pixels.
    pub picture: &'a RgbPicture,
    /// The camera, of the picture's size.
    pub view: &'a View,
    /// Depth along the camera's axis, 0 where it is not known; units of the world. `[H, W]`
    pub depth: Option<&'a [f32]>,
}

impl PosedPicture<'_> {
    /// Checks that picture, camera and depth have one size.
    ///
    /// # Errors
    /// Names what has another one.
    pub fn check(&self) -> Result<(), CollectError> {
        let (width, height) = (self.picture.width(), self.picture.height());
        if (width, height) != (self.view.width, self.view.height) {
            let problem = format!(
                "frame {:?} is {width}×{height}, its camera {}×{}",
                self.name, self.view.width, self.view.height
            );
            return Err(CollectError::argument("picture", problem));
        }
        match self.depth {
            Some(depth) if depth.len() != self.view.pixels() => {
                let problem = format!(
                    "frame {:?} has {} values for {width}×{height} pixels",
                    self.name,
                    depth.len()
                );
                Err(CollectError::argument("depth", problem))
            }
            _ => Ok(()),
        }
    }
}

/// The segments of a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segmented {
    /// Of the picture's size; ids from 0 without gaps, each with at least one pixel.
    pub map: SegmentMap,
    /// Segments that were found and are in no pixel: covered by others, or too small.
    pub left_out: usize,
}

impl Segmented {
    /// Numbers ids anew from 0, in the order of the old ones; those without a pixel are left out. `found`: how many
    /// there were.
    ///
    /// # Errors
    /// If more than 65,535 have pixels, or there is not one id per pixel.
    pub fn dense(
        width: u32,
        height: u32,
        ids: &[Option<u32>],
        found: usize,
    ) -> Result<Self, CollectError> {
        let mut used: Vec<u32> = ids.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        if used.len() > usize::from(NO_SEGMENT) {
            let problem =
                format!("{} in one picture, at most {NO_SEGMENT} are possible", used.len());
            return Err(CollectError::argument("segments", problem));
        }
        let place = |id: &Option<u32>| match id {
            // Every id is in the list.
            Some(id) => used.binary_search(id).map_or(NO_SEGMENT, |at| at as u16),
            None => NO_SEGMENT,
        };
        let map = SegmentMap::new(width, height, ids.iter().map(place).collect())?;
        Ok(Self { map, left_out: found.saturating_sub(used.len()) })
    }
}

/// Cuts pictures into segments.
///
/// The same picture gives the same segments, whatever was cut before and on however many threads.
pub trait Segmenter: Send + Sync {
    /// What it is and with which settings: what is computed once is kept under this name, so another result needs
    /// another name.
    fn name(&self) -> String;

    /// Whether it reads [`PosedPicture::depth`].
    fn wants_depth(&self) -> bool {
        false
    }

    /// The segments of a picture.
    ///
    /// # Errors
    /// If the picture cannot be cut; names the frame.
    fn segment(&self, picture: &PosedPicture<'_>) -> Result<Segmented, CollectError>;
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    /// A camera at the origin that looks along z.
    pub(crate) fn view(width: u32, height: u32) -> View {
        View {
            world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
            fx: width as f32,
            fy: width as f32,
            cx: width as f32 / 2.0,
            cy: height as f32 / 2.0,
            width,
            height,
        }
    }

    #[test]
    fn sizes_have_to_be_one() {
        let picture = RgbPicture::filled(4, 3, [0; 3]);
        let good = view(4, 3);
        let posed = PosedPicture { name: "a", picture: &picture, view: &good, depth: None };
        posed.check().unwrap();
        for (size, said) in [((4, 2), "4×2"), ((5, 3), "5×3")] {
            let other = view(size.0, size.1);
            let error = PosedPicture { view: &other, ..posed }.check().unwrap_err().to_string();
            assert!(error.contains(&format!("\"a\" is 4×3, its camera {said}")), "{error}");
        }
        let other = view(3, 4);
        let error = PosedPicture { view: &other, ..posed }.check().unwrap_err().to_string();
        assert!(error.contains("\"a\" is 4×3, its camera 3×4"), "{error}");
        let error = PosedPicture { depth: Some(&[1.0; 11]), ..posed }.check().unwrap_err();
        assert!(error.to_string().contains("11 values"), "{error}");
    }

    #[test]
    fn dense_ids_leave_out_what_has_no_pixel() {
        let ids = [Some(9), None, Some(2), Some(9)];
        let found = Segmented::dense(2, 2, &ids, 5).unwrap();
        assert_eq!((found.map.ids(), found.left_out), (&[1, NO_SEGMENT, 0, 1][..], 3));
        let many: Vec<Option<u32>> = (0..70_000).map(Some).collect();
        let error = Segmented::dense(70_000, 1, &many, 70_000).unwrap_err().to_string();
        assert!(error.contains("70000"), "{error}");
    }

    #[test]
    fn a_picture_has_as_many_segments_as_there_are_numbers_for_and_no_more() {
        // 16 bits have 65,536 values, and the largest means no segment.
        let ids = |count: u32| (0..count).map(Some).collect::<Vec<_>>();
        let most = Segmented::dense(65_535, 1, &ids(65_535), 65_535).unwrap();
        let (first, last) = (most.map.ids().first(), most.map.ids().last());
        assert_eq!((first, last, most.left_out), (Some(&0), Some(&65_534), 0));
        let more = Segmented::dense(65_536, 1, &ids(65_536), 65_536).map(|found| found.left_out);
        let error = more.unwrap_err().to_string();
        assert!(error.contains("65536"), "{error}");
    }
}
