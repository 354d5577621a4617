//! Depth as people see it.

use scenesplat_scene::picture::RgbPicture;

/// Colors from near to far: six points of a ramp whose lightness rises evenly, so that it can be
/// read without color vision (after viridis).
const RAMP: [[f32; 3]; 6] = [
    [253.0, 231.0, 37.0],
    [122.0, 209.0, 81.0],
    [34.0, 168.0, 132.0],
    [42.0, 120.0, 142.0],
    [65.0, 68.0, 135.0],
    [68.0, 1.0, 84.0],
];

/// Pixels without a depth.
const NOTHING: [u8; 3] = [0; 3];

/// Colors of depths, near is bright; 0 and what is not finite is black.
///
/// The ramp spans the depths from the nearest to the farthest 2 %.
pub fn depth_picture(depth: &[f32], width: u32, height: u32) -> RgbPicture {
    let is_depth = |d: f32| d > 0.0 && d.is_finite();
    let mut sorted: Vec<f32> = depth.iter().copied().filter(|d| is_depth(*d)).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let rank = |share: f32| {
        let last = sorted.len().saturating_sub(1);
        sorted.get((last as f32 * share).round() as usize).copied().unwrap_or(1.0)
    };
    let (near, far) = (rank(0.02), rank(0.98));
    let color = |d: f32| {
        if !is_depth(d) {
            return NOTHING;
        }
        let share = if far > near { ((d - near) / (far - near)).clamp(0.0, 1.0) } else { 0.0 };
        let place = share * (RAMP.len() - 1) as f32;
        let below = (place as usize).min(RAMP.len() - 2);
        let part = place - below as f32;
        [0, 1, 2].map(|c| {
            let (a, b) = (RAMP[below][c], RAMP[below + 1][c]);
            (a + part * (b - a)).round() as u8
        })
    };
    RgbPicture::from_fn(width, height, |x, y| {
        let at = y as usize * width as usize + x as usize;
        depth.get(at).map_or(NOTHING, |d| color(*d))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let depth = [1.0, 2.0, 3.0, 0.0, f32::NAN, f32::INFINITY];
        let picture = depth_picture(&depth, 3, 2);
        assert_eq!(picture.get(0, 0).unwrap(), [253, 231, 37]);
        assert_eq!(picture.get(2, 0).unwrap(), [68, 1, 84]);
        for x in 0..3 {
            assert_eq!(picture.get(x, 1).unwrap(), [0; 3]);
        }
        let flat = depth_picture(&[4.0; 4], 2, 2);
        assert!(flat.pixels().iter().all(|p| *p == [253, 231, 37]));
        assert!(depth_picture(&[0.0; 4], 2, 2).pixels().iter().all(|p| *p == [0; 3]));
    }
}
