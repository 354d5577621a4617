//! Lines of text, in a font whose letters are all 8 pixels wide per unit of size.

use super::blend;
use ab_glyph::{Font, FontRef, GlyphId, point};
use scenesplat_scene::picture::RgbPicture;
use std::sync::LazyLock;

static FONT: LazyLock<FontRef<'static>> = LazyLock::new(|| {
    FontRef::try_from_slice(include_bytes!("../../assets/fonts/DejaVuSansMono-subset.ttf"))
        .expect("the font in the program is whole")
});

/// Width of a line, pixels.
pub(crate) fn width(text: &str, size: u32) -> u32 {
    u32::try_from(text.chars().count()).unwrap_or(u32::MAX).saturating_mul(8 * size)
}

/// Draws a line whose letters stand on `top + 8 · size`; a line wider than `max_width` is cut and ends in `…`.
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
    let kept = if cut { fitting.saturating_sub(1) } else { fitting };
    let base = (top + 8 * size) as f32;
    let scale =
        8.0 * size as f32 * FONT.height_unscaled() / FONT.h_advance_unscaled(FONT.glyph_id('0'));
    for (i, letter) in text.chars().take(kept).chain(cut.then_some('…')).enumerate() {
        let id = Some(FONT.glyph_id(letter)).filter(|id| *id != GlyphId(0));
        let at = point((left + 8 * size * i as u32) as f32, base);
        let glyph = id.unwrap_or_else(|| FONT.glyph_id('?')).with_scale_and_position(scale, at);
        let Some(outline) = FONT.outline_glyph(glyph) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|x, y, share| {
            let (x, y) = (corner.x + x as f32, corner.y + y as f32);
            if x >= 0.0 && y >= 0.0 {
                blend(picture, [x as u32, y as u32], color, f64::from(share.min(1.0)));
            }
        });
    }
}
