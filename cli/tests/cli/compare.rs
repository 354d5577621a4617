//! `compare`: numbers, pairing, messages.

use crate::{done, scenesplat, stderr};
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples};
use std::path::{Path, PathBuf};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a", "b"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn grey(&self, name: &str, value: u8) {
        let picture = RgbPicture::filled(32, 24, [value; 3]);
        std::fs::write(self.path(name), picture.encode_png().unwrap()).unwrap();
    }

    fn depth(&self, name: &str, value: impl Fn(u32) -> u16) {
        let values = (0..32 * 24).map(|i| value(i % 32)).collect();
        let picture = Picture::new(32, 24, Channels::Gray, Samples::Sixteen(values)).unwrap();
        std::fs::write(self.path(name), picture.encode_png().unwrap()).unwrap();
    }

    fn compare(&self, a: &str, b: &str, more: &[&str]) -> std::process::Output {
        let (a, b) = (self.path(a), self.path(b));
        let mut args = vec!["compare", a.to_str().unwrap(), b.to_str().unwrap(), "--quiet"];
        args.extend(more);
        scenesplat(&args)
    }
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn means_over_a_folder() {
    let place = Place::new();
    // Two pairs 51/255 = 0.2 apart, 13.98 dB; one that is identical; one of depths.
    place.grey("a/one.png", 51);
    place.grey("b/one.png", 0);
    place.grey("a/two.png", 51);
    place.grey("b/two.png", 102);
    place.grey("a/three.png", 9);
    place.grey("b/three.png", 9);
    place.depth("a/four.png", |x| if x == 0 { 0 } else { 1500 });
    place.depth("b/four.png", |x| if x == 1 { 0 } else { 2000 });
    let report = place.path("report.json");
    let output = place.compare("a", "b", &["--json", report.to_str().unwrap()]);
    done(&output);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for part in ["PSNR dB", "SSIM valid", "SSIM reflect", "SSIM zero", "13.979", "0.50000"] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
    assert!(text.contains("LPIPS skipped: weights not found"), "{text}");
    assert!(text.contains("1 identical"), "{text}");
    let report = json(&report);
    let images = report["images"].as_array().unwrap();
    let names: Vec<&str> = images.iter().map(|i| i["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["four.png", "one.png", "three.png", "two.png"]);
    let psnr = report["mean"]["psnr"].as_f64().unwrap();
    assert!((psnr - 13.9794).abs() < 1e-3, "{psnr}");
    assert_eq!((&images[2]["identical"], &images[2]["psnr"]), (&true.into(), &().into()));
    assert_eq!(images[2]["ssim_valid"].as_f64().map(|v| (v - 1.0).abs() < 1e-9), Some(true));
    assert_eq!(images[0]["depth_l1"].as_f64().map(|v| (v - 0.5).abs() < 1e-6), Some(true));
    assert_eq!(images[0]["depth_pixels"], 30 * 24);
    assert_eq!((&images[1]["lpips"], &report["mean"]["lpips"]), (&().into(), &().into()));
    assert_eq!(report["mean"]["identical"], 1);

    // One metric alone.
    let output = place.compare("a/one.png", "b/two.png", &["--metrics", "psnr"]);
    done(&output);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("13.979") && !text.contains("SSIM") && !text.contains("LPIPS"), "{text}");
}

/// A gray JPEG of 32 × 24 pixels, all 51: twelve blocks, the first −77 off the middle, the others as
/// the one before. A short file: quantisation by 8, one code for each table that is used.
fn jpeg() -> Vec<u8> {
    let mut out = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
    out.extend([8; 64]);
    out.extend([0xff, 0xc0, 0, 11, 8, 0, 24, 0, 32, 1, 1, 0x11, 0]);
    // Differences of 0 and 7 bits are the codes 0 and 10; "nothing follows" is the code 0.
    for (table, counts, values) in [(0, [1, 1], vec![0, 7]), (0x10, [1, 0], vec![0])] {
        out.extend([0xff, 0xc4, 0, 19 + values.len() as u8, table]);
        out.extend(counts);
        out.extend([0; 14]);
        out.extend(values);
    }
    out.extend([0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0]);
    // 10, then −77 in seven bits (127 − 77 = 50), 0; then eleven times 0 and 0; ones to the end.
    let bits = format!("10{:07b}0{}", 50, "00".repeat(11));
    assert_eq!(bits.len(), 32);
    out.extend(u32::from_str_radix(&bits, 2).unwrap().to_be_bytes());
    out.extend([0xff, 0xd9]);
    out
}

#[test]
fn photos_are_jpeg() {
    let place = Place::new();
    place.grey("a/one.png", 102);
    place.grey("a/two.png", 51);
    std::fs::write(place.path("b/one.JPG"), jpeg()).unwrap();
    std::fs::write(place.path("b/two.jpeg"), jpeg()).unwrap();
    let output = place.compare("a", "b", &["--metrics", "psnr"]);
    done(&output);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("13.979") && text.contains("1 identical"), "{text}");
    std::fs::write(place.path("b/one.JPG"), &jpeg()[..100]).unwrap();
    let output = place.compare("a", "b", &["--metrics", "psnr"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("one.JPG: is a JPEG that cannot be read"),
        "{}",
        stderr(&output)
    );
    place.grey("b/one.png", 7);
    let output = place.compare("a", "b", &[]);
    assert!(stderr(&output).contains("one picture by their names"), "{}", stderr(&output));
}

#[test]
fn what_does_not_fit_together_is_said() {
    let place = Place::new();
    place.grey("a/one.png", 51);
    let said = |a: &str, b: &str, more: &[&str], part: &str| {
        let output = place.compare(a, b, more);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains(part), "{part} in {}", stderr(&output));
    };
    said("a", "b", &[], "has no one.png");
    said("b", "b", &[], "no .png, .jpg or .jpeg files");
    said("a", "a/one.png", &[], "two of a kind");
    said("a", "none", &[], "none");
    let taller = RgbPicture::filled(32, 25, [0; 3]).encode_png().unwrap();
    std::fs::write(place.path("b/one.png"), taller).unwrap();
    said("a", "b", &[], "32 × 24 against 32 × 25");
    place.depth("b/one.png", |_| 1);
    said("a", "b", &[], "depth, the other colour");
    std::fs::write(place.path("b/one.png"), b"no picture").unwrap();
    said("a", "b", &[], "one.png");
    let clear = Samples::Eight(vec![0; 32 * 24 * 4]);
    let clear = Picture::new(32, 24, Channels::Rgba, clear).unwrap().encode_png().unwrap();
    std::fs::write(place.path("b/one.png"), clear).unwrap();
    said("a", "b", &[], "transparent");
    place.grey("b/one.png", 51);
    said("a", "b", &["--lpips-weights", "missing.safetensors"], "missing.safetensors");
    let output = place.compare("a", "b", &["--depth-scale", "0"]);
    assert_eq!(output.status.code(), Some(2));
}
