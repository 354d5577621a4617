//! A trained network as others take it.

use super::ExperimentError;
use crate::NetworkConfig;
use candle_core::Tensor;
use scenesplat_models::BackboneConfig;
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::StagedFolder;
use scenesplat_trainers::checkpoint::{
    best_checkpoint, newest_checkpoint, read_network, read_store,
};
use scenesplat_trainers::tasks::self_supervised::{Export, is_head};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Writes `model.safetensors` and `config.json` into `folder`: the parameters of the best
/// checkpoint, or of the newest if none is marked, averaged ones where there is an average.
///
/// Gives remarks about which it was.
///
/// # Errors
/// If there is no checkpoint or a file cannot be read or written.
pub fn export_model(
    checkpoints: &Path,
    config: &NetworkConfig,
    folder: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let (dir, remark) = exported_checkpoint(checkpoints)?;
    let tensors = read_network(&dir)?;
    let averaged = dir.join("average.safetensors").is_file();
    let tensors = tensors.into_iter().collect();
    write_model(&tensors, config, folder)?;
    let averaged = if averaged { ", averaged parameters" } else { "" };
    Ok(vec![format!("model: {remark}{averaged}")])
}

/// The checkpoint that becomes the model (the best, or the newest if none is marked), and which it is.
///
/// # Errors
/// If there is none.
pub fn exported_checkpoint(checkpoints: &Path) -> Result<(PathBuf, String), ExperimentError> {
    if let Some(best) = best_checkpoint(checkpoints)? {
        let dir = checkpoints.join(&best.checkpoint);
        return Ok((dir, format!("{} of {} ({})", best.checkpoint, best.measurement, best.value)));
    }
    let newest = newest_checkpoint(checkpoints)?;
    let none = || ExperimentError::NoCheckpoint { path: checkpoints.to_owned() };
    let dir = newest.ok_or_else(none)?;
    let name = dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((dir, name))
}

/// As [`export_model`], of the student or the teacher of self-supervised training, without their heads.
/// The teacher has no mask token, as it masks nothing.
///
/// # Errors
/// As [`export_model`].
pub fn export_self_supervised(
    checkpoints: &Path,
    config: &NetworkConfig,
    which: Export,
    folder: &Path,
) -> Result<Vec<String>, ExperimentError> {
    let (dir, remark) = exported_checkpoint(checkpoints)?;
    let mut config = config.clone();
    let (tensors, who) = match which {
        Export::Student => (read_network(&dir)?, "student"),
        Export::Teacher => (read_store(&dir, "teacher")?, "teacher"),
    };
    if let (Export::Teacher, BackboneConfig::PointTransformerV3(backbone)) =
        (which, &mut config.model.backbone)
    {
        backbone.mask_token = false;
    }
    let tensors = tensors.into_iter().filter(|(name, _)| !is_head(name)).collect();
    write_model(&tensors, &config, folder)?;
    let averaged = which == Export::Student && dir.join("average.safetensors").is_file();
    let averaged = if averaged { ", averaged parameters" } else { "" };
    Ok(vec![format!("model: {remark}, the {who}{averaged}")])
}

/// Writes a model folder, whose files appear together: `config.json` says what the network is and
/// what it reads.
///
/// # Errors
/// If a file cannot be written.
pub fn write_model(
    tensors: &HashMap<String, Tensor>,
    config: &NetworkConfig,
    folder: &Path,
) -> Result<(), ExperimentError> {
    let mut staged = StagedFolder::create(folder)?;
    save_tensors(tensors, &staged.add("model.safetensors"))?;
    staged.write("config.json", serde_json::to_string_pretty(config)?.as_bytes())?;
    staged.commit::<&str>(&[])?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{ExperimentConfig, RunOptions, data, train};
    use crate::SceneEncoder;
    use crate::network::{Network, NetworkConfig, WeightOptions, Weights, config_beside};
    use scenesplat_metrics::Metric;
    use scenesplat_trainers::callbacks::read_json_lines;
    use scenesplat_trainers::evaluators::ZeroShotEvaluator;
    use std::path::Path;
    use std::sync::Arc;

    const EXPERIMENT: &str = r#"
task = "language_pretraining"
targets = "class_text"
text = { type = "vocabulary", dim = 32 }
[input]
channels = CHANNELS
[model]
in_channels = WIDTH
grid_size = 0.15
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [64, 64]
dec_depths = [1]
dec_channels = [32]
dec_num_head = [2]
dec_patch_size = [64]
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 1500 } }
transforms = "language_pretraining"
repeat = 6
[loader]
workers = 1
mix_probability = 0.0
[[losses]]
type = "cosine"
[optimizer]
lr = 0.01
groups = []
[trainer]
epochs = 1
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 2, seed = 9, room = { num_gaussians = 1500 } }
"#;

    /// Trains, and gives what the run measured last, what its folder says, and what the folder's
    /// network measures on the same scenes.
    fn run(out: &Path, channels: &str, width: usize) -> (f64, NetworkConfig, f64) {
        let text = EXPERIMENT.replace("CHANNELS", channels).replace("WIDTH", &width.to_string());
        std::fs::create_dir_all(out).unwrap();
        let file = out.join("experiment.toml");
        std::fs::write(&file, text).unwrap();
        let experiment = ExperimentConfig::read(&file).unwrap();
        let options = RunOptions {
            device: candle_core::Device::Cpu,
            commit: None,
            out: out.join("run"),
            resume: false,
            quiet: true,
            stop: Arc::default(),
        };
        let report = train(&experiment, &options).unwrap();
        let log = read_json_lines(&out.join("run/metrics.jsonl")).unwrap();
        let trained = log.iter().rfind(|m| m.name == "unseen/allAcc").unwrap().value;

        let config = config_beside(&report.model).unwrap().unwrap();
        let weights = Weights::File(report.model);
        let network = Network::load(config.clone(), &weights, WeightOptions::default()).unwrap();
        let entry = &experiment.evaluate[0];
        let scenes = data::evaluation(entry, &experiment, None).unwrap();
        let table = data::text_table(experiment.text.as_ref().unwrap()).unwrap().table;
        let input = network.input().clone();
        let evaluator = ZeroShotEvaluator::new("again", scenes, input, table, Vec::new());
        let measured = evaluator.confusion(network.model()).unwrap().measure();
        let again = measured.iter().find(|m| m.name == "allAcc").unwrap().value;
        (trained, config, again)
    }

    /// The loss of each step, and the folder's network on a room, whole and in tiles.
    fn trains_and_runs(out: &Path, model: &str) {
        let text = EXPERIMENT
            .replace("CHANNELS", r#"["color", "opacity", "quat", "scale"]"#)
            .replace("language_pretraining", "semantic_segmentation")
            .replace("targets = \"class_text\"\n", "")
            .replace("\"cosine\"", "\"cross_entropy\"")
            .replace("repeat = 6", "repeat = 20")
            .replace("epochs = 1", "epochs = 1\nlog_every = 1");
        let (start, end) = (text.find("[model]").unwrap(), text.find("[[train]]").unwrap());
        let text = format!("{}[model]\ngrid_size = 0.15\n{model}{}", &text[..start], &text[end..]);
        let file = out.join("experiment.toml");
        std::fs::write(&file, text).unwrap();
        let experiment = ExperimentConfig::read(&file).unwrap();
        let stop = Arc::default();
        let out_run = out.join("run");
        let options = RunOptions {
            commit: None,
            out: out_run,
            resume: false,
            quiet: true,
            stop,
            device: candle_core::Device::Cpu,
        };
        let report = train(&experiment, &options).unwrap();
        let log = read_json_lines(&out.join("run/metrics.jsonl")).unwrap();
        let losses: Vec<f64> =
            log.iter().filter(|m| m.name == "train/loss").map(|m| m.value).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (first, last) = (mean(&losses[..5]), mean(&losses[losses.len() - 5..]));
        assert!(last < 0.9 * first, "{losses:?}");

        let config = config_beside(&report.model).unwrap().unwrap();
        let weights = Weights::File(report.model);
        let network = Network::load(config, &weights, WeightOptions::default()).unwrap();
        let settings = scenesplat_rooms::SyntheticRoomSettings::with_count(6000, 1);
        let scene = scenesplat_rooms::generate(&settings).unwrap().scene;
        let mut encoder = SceneEncoder { grid_size: 0.03, ..SceneEncoder::new(&network) };
        let whole = encoder.encode(&scene, &mut |_| Ok(())).unwrap();
        assert_eq!((whole.len(), whole.width(), whole.summary.tiles), (scene.len(), 41, 1));
        encoder.halo = 4;
        // The smallest limit that is accepted has room for the smallest tiles only.
        let parts = (1..4000).find_map(|step| {
            encoder.max_memory = Some(step << 18);
            encoder.encode(&scene, &mut |_| Ok(())).ok()
        });
        let parts = parts.expect("some limit is enough");
        assert!(parts.summary.tiles > 1, "{:?}", parts.summary);
    }

    #[test]
    fn networks_of_points_train_and_run_like_the_others() {
        let one = tempfile::tempdir().unwrap();
        trains_and_runs(
            one.path(),
            "architecture = \"point_transformer_v1\"\nnum_classes = 41\nstride = [1, 2]\n\
             enc_depths = [1, 1]\nchannels = [16, 32]\nneighbors = [6, 8]\ndec_depths = [1, 1]\n",
        );
        let two = tempfile::tempdir().unwrap();
        trains_and_runs(
            two.path(),
            "architecture = \"point_transformer_v2\"\nnum_classes = 41\ndrop_path = 0.0\n\
             patch_embed_channels = 12\npatch_embed_groups = 3\nstride = [2]\nenc_depths = [1]\n\
             enc_channels = [24]\nenc_groups = [6]\nenc_neighbors = [8]\ndec_depths = [1]\n\
             dec_channels = [12]\ndec_groups = [3]\ndec_neighbors = [8]\n",
        );
    }

    #[test]
    fn a_model_folder_says_what_its_network_reads() {
        let folder = tempfile::tempdir().unwrap();
        let own = |name: &str, channels: &str, width| {
            let (trained, config, again) = run(&folder.path().join(name), channels, width);
            let written = serde_json::to_value(&config.input.channels).unwrap().to_string();
            assert_eq!(written, channels.replace(' ', ""));
            assert!((trained - again).abs() < 1e-9, "{name}: {trained}, then {again}");
            config
        };
        let plain = own("plain", r#"["color", "opacity", "quat", "scale"]"#, 11);
        let swapped = own("swapped", r#"["scale", "quat", "opacity", "color"]"#, 11);
        assert_ne!(plain, swapped);
        // A set that no released network has.
        let config = own("normals", r#"["color", "normal"]"#, 6);
        let weights = Weights::File(folder.path().join("normals/run/model"));
        let network = Network::load(config, &weights, WeightOptions::default()).unwrap();
        let settings = scenesplat_rooms::SyntheticRoomSettings::with_count(300, 1);
        let mut scene = scenesplat_rooms::generate(&settings).unwrap().scene;
        scene.normal = Some(vec![[0.0, 0.0, 1.0]; scene.len()]);
        let features = SceneEncoder::new(&network).encode(&scene, &mut |_| Ok(())).unwrap();
        assert_eq!((features.len(), features.width()), (scene.len(), 32));
    }
}
