//! `scenesplat codes`: an autoencoder from a file, codes in scene folders, training that reads them, and back.

use crate::support::*;
use half::f16;
use scenesplat::rooms::vocabulary::Vocabulary;
use scenesplat::scene::LanguageFeatures;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use scenesplat::scene::formats::npy_writer::write_npy;
use std::path::{Path, PathBuf};

const WIDTH: usize = 48;
const CODES: usize = 8;

/// Two rooms with the vocabulary's features, each in a folder of its own, and an autoencoder that has seen the
/// second.
struct World {
    folder: Folder,
    scenes: [String; 2],
    model: String,
}

impl World {
    fn new() -> Self {
        let folder = Folder::new();
        let table = Vocabulary::new(WIDTH).unwrap().class_table();
        let scenes = [1, 2].map(|seed| {
            let mut scene = room(900, seed);
            let rows = scene.segment.as_ref().unwrap().iter().flat_map(|label| {
                let row = usize::try_from(*label).map(|class| &table.values[class * WIDTH..]);
                (0..WIDTH).map(move |i| row.map_or(f16::ZERO, |row| f16::from_f32(row[i])))
            });
            scene.lang_feat = Some(LanguageFeatures { values: rows.collect(), dim: WIDTH });
            let name = format!("data/part{seed}/room{seed}");
            write_npy_folder(&scene, &folder.path(&name), false).unwrap();
            folder.at(&name)
        });
        let experiment = format!(
            "task = \"autoencoder\"\n[model]\ngrid_size = 0.1\n[autoencoder]\nwidths = [{WIDTH}, 24, {CODES}]\n\
             [[train]]\nsource = {{ type = \"generic\", root = '{}' }}\ntransforms = \"validation\"\nrepeat = 80\n\
             [loader]\nworkers = 0\nmix_probability = 0.0\n[optimizer]\nlr = 0.01\nweight_decay = 0.0\n\
             groups = []\n",
            folder.at("data/part2")
        );
        let model = train(&folder, "autoencoder", &experiment);
        Self { folder, scenes, model }
    }

    /// Two steps of alignment with what the scenes of a folder have: what was logged, or went wrong.
    fn alignment(&self, name: &str, data: &str, width: usize) -> String {
        let network = masked_network();
        let experiment = format!(
            r#"
task = "self_supervised"
[model]
{network}
[[train]]
source = {{ type = "generic", root = '{data}' }}
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
"#
        );
        let file = self.folder.write(&format!("{name}.toml"), experiment);
        let output = run!("train {file} --out {} --quiet", self.folder.at(name));
        match output.status.success() {
            true => text(self.folder.path(name).join("metrics.jsonl")),
            false => stderr(&output),
        }
    }
}

fn features(scene: &Path) -> (Vec<usize>, Vec<f32>) {
    let file = npy(scene.join("lang_feat.npy"));
    (file.shape().to_vec(), file.read_f32().unwrap())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let names = entries.map(|e| e.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

/// Of the rows that are not 0 in the first.
fn mean_cosine(before: &[f32], after: &[f32]) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in before.chunks_exact(WIDTH).zip(after.chunks_exact(WIDTH)) {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        if dot(a, a) > 0.0 {
            sum += f64::from(dot(a, b) / (dot(a, a) * dot(b, b)).sqrt());
            count += 1;
        }
    }
    sum / f64::from(count)
}

#[test]
fn codes_are_learned_like_features_and_lead_back() {
    let world = World::new();
    let (folder, [one, two]) = (&world.folder, &world.scenes);
    let scenes = [one, two].map(PathBuf::from);
    // What no reader reads, and a mark that is wrong.
    std::fs::write(scenes[0].join("notes.txt"), "mine").unwrap();
    let (shape, mut values) = features(&scenes[0]);
    values[0] = f32::NAN;
    write_npy(&scenes[0].join("lang_feat.npy"), &shape, &values).unwrap();
    write_npy(&scenes[0].join("valid_feat_mask.npy"), &[900], &[1u8; 900]).unwrap();
    let run = |out: &str, more: &str| {
        let output = run!("codes {} --out {} {more}", world.model, folder.at(out));
        printed(&output) + &stderr(&output)
    };
    let said = run("codes", &format!("{one} {two}"));
    let coded = folder.path("codes");
    has(&said, &["1 rows are marked as features and hold NaN", "notes.txt"]);
    assert_eq!(names(&coded), ["receipt.json", "room1", "room2"]);
    let (of, with) = (names(&scenes[1]), names(&coded.join("room2")));
    assert_eq!(of, with, "the same arrays");
    for name in
        with.iter().filter(|name| *name != "lang_feat.npy" && *name != "valid_feat_mask.npy")
    {
        let [before, after] = [&scenes[1], &coded.join("room2")].map(|s| bytes(s.join(name)));
        assert!(before == after, "{name}");
    }
    let receipt = text(coded.join("receipt.json"));
    has(&receipt, &["autoencoder.json", "model.safetensors", "48 to 8", "lang_feat.npy"]);

    // Rows of unit length where there is a feature, zeros elsewhere; no row is left at a NaN.
    let mask = npy(coded.join("room1/valid_feat_mask.npy")).read_u8().unwrap();
    assert_eq!(mask[0], 0);
    let (shape, codes) = features(&coded.join("room1"));
    assert_eq!(shape, [900, CODES]);
    for (row, marked) in codes.chunks_exact(CODES).zip(&mask) {
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((norm - f32::from(*marked)).abs() < 2e-3, "{norm}, marked {marked}");
    }
    assert!(mask.iter().filter(|mark| **mark == 1).count() > 700);

    // Training reads them, and names their width where it is another.
    let log = world.alignment("alignment", &folder.at("codes"), CODES);
    has(&log, &["language_alignment/cosine"]);
    has(&world.alignment("wrong", &folder.at("codes"), 16), &["are 8 wide"]);

    // And back: what the report said of each row.
    run("back", &format!("{} --decode", folder.at("codes/room2")));
    let (_, before) = features(&scenes[1]);
    let (shape, after) = features(&folder.path("back/room2"));
    assert_eq!(shape, [900, WIDTH]);
    let mean = mean_cosine(&before, &after);
    let reported = said.lines().find(|line| line.starts_with("room2: ")).unwrap();
    assert!(reported.contains(&format!("mean {mean:.3}")[..9]), "{reported}: {mean}");
    assert!(mean > 0.5, "{mean}: what is learned in 80 steps leads back");
}

#[test]
fn what_has_no_codes_is_said() {
    let world = World::new();
    let ([one, two], model) = (&world.scenes, &world.model);
    let refused = |words: String, code: i32, parts: &[&str]| {
        refused(&run!("codes {words} --out {} --quiet", world.folder.at("out")), code, parts);
        assert!(!world.folder.path("out").exists(), "{words}: nothing was written");
    };
    refused(format!("{one} {one}"), 1, &["room1", "autoencoder.json"]);
    refused(format!("{model} {one} --decode"), 1, &["lang_feat.npy", "(N, 8)", "[900, 48]"]);
    refused(format!("{model} {one} {one}"), 2, &["room1", "two scenes"]);
    refused(format!("{model} nowhere"), 1, &["nowhere"]);
    std::fs::remove_file(format!("{two}/lang_feat.npy")).unwrap();
    refused(format!("{model} {one} {two}"), 1, &["room2", "has no lang_feat.npy"]);
    // Codes of codes, where one way was meant.
    let file = PathBuf::from(one).join("lang_feat.npy");
    write_npy(&file, &[900, CODES], &vec![0.5f32; 900 * CODES]).unwrap();
    refused(format!("{model} {one}"), 1, &["(N, 48)", "decode"]);
    for (widths, parts) in [("[1]", "two widths"), ("[48, 8]", "do not fit")] {
        world
            .folder
            .write("autoencoder/model/autoencoder.json", format!("{{\"widths\": {widths}}}"));
        refused(format!("{model} {one}"), 1, &[parts]);
    }
}
