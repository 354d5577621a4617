//! Lines of text from an 8×8 bitmap font.

use font8x8::{BASIC_FONTS, LATIN_FONTS, UnicodeFonts};
use scenesplat_scene::picture::RgbPicture;

/// Width of a line, pixels, at `size` pixels per dot.
pub(crate) fn width(text: &str, size: u32) -> u32 {
    u32::try_from(text.chars().count()).unwrap_or(u32::MAX).saturating_mul(8 * size)
}

/// Draws a line; what is wider than `max_width` is cut and ends in `..`.
pub(crate) fn draw(
    picture: &mut RgbPicture,
    left: u32,
    top: u32,
    size: u32,
    color: [u8; 3],
    text: &str,
    max_width: u32,
) {
    let fitting = (max_width / (8 * size)) as usize;
    let cut = text.chars().count() > fitting;
    let kept = if cut { fitting.saturating_sub(2) } else { fitting };
    let dots = if cut { ".." } else { "" };
    for (i, letter) in text.chars().take(kept).chain(dots.chars()).enumerate() {
        let glyph = BASIC_FONTS
            .get(letter)
            .or_else(|| LATIN_FONTS.get(letter))
            .or_else(|| BASIC_FONTS.get('?'))
            .unwrap_or_default();
        let x = left + 8 * size * i as u32;
        for (row, bits) in (0..).zip(glyph) {
            for column in (0..8).filter(|c| bits >> c & 1 == 1) {
                dot(picture, [x + column * size, top + row * size], size, color);
            }
        }
    }
}

fn dot(picture: &mut RgbPicture, [left, top]: [u32; 2], size: u32, color: [u8; 3]) {
    for y in top..top + size {
        for x in left..left + size {
            picture.set(x, y, color);
        }
    }
}
