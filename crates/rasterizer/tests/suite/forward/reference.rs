//! Pictures of random scenes are those of the f64 reference.

use crate::support::reference::{Params, forward};
use crate::support::{random, view};
use scenesplat_rasterizer::*;

/// Compares a render with the reference outside doubtful pixels.
pub fn compare(g: &Gaussians, view: &View, settings: &RasterSettings) {
    let depth = DepthRequest { accumulated: true, ..DepthRequest::default() };
    let request = RenderRequest { depth, ..RenderRequest::rgb() };
    let got = render(g, view, settings, &request).unwrap();
    let expected = forward(&Params::from(g), view, settings, None);
    let (rgb, depth) = (got.rgb.unwrap(), got.depth_accumulated.unwrap());
    let mut doubtful = 0;
    for i in 0..view.pixels() {
        if expected.doubtful[i] {
            doubtful += 1;
            continue;
        }
        for k in 0..3 {
            let (a, b) = (f64::from(rgb[3 * i + k]), expected.rgb[i][k]);
            assert!((a - b).abs() < 3e-5, "rgb {k} of pixel {i}: {a}, not {b}");
        }
        let t = f64::from(got.transmittance[i]) - (1.0 - expected.alpha[i]);
        assert!(t.abs() < 3e-5, "transmittance of pixel {i} off by {t}");
        let z = f64::from(depth[i]) - expected.depth[i];
        assert!(z.abs() < 2e-4, "depth of pixel {i} off by {z}");
    }
    assert!(10 * doubtful <= 2 * view.pixels() + 20, "{doubtful} pixels are not compared");
}

#[test]
fn random_scenes() {
    for (rows, seed) in [(0, 1), (1, 2), (2, 3), (30, 4), (200, 5)] {
        let scene = random(rows, seed);
        for (width, height) in [(1, 1), (16, 16), (17, 33), (50, 40)] {
            let settings = RasterSettings::default();
            compare(&scene, &view(width, height), &settings);
            let antialiased = RasterSettings { antialiased: true, ..settings };
            compare(&scene, &view(width, height), &antialiased);
        }
    }
}
