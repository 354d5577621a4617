//! Depths value by value: steps, lenses of their own, shapes, and distances.

use super::super::depth::{DepthMap, read_distance, read_pgm_depth};
use super::*;

fn values(depth: &FrameDepth) -> (u32, u32, &[u16]) {
    let Samples::Sixteen(values) = depth.picture.samples() else { panic!("16 bits") };
    (depth.picture.width(), depth.picture.height(), values)
}

fn map(size: [u32; 2], values: Vec<u16>) -> DepthMap {
    DepthMap { size, values, too_far: 3 }
}

fn lens(focal: [f64; 2], centre: [f64; 2], size: Option<[u32; 2]>) -> Lens {
    Lens { focal, centre, size, from_below: false }
}

#[test]
fn steps_and_meters_become_whole_millimeters() {
    // 25 mm; 1.75 mm; 10.25 m; unknown twice.
    let found = DepthMap::of_steps([5, 1], vec![100, 7, 41_000, 0, u16::MAX], 4000.0);
    assert_eq!((found.size, found.values, found.too_far), ([5, 1], vec![25, 2, 10_250, 0, 0], 0));
    let found = DepthMap::of_steps([3, 1], vec![65_534, u16::MAX, 1], 1000.0);
    assert_eq!((found.values, found.too_far), (vec![65_534, 0, 1], 0));
    // 65.53 m, and 65.54 m and 80 m, which 16 bits of millimeters do not hold.
    let found = DepthMap::of_steps([3, 1], vec![6553, 6554, 8000], 100.0);
    assert_eq!((found.values, found.too_far), (vec![65_530, 0, 0], 2));
    let meters = [65.5344, 65.5346, -1.0, f64::NAN, f64::INFINITY, 0.0004, 0.0006, 1.2346];
    let found = DepthMap::of_metres([4, 2], meters.into_iter());
    assert_eq!((found.size, found.too_far), ([4, 2], 1));
    assert_eq!(found.values, [65_534, 0, 0, 0, 0, 0, 1, 1235]);
}

#[test]
fn a_depth_stays_where_its_lens_is_within_a_pixel_of_the_colors() {
    let path = Path::new("a");
    let color = lens([10.0, 6.0], [8.0, 6.0], Some([16, 12]));
    // Of half the size, 8 × 6: focal lengths 5 and 3, centered at (4, 3).
    let own = |focal, centre| Some(lens(focal, centre, Some([8, 6])));
    for (own, resampled) in [
        (None, false),
        (own([5.0, 3.0], [4.0, 3.0]), false),
        (own([5.0, 3.0], [5.0, 2.0]), false),
        (own([5.0, 3.0], [5.01, 3.0]), true),
        (own([5.0, 3.0], [4.0, 1.99]), true),
        // At the left and the right edge off by 4 · 0.26 pixels, at the upper and the lower by 3 · 0.34.
        (own([6.3, 3.0], [4.0, 3.0]), true),
        (own([5.0, 4.02], [4.0, 3.0]), true),
        // Off at one edge alone: right, left, lower, upper.
        (own([5.7, 3.0], [4.5, 3.0]), true),
        (own([5.7, 3.0], [3.5, 3.0]), true),
        (own([5.0, 3.6], [4.0, 3.5]), true),
        (own([5.0, 3.6], [4.0, 2.5]), true),
        (own([f64::NAN, 3.0], [4.0, 3.0]), true),
    ] {
        let found = map([8, 6], (1..49).collect()).fit(color, own, path).unwrap();
        assert_eq!((found.resampled, found.too_far), (resampled, 3), "{own:?}");
        let (w, h, values) = values(&found);
        assert_eq!((w, h), (8, 6), "{own:?}");
        assert_eq!(values.iter().copied().eq(1..49), !resampled, "{own:?}");
    }
    let other = Some(lens([5.0, 3.0], [4.0, 3.0], Some([6, 8])));
    let error = map([8, 6], vec![0; 48]).fit(color, other, path).unwrap_err();
    assert!(chain(&error).contains("its depth is 8 × 6, its depth camera is for 6 × 8"));
    let error = map([6, 8], vec![0; 48]).fit(color, None, path).unwrap_err();
    assert!(chain(&error).contains("is 16 × 12, its depth 6 × 8"), "{}", chain(&error));
    let error = map([8, 6], vec![0; 47]).fit(color, None, path).unwrap_err();
    assert!(chain(&error).contains("has not 8 × 6 values"));
}

#[test]
fn a_depth_of_another_lens_is_read_at_the_places_of_the_colors_pixels() {
    let path = Path::new("a");
    // For 4 × 3 pixels the color's focal lengths are 2 and 1.5, its center (1, 0.75).
    let color = lens([4.0, 3.0], [2.0, 1.5], Some([8, 6]));
    // Columns (x + 0.5 − 1) / 2 · 3 + 2.2 = 1.45, 2.95, 4.45, 5.95, of which 0 to 4 are there; rows
    // (y + 0.5 − 0.75) / 1.5 · 2 + 1.1 = 0.77, 2.1, 3.43, of which 0 to 3 are there.
    let own = lens([3.0, 2.0], [2.2, 1.1], None);
    let found = map([4, 3], (1..13).collect()).fit(color, Some(own), path).unwrap();
    assert_eq!(values(&found), (4, 3, &[2, 3, 0, 0, 10, 11, 0, 0, 0, 0, 0, 0][..]));
    // Columns −1.75, −0.25, 1.25, 2.75 and rows −0.73, 0.6, 1.93: what is just outside is outside.
    let own = lens([3.0, 2.0], [-1.0, -0.4], None);
    let found = map([4, 3], (1..13).collect()).fit(color, Some(own), path).unwrap();
    assert_eq!(values(&found), (4, 3, &[0, 0, 0, 0, 0, 0, 2, 3, 0, 0, 6, 7][..]));
    // Another shape: 4 × 2 with focal lengths of a half and a quarter of the color's. The finer is a half, so 8 × 6
    // become 4 × 3, of whose rows y the map's are (y + 0.5 − 1.5) / 2 · 1 + 1 = 0.5, 1, 1.5.
    let color = lens([4.0, 4.0], [4.0, 3.0], Some([8, 6]));
    let own = lens([2.0, 1.0], [2.0, 1.0], Some([4, 2]));
    let found = map([4, 2], (1..9).collect()).fit(color, Some(own), path).unwrap();
    assert_eq!(values(&found), (4, 3, &[1, 2, 3, 4, 5, 6, 7, 8, 5, 6, 7, 8][..]));
    assert!(found.resampled && found.too_far == 3);
    // Never more pixels than the picture has, nor fewer than one a side.
    for (focal, size) in [([9.0, 1.0], (8, 6)), ([1e-9, 1e-9], (1, 1)), ([1.0, f64::NAN], (2, 2))] {
        let own = lens(focal, [2.0, 1.0], Some([4, 2]));
        let found = map([4, 2], (1..9).collect()).fit(color, Some(own), path).unwrap();
        let (w, h, _) = values(&found);
        assert_eq!((w, h), size, "{focal:?}");
    }
}

#[test]
fn distances_and_binary_maps_are_read_pixel_by_pixel() {
    let mini = Mini::new();
    // Two rows of three pixels; the lens is of pictures of 6 × 4, so here its focal lengths are 1 and 2, its center
    // (1.25, 0.5).
    mini.hdf5("d.hdf5", &[1.0, 2.0, 3.0, 4.0, 5.0, 0.0], &[2, 3]);
    let own = lens([2.0, 4.0], [2.5, 1.0], Some([6, 4]));
    let found = read_distance(&mini.at("d.hdf5"), own).unwrap();
    let along = |at: usize, distance: f64| {
        let x = ((at % 3) as f64 + 0.5 - 1.25) / 1.0;
        let y = ((at / 3) as f64 + 0.5 - 0.5) / 2.0;
        (1000.0 * distance / (1.0 + x * x + y * y).sqrt()).round() as u16
    };
    let want: Vec<u16> =
        [1.0, 2.0, 3.0, 4.0, 5.0, 0.0].into_iter().enumerate().map(|(i, d)| along(i, d)).collect();
    assert_eq!((found.size, found.values), ([3, 2], want));
    // Without a size of its own the lens is of the map's pixels.
    let own = lens([1.0, 2.0], [1.25, 0.5], None);
    assert_eq!(read_distance(&mini.at("d.hdf5"), own).unwrap().values[0], along(0, 1.0));
    mini.hdf5("d.hdf5", &[1.0; 6], &[2, 3, 1]);
    let error = read_distance(&mini.at("d.hdf5"), own).unwrap_err();
    assert!(chain(&error).contains("[height, width]"));

    let pgm = |head: &str, bytes: &[u8]| {
        mini.write("a.pgm", [head.as_bytes(), bytes].concat());
        read_pgm_depth(&mini.at("a.pgm"), 2000.0).map_err(|error| chain(&error))
    };
    // 0x0102 = 258 steps of half a millimeter, and 0x0010 = 16.
    let found = pgm("P5\n#a\n2 #b\n1\n256\n", &[1, 2, 0, 16]).unwrap();
    assert_eq!((found.size, found.values), ([2, 1], vec![129, 8]));
    assert!(pgm("P5 2 1 255\n", &[1, 2]).unwrap_err().contains("up to 255"));
    assert!(pgm("P5 2 1 65536\n", &[1; 4]).unwrap_err().contains("up to 65536"));
    for bytes in [3, 5, 6] {
        let error = pgm("P5 2 1 65535\n", &vec![1; bytes]).unwrap_err();
        assert!(error.contains(&format!("2 × 1 pixels and holds {bytes} bytes")), "{error}");
    }
    assert!(pgm("P5 0 1 65535\n", &[]).unwrap_err().contains("0 × 1 pixels"));
    for head in ["P5 2 x 65535\n", "P5 2 1 65535x", "P5 2 1", "P2 2 1 65535\n"] {
        assert!(pgm(head, &[1; 4]).unwrap_err().contains("no binary PGM"), "{head:?}");
    }
}
