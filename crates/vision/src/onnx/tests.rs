//! Tiny ONNX files (`benches/pytorch/onnx_miniature.py`) whose answers are known. They need the library of ONNX Runtime: its
//! file is named by `SCENESPLAT_ONNXRUNTIME`; without it they say "NOT RUN".
#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

use super::*;
use crate::masks::{AutomaticMasks, ClickNetwork, Level, MaskSettings};
use scenesplat_scene::picture::RgbPicture;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    scenesplat_test_support::repository().join("crates/vision/tests/data/onnx").join(name)
}

fn runtime() -> Option<OnnxRuntime> {
    let Ok(library) = std::env::var("SCENESPLAT_ONNXRUNTIME") else {
        println!("NOT RUN: SCENESPLAT_ONNXRUNTIME does not name the library of ONNX Runtime");
        return None;
    };
    Some(OnnxRuntime::load(Some(Path::new(&library))).unwrap())
}

const RED: [u8; 3] = [210, 40, 40];
const BLUE: [u8; 3] = [40, 60, 200];
const GREY: [u8; 3] = [128, 128, 128];
const OTHER_GREY: [u8; 3] = [136, 128, 128];

/// A red and a blue rectangle on two grays, on borders of 4 × 4 pixels.
fn picture() -> RgbPicture {
    RgbPicture::from_fn(64, 64, |x, y| match (x, y) {
        (8..=27, 8..=39) => RED,
        (36..=55, 20..=51) => BLUE,
        (44.., ..=15) => OTHER_GREY,
        _ => GREY,
    })
}

/// As SAM 2 sees a color.
fn standardised(color: [u8; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| (f32::from(color[c]) / 255.0 - crate::sam2::MEAN[c]) / crate::sam2::STD[c])
}

/// The logit that `decoder.onnx` gives where a color is, after a click on another.
fn logit(limit: f32, here: [u8; 3], clicked: [u8; 3]) -> f32 {
    let (a, b) = (standardised(here), standardised(clicked));
    let apart = (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>();
    (40.0 * (limit - apart)).clamp(-16.0, 16.0)
}

#[test]
fn clicks_are_answered_as_the_file_says() {
    let Some(runtime) = runtime() else { return };
    let picture = picture();
    // The blue one, the red one and gray; one more than a lot of the file with a fixed number.
    let clicks = [[45.0, 30.0], [17.0, 25.0], [3.0, 60.0], [40.0, 40.0], [54.0, 5.0]];
    let colors = [BLUE, RED, GREY, BLUE, OTHER_GREY];
    for (folder, kinds, first) in [("", 3, 0.4), ("fixed", 4, 0.1)] {
        let network = OnnxClicks::open(&runtime, &data(folder)).unwrap();
        assert_eq!(network.mask_side(), 32);
        let seen = network.see(&picture).unwrap();
        let found = network.click(&seen, &clicks).unwrap();
        assert_eq!(found.len(), 5);
        for (answer, clicked) in found.iter().zip(colors) {
            // Of three masks the surest stands in for the one without a choice.
            assert_eq!(answer.iou, [if kinds == 3 { 0.95 } else { 0.7 }, 0.75, 0.85, 0.95]);
            for (kind, limit) in [first, 0.05, 0.2, 0.4].into_iter().enumerate() {
                for (x, y) in [(2, 2), (8, 8), (20, 20), (13, 19), (25, 3)] {
                    let here = picture.get(2 * x, 2 * y).unwrap();
                    let got = answer.logits[(kind * 32 + y as usize) * 32 + x as usize];
                    let want = logit(limit, here, clicked);
                    assert!((got - want).abs() < 1e-3, "{kind} {x} {y}: {got} {want}");
                }
            }
        }
    }
}

#[test]
fn the_mask_generator_finds_what_is_planted() {
    let Some(runtime) = runtime() else { return };
    let network = OnnxClicks::open(&runtime, &data("")).unwrap();
    let settings = MaskSettings {
        points_per_side: 8,
        stability_offset: 1.0,
        level: Level::Whole,
        ..MaskSettings::original()
    };
    let picture = picture();
    let masks = AutomaticMasks::new(&network, settings).unwrap().generate(&picture).unwrap();
    assert_eq!(masks.len(), 3);
    for colors in [&[RED][..], &[BLUE], &[GREY, OTHER_GREY]] {
        let iou = masks.iter().map(|found| {
            let (mut both, mut either) = (0, 0);
            for (x, y) in (0..64 * 64).map(|at| (at % 64, at / 64)) {
                let (a, b) =
                    (found.mask.contains(x, y), colors.contains(&picture.get(x, y).unwrap()));
                both += u32::from(a && b);
                either += u32::from(a || b);
            }
            f64::from(both) / f64::from(either)
        });
        let best = iou.fold(0.0, f64::max);
        assert!(best >= 0.9, "{colors:?}: {best}");
    }
}

#[test]
fn vectors_are_those_of_the_file_and_unit() {
    let Some(runtime) = runtime() else { return };
    let encoder = OnnxEncoder::open(&runtime, &data("features.onnx")).unwrap();
    assert_eq!((encoder.width(), encoder.image_size()), (5, 32));
    let halves = RgbPicture::from_fn(32, 32, |x, _| if x < 16 { RED } else { BLUE });
    let one = encoder.encode(std::slice::from_ref(&halves)).unwrap();
    // Means and mean squares of (v / 255 − ½) / ½, by hand.
    let s = |v: u8| (f64::from(v) / 255.0 - 0.5) / 0.5;
    let mean = |c: usize| (s(RED[c]) + s(BLUE[c])) / 2.0;
    let square = |c: usize| (s(RED[c]).powi(2) + s(BLUE[c]).powi(2)) / 2.0;
    let want = [mean(0), mean(1), mean(2), square(0), square(1)];
    let length = want.iter().map(|v| v * v).sum::<f64>().sqrt();
    for (got, want) in one.iter().zip(want) {
        assert!((f64::from(*got) - want / length).abs() < 1e-5, "{one:?}");
    }
    // More than go through at once: each has its own.
    let many: Vec<RgbPicture> =
        (0..11).map(|i| if i % 3 == 0 { halves.clone() } else { picture() }).collect();
    let rows = encoder.encode(&many).unwrap();
    assert_eq!(rows[15..20], one[..]);
    assert_ne!(rows[5..10], one[..]);
    let error = encoder.encode(&[RgbPicture::filled(0, 3, [0; 3])]).unwrap_err().to_string();
    assert!(error.contains("0 × 3") || error.contains("0×3"), "{error}");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let Some(runtime) = runtime() else { return };
    let dir = tempfile::tempdir().unwrap();
    let put = |from: &str, to: &str| {
        std::fs::copy(data(from), dir.path().join(to)).unwrap();
    };
    let refused = |parts: &[&str]| {
        let error = OnnxClicks::open(&runtime, dir.path()).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{parts:?}: {error}");
    };
    refused(&["encoder.onnx", "is no file"]);
    put("encoder.onnx", "encoder.onnx");
    refused(&["decoder.onnx", "is no file"]);
    put("encoder.onnx", "decoder.onnx");
    refused(&["decoder.onnx", "point_coords"]);
    put("features.onnx", "encoder.onnx");
    put("decoder.onnx", "decoder.onnx");
    refused(&["decoder.onnx", "\"image_embed\" is no output of encoder.onnx"]);
    put("decoder.onnx", "encoder.onnx");
    refused(&["encoder.onnx", "6 inputs"]);
    let whole = std::fs::read(data("encoder.onnx")).unwrap();
    std::fs::write(dir.path().join("encoder.onnx"), &whole[..whole.len() / 2]).unwrap();
    refused(&["encoder.onnx", "ONNX Runtime refuses it"]);
    let error = OnnxEncoder::open(&runtime, &data("decoder.onnx")).unwrap_err().to_string();
    assert!(error.contains("decoder.onnx") && error.contains("6 inputs"), "{error}");
    // What is beside the file has to fit it.
    put("features.onnx", "features.onnx");
    std::fs::write(
        dir.path().join("preprocessor_config.json"),
        r#"{"size": {"height": 48, "width": 48}}"#,
    )
    .unwrap();
    let error = OnnxEncoder::open(&runtime, &dir.path().join("features.onnx")).unwrap_err();
    assert!(error.to_string().contains("48 × 48"), "{error}");
    // One library in a process.
    let error = OnnxRuntime::load(Some(Path::new("libother.so"))).unwrap_err().to_string();
    assert!(error.contains("libother.so") && error.contains("is already"), "{error}");
}

#[test]
fn a_library_that_is_not_there_is_said() {
    let error = OnnxRuntime::load(Some(Path::new("no/such/libonnxruntime.so"))).unwrap_err();
    let text = error.to_string();
    // Where another test has loaded one, that is what is said.
    assert!(text.contains("no/such/libonnxruntime.so"), "{text}");
    assert!(text.contains("is no file") || text.contains("is already"), "{text}");
}
