//! The few segments of one tile, and which pixels belong to them.

use super::segment_map::{NO_SEGMENT, SegmentMap};
use crate::splats::Aligned;
use crate::{TILE, TileRect};

/// The most granularities of one pass.
pub const MAX_LEVELS: usize = 4;

/// The segment a pixel belongs to at every granularity.
pub(super) type SegmentTuple = [u16; MAX_LEVELS];

/// No segment at any granularity.
pub(super) const NOWHERE: SegmentTuple = [NO_SEGMENT; MAX_LEVELS];

/// Pixels of one row that share a tuple.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// Number of the tuple in the tile.
    pub(super) tuple: u32,
    /// 1 where the pixel belongs to it, else 0.
    pub(super) mask: Aligned<[f32; TILE]>,
}

/// What a tile holds of the maps. A tile has 256 pixels, so at most 256 tuples; mostly 1 to 5.
#[derive(Debug, Clone, Default)]
pub(super) struct TileSegments {
    /// In the order in which they are met, row by row.
    pub(super) tuples: Vec<SegmentTuple>,
    /// Row by row.
    pub(super) parts: Vec<Part>,
    /// Where each row's parts start, and where the last one's end.
    pub(super) starts: [u32; TILE + 1],
    /// The tuples of each row as bits, of the first [`MAX_BITS`] tuples.
    pub(super) bits: [u64; TILE],
}

/// Tuples of a tile that bits can stand for; a tile with more is rare.
pub(super) const MAX_BITS: usize = 64;

impl TileSegments {
    /// Reads a tile of the maps, all of one size. With `nowhere`, the first tuple is [`NOWHERE`].
    pub(super) fn new(maps: &[SegmentMap], rect: TileRect, nowhere: bool) -> Self {
        let mut out = Self::default();
        if nowhere {
            out.tuples.push(NOWHERE);
        }
        for r in 0..rect.height {
            let first_part = out.parts.len();
            out.starts[r as usize] = first_part as u32;
            let mut last: Option<(SegmentTuple, usize)> = None;
            for c in 0..rect.width {
                let mut ids = NOWHERE;
                for (id, map) in ids.iter_mut().zip(maps) {
                    *id = map.at(rect.x0 + c, rect.y0 + r);
                }
                let part = match last {
                    Some((tuple, part)) if tuple == ids => part,
                    _ => out.part(ids, first_part),
                };
                last = Some((ids, part));
                out.parts[part].mask.0[c as usize] = 1.0;
            }
        }
        for start in &mut out.starts[rect.height as usize..] {
            *start = out.parts.len() as u32;
        }
        for (r, bits) in out.bits.iter_mut().enumerate() {
            let parts = &out.parts[out.starts[r] as usize..out.starts[r + 1] as usize];
            let known = parts.iter().filter(|p| (p.tuple as usize) < MAX_BITS);
            *bits = known.fold(0, |bits, part| bits | 1 << part.tuple);
        }
        out
    }

    /// The part of a tuple in the row that begins at `first_part`.
    fn part(&mut self, ids: SegmentTuple, first_part: usize) -> usize {
        let tuple = self.tuples.iter().position(|t| *t == ids).unwrap_or_else(|| {
            self.tuples.push(ids);
            self.tuples.len() - 1
        }) as u32;
        let known = self.parts[first_part..].iter().position(|p| p.tuple == tuple);
        known.map_or_else(
            || {
                self.parts.push(Part { tuple, mask: Aligned([0.0; TILE]) });
                self.parts.len() - 1
            },
            |i| first_part + i,
        )
    }
}
