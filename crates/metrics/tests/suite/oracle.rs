//! The guard passes on truth and fails on every single spoiled row.

use crate::support::{
    self, gridded_room, in_all_pools, published_texts, random_rows, rng, unit_rows,
};
use scenesplat_metrics::{
    Fault, MetricError, OracleCheck, OracleStage, OracleVote, TextRows, UnknownRule,
    ZeroShotOptions, random_labels,
};

fn text_rows(seed: u64, num_classes: usize) -> Vec<f32> {
    unit_rows(&random_rows(&mut rng(seed), num_classes, 64), 64)
}

fn vote_of(coord: &[[f32; 3]], k: usize) -> OracleVote<'_> {
    OracleVote { coord, valid: None, query: None, k, keep_unknown: false }
}

#[test]
fn truth_scores_one_and_each_spoiled_row_is_caught() {
    let units = text_rows(1, 7);
    let text = TextRows::new(&units, 64).unwrap();
    let labels = support::random_labels(&mut rng(2), 150, 7);
    let names: Vec<String> = (0..7).map(|c| format!("thing {c}")).collect();
    let check = OracleCheck::new(&labels, text).with_class_names(&names);
    let report = check.run().unwrap();
    assert_eq!(report.metrics.all_accuracy, Some(1.0));
    assert!(report.metrics.mean_iou.unwrap() > 1.0 - 1e-9);
    assert!(report.aliases.is_empty());
    assert_eq!((report.num_rows, report.num_scored), (150, 150));
    for (row, label) in labels.iter().enumerate() {
        let class = (label + 3).rem_euclid(7) as usize;
        let error = check.clone().with_fault(Fault { row, class }).run().unwrap_err();
        let MetricError::Oracle(found) = error else { panic!("{error}") };
        assert_eq!((found.stage, found.num_wrong, found.first), (OracleStage::Classify, 1, row));
        assert_eq!(found.got, format!("class {class} (thing {class})"));
        assert!(found.to_string().starts_with("1 of 150 rows classified wrongly, the first at"));
    }
}

#[test]
fn votes_and_counts_are_predicted_exactly() {
    for seed in 0..12 {
        let rng = &mut rng(seed);
        let units = text_rows(seed, 6);
        let text = TextRows::new(&units, 64).unwrap();
        let coord = gridded_room(rng, 400);
        let labels = support::random_labels(rng, 400, 6);
        let query = gridded_room(rng, 90);
        let query_labels = support::random_labels(rng, 90, 6);
        let valid: Vec<bool> = (0..400).map(|i| i % 5 != 0).collect();
        for k in [1, 25, 500] {
            for query in [None, Some((&query[..], &query_labels[..]))] {
                let vote = OracleVote { valid: Some(&valid), query, ..vote_of(&coord, k) };
                let check = OracleCheck::new(&labels, text).with_vote(vote).with_excluded(&[0, 1]);
                let report = in_all_pools(|| check.run().unwrap());
                assert_eq!(report.num_scored, query.map_or(400, |q| q.0.len()));
                assert!(report.metrics.all_accuracy.unwrap() < 1.0, "a vote smooths");
            }
        }
    }
}

#[test]
fn real_text_tables_pass() {
    for name in ["scannet20", "scannet200", "matterport21", "matterport-nyu160", "holicity"] {
        let Some(units) = published_texts(name) else { return };
        let text = TextRows::new(&units, 768).unwrap();
        let labels = random_labels(3000, text.num_classes(), 4).unwrap();
        let report = OracleCheck::new(&labels, text).run().unwrap();
        assert_eq!(report.metrics.all_accuracy, Some(1.0), "{name}");
        let fault = Fault { row: 2999, class: usize::from(labels[2999] == 0) };
        assert!(OracleCheck::new(&labels, text).with_fault(fault).run().is_err(), "{name}");
    }
}

#[test]
fn equal_text_rows_are_aliases_and_lower_the_ceiling() {
    let mut rows = random_rows(&mut rng(1), 4, 32);
    rows.copy_within(32..64, 96);
    let units = unit_rows(&rows, 32);
    let text = TextRows::new(&units, 32).unwrap();
    let report = OracleCheck::new(&[0, 1, 2, 3, 3], text).run().unwrap();
    assert_eq!(report.aliases, [(3, 1)]);
    assert_eq!(report.metrics.all_accuracy, Some(0.6));
    // Withholding undecided rows withholds both.
    let options = ZeroShotOptions {
        unknown: UnknownRule { min_margin: Some(1e-9), min_cosine: None },
        candidates: None,
    };
    let check = OracleCheck::new(&[0, 1, 2, 3, 3], text).with_options(options);
    assert_eq!(check.run().unwrap().aliases, [(1, -1), (3, -1)]);
}

#[test]
fn almost_equal_text_rows_are_refused() {
    let mut rows = random_rows(&mut rng(1), 3, 32);
    rows.copy_within(0..32, 64);
    rows[70] += 1e-4;
    let units = unit_rows(&rows, 32);
    let text = TextRows::new(&units, 32).unwrap();
    let error = OracleCheck::new(&[1, 2], text).run().unwrap_err();
    assert!(matches!(error, MetricError::AmbiguousText { class: 2, other: 0, .. }), "{error}");
    assert!(OracleCheck::new(&[1, 1], text).run().is_ok(), "only classes in use matter");
}

#[test]
fn options_are_part_of_the_expectation() {
    let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0, -0.6, 0.8], 2).unwrap();
    let candidates = Some(vec![true, true, false]);
    let unknown = UnknownRule { min_cosine: Some(0.9), min_margin: None };
    let plain = ZeroShotOptions { candidates: candidates.clone(), ..Default::default() };
    let check = OracleCheck::new(&[0, 1, 2], text);
    assert_eq!(check.clone().with_options(plain).run().unwrap().aliases, [(2, 1)]);
    let strict = ZeroShotOptions { candidates, unknown };
    assert_eq!(check.clone().with_options(strict).run().unwrap().aliases, [(2, -1)]);
    let edge = UnknownRule { min_cosine: Some(1.0), min_margin: None };
    let edge = ZeroShotOptions { unknown: edge, candidates: None };
    let error = check.with_options(edge).run().unwrap_err();
    assert!(matches!(error, MetricError::AmbiguousText { class: 0, other: 0, .. }), "{error}");
}

#[test]
fn small_and_malformed_inputs() {
    let units = text_rows(1, 3);
    let text = TextRows::new(&units, 64).unwrap();
    for labels in [&[][..], &[-1], &[2], &[2, -1]] {
        let report = OracleCheck::new(labels, text).run().unwrap();
        assert_eq!(report.metrics.all_accuracy, labels.contains(&2).then_some(1.0));
        let coord = vec![[0.0; 3]; labels.len()];
        OracleCheck::new(labels, text).with_vote(vote_of(&coord, 25)).run().unwrap();
    }
    let error = |check: OracleCheck<'_>| check.run().unwrap_err().to_string();
    let check = OracleCheck::new(&[0, 1], text);
    assert_eq!(
        error(OracleCheck::new(&[0, 3], text)),
        "labels[1] is 3, expected -1 or a class below 3"
    );
    let coord = [[0.0; 3]; 3];
    let vote = vote_of(&coord, 1);
    assert_eq!(error(check.clone().with_vote(vote)), "coord: expected 2 rows, got 3");
    assert!(error(check.clone().with_fault(Fault { row: 0, class: 3 })).contains("class 3"));
    assert!(error(check.clone().with_fault(Fault { row: 2, class: 0 })).contains("fault"));
    let names = ["a".to_owned()];
    assert!(error(check.with_class_names(&names)).contains("class names"));
}

#[test]
fn a_hundred_thousand_coincident_points_stay_quick() {
    let units = text_rows(1, 5);
    let text = TextRows::new(&units, 64).unwrap();
    let labels = random_labels(100_000, 5, 9).unwrap();
    let coord = vec![[0.25; 3]; 100_000];
    OracleCheck::new(&labels, text).with_vote(vote_of(&coord, 25)).run().unwrap();
}
