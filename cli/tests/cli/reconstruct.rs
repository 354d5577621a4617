//! Pictures of what self-supervised training has learned: masked Gaussians, and features as colours.

use crate::probe::{EXPERIMENT, run};
use crate::{done, scenesplat, stderr};
use scenesplat::reconstruction::ReconstructionRun;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::picture::{Samples, read_picture};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn room(folder: &Path) -> PathBuf {
    let path = folder.join("room.ply");
    let room = generate(&SyntheticRoomSettings::with_count(3000, 3)).unwrap();
    write_inria_ply(&room.scene, &[], &path).unwrap();
    path
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Colours of a picture, and its width.
fn pixels(path: &Path) -> (Vec<[u8; 3]>, usize) {
    let picture = read_picture(path).unwrap();
    let Samples::Eight(values) = picture.samples() else { panic!("8 bits") };
    (values.as_chunks::<3>().0.to_vec(), picture.width() as usize)
}

fn reconstruct(run: &Path, scene: &Path, out: &Path, more: &[&str]) -> Value {
    let mut args = vec!["reconstruct", text(run), text(scene), "--out", text(out), "--quiet"];
    args.extend(more);
    done(&scenesplat(&args));
    let report = std::fs::read_to_string(out.join("reconstruction.json")).unwrap();
    serde_json::from_str(&report).unwrap()
}

#[test]
fn masked_gaussians_are_drawn_beside_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    run(folder.path(), "run", &EXPERIMENT.replace("EXPORT", ""));
    let (ssl, scene) = (at("run"), room(folder.path()));
    let look = ["--inside", "2", "--size", "96x64"];
    let report = reconstruct(&ssl, &scene, &at("out"), &look);
    let (voxels, masked) = (&report["voxels"], &report["masked_voxels"]);
    let share = masked.as_f64().unwrap() / voxels.as_f64().unwrap();
    assert!((0.1..0.6).contains(&share), "{share}: the run masks 30 % of the patches");
    for channel in ["color", "opacity", "quat", "scale"] {
        let error = report["mean_absolute_difference"][channel].as_f64().unwrap();
        assert!(error > 0.0 && error < 10.0, "{channel}: {error}");
        // Of rotations at unit length, of two signs the nearer one.
        assert!(channel != "quat" || error <= 1.0, "{error}");
    }
    let pictures = report["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), 2);
    let mut shown = 0;
    for picture in pictures {
        let name = picture["name"].as_str().unwrap();
        let (rgb, width) = pixels(&at("out").join(format!("{name}.png")));
        assert_eq!((width, rgb.len() / width), (3 * 96 + 8, 64));
        let part = |k: usize| -> Vec<[u8; 3]> {
            rgb.chunks(width).flat_map(|row| row[k * 100..k * 100 + 96].to_vec()).collect()
        };
        let differ = |a: usize, b: usize| {
            part(a).iter().zip(part(b)).filter(|(a, b)| *a != b).count() as f64 / (96.0 * 64.0)
        };
        if picture["masked_pixels"].as_u64().unwrap() > 0 {
            assert!(picture["psnr"].as_f64().unwrap() > 0.0);
            // What a network of two steps puts there may be as good as invisible.
            assert!(differ(0, 1) > 0.0 && differ(0, 2) > 0.0, "{name}");
            shown += 1;
        }
        assert!(differ(0, 1) < 0.95, "{name}: what is not masked stays");
    }
    assert!(shown > 0);
    // The same again, whatever the threads; with another seed others are masked.
    let again = [&look[..], &["--threads", "1"]].concat();
    assert_eq!(reconstruct(&ssl, &scene, &at("again"), &again), report);
    let other = [&look[..], &["--seed", "5"]].concat();
    assert_ne!(reconstruct(&ssl, &scene, &at("other"), &other)["pictures"], report["pictures"]);
    let receipt = std::fs::read_to_string(at("out").join("receipt.json")).unwrap();
    assert!(receipt.contains("step-") && receipt.contains("masking"), "{receipt}");

    let refused = |args: &[&str], code: i32, part: &str| {
        let nowhere = at("nowhere");
        let output = scenesplat(&[args, &["--out", text(&nowhere), "--quiet"]].concat());
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(part), "{args:?}: {}", stderr(&output));
        assert!(!nowhere.exists(), "{args:?}");
    };
    let both = ["reconstruct", text(&ssl), text(&scene), "--inside", "1", "--orbit", "1"];
    refused(&both, 2, "--inside");
    refused(&["reconstruct", text(&ssl.join("model")), text(&scene)], 1, "config.toml");
    let end = EXPERIMENT.find("[[self_supervised.terms]]").unwrap();
    let rest = &EXPERIMENT[EXPERIMENT.find("[optimizer]").unwrap()..];
    let no_mask = EXPERIMENT[..end].replace("EXPORT", "")
        + "[[self_supervised.terms]]\ntype = \"ibot\"\nhidden = 16\nout = 8\n"
        + rest;
    run(folder.path(), "ibot", &no_mask);
    refused(&["reconstruct", text(&at("ibot")), text(&scene)], 1, "only ibot");
}

#[test]
fn what_is_seen_stays_and_what_is_masked_is_told() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), "run", &EXPERIMENT.replace("EXPORT", ""));
    let run = ReconstructionRun::open(&folder.path().join("run")).unwrap();
    let scene = generate(&SyntheticRoomSettings::with_count(2000, 3)).unwrap().scene;
    let made = run.reconstruct(&scene, 0).unwrap();
    let all = &made.reconstructed;
    assert_eq!(all.coord, scene.coord, "where they are is known");
    let hidden = made.hidden.iter().filter(|hidden| **hidden).count();
    assert_eq!(made.masked.len() + hidden, scene.len());
    let mut changed = 0;
    for (row, hidden) in made.hidden.iter().enumerate() {
        let of =
            |s: &GaussianScene| (s.sh_dc[row], s.opacity_logit[row], s.quat[row], s.log_scale[row]);
        assert!(*hidden || of(all) == of(&scene), "row {row} is seen");
        changed += usize::from(of(all) != of(&scene));
        let norm = all.quat[row].iter().map(|v| v * v).sum::<f32>();
        assert!((norm - 1.0).abs() < 1e-4 && all.log_scale[row].iter().all(|v| v.is_finite()));
    }
    assert!(hidden > 100 && changed == hidden, "{changed} of {hidden}");
    assert_eq!(made.errors.len(), 4);
    assert!(run.reconstruct(&GaussianScene::default(), 0).is_err());
    let none = ReconstructionRun::open(&folder.path().join("run/model")).unwrap_err();
    assert!(none.to_string().contains("config.toml"), "{none}");
}

#[test]
fn features_of_an_encoder_alone_are_shown_as_colours() {
    let folder = tempfile::tempdir().unwrap();
    let (start, end) =
        (EXPERIMENT.find("dec_depths").unwrap(), EXPERIMENT.find("mask_token").unwrap());
    let encoder = EXPERIMENT[..start].to_owned()
        + "dec_depths = []\ndec_channels = []\ndec_num_head = []\ndec_patch_size = []\n"
        + &EXPERIMENT[end..];
    let model = run(folder.path(), "encoder", &encoder.replace("EXPORT", ""));
    let (scene, out) = (room(folder.path()), folder.path().join("features"));
    let args = ["features", text(&scene), "--weights", &model, "--out", text(&out), "--quiet"];
    done(&scenesplat(&args));
    let (rgb, _) = pixels(&out.join("preview.png"));
    let mut colors = rgb;
    colors.sort_unstable();
    colors.dedup();
    assert!(colors.len() > 100, "{} colours", colors.len());
    assert!(out.join("features.ply").is_file());
    // All scales side by side.
    let file = scenesplat::scene::formats::npy::NpyFile::open(&out.join("features.npy")).unwrap();
    assert_eq!(file.shape(), [3000, 24]);
}
