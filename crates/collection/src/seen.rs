//! What a camera shows of a scene, from a small render.

use crate::CollectError;
use scenesplat_rasterizer::{DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render};

/// Longer side of the small picture.
const SIDE: u32 = 96;
/// Gaussians of the sample, about.
const SAMPLE: usize = 40_000;
/// Weight, in pixels of the small picture, from which on a Gaussian is seen.
const LEAST_WEIGHT: f32 = 0.02;

/// What a camera shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen {
    /// Numbers of the Gaussians it shows, in a sample of every so-many-th of the scene.
    pub rows: Vec<u32>,
    /// Gaussians of the sample.
    pub sampled: usize,
    /// Part of the light that passes everything, 0 to 1.
    pub open: f32,
    /// Part of the pixels with something nearer than `clearance`, 0 to 1.
    pub near: f32,
}

/// Looks through a camera at a scene, in a picture of at most 96 pixels a side.
///
/// # Errors
/// What the renderer refuses.
pub fn seen_in(gaussians: &Gaussians, view: &View, clearance: f32) -> Result<Seen, CollectError> {
    let small = shrunk(view);
    let request = RenderRequest {
        contributions: true,
        depth: DepthRequest { median: true, ..DepthRequest::default() },
        ..RenderRequest::default()
    };
    let rendered = render(gaussians, &small, &RasterSettings::default(), &request)?;
    let step = gaussians.len().div_ceil(SAMPLE).max(1);
    let weights = rendered.contributions.map(|c| c.sum).unwrap_or_default();
    let sampled: Vec<f32> = weights.into_iter().step_by(step).collect();
    let rows = (0..).zip(&sampled).filter(|(_, w)| **w >= LEAST_WEIGHT).map(|(i, _)| i).collect();
    let pixels = rendered.transmittance.len().max(1) as f32;
    let depth = rendered.depth_median.unwrap_or_default();
    let near = depth.iter().filter(|d| **d > 0.0 && **d < clearance).count() as f32 / pixels;
    let open = rendered.transmittance.iter().sum::<f32>() / pixels;
    Ok(Seen { rows, sampled: sampled.len(), open, near })
}

fn shrunk(view: &View) -> View {
    let longer = view.width.max(view.height);
    if longer <= SIDE {
        return *view;
    }
    let size = |side: u32| ((u64::from(side) * u64::from(SIDE) / u64::from(longer)) as u32).max(1);
    let (width, height) = (size(view.width), size(view.height));
    let (x, y) = (width as f32 / view.width as f32, height as f32 / view.height as f32);
    View {
        fx: view.fx * x,
        fy: view.fy * y,
        cx: view.cx * x,
        cy: view.cy * y,
        width,
        height,
        ..*view
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::segmenter::tests::view;

    #[test]
    fn a_small_picture_keeps_what_the_camera_sees() {
        let large = View { fx: 100.0, fy: 210.0, cx: 90.0, cy: 50.0, ..view(192, 120) };
        // 96 of 192 columns: half of everything.
        let small = shrunk(&large);
        assert_eq!((small.width, small.height), (96, 60));
        assert_eq!([small.fx, small.fy, small.cx, small.cy], [50.0, 105.0, 45.0, 25.0]);
        assert_eq!(small.world_to_camera, large.world_to_camera);
        // A tall one: ⌊50 · 96 / 640⌋ = 7 columns, at least one.
        let tall = shrunk(&View { fx: 100.0, cx: 30.0, ..view(50, 640) });
        assert_eq!((tall.width, tall.height, tall.fx, tall.cx), (7, 96, 14.0, 30.0 * 0.14));
        assert_eq!(shrunk(&view(2, 500)).width, 1);
        assert_eq!(shrunk(&view(96, 40)), view(96, 40));
    }

    #[test]
    fn what_is_seen_is_counted_in_pixels_and_every_so_many_rows() {
        // A wall of depth 3 over the left half, a panel of depth 1 over a quarter of it, and many behind the camera.
        let mut means = Vec::new();
        for (depth, columns, rows) in [(3.0, 0..24, 0..36), (1.0, 0..12, 0..18)] {
            for (x, y) in columns.flat_map(|x| rows.clone().map(move |y| (x, y))) {
                let place = |i: i32, c: f32| (i as f32 + 0.5 - c) / 48.0 * depth;
                means.push([place(x, 24.0), place(y, 18.0), depth]);
            }
        }
        let shown = means.len();
        means.resize(40_001, [0.0, 0.0, -5.0]);
        let n = means.len();
        let of = |means: Vec<[f32; 3]>| {
            let n = means.len();
            let scales = means.iter().map(|m| [m[2].abs() / 48.0; 3]).collect();
            Gaussians {
                means,
                quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
                scales,
                opacities: vec![0.95; n],
                sh: vec![0.0; 3 * n],
                sh_degree: 0,
            }
        };
        let camera = view(48, 36);
        let near = |found: f32, want: f32| assert!((found - want).abs() < 0.04, "{found} {want}");
        // Up to 40,000 all are looked at, from there on every second one: of 40,001 the half, rounded up.
        let few = seen_in(&of(means[..shown].to_vec()), &camera, 2.0).unwrap();
        let many = seen_in(&of(means), &camera, 2.0).unwrap();
        assert_eq!((few.sampled, many.sampled), (shown, n.div_ceil(2)));
        let halves: Vec<u32> = few.rows.iter().filter(|i| **i % 2 == 0).map(|i| i / 2).collect();
        assert_eq!(many.rows, halves);
        near(few.open, 0.5);
        near(few.near, 0.125);
        assert!(few.near > 0.0 && (few.near - many.near).abs() < 1e-6);
        near(seen_in(&of(vec![[0.0, 0.0, -1.0]]), &camera, 2.0).unwrap().open, 1.0);
        // All that the panel does not hide, and no more than that; the rest of the wall is seen as a whole.
        let hidden = |i: u32| i < 864 && i / 36 < 10 && i % 36 < 16;
        assert!(few.rows.len() > 800 && few.rows.iter().all(|i| !hidden(*i)), "{}", few.rows.len());
        assert!(few.rows.iter().any(|i| *i >= 864));
        assert_eq!(seen_in(&of(vec![[0.0, 0.0, 2.0]]), &camera, 1.9).unwrap().near, 0.0);
    }
}
