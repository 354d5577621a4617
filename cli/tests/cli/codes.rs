//! `scenesplat codes`: an autoencoder from a file, codes in scene folders, training that reads them, and back.

use crate::{done, scenesplat, stderr};
use half::f16;
use scenesplat::rooms::vocabulary::Vocabulary;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::LanguageFeatures;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use scenesplat::scene::formats::npy_writer::write_npy;
use std::path::{Path, PathBuf};

const WIDTH: usize = 48;
const CODES: usize = 8;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Folders of two rooms with the vocabulary's features, each in a folder of its own.
fn rooms(root: &Path) -> Vec<PathBuf> {
    let vocabulary = Vocabulary::new(WIDTH).unwrap();
    let table = vocabulary.class_table();
    let write = |seed: u64| {
        let mut scene = generate(&SyntheticRoomSettings::with_count(900, seed)).unwrap().scene;
        let mut values = Vec::new();
        for label in scene.segment.clone().unwrap() {
            let row =
                usize::try_from(label).ok().map(|class| &table.values[class * WIDTH..][..WIDTH]);
            let value = |i: usize| row.map_or(0.0, |row| row[i]);
            values.extend((0..WIDTH).map(|i| f16::from_f32(value(i))));
        }
        scene.lang_feat = Some(LanguageFeatures { values, dim: WIDTH });
        let folder = root.join(format!("part{seed}/room{seed}"));
        write_npy_folder(&scene, &folder, false).unwrap();
        folder
    };
    vec![write(1), write(2)]
}

fn train(folder: &Path, name: &str, experiment: &str) -> PathBuf {
    let file = folder.join(format!("{name}.toml"));
    std::fs::write(&file, experiment).unwrap();
    let out = folder.join(name);
    done(&scenesplat(&["train", text(&file), "--out", text(&out), "--quiet"]));
    out.join("model")
}

/// One that has seen the folder of a scene.
fn autoencoder(folder: &Path, scene: &Path) -> PathBuf {
    let experiment = format!(
        "task = \"autoencoder\"\n[model]\ngrid_size = 0.1\n[autoencoder]\nwidths = [{WIDTH}, 24, {CODES}]\n\
         [[train]]\nsource = {{ type = \"generic\", root = '{}' }}\ntransforms = \"validation\"\nrepeat = 80\n\
         [loader]\nworkers = 0\nmix_probability = 0.0\n[optimizer]\nlr = 0.01\nweight_decay = 0.0\n\
         groups = []\n",
        scene.parent().unwrap().display()
    );
    train(folder, "autoencoder", &experiment)
}

/// Two steps of alignment with what the scenes of a folder have.
fn alignment(folder: &Path, name: &str, data: &Path, width: usize) -> String {
    let experiment = format!(
        r#"
task = "self_supervised"
[model]
grid_size = 0.25
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [32, 32]
dec_depths = [1]
dec_channels = [8]
dec_num_head = [1]
dec_patch_size = [32]
mask_token = true
[[train]]
source = {{ type = "generic", root = '{}' }}
transforms = [{{ type = "views", groups = [
    {{ kind = "global", views = [[{{ type = "grid_sample", grid_size = 0.25 }}]] }},
] }}]
[loader]
workers = 0
mix_probability = 0.0
[self_supervised]
masking = {{ shape = {{ patches = 0.6 }}, ratio = [0.5, 0.5], scenes = 1.0, weight = "per_gaussian" }}
[[self_supervised.terms]]
type = "language_alignment"
out = {width}
[optimizer]
groups = []
[trainer]
log_every = 1
"#,
        data.display()
    );
    let file = folder.join(format!("{name}.toml"));
    std::fs::write(&file, experiment).unwrap();
    let out = folder.join(name);
    let output = scenesplat(&["train", text(&file), "--out", text(&out), "--quiet"]);
    if output.status.success() {
        return std::fs::read_to_string(out.join("metrics.jsonl")).unwrap();
    }
    stderr(&output)
}

fn features(scene: &Path) -> (Vec<usize>, Vec<f32>) {
    let file = NpyFile::open(&scene.join("lang_feat.npy")).unwrap();
    (file.shape().to_vec(), file.read_f32().unwrap())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn codes_are_learned_like_features_and_lead_back() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scenes = rooms(&at("data"));
    // What no reader looks at, and a mark that is wrong.
    std::fs::write(scenes[0].join("notes.txt"), "mine").unwrap();
    let (shape, mut values) = features(&scenes[0]);
    values[0] = f32::NAN;
    write_npy(&scenes[0].join("lang_feat.npy"), &shape, &values).unwrap();
    write_npy(&scenes[0].join("valid_feat_mask.npy"), &[900], &[1u8; 900]).unwrap();
    let model = autoencoder(folder.path(), &scenes[1]);

    let run = |name: &str, more: &[&str], scenes: &[&Path]| {
        let out = at(name);
        let mut args = vec!["codes", text(&model)];
        args.extend(scenes.iter().map(|scene| text(scene)));
        args.extend(["--out", text(&out)]);
        args.extend(more);
        let output = scenesplat(&args);
        done(&output);
        (out, String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output))
    };
    let (coded, said) = run("codes", &[], &[&scenes[0], &scenes[1]]);
    assert!(said.contains("1 rows are marked as features and hold NaN"), "{said}");
    assert!(said.contains("notes.txt"), "{said}");
    assert_eq!(names(&coded), ["receipt.json", "room1", "room2"]);
    let (of, mut with) = (names(&scenes[1]), names(&coded.join("room2")));
    assert_eq!(of, with, "the same arrays");
    with.retain(|name| name != "lang_feat.npy");
    for name in &with {
        let read = |scene: &Path| std::fs::read(scene.join(name)).unwrap();
        let is_mask = name == "valid_feat_mask.npy";
        assert!(is_mask || read(&scenes[1]) == read(&coded.join("room2")), "{name}");
    }
    let receipt = std::fs::read_to_string(coded.join("receipt.json")).unwrap();
    for part in ["autoencoder.json", "model.safetensors", "48 to 8", "lang_feat.npy"] {
        assert!(receipt.contains(part), "{part}");
    }

    // Rows of unit length where there is a feature, zeros elsewhere; no row is left at a NaN.
    let mask = NpyFile::open(&coded.join("room1/valid_feat_mask.npy")).unwrap().read_u8().unwrap();
    assert_eq!(mask[0], 0);
    let (shape, codes) = features(&coded.join("room1"));
    assert_eq!(shape, [900, CODES]);
    for (row, marked) in codes.chunks_exact(CODES).zip(&mask) {
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((norm - f32::from(*marked)).abs() < 2e-3, "{norm}, marked {marked}");
    }
    assert!(mask.iter().filter(|mark| **mark == 1).count() > 700);

    // Training reads them, and names their width where it is another.
    let log = alignment(folder.path(), "alignment", &coded, CODES);
    assert!(log.contains("language_alignment/cosine"), "{log}");
    let refused = alignment(folder.path(), "wrong", &coded, 16);
    assert!(refused.contains("are 8 wide"), "{refused}");

    // And back: what the report said of each row.
    let (back, _) = run("back", &["--decode"], &[&coded.join("room2")]);
    let ((_, before), (shape, after)) = (features(&scenes[1]), features(&back.join("room2")));
    assert_eq!(shape, [900, WIDTH]);
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in before.chunks_exact(WIDTH).zip(after.chunks_exact(WIDTH)) {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        if dot(a, a) > 0.0 {
            sum += f64::from(dot(a, b) / (dot(a, a) * dot(b, b)).sqrt());
            count += 1;
        }
    }
    let mean = sum / f64::from(count);
    let told = said.lines().find(|line| line.starts_with("room2: ")).unwrap();
    assert!(told.contains(&format!("mean {mean:.3}")[..9]), "{told}: {mean}");
    assert!(mean > 0.5, "{mean}: what is learned in 80 steps leads back");
}

#[test]
fn what_has_no_codes_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scenes = rooms(&at("data"));
    let model = autoencoder(folder.path(), &scenes[1]);
    let out = at("out");
    let refused = |args: &[&str], code: i32, parts: &[&str]| {
        let mut all = vec!["codes"];
        all.extend(args);
        all.extend(["--out", text(&out), "--quiet"]);
        let output = scenesplat(&all);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", stderr(&output));
        for part in parts {
            assert!(stderr(&output).contains(part), "{args:?}: {}", stderr(&output));
        }
        assert!(!out.exists(), "{args:?}: nothing was written");
    };
    let (model, scene) = (text(&model), text(&scenes[0]));
    refused(&[scene, scene], 1, &["room1", "autoencoder.json"]);
    refused(&[model, scene, "--decode"], 1, &["lang_feat.npy", "(N, 8)", "[900, 48]"]);
    refused(&[model, scene, scene], 2, &["room1", "two scenes"]);
    refused(&[model, text(&at("nowhere"))], 1, &["nowhere"]);
    std::fs::remove_file(scenes[1].join("lang_feat.npy")).unwrap();
    refused(&[model, scene, text(&scenes[1])], 1, &["room2", "has no lang_feat.npy"]);
    // Codes of codes, where one way was meant.
    write_npy(&scenes[0].join("lang_feat.npy"), &[900, CODES], &vec![0.5f32; 900 * CODES]).unwrap();
    refused(&[model, scene], 1, &["(N, 48)", "decode"]);
    std::fs::write(Path::new(model).join("autoencoder.json"), "{\"widths\": [1]}").unwrap();
    refused(&[model, scene], 1, &["autoencoder.json", "two widths"]);
    std::fs::write(Path::new(model).join("autoencoder.json"), "{\"widths\": [48, 8]}").unwrap();
    refused(&[model, scene], 1, &["do not fit"]);
}
