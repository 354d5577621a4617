//! A whole probe of a small model folder, against its parts.

use super::rows::{choose, objects, read};
use super::*;
use crate::experiment::export::write_model;
use scenesplat_datasets::SyntheticRooms;
use scenesplat_models::{ModelConfig, PointTransformerV3Config};
use scenesplat_rooms::SyntheticRoomSettings;
use std::sync::Arc;

#[test]
fn a_report_is_of_the_network_of_an_untrained_one_and_of_what_they_read() {
    let stages = [[1, 8, 1], [1, 16, 2]];
    let backbone = PointTransformerV3Config::language().with_stages(&stages, &[[1, 8, 1]], 32);
    let model = ModelConfig { grid_size: 0.3, ..ModelConfig::new(backbone) };
    let config = NetworkConfig { model, ..NetworkConfig::language() };
    // Trained, as far as a probe can tell: other values than those of any seed.
    let store = ParamStore::trainable(5);
    config.model.build(store.builder()).unwrap();
    let all = store.parameters().into_iter().chain(store.buffers());
    let tensors =
        all.map(|(name, var)| (name, (var.as_detached_tensor() * 1.5).unwrap())).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    write_model(&tensors, &config, &path).unwrap();
    let room = SyntheticRoomSettings { num_gaussians: Some(500), ..Default::default() };
    let rooms = Arc::new(SyntheticRooms::new(3, room, 3).unwrap());
    let scenes = ProbeScenes::new(rooms, 0.3, Some(1)).unwrap();
    let labels = LabelRegime::PerScene(15);
    let settings =
        ProbeSettings { labels, steps: 4, lr: 0.05, seed: 2, ..ProbeSettings::default() };
    let mut said = Vec::new();
    let report = probe(&path, &scenes, &settings, &mut |text| {
        said.push(text.to_owned());
        true
    })
    .unwrap();
    let kinds = ["backbone", "random", "raw_inputs"];
    let steps = kinds.map(|kind| {
        [format!("{kind}: rows of 3 scenes"), format!("{kind}: 30 rows are learned from")]
    });
    assert_eq!(said, steps.concat());
    assert_eq!(report.settings, settings);
    assert_eq!(report.train_scenes, ["room-000000", "room-000001"]);
    assert_eq!(
        (report.test_scenes.as_slice(), report.learned_rows),
        (&["room-000002".to_owned()][..], 30)
    );

    let network =
        Network::load(config.clone(), &Weights::File(path.clone()), WeightOptions::default())
            .unwrap();
    let random = random_network(&config, 2).unwrap();
    let (train, test) = scenes.split().unwrap();
    let sources = [
        (&report.backbone, RowSource::Network(network.model())),
        (&report.random, RowSource::Network(random.as_ref())),
        (&report.raw_inputs, RowSource::Inputs),
    ];
    for ((result, source), width) in sources.into_iter().zip([24, 24, 12]) {
        let [train, test] =
            [&train, &test].map(|data| read(data.as_ref(), &config, source).unwrap());
        let labelled: usize =
            train.iter().map(|s| s.labels.iter().filter(|l| **l >= 0).count()).sum();
        let largest = train.iter().chain(&test).flat_map(|s| &s.truth).max().unwrap();
        assert_eq!((report.labelled_rows, report.classes), (labelled, *largest as usize + 1));
        let classifier =
            Classifier::train(&choose(&train, labels, 2).unwrap(), report.classes, &settings)
                .unwrap();
        let answer =
            score(|s| classifier.classes(&s.rows), &test, report.classes).unwrap().tester_report();
        assert_eq!((result.width, result.loss), (width, classifier.loss));
        assert_eq!(
            (result.miou, result.macc, result.all_acc),
            (answer.mean_iou, answer.mean_accuracy, answer.all_accuracy)
        );
        assert!(
            result.class_iou.iter().eq(answer.classes.iter().map(|c| &c.iou))
                && result.seconds > 0.0
        );
        let both = [&train, &test].map(|scenes| objects(scenes).unwrap().map(|o| o.labels.len()));
        assert_eq!(
            result.objects.map(|o| [Some(o.train_objects), Some(o.test_objects)]),
            both[0].map(|_| both)
        );
    }
    assert_ne!(report.backbone.loss, report.random.loss);

    // A decoder on its own encoder, and three layers where there is none.
    let of = |objects, kind| {
        let settings = ProbeSettings { objects, kind, steps: 2, ..settings.clone() };
        probe(&path, &scenes, &settings, &mut |_| true).unwrap()
    };
    let decoded = of(false, ProbeKind::Decoder);
    let widths =
        [&decoded.backbone, &decoded.random, &decoded.raw_inputs].map(|result| result.width);
    assert_eq!((widths, decoded.backbone.objects.is_none()), ([64, 64, 12], true));
    assert_ne!(decoded.backbone.loss, decoded.random.loss);
    let deep = of(false, ProbeKind::Mlp3);
    assert_eq!(deep.raw_inputs.loss, decoded.raw_inputs.loss);
    for stop in 1..=6 {
        let mut left = stop;
        let stopped = probe(&path, &scenes, &settings, &mut |_| {
            left -= 1;
            left > 0
        });
        assert!(matches!(stopped, Err(ProbeError::Stopped)), "{stop}");
    }
    let bad = ProbeSettings { steps: 0, ..settings };
    assert!(matches!(probe(&path, &scenes, &bad, &mut |_| true), Err(ProbeError::Setting { .. })));
}
