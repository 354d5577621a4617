//! Points from measured depths: what the first Gaussians are made of where there is no cloud.

use crate::frame::TrainingFrame;
use std::collections::HashSet;

/// Pixels tried for each point of the result.
const CANDIDATES: usize = 6;
/// Factor by which cells grow until few enough are taken.
const COARSER: f64 = 1.2;

/// At most `most` points on what the depths show, spread evenly in space, with their colors in 0 to 1.
///
/// Pixels at equal distances over all frames are lifted into the world; of those in one cell the first
/// stays, and cells grow until there are few enough.
pub fn fused_points(frames: &[TrainingFrame], most: usize) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let measured = |z: f32| z > 0.01 && z.is_finite();
    let all: usize = frames
        .iter()
        .filter_map(|f| f.depth.as_ref())
        .map(|d| d.iter().filter(|z| measured(**z)).count())
        .sum();
    // Odd, so that the columns of even pictures are not always the same.
    let stride = (all / (CANDIDATES * most).max(1)).max(1) | 1;
    let (mut points, mut colors) = (Vec::new(), Vec::new());
    let mut number = 0usize;
    for frame in frames {
        let Some(depth) = &frame.depth else { continue };
        for (i, &z) in depth.iter().enumerate() {
            if !measured(z) || !frame.shows(i) {
                continue;
            }
            number += 1;
            if number.is_multiple_of(stride) {
                points.push(lifted(frame, i, z));
                colors.push([0, 1, 2].map(|c| frame.rgb.at(3 * i + c)));
            }
        }
    }
    let keep = spread(&points, most);
    let kept = |rows: &[[f32; 3]]| keep.iter().map(|i| rows[*i]).collect();
    (kept(&points), kept(&colors))
}

/// The point of the world that pixel `i` of a frame shows at depth `z`.
pub fn lifted(frame: &TrainingFrame, i: usize, z: f32) -> [f32; 3] {
    let v = &frame.view;
    let (x, y) = ((i as u32 % v.width) as f32 + 0.5, (i as u32 / v.width) as f32 + 0.5);
    let camera = [(x - v.cx) / v.fx * z, (y - v.cy) / v.fy * z, z];
    let m = &v.world_to_camera;
    let from = [0, 1, 2].map(|k| f64::from(camera[k]) - f64::from(m[k][3]));
    [0, 1, 2].map(|k| (0..3).map(|r| f64::from(m[r][k]) * from[r]).sum::<f64>() as f32)
}

/// Rows of at most `most` points, one in each cell.
fn spread(points: &[[f32; 3]], most: usize) -> Vec<usize> {
    if points.len() <= most {
        return (0..points.len()).collect();
    }
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for p in points {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    }
    let side = (0..3).map(|k| f64::from(high[k] - low[k])).fold(0.0, f64::max).max(1e-6);
    // Surfaces: some six sides of the box, each cell a square of them.
    let mut cell = side * (3.0 / most.max(1) as f64).sqrt() / 4.0;
    loop {
        let of = |p: &[f32; 3]| [0, 1, 2].map(|k| (f64::from(p[k] - low[k]) / cell) as i64);
        let mut taken = HashSet::with_capacity(2 * most);
        let keep: Vec<usize> =
            (0..points.len()).filter(|i| taken.insert(of(&points[*i]))).collect();
        if keep.len() <= most {
            return keep;
        }
        cell *= COARSER;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Colors;
    use crate::frame::tests::view;

    #[test]
    fn points_lie_where_the_depth_says() {
        let frame = TrainingFrame {
            name: String::new(),
            view: view(4, 4),
            rgb: Colors::Floats(vec![0.5; 48]),
            alpha: None,
            depth: Some((0..16).map(|i| if i == 5 { f32::NAN } else { 3.0 }).collect()),
            mask: None,
        };
        let (points, colors) = fused_points(std::slice::from_ref(&frame), 100);
        assert_eq!((points.len(), colors[0]), (15, [0.5; 3]));
        // The camera is at z = −2, so depth 3 is z = 1; the first pixel is 1.5 of 4 pixels off the axis.
        assert_eq!(points[0], [-1.125, -1.125, 1.0]);
        assert!(fused_points(&[frame], 4).0.len() <= 4);
        assert!(fused_points(&[], 4).0.is_empty());
    }
}
