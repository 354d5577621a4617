//! Figures of a record by hand, and a setting measured on two rooms.

use super::super::record::tests::record;
use super::*;
use scenesplat::evaluation::{classes_of_rooms, own_directions};
use scenesplat::network::{NetworkConfig, WeightOptions, Weights};
use scenesplat_rooms::{SyntheticRoomSettings, Vocabulary, generate};
use scenesplat_scene::formats::inria_ply::write_inria_ply;

fn network() -> Network {
    let weights = Weights::Seeded(1);
    Network::load(NetworkConfig::tiny(), &weights, WeightOptions::default()).unwrap()
}

fn job<'a>(network: &'a Network, text: &'a TextTable, scenes: &'a [SceneInput]) -> Job<'a> {
    Job {
        setting: "k=8".to_owned(),
        set: "rooms".to_owned(),
        encoder: SceneEncoder::new(network),
        text,
        evaluation: EvaluationSettings { excluded: vec![2], vote_k: 3, ..Default::default() },
        scenes,
        read: ReadOptions::default(),
        repeats: 3,
        writes: vec![Written::Labels],
        scratch: PathBuf::new(),
        reference: None,
        keep_labels: None,
        bounds: false,
        conditions: "conditions".to_owned(),
        weights_hash: "weights".to_owned(),
        input_hash: "input".to_owned(),
        load_seconds: 0.25,
        machine: Machine { cpu: "cpu".to_owned(), ..Machine::default() },
    }
}

fn sha(bytes: &[u8]) -> String {
    hex(Sha256::new_with_prefix(bytes))
}

#[test]
fn figures_of_a_record_by_hand() {
    let network = network();
    let text = own_directions(["wall", "chair", "lamp"].map(str::to_owned).to_vec()).unwrap();
    let job = job(&network, &text, &[]);
    let of = |seconds: [f64; 3], stage_seconds: [f64; 4], hash: &str| SceneRecord {
        seconds: seconds.to_vec(),
        stage_seconds: stage_seconds.to_vec(),
        prediction_hash: hash.to_owned(),
        ..SceneRecord::default()
    };
    let scenes = |network: f64| {
        let first = of([1.0, 2.0, 3.0], [0.1, network, 0.3, 0.05], "one");
        vec![first, of([4.0, 5.0, 9.0], [0.3, 4.5, 0.8, 0.25], "two")]
    };
    let mut quality = Quality { agreeing: 7, compared: 9, ..Quality::default() };
    quality.hits = Hits { hits: 3, asked: 4 };
    quality.calibration.add(0.9, false);
    quality.calibration.add(0.5, true);
    for (said, truth) in [([0, 1, 1, 2], [0, 0, 1, 2]), ([0, 0, 1, 2], [0, 1, 1, 0])] {
        let mut matrix = ConfusionMatrix::new(3).unwrap().with_excluded(&[2]).unwrap();
        matrix.update((&said, &truth)).unwrap();
        quality.matrices.push(matrix);
    }
    quality.truth.update([5, 0, 0, 0]);
    let names = job.stage_names();
    assert_eq!(names, ["read", "network", "labels", "write_labels"]);
    let found = finish(&job, &names, scenes(1.5), &quality, 77, 88).unwrap();
    // All times: 1, 2, 3, 4, 5, 9. Their middle, and 3/4 of the way from 5 to 9. Repeats' medians: 2.5, 3.5 and 6.
    let near = |found: f64, want: f64| assert!((found - want).abs() < 1e-9, "{found} {want}");
    near(found.seconds_p50, 3.5);
    near(found.seconds_p95, 8.0);
    assert_eq!((found.seconds_low, found.seconds_high), (2.5, 6.0));
    assert_eq!((found.peak_bytes, found.bytes_written, found.repeats), (77, 88, 3));
    // Of 4 s in the mean.
    let want = [("read", 0.2), ("network", 3.0), ("labels", 0.55), ("write_labels", 0.15)];
    for (stage, (name, seconds)) in found.stages.iter().zip(want) {
        assert_eq!(stage.name, name);
        near(stage.seconds, seconds);
        near(stage.share, seconds / 4.0);
    }
    near(found.stage_coverage, 0.975);
    // Class 0: 2 of 4 + 3 − 2, class 1: 2 of 3 + 3 − 2, class 2, which is no foreground: 1 of 1 + 2 − 1.
    near(found.f_miou.unwrap(), 0.45);
    near(found.miou.unwrap(), 1.4 / 3.0);
    near(found.f_macc.unwrap(), (0.5 + 2.0 / 3.0) / 2.0);
    near(found.macc.unwrap(), (0.5 + 2.0 / 3.0 + 1.0) / 3.0);
    near(found.all_acc.unwrap(), 5.0 / 8.0);
    let bounds = f_miou_with_bounds(&quality.matrices).unwrap().unwrap();
    assert_eq!((found.f_miou_low, found.f_miou_high), (Some(bounds[1]), Some(bounds[2])));
    assert!(bounds[1] < bounds[2]);
    assert_eq!((found.agreement, found.query_hit1), (Some(7.0 / 9.0), Some(0.75)));
    // Off by 0.9 and by 0.5.
    near(found.ece.unwrap(), 0.7);
    assert_eq!((found.prediction_hash, found.truth_hash), (sha(b"onetwo"), sha(&[5, 0, 0, 0])));
    let texts =
        [&found.setting, &found.scenes, &found.conditions, &found.weights_hash, &found.input_hash];
    assert_eq!(texts, ["k=8", "rooms", "conditions", "weights", "input"]);
    assert_eq!(
        (found.load_seconds, found.width, found.classes),
        (0.25, network.model().out_channels(), 3)
    );
    assert_eq!((found.machine.cpu.as_str(), found.fingerprint), ("cpu", job.machine.fingerprint()));
    assert_eq!(
        (found.kind, found.changes_result, found.per_scene.len()),
        (Kind::Setting, Some(true), 2)
    );
    assert_eq!((found.neutral, found.rule, found.holds), (None, None, None));
    // 0.2 s less of the first network are 0.1 s of 4 less in the mean: 95 %.
    let error = finish(&job, &names, scenes(1.3), &quality, 0, 0).unwrap_err().to_string();
    assert!(
        error.contains("k=8: the stages add up to 95.0 %") && error.contains("97 %"),
        "{error}"
    );
    let both = Job { writes: vec![Written::Features, Written::Labels], ..job };
    assert_eq!(both.stage_names()[3..], ["write_features", "write_labels"]);
    assert_eq!(labels_path(Path::new("a"), 17), Path::new("a").join("00017.npy"));
    assert_eq!(labels_hash(&vec![-2; 5000]), sha(&[254, 255, 255, 255].repeat(5000)));
}

#[test]
fn rows_that_are_no_settings_keep_the_machine_and_lose_what_is_of_the_setting() {
    let text = own_directions(["wall", "chair"].map(str::to_owned).to_vec()).unwrap();
    let mut evaluation = Evaluation::new(&text, EvaluationSettings::default()).unwrap();
    let coord = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let truth = SceneTruth::new(&coord, Some(&[0, 1, 1]), None, 2).unwrap().unwrap();
    let mut quality = Quality::default();
    quality.add_bounds(&mut evaluation, &truth).unwrap();
    (quality.oracle_seconds, quality.random_seconds) = (vec![1.0, 2.0, 5.0], vec![0.25]);
    let rows = quality.rows(&evaluation, &record("k=8", 1.0, 0.5));
    for (row, (name, median, high)) in
        rows.iter().zip([("oracle", 2.0, 4.7), ("random labels", 0.25, 0.25)])
    {
        assert_eq!((row.setting.as_str(), row.changes_result, row.repeats), (name, None, 1));
        assert_eq!([row.seconds_p50, row.seconds_low, row.seconds_high], [median; 3]);
        assert!((row.seconds_p95 - high).abs() < 1e-12);
        assert_eq!((row.load_seconds, row.bytes_written, row.stage_coverage), (0.0, 0, 1.0));
        assert_eq!((row.agreement, row.query_hit1, row.ece), (None, None, None));
        assert!(
            row.stages.is_empty() && row.prediction_hash.is_empty() && row.per_scene.is_empty()
        );
        assert_eq!(
            (row.scenes.as_str(), row.fingerprint.as_str(), row.peak_bytes),
            ("rooms", "m", 100_000_000)
        );
    }
}

#[test]
fn two_rooms_are_measured_scored_and_compared_with_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    let network = network();
    let text = Vocabulary::new(network.model().out_channels()).unwrap().class_table();
    let mut truth = Vec::new();
    let scenes = [(300, 1), (420, 2)].map(|(count, room)| {
        let settings = SyntheticRoomSettings {
            room,
            points_share: 0.0,
            ..SyntheticRoomSettings::with_count(count, 3)
        };
        let scene = generate(&settings).unwrap().scene;
        truth.extend(scene.segment.clone().unwrap());
        let path = folder.path().join(format!("{room}.ply"));
        write_inria_ply(&scene, &[], &path).unwrap();
        SceneInput {
            name: format!("room{room}"),
            path,
            label_ids: None,
            class_of: Some(classes_of_rooms(&text.names)),
        }
    });
    let kept = folder.path().join("kept");
    let with = |reference: Option<&Path>, keep: Option<&Path>, bounds: bool| {
        measure(&Job {
            evaluation: EvaluationSettings { vote_k: 3, ..Default::default() },
            repeats: 2,
            writes: vec![Written::Labels, Written::Features],
            scratch: folder.path().to_owned(),
            reference: reference.map(Path::to_owned),
            keep_labels: keep.map(Path::to_owned),
            bounds,
            ..job(&network, &text, &scenes)
        })
        .unwrap()
    };
    let first = with(None, Some(&kept), true);
    let record = &first.setting;
    assert_eq!((record.agreement, record.per_scene.len(), record.repeats), (None, 2, 2));
    let sizes: Vec<usize> = record.per_scene.iter().map(|s| s.gaussians).collect();
    assert_eq!(sizes, [300, 420]);
    let mut labels = Vec::new();
    for (i, scene) in record.per_scene.iter().enumerate() {
        let own = NpyFile::open(&labels_path(&kept, i)).unwrap().read_i64().unwrap();
        let bytes: Vec<u8> = own.iter().flat_map(|l| (*l as i32).to_le_bytes()).collect();
        assert_eq!((scene.prediction_hash.clone(), own.len()), (sha(&bytes), sizes[i]));
        assert_eq!(
            (scene.name.clone(), scene.passes, scene.tiles),
            (format!("room{}", i + 1), 1, 1)
        );
        assert!(scene.voxels > 0 && scene.voxels <= sizes[i] && scene.seconds.len() == 2);
        assert!(
            (scene.stage_seconds.iter().sum::<f64>() * 2.0 / scene.seconds.iter().sum::<f64>()
                - 1.0)
                .abs()
                < 0.05
        );
        labels.push(own);
    }
    // Four bytes a label and a score, two a number of a feature; the mean of both rooms is 360 Gaussians, and of each
    // file a head of 128 bytes.
    let bytes = 3 * 128 + 360 * (4 + 4 + 2 * record.width as u64);
    assert_eq!(record.bytes_written, bytes);
    let classes = classes_of_rooms(&text.names);
    let known = |t: i32| usize::try_from(t).map_or(-1, |t| classes[t]);
    let flat: Vec<i64> = labels.concat();
    let scored: Vec<(i64, i32)> =
        flat.iter().copied().zip(truth.iter().map(|t| known(*t))).filter(|p| p.1 >= 0).collect();
    let right = scored.iter().filter(|(l, t)| *l == i64::from(*t)).count();
    assert!((record.all_acc.unwrap() - right as f64 / scored.len() as f64).abs() < 1e-12);
    let [oracle, random] = first.bounds.unwrap();
    assert_eq!((oracle.kind, random.kind), (Kind::Oracle, Kind::Random));
    assert!(oracle.f_miou.unwrap() > random.f_miou.unwrap());
    // Queries are asked of both rooms: the hits of each alone, over the classes of both.
    let alone = [0, 1].map(|i| {
        let own = &truth[if i == 0 { 0..sizes[0] } else { sizes[0]..truth.len() }];
        let classes: std::collections::BTreeSet<i32> =
            own.iter().map(|t| known(*t)).filter(|t| *t >= 0).collect();
        let scratch = folder.path().to_owned();
        let one = Job { scratch, ..job(&network, &text, &scenes[i..=i]) };
        let record = measure(&one).unwrap().setting;
        [record.query_hit1.unwrap() * classes.len() as f64, classes.len() as f64]
    });
    let [hits, asked] = [0, 1].map(|k| alone[0][k] + alone[1][k]);
    assert!(alone.iter().all(|room| room[1] > 2.0));
    assert!((record.query_hit1.unwrap() - hits / asked).abs() < 1e-12, "{alone:?}");
    // Against itself all labels agree. Three of the second room's were others.
    let again = with(Some(&kept), None, false);
    assert_eq!((again.setting.agreement, again.bounds), (Some(1.0), None));
    assert_eq!(again.setting.prediction_hash, record.prediction_hash);
    assert_eq!(
        (again.setting.truth_hash.clone(), again.setting.f_miou),
        (record.truth_hash.clone(), record.f_miou)
    );
    let other: Vec<i32> =
        labels[1].iter().enumerate().map(|(i, l)| *l as i32 + i32::from(i < 3)).collect();
    write_npy(&labels_path(&kept, 1), &[other.len()], &other).unwrap();
    let third = with(Some(&kept), None, false).setting;
    assert_eq!(third.agreement, Some(717.0 / 720.0));
    assert_eq!(third.per_scene[1].agreement, Some(417.0 / 420.0));
    assert_eq!(third.per_scene[0].agreement, Some(1.0));
    let missing = [SceneInput { path: folder.path().join("no.ply"), ..scenes[0].clone() }];
    assert_eq!(measure(&job(&network, &text, &missing)).unwrap_err().to_string(), "room1");
    assert!(
        measure(&job(&network, &text, &[]))
            .unwrap_err()
            .to_string()
            .contains("no measured setting with a scene")
    );
}
