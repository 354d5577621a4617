//! Which segment each pixel of a picture belongs to.

use super::LiftError;
use scenesplat_scene::picture::nearest;

/// The id of a pixel that belongs to no segment.
pub const NO_SEGMENT: u16 = u16::MAX;

/// Segment ids of one picture at one granularity: rows of the picture's feature table, or
/// [`NO_SEGMENT`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SegmentMap {
    width: u32,
    height: u32,
    ids: Vec<u16>,
}

impl SegmentMap {
    /// A map of `[height, width]` ids.
    ///
    /// # Errors
    /// If there is not one id per pixel.
    pub fn new(width: u32, height: u32, ids: Vec<u16>) -> Result<Self, LiftError> {
        if (width as usize).checked_mul(height as usize) != Some(ids.len()) {
            let problem = format!("expected {height}×{width} ids, got {}", ids.len());
            return Err(LiftError::argument("segment map", problem));
        }
        Ok(Self { width, height, ids })
    }

    /// Pixels in a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Ids row by row. `[height · width]`
    pub fn ids(&self) -> &[u16] {
        &self.ids
    }

    /// The id at a pixel inside the map.
    pub fn at(&self, x: u32, y: u32) -> u16 {
        self.ids[y as usize * self.width as usize + x as usize]
    }

    /// A map of the same size with other ids, one for each pixel.
    pub(super) fn with_ids(&self, ids: impl Iterator<Item = u16>) -> Self {
        let ids: Vec<u16> = ids.collect();
        debug_assert_eq!(ids.len(), self.ids.len());
        Self { width: self.width, height: self.height, ids }
    }

    /// One more than the largest id; 0 without segments.
    pub fn num_ids(&self) -> usize {
        let largest = self.ids.iter().filter(|&&id| id != NO_SEGMENT).max();
        largest.map_or(0, |&id| usize::from(id) + 1)
    }

    /// The map at another size, by [nearest pixel](nearest), for pictures that were made smaller or larger as a
    /// whole before they were cut into segments: `None` unless the shape is the same.
    pub fn resized(&self, width: u32, height: u32) -> Option<Self> {
        let (from, to) = ([self.width, self.height], [width, height]);
        let ids = nearest(self.ids.clone(), from, to)?;
        Some(Self { width, height, ids })
    }

    /// The map without the pixels nearer than `radius` pixels to another segment (along either axis
    /// or both): there, masks are least sure. The picture's border is no border of segments; a
    /// segment narrower than `2 · radius + 1` pixels vanishes.
    #[must_use]
    pub fn eroded(&self, radius: u32) -> Self {
        let (width, height, r) = (self.width as usize, self.height as usize, radius as usize);
        if radius == 0 || self.ids.is_empty() {
            return self.clone();
        }
        // Row by row, then column by column: a window is of one id if all its rows are, and its
        // middle column is.
        let mut inside = vec![true; self.ids.len()];
        let mut changes = Vec::new();
        for (ids, inside) in self.ids.chunks_exact(width).zip(inside.chunks_exact_mut(width)) {
            changes.clear();
            changes.extend((1..width).filter(|&x| ids[x] != ids[x - 1]));
            for &x in &changes {
                inside[x.saturating_sub(r)..(x + r).min(width)].fill(false);
            }
        }
        let mut ids = vec![NO_SEGMENT; self.ids.len()];
        let mut column = vec![true; height];
        for x in 0..width {
            let at = |y: usize| y * width + x;
            column.fill(true);
            for y in 0..height {
                if !inside[at(y)] {
                    column[y.saturating_sub(r)..(y + r + 1).min(height)].fill(false);
                }
                if y > 0 && self.ids[at(y)] != self.ids[at(y - 1)] {
                    column[y.saturating_sub(r)..(y + r).min(height)].fill(false);
                }
            }
            for y in (0..height).filter(|&y| column[y]) {
                ids[at(y)] = self.ids[at(y)];
            }
        }
        Self { width: self.width, height: self.height, ids }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use rand::{Rng, SeedableRng};

    fn random(width: u32, height: u32, seed: u64) -> SegmentMap {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        // Blocks of a few pixels, so that something survives.
        let coarse: Vec<u16> = (0..64).map(|_| rng.random_range(0..3)).collect();
        let id = |i: u32| coarse[((i / width) / 5 * 8 + (i % width) / 6) as usize % 64];
        let ids = (0..width * height).map(|i| if id(i) == 2 { NO_SEGMENT } else { id(i) });
        SegmentMap::new(width, height, ids.collect()).unwrap()
    }

    /// Looks at every pixel of the window.
    fn eroded_slowly(map: &SegmentMap, r: i64) -> Vec<u16> {
        let (width, height) = (i64::from(map.width), i64::from(map.height));
        let at = |x: i64, y: i64| map.ids[(y * width + x) as usize];
        let mut out = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let same = (y - r..=y + r).all(|v| {
                    (x - r..=x + r).all(|u| {
                        u < 0 || v < 0 || u >= width || v >= height || at(u, v) == at(x, y)
                    })
                });
                out.push(if same { at(x, y) } else { NO_SEGMENT });
            }
        }
        out
    }

    #[test]
    fn erosion_is_that_of_a_slow_window() {
        for (seed, (width, height)) in [(23, 17), (1, 9), (9, 1), (40, 31)].into_iter().enumerate()
        {
            let map = random(width, height, seed as u64);
            for radius in 0..4 {
                let expected = eroded_slowly(&map, i64::from(radius));
                assert_eq!(map.eroded(radius).ids, expected, "{width}×{height}, radius {radius}");
            }
        }
        let one = SegmentMap::new(4, 3, vec![7; 12]).unwrap();
        assert_eq!(one.eroded(9), one, "the picture's border is no border of segments");
    }

    #[test]
    fn resizing_by_hand() {
        let map = SegmentMap::new(4, 2, vec![0, 1, 2, 3, 4, 5, 6, 7]).unwrap();
        assert_eq!(map.resized(2, 1).unwrap().ids, [5, 7]);
        let twice = map.resized(8, 4).unwrap();
        assert_eq!(twice.ids[..8], [0, 0, 1, 1, 2, 2, 3, 3]);
        assert_eq!(twice.resized(4, 2).unwrap(), map);
        // 648×420 of 1297×840: halves are rounded.
        assert!(SegmentMap::new(3, 2, vec![0; 6]).unwrap().resized(7, 4).is_some());
        assert!(map.resized(4, 4).is_none() && map.resized(4, 1).is_none());
        let large = SegmentMap::new(400, 200, vec![0; 80_000]).unwrap();
        assert!(large.resized(100, 50).is_some() && large.resized(100, 51).is_none());
        assert!(SegmentMap::new(0, 0, vec![]).unwrap().resized(1, 1).is_none());
        assert_eq!(map.num_ids(), 8);
        assert!(SegmentMap::new(2, 2, vec![0; 5]).is_err());
        assert!(SegmentMap::new(u32::MAX, u32::MAX, vec![]).is_err());
    }
}
