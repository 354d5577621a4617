//! Commands with `--device gpu`: a graphics processor of any maker, in CI a software one.

use crate::support::*;
use scenesplat::models::{DeviceChoice, GpuName};

/// Whether this machine has one; if not, CI fails by the word.
fn there() -> bool {
    match DeviceChoice::Gpu(GpuName::Best).open() {
        Ok(_) => true,
        Err(error) => {
            println!("skipped: {error}");
            false
        }
    }
}

#[test]
fn labels_and_features_are_those_of_the_cpu() {
    if !there() {
        return;
    }
    let folder = Folder::new();
    let scene = folder.room("room.ply", 1200, 5);
    let run = |command: &str, device: &str, out: &str| {
        let out = folder.at(out);
        done(&run!("{command} {scene} --as-is --device {device} --out {out}"));
    };
    run("segment", "cpu", "cpu");
    run("segment", "gpu", "gpu");
    let receipt = json(folder.path("gpu/receipt.json"));
    assert!(setting(&receipt, "device").unwrap().starts_with("gpu ("), "{receipt}");
    let (on_cpu, on_gpu) =
        (labels(folder.path("cpu/labels.npy")), labels(folder.path("gpu/labels.npy")));
    let equal = on_cpu.iter().zip(&on_gpu).filter(|(a, b)| a == b).count();
    assert!(equal as f64 >= 0.999 * on_cpu.len() as f64, "{equal} of {}", on_cpu.len());
    run("features", "cpu", "features_cpu");
    run("features", "gpu", "features_gpu");
    run("features", "gpu --precision f16", "features_f16");
    let rows = |name: &str| floats(folder.path(name).join("features.npy"));
    let (want, got, half) = (rows("features_cpu"), rows("features_gpu"), rows("features_f16"));
    let width = want.len() / 1200;
    let least = |got: &[f32]| {
        assert!(got.iter().all(|v| v.is_finite()));
        let rows = got.chunks_exact(width).zip(want.chunks_exact(width));
        let dot = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        rows.map(|(a, b)| dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()).fold(1.0, f64::min)
    };
    assert!(least(&got) >= 0.99999, "{}", least(&got));
    assert!((0.98..1.0 - 1e-9).contains(&least(&half)), "{}", least(&half));
}

#[test]
fn what_a_graphics_processor_cannot_do_is_refused_before_anything_is_read() {
    let folder = Folder::new();
    let scene = folder.room("room.ply", 300, 5);
    let out = folder.at("out");
    let segment = format!("segment {scene} --out {out}");
    refused(&run!("{segment} --precision f16"), 1, &["cpu computes in f32, split, bf16 and int8"]);
    refused(&run!("{segment} --device gpu:99"), 1, &["--device", "gpu:99"]);
    if there() {
        refused(&run!("{segment} --device gpu --precision bf16"), 1, &["f32 and f16"]);
        refused(&run!("{segment} --device gpu:no-such-maker"), 1, &["there are: 0: "]);
    }
    let experiment = folder.write("train.toml", small_segmentation());
    let train = format!("train {experiment} --out {out}");
    refused(&run!("{train} --device gpu"), 1, &["train on cpu or cuda:0"]);
    assert!(!folder.path("out").exists());
}

/// A system without a driver: an error before anything is read, or the processor and a line that says so.
#[cfg(target_os = "linux")]
#[test]
fn without_a_driver_auto_is_the_cpu_and_says_so() {
    let folder = Folder::new();
    let (scene, out) = (folder.room("room.ply", 300, 5), folder.at("out"));
    let run = |device: &str| {
        let mut program = program();
        // The names that loaders of Vulkan know, the old one and the new one.
        program.env("VK_ICD_FILENAMES", "/nowhere.json").env("VK_DRIVER_FILES", "/nowhere.json");
        program.args(["segment", &scene, "--as-is", "--out", &out, "--device", device]);
        program.output().unwrap()
    };
    refused(&run("gpu"), 1, &["no graphics processor", "driver"]);
    assert!(!folder.path("out").exists());
    done(&run("auto"));
    let receipt = json(folder.path("out/receipt.json")).to_string();
    assert!(receipt.contains("--device auto: computing on the cpu: gpu: no graphics"), "{receipt}");
}
