//! `compare`: numbers, pairing, messages.

use crate::support::*;
use scenesplat::evaluation::EvaluationReport;
use scenesplat::metrics::{ConfusionMatrix, Metric};
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples};

struct Place(Folder);

impl Place {
    fn grey(&self, name: &str, value: u8) {
        let picture = RgbPicture::filled(32, 24, [value; 3]);
        self.0.write(name, picture.encode_png().unwrap());
    }

    fn depth(&self, name: &str, value: impl Fn(u32) -> u16) {
        let values = (0..32 * 24).map(|i| value(i % 32)).collect();
        let picture = Picture::new(32, 24, Channels::Gray, Samples::Sixteen(values)).unwrap();
        self.0.write(name, picture.encode_png().unwrap());
    }

    fn compare(&self, a: &str, b: &str, more: &str) -> std::process::Output {
        run!("compare {} {} --quiet {more}", self.0.at(a), self.0.at(b))
    }
}

#[test]
fn means_over_a_folder() {
    let place = Place(Folder::new());
    // Two pairs 51/255 = 0.2 apart, 13.98 dB; one that is identical; one of depths.
    for (name, a, b) in [("one", 51, 0), ("two", 51, 102), ("three", 9, 9)] {
        place.grey(&format!("a/{name}.png"), a);
        place.grey(&format!("b/{name}.png"), b);
    }
    place.depth("a/four.png", |x| if x == 0 { 0 } else { 1500 });
    place.depth("b/four.png", |x| if x == 1 { 0 } else { 2000 });
    let report = place.0.at("report.json");
    let said = printed(&place.compare("a", "b", &format!("--json {report}")));
    has(&said, &["PSNR dB", "SSIM valid", "SSIM reflect", "SSIM zero", "13.979", "0.50000"]);
    has(&said, &["LPIPS skipped: weights not found", "1 identical"]);
    let report = json(&report);
    let images = report["images"].as_array().unwrap();
    let names: Vec<&str> = images.iter().map(|i| i["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["four.png", "one.png", "three.png", "two.png"]);
    let near = |value: &serde_json::Value, due: f64, within: f64| {
        assert!((value.as_f64().unwrap() - due).abs() < within, "{value} {due}");
    };
    near(&report["mean"]["psnr"], 13.9794, 1e-3);
    assert_eq!((&images[2]["identical"], &images[2]["psnr"]), (&true.into(), &().into()));
    near(&images[2]["ssim_valid"], 1.0, 1e-9);
    near(&images[0]["depth_l1"], 0.5, 1e-6);
    assert_eq!(images[0]["depth_pixels"], 30 * 24);
    assert_eq!((&images[1]["lpips"], &report["mean"]["lpips"]), (&().into(), &().into()));
    assert_eq!(report["mean"]["identical"], 1);

    // One metric alone.
    let said = printed(&place.compare("a/one.png", "b/two.png", "--metrics psnr"));
    assert!(said.contains("13.979") && !said.contains("SSIM") && !said.contains("LPIPS"), "{said}");
}

/// A gray JPEG of 32 × 24 pixels, all 51: twelve blocks, the first −77 off the middle, the others as
/// the one before. A short file: quantization by 8, one code for each table that is used.
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
    let place = Place(Folder::new());
    place.grey("a/one.png", 102);
    place.grey("a/two.png", 51);
    place.0.write("b/one.JPG", jpeg());
    place.0.write("b/two.jpeg", jpeg());
    let psnr = || place.compare("a", "b", "--metrics psnr");
    has(&printed(&psnr()), &["13.979", "1 identical"]);
    place.0.write("b/one.JPG", &jpeg()[..100]);
    refused(&psnr(), 1, &["one.JPG: is a JPEG that cannot be read"]);
    place.grey("b/one.png", 7);
    has(&stderr(&place.compare("a", "b", "")), &["one picture by their names"]);
}

#[test]
fn what_does_not_fit_together_is_said() {
    let place = Place(Folder::new());
    place.grey("a/one.png", 51);
    std::fs::create_dir(place.0.path("b")).unwrap();
    let said = |a: &str, b: &str, more: &str, part: &str| {
        refused(&place.compare(a, b, more), 1, &[part]);
    };
    said("a", "b", "", "has no one.png");
    said("b", "b", "", "no .png, .jpg or .jpeg files");
    said("a", "a/one.png", "", "two of a kind");
    said("a", "none", "", "none");
    place.0.write("b/one.png", RgbPicture::filled(32, 25, [0; 3]).encode_png().unwrap());
    said("a", "b", "", "32 × 24 against 32 × 25");
    place.depth("b/one.png", |_| 1);
    said("a", "b", "", "depth, the other colour");
    place.0.write("b/one.png", b"no picture");
    said("a", "b", "", "one.png");
    let clear = Samples::Eight(vec![0; 32 * 24 * 4]);
    let clear = Picture::new(32, 24, Channels::Rgba, clear).unwrap().encode_png().unwrap();
    place.0.write("b/one.png", clear);
    said("a", "b", "", "transparent");
    place.grey("b/one.png", 51);
    said("a", "b", "--lpips-weights missing.safetensors", "missing.safetensors");
    refused(&place.compare("a", "b", "--depth-scale 0"), 2, &[]);
}

/// An `evaluation.json` of two classes: so many of the first class and of the second are right, out of ten each.
fn evaluation(right: [usize; 2], excluded: &[usize]) -> String {
    let truth: Vec<i32> = (0..20).map(|i| i / 10).collect();
    let said: Vec<i32> = (0..20_i32)
        .map(|i| if (i % 10) < right[i as usize / 10] as i32 { i / 10 } else { 1 - i / 10 })
        .collect();
    let report = |said: &[i32]| {
        let mut matrix = ConfusionMatrix::new(2).unwrap().with_excluded(excluded).unwrap();
        matrix.update((said, &truth)).unwrap();
        matrix.tester_report()
    };
    let counts = EvaluationReport {
        oracle: report(&truth),
        random: report(&truth),
        model: Some(report(&said)),
        given: None,
        withheld: 0,
    };
    serde_json::json!({
        "counts": counts, "classes": ["wall", "chair"], "excluded": excluded, "vote_k": 25,
        "meaningless": false,
    })
    .to_string()
}

#[test]
fn evaluations_are_compared_by_class_and_scene() {
    let place = Place(Folder::new());
    // Rows that both have right count once in the union, those exchanged twice: 8 of 12, 10 of 12 and so on.
    for (name, a, b) in [("one", [8, 10], [10, 10]), ("two", [10, 6], [10, 9])] {
        place.0.write(&format!("a/{name}/evaluation.json"), evaluation(a, &[0]));
        place.0.write(&format!("b/{name}/evaluation.json"), evaluation(b, &[0]));
    }
    place.0.write("a/more/evaluation.json", evaluation([5, 5], &[0]));
    let (report, picture) = (place.0.at("report.json"), place.0.at("scatter.png"));
    let output = place.compare("a", "b", &format!("--json {report} --picture {picture}"));
    let said = printed(&output);
    has(&said, &["wall", "chair", "one", "two", "IoU: 2 classes are better in b, 0 are worse"]);
    has(&told(&output), &["not in", "more", "other scenes"]);
    let report = json(&report);
    let near = |value: &serde_json::Value, due: &[f64]| {
        assert_eq!(value.as_array().unwrap().len(), due.len(), "{value}");
        for (value, due) in value.as_array().unwrap().iter().zip(due) {
            assert!((value.as_f64().unwrap() - due).abs() < 1e-9, "{value} {due:?}");
        }
    };
    // Over all scenes: 23 of 30 walls right with 9 chairs among them; 21 of 30 chairs.
    near(&report["classes"][0]["iou"], &[23.0 / 39.0, 20.0 / 21.0]);
    near(&report["classes"][1]["iou"], &[21.0 / 37.0, 19.0 / 20.0]);
    near(&report["classes"][1]["accuracy"], &[21.0 / 30.0, 19.0 / 20.0]);
    near(&report["f_miou"], &[21.0 / 37.0, 19.0 / 20.0]);
    assert_eq!(report["scenes"].as_array().unwrap().len(), 2);
    near(&report["scenes"][0]["iou"], &[10.0 / 12.0, 1.0]);
    near(&report["scenes"][1]["iou"], &[6.0 / 10.0, 9.0 / 10.0]);
    // Of the two scenes alone: 16 of 22 against 19 of 20, wherever the draws of two scenes may lie.
    let bounds = &report["f_miou_change_of_scenes"];
    near(bounds, &[19.0 / 20.0 - 16.0 / 22.0, 1.0 - 10.0 / 12.0, 9.0 / 10.0 - 6.0 / 10.0]);
    assert_eq!(bytes(&picture)[1..4], *b"PNG");

    // One file each; and what cannot be compared.
    let one = place.compare("a/one/evaluation.json", "b/one/evaluation.json", "");
    has(&printed(&one), &["80.00", "wall", "+20.00"]);
    place.0.write("other.json", evaluation([8, 10], &[]));
    for (b, part) in [
        ("other.json", "leaves out"),
        ("b/one", "no evaluation.json"),
        ("scatter.png", "no evaluation.json"),
    ] {
        let a = if b == "b/one" { "scatter.png" } else { "a/one" };
        refused(&place.compare(a, b, ""), 1, &[part]);
    }
    refused(&place.compare("a/one", "b/one", "--metrics psnr"), 2, &["--metrics"]);
    refused(&place.compare("scatter.png", "scatter.png", "--picture x.png"), 2, &["--picture"]);
}
