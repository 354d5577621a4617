//! `compare`: numbers, pairing, messages.

use crate::{done, scenesplat, stderr};
use image::{ImageBuffer, Luma, Rgb, RgbImage};
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
        RgbImage::from_pixel(32, 24, Rgb([value; 3])).save(self.path(name)).unwrap();
    }

    fn depth(&self, name: &str, value: impl Fn(u32) -> u16) {
        let picture = ImageBuffer::from_fn(32, 24, |x, _| Luma([value(x)]));
        picture.save(self.path(name)).unwrap();
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
    said("b", "b", &[], "no .png files");
    said("a", "a/one.png", &[], "two of a kind");
    said("a", "none", &[], "none");
    RgbImage::new(32, 25).save(place.path("b/one.png")).unwrap();
    said("a", "b", &[], "32 × 24 against 32 × 25");
    place.depth("b/one.png", |_| 1);
    said("a", "b", &[], "depth, the other colour");
    std::fs::write(place.path("b/one.png"), b"no picture").unwrap();
    said("a", "b", &[], "one.png");
    image::RgbaImage::new(32, 24).save(place.path("b/one.png")).unwrap();
    said("a", "b", &[], "transparent");
    place.grey("b/one.png", 51);
    said("a", "b", &["--lpips-weights", "missing.safetensors"], "missing.safetensors");
    let output = place.compare("a", "b", &["--depth-scale", "0"]);
    assert_eq!(output.status.code(), Some(2));
}
