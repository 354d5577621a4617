//! Evaluations of small scenes, each number written out.

use super::*;
use crate::embedded;
use scenesplat_rooms::{SyntheticRoomSettings, generate};

/// Five Gaussians on a line: three close together and two far off.
fn scene(segment: &[i32]) -> GaussianScene {
    GaussianScene {
        coord: [0.0, 1.0, 2.0, 10.0, 11.0].map(|x| [x, 0.0, 0.0]).to_vec(),
        segment: Some(segment.to_vec()),
        ..GaussianScene::default()
    }
}

fn text() -> TextTable {
    own_directions(["wall", "chair", "bed"].map(str::to_owned).to_vec()).unwrap()
}

fn near(got: Option<f64>, want: f64) {
    assert!(got.is_some_and(|v| (v - want).abs() < 1e-8), "{got:?}, by hand {want}");
}

#[test]
fn each_average_is_over_its_own_classes_and_chance_goes_by_the_seed() {
    let settings = EvaluationSettings {
        excluded: Vec::new(),
        options: ZeroShotOptions::default(),
        vote_k: 25,
        voters_with_feature: false,
        keeps_unknown: false,
        seed: 0,
    };
    assert_eq!(EvaluationSettings::default(), settings);
    let text = text();
    for seed in [0, 7] {
        let settings =
            EvaluationSettings { excluded: vec![0], vote_k: 0, seed, ..settings.clone() };
        let mut evaluation = Evaluation::new(&text, settings).unwrap();
        assert_eq!(evaluation.names(), ["wall", "chair", "bed"]);
        let scene = scene(&[0, 0, 1, 2, 2]);
        let truth = evaluation.truth(&scene, None).unwrap();
        let checked = evaluation.check(&truth, None).unwrap();
        evaluation.add_truth(&truth, &checked).unwrap();
        let labels = vec![0, 0, 0, 2, -1];
        assert_eq!(evaluation.add_labels(&truth, labels.clone()).unwrap(), labels);
        let report = evaluation.report();
        let model = report.model.unwrap();
        // IoU 2/3, 0, 1/2; accuracies 1, 0, 1/2; the wall is left out of those that begin with f.
        near(model.all_accuracy, 0.6);
        near(model.mean_iou, (2.0 / 3.0 + 0.0 + 0.5) / 3.0);
        near(model.mean_accuracy, 0.5);
        near(model.foreground_mean_iou, 0.25);
        near(model.foreground_mean_accuracy, 0.25);
        near(report.oracle.mean_iou, 1.0);
        let drawn = random_labels(5, 3, seed).unwrap();
        let right = drawn.iter().zip([0, 0, 1, 2, 2]).filter(|(a, b)| **a == *b).count();
        near(report.random.all_accuracy, right as f64 / 5.0);
        assert_eq!((report.given.is_none(), report.withheld), (true, 0));
    }
    let gone = EvaluationSettings { excluded: vec![3], ..settings };
    assert!(Evaluation::new(&text, gone).is_err());
}

#[test]
fn who_votes_and_what_stays_unknown_are_as_they_are_set() {
    let text = text();
    let votes = |settings: EvaluationSettings, mask: Option<[bool; 5]>, about: Restraint<'_>| {
        let mut evaluation = Evaluation::new(&text, settings).unwrap();
        let given =
            GaussianScene { valid_feat_mask: mask.map(Vec::from), ..scene(&[0, 0, 1, 2, 2]) };
        let truth = evaluation.truth(&given, None).unwrap();
        evaluation.add_some_labels(&truth, vec![0, 0, 1, 2, -1], about).unwrap()
    };
    let of = |vote_k| EvaluationSettings { vote_k, ..EvaluationSettings::default() };
    let all = Restraint::default();
    // Of three each: 0 0 1, 0 0 1, 1 0 0, 2 none 1 and none 2 1, where the smaller of equally many wins.
    assert_eq!(votes(of(3), None, all), [0, 0, 0, 1, 1]);
    assert_eq!(votes(of(1), None, all), [0, 0, 1, 2, -1]);
    assert_eq!(votes(of(0), None, all), [0, 0, 1, 2, -1]);
    let keeps = EvaluationSettings { keeps_unknown: true, ..of(3) };
    assert_eq!(votes(keeps, None, all), [0, 0, 0, 1, -1]);
    let unknown = UnknownRule { min_cosine: Some(0.1), min_margin: None };
    let withholds = ZeroShotOptions { unknown, ..ZeroShotOptions::default() };
    assert_eq!(
        votes(EvaluationSettings { options: withholds, ..of(3) }, None, all),
        [0, 0, 0, 1, -1]
    );
    // Only the third and the fourth vote, by the scene, by the restraint, or by both together.
    let (mask, voters) = ([false, true, true, true, false], [true, false, true, true, true]);
    let some = EvaluationSettings { voters_with_feature: true, ..of(1) };
    let both = Restraint { voters: Some(&voters), withheld: &[] };
    let three = EvaluationSettings { vote_k: 3, ..some };
    // The nearest three that vote: 0 1 2, and so on: the smallest of equally many.
    assert_eq!(votes(three.clone(), Some(mask), all), [0; 5]);
    assert_eq!(votes(three, Some(mask), both), [1; 5]);
    assert_eq!(votes(of(3), Some(mask), both), [0, 0, 0, 1, 1]);
    let withheld = [false, true, false, true, false];
    let about = Restraint { voters: None, withheld: &withheld };
    assert_eq!(votes(of(0), None, about), [0, -1, 1, -1, -1]);
    let mut evaluation = Evaluation::new(&text, of(0)).unwrap();
    let given = scene(&[0, 0, 1, -1, 2]);
    let truth = evaluation.truth(&given, None).unwrap();
    evaluation.add_some_labels(&truth, vec![0, 0, 0, 2, 2], about).unwrap();
    let report = evaluation.report();
    // One of the two places has a class; of four 0 and 2 are right, of the three others two.
    assert_eq!(report.withheld, 1);
    near(report.model.unwrap().all_accuracy, 0.5);
    near(report.given.unwrap().all_accuracy, 2.0 / 3.0);
}

#[test]
fn labels_of_a_scene_mean_other_classes_and_features_become_classes() {
    let text = text();
    let mut evaluation =
        Evaluation::new(&text, EvaluationSettings { vote_k: 0, ..<_>::default() }).unwrap();
    // Labels 0 to 3 mean bed, nothing, wall, chair.
    let given = scene(&[0, 1, 2, 3, -1]);
    let truth = evaluation.truth(&given, Some(&[2, -1, 0, 1])).unwrap();
    assert_eq!(truth.scored(), [2, -1, 0, 1, -1]);
    let checked = evaluation.check(&truth, None).unwrap();
    evaluation.add_oracle(&truth, &checked).unwrap();
    near(evaluation.report().oracle.all_accuracy, 1.0);
    // A row of another class is noticed, and one that cannot be another is named.
    assert!(matches!(evaluation.check(&truth, Some(2)), Err(EvaluationError::Oracle(_))));
    for row in [1, 4, 9] {
        let error = evaluation.check(&truth, Some(row)).unwrap_err();
        assert!(matches!(error, EvaluationError::Fault { row: found } if found == row), "{error}");
    }
    let fault = fault(&[-1, 2, 2, 1, 0], 2).unwrap();
    assert_eq!((fault.row, fault.class), (2, 1));
    assert!(super::fault(&[1, 1, -1], 0).is_err());
    let rows = vec![0.9, 0.1, 0.0, 0.0, 0.2, 0.8, 0.0, 0.0, 0.0, 0.1, 0.7, 0.2, 0.2, 0.0, 0.1];
    let features = SceneFeatures::from_rows(rows, 3).unwrap();
    for classifier in [false, true] {
        let found = evaluation.label(&features, classifier).unwrap();
        // A row of zeros has no direction; of equal probabilities the first class is the largest.
        let none = if classifier { 0 } else { -1 };
        assert_eq!(found, [0, 2, none, 1, 0], "{classifier}");
        let again = evaluation.label_agreeing(&features, classifier, &Agreement::default());
        assert_eq!(again.unwrap(), found);
    }
    // Classes whose texts are equal come out as the first of them, which is no error.
    let names = ["a", "b", "c"].map(str::to_owned).to_vec();
    let same = TextTable::from_rows(names, vec![1.0, 0.0, 0.0, 1.0, 1.0, 0.0], 2).unwrap();
    let mut evaluation =
        Evaluation::new(&same, EvaluationSettings { vote_k: 0, ..<_>::default() }).unwrap();
    let given = scene(&[0, 1, 2, 2, -1]);
    let truth = evaluation.truth(&given, None).unwrap();
    let checked = evaluation.check(&truth, None).unwrap();
    evaluation.add_truth(&truth, &checked).unwrap();
    near(evaluation.report().oracle.all_accuracy, 0.5);
}

#[test]
fn a_network_is_evaluated_scene_by_scene() {
    let network = Network::load(
        embedded::config().unwrap(),
        &crate::network::Weights::Embedded,
        crate::network::WeightOptions::default(),
    )
    .unwrap();
    let text = embedded::vocabulary().unwrap().class_table();
    let room = |seed| generate(&SyntheticRoomSettings::with_count(300, seed)).unwrap().scene;
    let settings =
        EvaluationSettings { excluded: vec![0, 2], vote_k: 5, seed: 3, ..<_>::default() };
    let scenes = || [1, 2].map(|seed| (format!("room {seed}"), room(seed)));
    let mut told = 0;
    let found = evaluate(&network, &text, settings.clone(), scenes(), None, &mut |_| {
        told += 1;
        Ok(())
    });
    let mut by_hand = Evaluation::new(&text, settings.clone()).unwrap();
    for (_, scene) in &scenes() {
        let truth = by_hand.truth(scene, None).unwrap();
        let checked = by_hand.check(&truth, None).unwrap();
        by_hand.add_truth(&truth, &checked).unwrap();
        let features = SceneEncoder::new(&network).encode(scene, &mut |_| Ok(())).unwrap();
        let labels = by_hand.label(&features, false).unwrap();
        by_hand.add_labels(&truth, labels).unwrap();
    }
    let found = found.unwrap();
    assert_eq!(found, by_hand.report());
    assert!(told >= 2 && found.model.unwrap().classes[0].excluded);
    // The first scene that cannot be scored is named; who stops it is not asked for one.
    let bare = GaussianScene { segment: None, ..room(1) };
    let scenes = [("first".to_owned(), room(2)), ("second".to_owned(), bare)];
    let error =
        evaluate(&network, &text, settings.clone(), scenes, None, &mut |_| Ok(())).unwrap_err();
    let EvaluationError::Scene { scene, source } = error else { panic!("{error}") };
    assert!(scene == "second" && matches!(*source, EvaluationError::NoLabels));
    let stop = &mut |_| Err(EncodeError::Stopped);
    let error =
        evaluate(&network, &text, settings, [("a".to_owned(), room(1))], None, stop).unwrap_err();
    assert!(matches!(error, EvaluationError::Encode(EncodeError::Stopped)), "{error}");
    let says = [
        (
            EvaluationError::UnknownLabel { row: 1, label: 2, known: 3 },
            "row 1 has label 2, but there are only 3 names",
        ),
        (EvaluationError::Fault { row: 4 }, "row 4 cannot be spoiled"),
        (EvaluationError::NoVoters, "(no valid_feat_mask)"),
        (EvaluationError::NoLabels, "nothing to evaluate"),
    ];
    assert!(says.iter().all(|(error, text)| error.to_string().contains(text)));
}

#[test]
fn ids_are_other_ones_by_a_fifth_of_all_twice_as_many_and_three_classes() {
    // So many labels agree as they are, so many if each stood for the name before, and the next one; the rest with none.
    let judged = |all: usize, [own, before, next]: [usize; 3], classes: i32| {
        let labels: Vec<i32> = (0..all as i32).map(|i| 10 + 3 * (i % classes)).collect();
        let found: Vec<i32> = (0..all)
            .map(|i| match i {
                i if i < own => labels[i],
                i if i < own + before => labels[i] - 1,
                i if i < own + before + next => labels[i] + 1,
                i if i % 2 == 0 => -1,
                _ => 99,
            })
            .collect();
        let scene = GaussianScene { segment: Some(labels), ..GaussianScene::default() };
        other_ids(&scene, &found, None)
    };
    let found = judged(20, [2, 9, 0], 7).unwrap();
    assert_eq!((found.by, found.agree, found.would_agree), (-1, 0.1, 0.45));
    let found = judged(20, [2, 0, 9], 7).unwrap();
    assert_eq!((found.by, found.agree, found.would_agree), (1, 0.1, 0.45));
    assert_eq!(judged(20, [0, 6, 8], 7).map(|o| (o.by, o.would_agree)), Some((1, 0.4)));
    assert_eq!(judged(20, [0, 8, 6], 7).map(|o| (o.by, o.would_agree)), Some((-1, 0.4)));
    // By 20 of 100 more, not by less.
    assert!(judged(15, [0, 3, 0], 7).is_some() && judged(16, [0, 3, 0], 7).is_none());
    assert!(judged(100, [10, 31, 0], 7).is_some() && judged(100, [10, 29, 0], 7).is_none());
    assert!(judged(100, [0, 20, 0], 7).is_some() && judged(100, [0, 19, 0], 7).is_none());
    // Twice as many, not fewer.
    assert!(judged(100, [30, 60, 0], 7).is_some() && judged(100, [30, 59, 0], 7).is_none());
    assert!(judged(20, [0, 10, 0], 3).is_some() && judged(20, [0, 10, 0], 2).is_none());
    // Labels of nothing are not counted, and what a map does not know is no class.
    let labels = [vec![1, 2, 3], vec![-1; 9]].concat();
    let scene = GaussianScene { segment: Some(labels), ..GaussianScene::default() };
    let found = [vec![5, 6, 7], vec![0; 9]].concat();
    let other = other_ids(&scene, &found, Some(&[5, 6, 7])).unwrap();
    assert_eq!((other.by, other.agree, other.would_agree), (-1, 0.0, 1.0));
}

#[test]
fn classes_are_found_by_their_names() {
    use crate::scene::LabelSet;
    use scenesplat_rooms::CLASSES;
    let names = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<String>>();
    let set = |list: &[&str]| background(&LabelSet::new(names(list)).unwrap());
    assert_eq!(set(&["ceiling", "chair", "wall", "floor"]), [2, 3, 0]);
    assert_eq!(set(&["floor", "bed"]), [0]);
    let table = text();
    assert_eq!(
        (table.dim, table.values.as_slice()),
        (3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0][..])
    );
    assert!(own_directions(Vec::new()).is_err());
    let all: Vec<String> = CLASSES.iter().map(|class| class.scannet200_name.to_owned()).collect();
    let found = classes_of_rooms(&all);
    for (row, class) in CLASSES.iter().enumerate() {
        let of = |list: &[&str]| classes_of_rooms(&names(list))[row];
        // The class of the same meaning, or a class of that very name elsewhere in the list.
        let at = usize::try_from(found[row]).unwrap();
        assert!([class.name, class.scannet200_name].contains(&all[at].as_str()), "{}", class.name);
        assert_eq!(of(&["no such thing", class.scannet200_name]), 1);
        assert_eq!(of(&["no such thing"]), -1);
        if class.name != class.scannet200_name {
            assert_eq!(of(&[class.scannet200_name, class.name]), 1, "its own name comes first");
        }
    }
}
