//! A picture that tiles write into from several threads.

use crate::{TILE, TileRect};
use std::marker::PhantomData;

/// A borrowed picture of `channels` values per pixel, handed out in tiles.
///
/// Tiles do not overlap, and each is written by the one visitor that was made for it.
#[derive(Clone, Copy)]
pub(crate) struct Canvas<'a, T = f32> {
    start: *mut T,
    width: usize,
    height: usize,
    channels: usize,
    picture: PhantomData<&'a mut [T]>,
}

// SAFETY: it is a `&mut [T]` of which every thread writes another part, see `Canvas::tile`.
unsafe impl<T: Send> Send for Canvas<'_, T> {}
// SAFETY: as above; nothing is read through it.
unsafe impl<T: Send> Sync for Canvas<'_, T> {}

impl<'a, T: Copy> Canvas<'a, T> {
    /// A picture of `width · height · channels` values, all of which the caller gives away.
    pub(crate) fn new(picture: &'a mut [T], width: u32, channels: usize) -> Self {
        let width = width as usize;
        let height = picture.len().checked_div(width * channels).unwrap_or(0);
        assert_eq!(picture.len(), width * height * channels, "a picture has whole rows");
        Self { start: picture.as_mut_ptr(), width, height, channels, picture: PhantomData }
    }

    /// The part of one tile.
    ///
    /// # Safety
    /// No two live parts of one picture may be of the same tile.
    pub(crate) unsafe fn tile(self, rect: TileRect) -> CanvasTile<'a, T> {
        let (x0, y0) = (rect.x0 as usize, rect.y0 as usize);
        let (width, height) = (rect.width as usize, rect.height as usize);
        assert!(width <= TILE && height <= TILE);
        assert!(x0.is_multiple_of(TILE) && y0.is_multiple_of(TILE), "tiles are on the grid");
        assert!(x0 + width <= self.width && y0 + height <= self.height, "tiles are inside");
        CanvasTile { canvas: self, rect }
    }
}

/// One tile of a [`Canvas`].
pub(crate) struct CanvasTile<'a, T = f32> {
    canvas: Canvas<'a, T>,
    rect: TileRect,
}

impl<T> CanvasTile<'_, T> {
    /// Where the tile is.
    pub(crate) fn rect(&self) -> TileRect {
        self.rect
    }

    /// The values of row `r` of the tile, channels last; `r` below the tile's height.
    pub(crate) fn row(&mut self, r: usize) -> &mut [T] {
        assert!(r < self.rect.height as usize);
        let c = &self.canvas;
        let first = (self.rect.y0 as usize + r) * c.width + self.rect.x0 as usize;
        let len = self.rect.width as usize * c.channels;
        // SAFETY: inside the picture by the checks of `Canvas::tile`; no other part overlaps this
        // one, and the slice borrows this part.
        unsafe { std::slice::from_raw_parts_mut(c.start.add(first * c.channels), len) }
    }
}
