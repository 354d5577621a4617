//! Points from measured depths: what the first Gaussians are made of where there is no cloud.

use crate::frame::TrainingFrame;
use std::collections::HashSet;

/// Pixels tried for each point of the result.
const CANDIDATES: usize = 6;
/// Factor by which cells grow until few enough are taken.
pub(crate) const COARSER: f64 = 1.2;

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

    #[test]
    fn a_lifted_pixel_is_seen_again_where_it_was() {
        let mut frame = crate::frame::tests::frame(view(6, 4), None);
        let (s, c) = 0.6f32.sin_cos();
        frame.view.world_to_camera = [[c, 0.0, s, 0.3], [0.0, 1.0, 0.0, -0.7], [-s, 0.0, c, 1.1]];
        (frame.view.fx, frame.view.fy, frame.view.cx, frame.view.cy) = (5.0, 7.0, 2.5, 2.25);
        // Pixel 15 is the fourth of the third row.
        let want = [(3.5 - 2.5) / 5.0 * 2.5, (2.5 - 2.25) / 7.0 * 2.5, 2.5];
        let found = frame.view.to_camera(lifted(&frame, 15, 2.5));
        for k in 0..3 {
            assert!((found[k] - want[k]).abs() < 1e-5, "{found:?} {want:?}");
        }
    }

    #[test]
    fn pixels_at_equal_distances_over_all_frames_are_tried() {
        let frame = |z: f32, first: u8| {
            let mut frame = crate::frame::tests::frame(view(40, 30), Some(z));
            frame.rgb =
                Colors::Bytes((0..3 * 1200).map(|k| (first as usize + k / 3 % 50) as u8).collect());
            frame
        };
        // 2400 measured pixels for 6 · 10 candidates: every 41st. All of the first frame are in one cell.
        let (points, colors) = fused_points(&[frame(1.0, 0), frame(100.0, 100)], 10);
        assert!((2..=10).contains(&points.len()) && colors.len() == points.len());
        assert_eq!(colors[0], [40.0 / 255.0; 3]);
        // The 30th, 1230th of both, is the 30th pixel of the second.
        assert_eq!(colors[1], [129.0 / 255.0; 3]);
        // What does not show is not counted: with the first two pixels hidden it is two further.
        let mut hidden = frame(1.0, 0);
        hidden.mask = Some((0..1200).map(|i| u8::from(i != 0)).collect());
        hidden.alpha = Some((0..1200).map(|i| if i == 1 { 127 } else { 128 }).collect());
        // Depths up to 0.01 are no measurement, here the last.
        hidden.depth.as_mut().unwrap()[1199] = 0.01;
        // 1199 / 60 = 19, odd.
        assert_eq!(fused_points(&[hidden], 10).1[0], [20.0 / 255.0; 3]);
        assert_eq!(fused_points(&[frame(1.0, 0)], 10).1[0], [20.0 / 255.0; 3]);
        // As many as are wanted stay.
        assert_eq!(fused_points(&[frame(1.0, 0)], 1200).0.len(), 1200);
    }

    #[test]
    fn cells_grow_until_there_are_few_enough() {
        // 101 points on a line of length 100: cells of 100 · √(3/5) / 4 = 19.4 are six, of 1.2 times that five.
        let points: Vec<[f32; 3]> = (0..=100).map(|i| [3.0, i as f32 - 50.0, 8.0]).collect();
        assert_eq!(spread(&points, 5), [0, 24, 47, 70, 93]);
        assert_eq!(spread(&points, 101).len(), 101);
    }
}
