//! Values of the flags of `render`.

use scenesplat::rasterizer::{MAX_PIXELS, MAX_SIDE};
use scenesplat::scene::camera::FARTHEST;

/// Reads the size of pictures.
pub fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let size: Option<[u32; 2]> =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    match size {
        Some([w, h]) if w > 0 && h > 0 => {
            if w.max(h) > MAX_SIDE || u64::from(w) * u64::from(h) > MAX_PIXELS {
                let most = format!("{MAX_SIDE} on a side and {MAX_PIXELS} in all");
                return Err(format!("{text:?}: pictures have at most {most}"));
            }
            Ok([w, h])
        }
        _ => Err(format!("{text:?} is no size; write 640x480")),
    }
}

/// Reads three coordinates.
pub fn parse_point(text: &str) -> Result<[f64; 3], String> {
    let values: Option<Vec<f64>> = text
        .split(',')
        .map(|v| v.trim().parse().ok().filter(|v: &f64| v.abs() <= FARTHEST))
        .collect();
    let point = values.and_then(|v| <[f64; 3]>::try_from(v).ok());
    point.ok_or_else(|| {
        format!("{text:?} is no point; write three numbers: 1.5,0,-2, at most {FARTHEST:e} from 0")
    })
}

/// Reads an angle of view, degrees.
pub fn parse_fov(text: &str) -> Result<f64, String> {
    let angle = text.parse().ok().filter(|v: &f64| *v >= 1.0 && *v <= 170.0);
    angle.ok_or_else(|| format!("{text:?}: write an angle of 1 to 170 degrees"))
}

/// Reads a color.
pub fn parse_color(text: &str) -> Result<[f32; 3], String> {
    let values: Option<Vec<f32>> = text.split(',').map(|v| v.trim().parse().ok()).collect();
    match values.as_deref() {
        Some(&[r, g, b]) if [r, g, b].iter().all(|v| (0.0..=1.0).contains(v)) => Ok([r, g, b]),
        _ => Err(format!("{text:?} is no color; write three numbers from 0 to 1: 1,1,1")),
    }
}
