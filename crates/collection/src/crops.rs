//! Pictures of a segment: with what is around it, and alone.

use scenesplat_rasterizer::lifting::{NO_SEGMENT, SegmentMap};
use scenesplat_scene::picture::RgbPicture;

/// Two square pictures of a segment, as large as the longer side of its box.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Crops {
    /// The tight box as it is, padded with black to a square about its middle.
    pub with_surroundings: RgbPicture,
    /// The same with black outside of the segment.
    pub alone: RgbPicture,
}

/// The tight box around a segment: first column and row, width and height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Box2 {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

/// The boxes of all ids of a map; `None` for ids without a pixel.
pub(crate) fn boxes(map: &SegmentMap) -> Vec<Option<Box2>> {
    // First and last column and row.
    let mut ends: Vec<Option<[u32; 4]>> = vec![None; map.num_ids()];
    for (at, &id) in map.ids().iter().enumerate().filter(|(_, id)| **id != NO_SEGMENT) {
        let (x, y) = (at as u32 % map.width(), at as u32 / map.width());
        let end = ends[usize::from(id)].get_or_insert([x, y, x, y]);
        *end = [end[0].min(x), end[1].min(y), end[2].max(x), end[3].max(y)];
    }
    let to_box = |[x, y, right, bottom]: [u32; 4]| Box2 {
        x,
        y,
        width: right - x + 1,
        height: bottom - y + 1,
    };
    ends.into_iter().map(|end| end.map(to_box)).collect()
}

/// Cuts out the pixels of a box, padded with black to a square: ⌊(long − short) / 2⌋ before, the rest behind.
fn square(place: Box2, color: impl Fn(u32, u32) -> [u8; 3]) -> RgbPicture {
    let side = place.width.max(place.height);
    let (left, top) = ((side - place.width) / 2, (side - place.height) / 2);
    RgbPicture::from_fn(side, side, |x, y| {
        let inside = x >= left && y >= top && x - left < place.width && y - top < place.height;
        if inside { color(place.x + x - left, place.y + y - top) } else { [0; 3] }
    })
}

pub(crate) fn crops_in(picture: &RgbPicture, map: &SegmentMap, id: u16, place: Box2) -> Crops {
    let width = picture.width() as usize;
    let at = |x: u32, y: u32| picture.pixels()[y as usize * width + x as usize];
    let own = |x: u32, y: u32| if map.at(x, y) == id { at(x, y) } else { [0; 3] };
    Crops { with_surroundings: square(place, at), alone: square(place, own) }
}

/// The crops of one segment; `None` if no pixel has its id, or the map is of another size than the picture.
///
/// # Source
/// The public label collection of SceneSplat's authors: tight boxes without margin, black outside of the mask, padded
/// to a centerd square. They are resized by the encoder.
pub fn crops_of(picture: &RgbPicture, map: &SegmentMap, id: u16) -> Option<Crops> {
    if (picture.width(), picture.height()) != (map.width(), map.height()) {
        return None;
    }
    let place = boxes(map).get(usize::from(id)).copied().flatten()?;
    Some(crops_in(picture, map, id, place))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn boxes_are_tight_and_squares_are_centred() {
        // Column, row and 9 as the color.
        let picture = RgbPicture::from_fn(6, 5, |x, y| [x as u8, y as u8, 9]);
        let mut ids = vec![NO_SEGMENT; 30];
        // An L of id 1: (1, 1), (1, 2), (2, 2), (3, 2), (4, 2).
        for (x, y) in [(1, 1), (1, 2), (2, 2), (3, 2), (4, 2)] {
            ids[y * 6 + x] = 1;
        }
        ids[0] = 0;
        let map = SegmentMap::new(6, 5, ids).unwrap();
        let crops = crops_of(&picture, &map, 1).unwrap();
        // 4 × 2 pixels in a square of 4: one row of black above, one below.
        assert_eq!((crops.alone.width(), crops.alone.height()), (4, 4));
        let row = |p: &RgbPicture, y: u32| [0, 1, 2, 3].map(|x| p.get(x, y).unwrap());
        let black = [[0; 3]; 4];
        assert_eq!([row(&crops.alone, 0), row(&crops.alone, 3)], [black; 2]);
        assert_eq!(row(&crops.alone, 1), [[1, 1, 9], [0; 3], [0; 3], [0; 3]]);
        assert_eq!(row(&crops.alone, 2), [[1, 2, 9], [2, 2, 9], [3, 2, 9], [4, 2, 9]]);
        assert_eq!(row(&crops.with_surroundings, 1), [[1, 1, 9], [2, 1, 9], [3, 1, 9], [4, 1, 9]]);
        assert_eq!(row(&crops.with_surroundings, 0), black);
        // One pixel is a picture of one pixel; an odd rest goes behind.
        assert_eq!(crops_of(&picture, &map, 0).unwrap().alone.pixels(), [[0, 0, 9]]);
        assert_eq!(crops_of(&picture, &map, 2), None);
        let two = SegmentMap::new(6, 5, (0..30).map(|i| u16::from(i % 6 > 2)).collect()).unwrap();
        let crops = crops_of(&picture, &two, 0).unwrap();
        // 3 wide, 5 high: one column before, one behind.
        assert_eq!(crops.alone.get(0, 0), Some([0; 3]));
        assert_eq!(crops.alone.get(1, 4), Some([0, 4, 9]));
        assert_eq!(crops.alone.get(4, 2), Some([0; 3]));
        let thin = SegmentMap::new(6, 5, (0..30).map(|i| u16::from(i % 6 > 1)).collect()).unwrap();
        let crops = crops_of(&picture, &thin, 0).unwrap();
        // 2 wide, 5 high: one column before, two behind.
        let row = [0, 1, 2, 3, 4].map(|x| crops.alone.get(x, 2).unwrap());
        assert_eq!(row, [[0; 3], [0, 2, 9], [1, 2, 9], [0; 3], [0; 3]]);
        let small = SegmentMap::new(1, 1, vec![0]).unwrap();
        assert_eq!(crops_of(&picture, &small, 0), None);
    }
}
