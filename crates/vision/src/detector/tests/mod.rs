#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod boxes;
mod files;
mod layers;

use super::*;
use scenesplat_test_support::graph_file::{GraphFile, miniature_detector};
use serde_json::{Value, json};

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[test]
fn a_miniature_finds_a_cup_and_a_chair() {
    let folder = tempfile::tempdir().unwrap();
    let path = miniature_detector().write(folder.path());
    let settings = DetectorSettings { tiles: 1, ..DetectorSettings::default() };
    let detector = Detector::open(&path, settings).unwrap();
    assert_eq!(detector.bytes(), 4 * (4 + 32 * 32 * 3 * 124 + 124 + 1 + 1 + 3 + 2 + 1));
    assert_eq!(detector.files(), [path, folder.path().join("made.bin")]);
    // Blue in the place of column 4, row 2, red in that of column 9, row 7; black elsewhere.
    let picture = RgbPicture::from_fn(416, 416, |x, y| match (x / 32, y / 32) {
        (4, 2) => [0, 0, 255],
        (9, 7) => [250, 0, 0],
        _ => [0; 3],
    });
    let found = detector.detect(&picture).unwrap();
    let black = [-103.53 / 57.375, -123.675 / 58.395];
    let cup = sigmoid((255.0 - 103.53) / 57.375 - 2.0);
    let chair = sigmoid((250.0 - 123.675) / 58.395 - 1.0);
    let near = |a: &Detection, area: [f32; 4], scores: [(usize, f32); 1]| {
        assert!((0..4).all(|k| (a.area[k] - area[k]).abs() < 1e-3), "{:?} is not {area:?}", a.area);
        let same = a.scores.iter().zip(scores).all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-5);
        assert!(same, "{:?} is not {scores:?}", a.scores);
    };
    assert_eq!(found.len(), 2);
    // Middles at (304, 240) and (144, 80); one stride to the left, none up, two to the right, three down.
    near(&found[0], [272.0, 240.0, 368.0, 336.0], [(56, chair)]);
    near(&found[1], [112.0, 80.0, 208.0, 176.0], [(41, cup)]);
    // The other class of each, as black as elsewhere, is kept where it is 0.05 or more.
    assert_eq!(found[0].scores.len(), 1 + usize::from(sigmoid(black[0] - 2.0) >= 0.05));
    assert_eq!(found[1].scores.len(), 1 + usize::from(sigmoid(black[1] - 1.0) >= 0.05));
    assert_eq!([found[0].class(), found[1].class()].map(|class| COCO[class]), ["chair", "cup"]);

    // Twice as wide: the same in pixels that are twice as wide; boxes end with the picture.
    let wide = RgbPicture::from_fn(832, 416, |x, y| picture.get(x / 2, y).unwrap());
    near(&detector.detect(&wide).unwrap()[0], [544.0, 240.0, 736.0, 336.0], [(56, chair)]);
    let corner =
        RgbPicture::from_fn(416, 416, |x, y| [if x >= 384 && y >= 384 { 250 } else { 0 }, 0, 0]);
    near(&detector.detect(&corner).unwrap()[0], [368.0, 400.0, 416.0, 416.0], [(56, chair)]);
    // Nothing in the dark.
    assert_eq!(detector.detect(&RgbPicture::filled(64, 48, [0; 3])).unwrap(), []);
}

#[test]
fn tiles_look_closer_and_leave_out_what_they_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = miniature_detector().write(folder.path());
    let open =
        |tiles| Detector::open(&path, DetectorSettings { tiles, ..DetectorSettings::default() });
    // A red spot of 24 pixels at (1016, 1016) of 1248: the whole picture has a place each 96 pixels, whose middles are
    // 48 + 96 k; its pixel there is a mean of 3 × 3. Tiles of 832 have a place each 64.
    let picture = RgbPicture::from_fn(1248, 1248, |x, y| {
        let near = |v: u32, middle: u32| v.abs_diff(middle) < 12;
        if near(x, 928) && near(y, 928) { [255, 0, 0] } else { [0; 3] }
    });
    assert_eq!(open(1).unwrap().detect(&picture).unwrap(), []);
    let found = open(2).unwrap().detect(&picture).unwrap();
    // The tile at (416, 416) has a middle at 416 + 32 + 64 * 7 + … : 416 + (7 + 0.5) * 64 = 896, (8 + 0.5) * 64 + 416 = 960.
    assert_eq!(found, [], "no middle of a place is on the spot");
    let found = open(3).unwrap().detect(&picture).unwrap();
    // Tiles of 624 at 0, 312, 624: middles at 24 + 48 k from there: 624 + 24 + 48 * 6 = 936 is on it.
    let [chair] = &*found else { panic!("{found:?}") };
    assert_eq!((chair.class(), chair.area), (56, [888.0, 936.0, 1032.0, 1080.0]));

    assert_eq!(tiles(1248, 1248, 3).len(), 9);
    assert_eq!(
        tiles(640, 480, 2),
        [[0, 0, 427, 320], [213, 0, 427, 320], [0, 160, 427, 320], [213, 160, 427, 320]]
    );
    assert_eq!((tiles(416, 416, 2), tiles(640, 480, 1)), (vec![], vec![]));
    let cut = |area| is_cut(area, [213, 160, 427, 320], [640, 480]);
    assert!(cut([214.0, 200.0, 300.0, 300.0]) && cut([300.0, 165.0, 400.0, 300.0]));
    // At the picture's own sides a box may end, and the tile in the other corner has other sides.
    assert!(!cut([300.0, 200.0, 640.0, 480.0]));
    assert!(is_cut([0.0, 0.0, 426.0, 100.0], [0, 0, 427, 320], [640, 480]));
    assert!(is_cut([0.0, 0.0, 100.0, 316.0], [0, 0, 427, 320], [640, 480]));
}

/// Against TensorFlow.js (its CPU backend, `benches/detector.mjs`), with the real file if there is one: sums of each
/// output, weighted by place, and single values.
#[test]
fn the_published_network_has_the_values_of_tensorflow_js() {
    let Some(path) = std::env::var_os("SCENESPLAT_DETECTOR") else {
        println!("NOT RUN: SCENESPLAT_DETECTOR does not name nanodet.json");
        return;
    };
    let detector = Detector::open(Path::new(&path), DetectorSettings::default()).unwrap();
    let value = |at: usize| {
        let (c, y, x) = (at / (SIDE * SIDE), at / SIDE % SIDE, at % SIDE);
        let v = (c * 131 + y * 17 + x * 29 + (y / 37) * (x / 53) * 41) % 256;
        v as f32 / 64.0 - 2.0
    };
    let input = Tensor::floats(vec![1, 3, SIDE, SIDE], (0..3 * SIDE * SIDE).map(value).collect());
    let outputs = detector.graph.run(input).unwrap();
    let wanted: [(usize, usize, f64, f64, [f32; 4]); 6] = [
        (2704, 80, 728.210_491, -0.364_508, [0.016856, 0.003328, 0.009731, 0.004659]),
        (676, 80, 270.053_223, -0.125_742, [0.008203, 0.005354, 0.007412, 0.006504]),
        (169, 80, 187.048_018, -0.098_026, [0.012377, 0.020556, 0.02052, 0.009058]),
        (2704, 44, 104_291.941_807, 21.140_035, [3.244869, 0.954561, -1.316628, -0.413058]),
        (676, 44, 14_718.208_686, 5.899_893, [-0.120243, 0.155482, -0.647649, -0.641992]),
        (169, 44, 7_755.683_860, 6.680_921, [0.025236, 0.893377, 7.249552, -1.218231]),
    ];
    let mut worst = 0f64;
    for (places, width, sum, weighted, probes) in wanted {
        let found = outputs.iter().find(|(_, t)| t.shape == [1, places, width]).unwrap();
        let values = found.1.as_floats().unwrap();
        let all = places * width;
        for (at, want) in [0, all / 3, all / 2 + 7, all - 1].into_iter().zip(probes) {
            worst = worst.max(f64::from((values[at] - want).abs()));
        }
        let total: f64 = values.iter().map(|v| f64::from(v.abs())).sum();
        assert!((total - sum).abs() < 1e-4 * sum, "{places}: {total}");
        let weight = |at: usize| ((at * 7919) % 1009) as f64 / 1009.0 - 0.5;
        let total: f64 = values.iter().enumerate().map(|(at, v)| f64::from(*v) * weight(at)).sum();
        assert!((total - weighted).abs() < 1e-5 * sum, "{places}: {total}");
    }
    println!("largest difference of single values {worst:.1e}");
    assert!(worst < 1e-4, "{worst}");
}
