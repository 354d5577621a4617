//! What the rasterizer gives, as pictures that files hold.

use scenesplat_rasterizer::Rendered;
use scenesplat_scene::picture::RgbPicture;

/// Depth counts where at least this much of the light is stopped.
const SOLID: f32 = 0.5;

/// The colors of a rendered picture, cut to 0..=1 and rounded to 8 bits; `None` if it has none.
pub fn rendered_picture(rendered: &Rendered) -> Option<RgbPicture> {
    picture_of(rendered.rgb.as_ref()?, rendered.width, rendered.height)
}

/// Colors, cut to 0..=1 and rounded to 8 bits; `None` unless there are `3 · width · height`.
pub fn picture_of(rgb: &[f32], width: u32, height: u32) -> Option<RgbPicture> {
    let bytes = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rgb: Vec<u8> = rgb.iter().map(bytes).collect();
    RgbPicture::from_pixels(width, height, rgb.as_chunks::<3>().0.to_vec())
}

/// The expected depth of a rendered picture, units of the scene; 0 where less than half of the light
/// is stopped. `None` if it was not computed. `[H, W]`
pub fn solid_depth(rendered: &Rendered) -> Option<Vec<f32>> {
    let depth = rendered.depth_expected.as_ref()?.iter().zip(&rendered.transmittance);
    Some(depth.map(|(d, t)| if 1.0 - t >= SOLID { *d } else { 0.0 }).collect())
}

/// Depths in 16-bit steps, `scale` to the unit, with the number of those that do not fit and became
/// 0.
pub fn depth_steps(depth: &[f32], scale: f64) -> (Vec<u16>, usize) {
    let mut lost = 0;
    let step = |d: &f32| {
        let steps = (f64::from(*d) * scale).round();
        lost += usize::from(steps > 65535.0);
        if steps > 65535.0 { 0 } else { steps as u16 }
    };
    (depth.iter().map(step).collect(), lost)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_that_do_not_fit_are_counted() {
        assert_eq!(
            depth_steps(&[0.0, 1.2345, 65.535, 65.6, -1.0], 1000.0),
            (vec![0, 1235, 65535, 0, 0], 1)
        );
    }
}
