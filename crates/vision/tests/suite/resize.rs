//! Resizing against Pillow.

use scenesplat_scene::picture::RgbPicture;
use scenesplat_vision::resize::{Filter, resize, resize_planes};

/// Checksums that `benches/pytorch/pillow_resize.py` wrote.
const PILLOW: &str = include_str!("../data/pillow_resize.csv");

fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |code, byte| {
        (code ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3)
    })
}

/// The picture of the script.
fn picture(width: u32, height: u32) -> RgbPicture {
    let mut state = u64::from(width) * 65537 + u64::from(height);
    let mut next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    };
    let pixels = (0..width * height).map(|i| {
        std::array::from_fn(|_| {
            let value = next();
            if i % width % 16 < 8 { 255 * (value >> 63) as u8 } else { (value >> 56) as u8 }
        })
    });
    RgbPicture::from_pixels(width, height, pixels.collect()).unwrap()
}

#[test]
fn equal_to_pillow_to_the_bit() {
    let mut sizes = 0;
    for line in PILLOW.lines().filter(|line| !line.starts_with('#')) {
        let cells: Vec<&str> = line.split(',').collect();
        let size: Vec<u32> = cells[1..5].iter().map(|v| v.parse().unwrap()).collect();
        let filter = if cells[0] == "bicubic" { Filter::Bicubic } else { Filter::Bilinear };
        let small = resize(&picture(size[0], size[1]), size[2], size[3], filter).unwrap();
        let code = fnv(small.pixels().as_flattened());
        assert_eq!(format!("{code:016x}"), cells[5], "{line}");
        sizes += 1;
    }
    assert_eq!(sizes, 100, "50 sizes, two filters");
}

#[test]
fn planes_differ_from_the_picture_by_rounding_alone() {
    for (width, height) in [(97, 61), (640, 480), (20, 31)] {
        let from = picture(width, height);
        let eight = resize(&from, 128, 96, Filter::Bilinear).unwrap();
        let planes = resize_planes(&from, 128, 96, Filter::Bilinear).unwrap();
        for (i, pixel) in eight.pixels().iter().enumerate() {
            for c in 0..3 {
                let exact = 255.0 * planes[c * 128 * 96 + i];
                // Half a step of each of the two passes.
                assert!((exact - f32::from(pixel[c])).abs() <= 1.001, "pixel {i} of {c}");
            }
        }
    }
}

#[test]
fn planes_by_hand() {
    // Two pixels to one: the triangle of width 4 weighs them alike. One to two: each is the one.
    let two = RgbPicture::from_pixels(2, 1, vec![[0, 51, 255], [255, 153, 255]]).unwrap();
    assert_eq!(resize_planes(&two, 1, 1, Filter::Bilinear).unwrap(), [0.5, 0.4, 1.0]);
    // Two to four: 1, ¾·1 + ¼·2, …
    let wide = resize_planes(&two, 4, 1, Filter::Bilinear).unwrap();
    for (got, want) in wide[..4].iter().zip([0.0, 0.25, 0.75, 1.0]) {
        assert!((got - want).abs() < 1e-7, "{wide:?}");
    }
}

#[test]
fn sizes_without_pixels_are_refused() {
    let one = picture(1, 1);
    for (width, height) in [(0, 5), (5, 0), (1 << 20, 1 << 20)] {
        let error = resize(&one, width, height, Filter::Bilinear).unwrap_err().to_string();
        assert!(error.contains(&format!("{width} × {height}")), "{error}");
    }
    let empty = RgbPicture::filled(0, 3, [0; 3]);
    assert!(resize_planes(&empty, 4, 4, Filter::Bilinear).is_err());
}

#[test]
fn planes_are_the_definitions_in_f64() {
    // Wider and less high, so that the triangle is stretched along one axis alone; and the other way round.
    for (from, to) in [([23u32, 31u32], [40u32, 9u32]), ([31, 11], [7, 20])] {
        let picture = picture(from[0], from[1]);
        let planes = resize_planes(&picture, to[0], to[1], Filter::Bilinear).unwrap();
        let weight = |axis: usize, out: u32, i: u32| {
            let scale = f64::from(from[axis]) / f64::from(to[axis]);
            let middle = (f64::from(out) + 0.5) * scale;
            (1.0 - ((f64::from(i) + 0.5 - middle) / scale.max(1.0)).abs()).max(0.0)
        };
        let taps = |axis: usize, out: u32| -> Vec<f64> {
            let all: Vec<f64> = (0..from[axis]).map(|i| weight(axis, out, i)).collect();
            let sum: f64 = all.iter().sum();
            all.iter().map(|w| w / sum).collect()
        };
        for (i, got) in planes.iter().enumerate() {
            let (c, at) = (i / (to[0] * to[1]) as usize, i as u32 % (to[0] * to[1]));
            let (across, down) = (taps(0, at % to[0]), taps(1, at / to[0]));
            let mut want = 0.0;
            for (y, v) in (0..).zip(&down) {
                for (x, u) in (0..).zip(&across).filter(|(_, u)| **u > 0.0) {
                    want += v * u * f64::from(picture.get(x, y).unwrap()[c]) / 255.0;
                }
            }
            assert!((f64::from(*got) - want).abs() < 1e-5, "{from:?} {i}: {got} {want}");
        }
    }
}
