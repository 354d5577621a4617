//! Pictures of what self-supervised training has learned: masked Gaussians, and features as colors.

use crate::support::*;
use scenesplat::reconstruction::ReconstructionRun;
use scenesplat::scene::GaussianScene;
use scenesplat::scene::picture::{Samples, read_picture};
use std::path::Path;

/// Colors of a picture, and its width.
fn pixels(path: &Path) -> (Vec<[u8; 3]>, usize) {
    let picture = read_picture(path).unwrap();
    let Samples::Eight(values) = picture.samples() else { panic!("8 bits") };
    (values.as_chunks::<3>().0.to_vec(), picture.width() as usize)
}

#[test]
fn masked_gaussians_are_drawn_beside_the_scene() {
    let folder = Folder::new();
    let (ssl, scene) = (student().at("student"), folder.room("room.ply", 3000, 3));
    let reconstruct = |out: &str, more: &str| {
        let words = format!("--inside 2 --size 96x64 --quiet {more}");
        done(&run!("reconstruct {ssl} {scene} --out {} {words}", folder.at(out)));
        json(folder.path(out).join("reconstruction.json"))
    };
    let report = reconstruct("out", "");
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let share = number(&report["masked_voxels"]) / number(&report["voxels"]);
    assert!((0.1..0.6).contains(&share), "{share}: the run masks 30 % of the patches");
    for channel in ["color", "opacity", "quat", "scale"] {
        let error = number(&report["mean_absolute_difference"][channel]);
        // Of rotations at unit length, of two signs the nearer one.
        let most = if channel == "quat" { 1.0 } else { 10.0 };
        assert!(error > 0.0 && error <= most, "{channel}: {error}");
    }
    let pictures = report["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), 2);
    let mut shown = 0;
    for picture in pictures {
        let name = picture["name"].as_str().unwrap();
        let (rgb, width) = pixels(&folder.path(&format!("out/{name}.png")));
        assert_eq!((width, rgb.len() / width), (3 * 96 + 8, 64));
        let part = |k: usize| -> Vec<[u8; 3]> {
            rgb.chunks(width).flat_map(|row| row[k * 100..k * 100 + 96].to_vec()).collect()
        };
        let differ = |a: usize, b: usize| {
            part(a).iter().zip(part(b)).filter(|(a, b)| *a != b).count() as f64 / (96.0 * 64.0)
        };
        if picture["masked_pixels"].as_u64().unwrap() > 0 {
            assert!(number(&picture["psnr"]) > 0.0);
            // What a network of two steps puts there may be as good as invisible.
            assert!(differ(0, 1) > 0.0 && differ(0, 2) > 0.0, "{name}");
            shown += 1;
        }
        assert!(differ(0, 1) < 0.95, "{name}: what is not masked stays");
    }
    assert!(shown > 0);
    // The same again, whatever the threads; with another seed others are masked.
    assert_eq!(reconstruct("again", "--threads 1"), report);
    assert_ne!(reconstruct("other", "--seed 5")["pictures"], report["pictures"]);
    has(&text(folder.path("out/receipt.json")), &["step-", "masking"]);

    let ibot = "[[self_supervised.terms]]\ntype = \"ibot\"\nhidden = 16\nout = 8\n";
    train(&folder, "ibot", &self_supervised(&masked_network().to_string(), "", ibot));
    let ibot = folder.at("ibot");
    let cases = [
        (&*format!("{ssl} {scene} --inside 1 --orbit 1"), 2, "--inside"),
        (&format!("{ssl}/model {scene}"), 1, "config.toml"),
        (&format!("{ibot} {scene}"), 1, "only ibot"),
    ];
    let nowhere = folder.at("nowhere");
    all_refused(cases, |words| run!("reconstruct {words} --out {nowhere} --quiet"));
    assert!(!folder.path("nowhere").exists());
}

#[test]
fn what_is_seen_stays_and_what_is_masked_is_told() {
    let run = ReconstructionRun::open(&student().path("student")).unwrap();
    let scene = room(2000, 3);
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
    let none = ReconstructionRun::open(&student().path("student/model")).unwrap_err();
    has(&none.to_string(), &["config.toml"]);
}

#[test]
fn features_of_an_encoder_alone_are_shown_as_colors() {
    let folder = Folder::new();
    let network = masked_network().to_string();
    let decoder = network.find("dec_depths").unwrap();
    let encoder = network[..decoder].to_owned()
        + "dec_depths = []\ndec_channels = []\ndec_num_head = []\ndec_patch_size = []\n\
           mask_token = true\n";
    let model = train(&folder, "encoder", &self_supervised(&encoder, "", TERMS));
    let scene = folder.room("room.ply", 3000, 3);
    done(&run!("features {scene} --weights {model} --out {} --quiet", folder.at("features")));
    let (mut colors, _) = pixels(&folder.path("features/preview.png"));
    colors.sort_unstable();
    colors.dedup();
    assert!(colors.len() > 100, "{} colors", colors.len());
    assert!(folder.path("features/features.ply").is_file());
    // All scales side by side.
    assert_eq!(npy(folder.path("features/features.npy")).shape(), [3000, 24]);
}
