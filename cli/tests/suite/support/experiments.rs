//! Experiments that train in a second.

use super::*;
use scenesplat_test_support::Network;
use std::sync::OnceLock;

/// Two epochs of a network, as its `[model]` table says, on four rooms; an evaluation on two others.
pub fn segmentation(model: &str) -> String {
    format!(
        r#"
task = "semantic_segmentation"
[model]
{model}
[[train]]
source = {{ type = "synthetic", count = 4, seed = 1, room = {{ num_gaussians = 1500 }} }}
transforms = "semantic_segmentation"
repeat = 2
[loader]
workers = 1
mix_probability = 0.5
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[trainer]
epochs = 2
log_every = 1
[trainer.checkpoint]
best = "unseen/mIoU"
[[evaluate]]
name = "unseen"
source = {{ type = "synthetic", count = 2, seed = 9, room = {{ num_gaussians = 1500 }} }}
"#
    )
}

/// As [`segmentation`] of a Point Transformer V3.
pub fn small_segmentation() -> String {
    segmentation(&Network { grid_size: 0.15, ..Network::default() }.to_string())
}

/// The network of [`self_supervised`].
pub fn masked_network() -> Network {
    Network { grid_size: 0.25, patch: 32, width: 8, head: "mask_token = true" }
}

/// Two steps of self-supervised training: lines of `[self_supervised]` first, then its terms.
pub fn self_supervised(model: &str, lines: &str, terms: &str) -> String {
    format!(
        r#"
task = "self_supervised"
[model]
{model}
[[train]]
source = {{ type = "synthetic", count = 4, seed = 1, room = {{ num_gaussians = 800 }} }}
transforms = [{{ type = "center_shift" }}, {{ type = "views", groups = [
    {{ kind = "global", views = [[{{ type = "random_flip" }}, {{ type = "grid_sample", grid_size = 0.25 }}]] }},
    {{ kind = "local", crop = {{ ratio = [0.3, 0.5], point_max = 800 }}, views = [[{{ type = "grid_sample", grid_size = 0.25 }}]] }},
] }}]
[loader]
workers = 0
mix_probability = 0.0
[self_supervised]
masking = {{ shape = {{ patches = 0.6 }}, ratio = [0.3, 0.3], scenes = 1.0, weight = "per_gaussian" }}
{lines}
{terms}
[optimizer]
groups = []
"#
    )
}

/// Terms that every network of [`self_supervised`] can learn.
pub const TERMS: &str = "[[self_supervised.terms]]\ntype = \"masked_gaussians\"\n\
    [[self_supervised.terms]]\ntype = \"sim_dino\"\nhidden = 16\nout = 8\n";

/// Trains into the folder `name`, and gives the model.
pub fn train(folder: &Folder, name: &str, experiment: &str) -> String {
    let file = folder.write(&format!("{name}.toml"), experiment);
    done(&run!("train {file} --out {} --quiet", folder.at(name)));
    folder.at(&format!("{name}/model"))
}

/// The folder of a self-supervised training, `student`, made once: its model is `student/model`.
pub fn student() -> &'static Folder {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Folder::lasting();
        train(&folder, "student", &self_supervised(&masked_network().to_string(), "", TERMS));
        folder
    })
}
