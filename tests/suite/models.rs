//! The model folder of a run: it says what its network reads, and gives what training measured.

use crate::runs::run;
use crate::settings::{Data, text};
use scenesplat::experiment::{ExperimentConfig, RunReport, data};
use scenesplat::metrics::Metric;
use scenesplat::network::config_beside;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::trainers::callbacks::read_json_lines;
use scenesplat::trainers::evaluators::ZeroShotEvaluator;
use scenesplat::{Network, SceneEncoder, WeightOptions, Weights};

/// The network of a model folder.
fn network(report: &RunReport) -> Network {
    let config = config_beside(&report.model).unwrap().unwrap();
    let weights = Weights::File(report.model.clone());
    Network::load(config, &weights, WeightOptions::default()).unwrap()
}

fn room(count: usize) -> GaussianScene {
    generate(&SyntheticRoomSettings::with_count(count, 1)).unwrap().scene
}

/// The accuracy that the folder's network has on the scenes of the experiment's evaluation.
fn accuracy(experiment: &ExperimentConfig, network: &Network) -> f64 {
    let scenes = data::evaluation(&experiment.evaluate[0], experiment, None).unwrap();
    let table = data::text_table(experiment.text.as_ref().unwrap()).unwrap().table;
    let input = network.input().clone();
    let evaluator = ZeroShotEvaluator::new("again", scenes, input, table, Vec::new());
    let measured = evaluator.confusion(network.model()).unwrap().measure();
    measured.iter().find(|m| m.name == "allAcc").unwrap().value
}

#[test]
fn a_model_folder_says_what_its_network_reads() {
    let data = Data::new();
    for (name, channels, width) in [
        ("plain", r#"["color","opacity","quat","scale"]"#, 11),
        ("swapped", r#"["scale","quat","opacity","color"]"#, 11),
        // A set that no released network has.
        ("normals", r#"["color","normal"]"#, 6),
    ] {
        let text = text("rooms").replace(
            "[model]",
            &format!("[input]\nchannels = {channels}\n[model]\nin_channels = {width}"),
        );
        let experiment = data.experiment(&text).unwrap();
        let out = data.path().join(name);
        let report = run(&experiment, &out, false).unwrap();
        let log = read_json_lines(&out.join("metrics.jsonl")).unwrap();
        let trained = log.iter().rfind(|m| m.name == "unseen/allAcc").unwrap().value;
        let network = network(&report);
        let written = serde_json::to_value(&network.input().channels).unwrap().to_string();
        assert_eq!(written, channels);
        let again = accuracy(&experiment, &network);
        assert!((trained - again).abs() < 1e-9, "{name}: {trained}, then {again}");
        let mut scene = room(300);
        scene.normal = Some(vec![[0.0, 0.0, 1.0]; scene.len()]);
        let features = SceneEncoder::new(&network).encode(&scene, &mut |_| Ok(())).unwrap();
        assert_eq!((features.len(), features.width()), (scene.len(), 64));
    }
}

#[test]
fn networks_of_points_train_and_run_like_the_others() {
    let data = Data::new();
    for base in ["v1", "v2"] {
        let text = text(base).replace("drop_path = 0.3", "drop_path = 0.0").replace(
            "{ groups = [] }",
            "{ groups = [], lr = 0.01 }\ntrainer = { epochs = 30, log_every = 1 }",
        );
        let out = data.path().join(base);
        let report = run(&data.experiment(&text).unwrap(), &out, false).unwrap();
        let log = read_json_lines(&out.join("metrics.jsonl")).unwrap();
        let losses: Vec<f64> =
            log.iter().filter(|m| m.name == "train/loss").map(|m| m.value).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (first, last) = (mean(&losses[..5]), mean(&losses[losses.len() - 5..]));
        assert!(last < 0.9 * first, "{losses:?}");

        let (network, scene) = (network(&report), room(6000));
        let mut encoder = SceneEncoder { grid_size: 0.03, ..SceneEncoder::new(&network) };
        let whole = encoder.encode(&scene, &mut |_| Ok(())).unwrap();
        assert_eq!((whole.len(), whole.width(), whole.summary.tiles), (scene.len(), 41, 1));
        encoder.halo = 4;
        // The smallest limit that is accepted has room for the smallest tiles only.
        let parts = (1..1000).find_map(|step| {
            encoder.max_memory = Some(step << 20);
            encoder.encode(&scene, &mut |_| Ok(())).ok()
        });
        let parts = parts.expect("some limit is enough");
        assert!(parts.summary.tiles > 1, "{:?}", parts.summary);
    }
}
