//! The zero-shot evaluation and the tester of the original implementation, with real text embeddings.

use crate::support::{all_close, close, published_texts};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, IGNORE, KdTree, Metric, TesterClass, TextRows, UnknownRule,
    ZeroShotOptions, classify, cosine_scores, sigmoid_threshold_to_cosine, vote,
};
use scenesplat_test_support::Golden;

const LOGIT_ATOL: f64 = 2e-6;
const METRIC_ATOL: f64 = 1e-6;
const DISTANCE_ATOL: f64 = 1e-5;

fn mask(golden: &Golden, name: &str) -> Vec<bool> {
    golden.ints::<u8>(name).iter().map(|v| *v != 0).collect()
}

fn same_metrics(golden: &Golden, values: &[(&str, Option<f64>)]) {
    for (name, value) in values {
        close(value.unwrap(), golden.f64s(name)[0], METRIC_ATOL, name);
    }
}

/// `clustering_voting` of the original: all rows of one instance get the label most of them have, -1
/// counts too, ties go to the smallest label. This project does not do it: it uses the truth's instances.
fn instance_vote(labels: &[i32], instances: &[i32]) -> Vec<i32> {
    assert_eq!(labels.len(), instances.len());
    let mut order: Vec<usize> = (0..labels.len()).filter(|&i| instances[i] != IGNORE).collect();
    order.sort_unstable_by_key(|&i| (instances[i], labels[i]));
    let mut voted = labels.to_vec();
    for members in order.chunk_by(|&a, &b| instances[a] == instances[b]) {
        let runs = members.chunk_by(|&a, &b| labels[a] == labels[b]);
        // `max_by_key` gives the last of several.
        let longest = runs.rev().max_by_key(|run| run.len()).unwrap();
        for &i in members {
            voted[i] = labels[longest[0]];
        }
    }
    voted
}

#[test]
fn instances_count_withheld_labels_and_break_ties_downwards() {
    let labels = [2, 1, 5, -1, -1, 4, 3, 3];
    let instances = [7, 7, -1, -2, -2, -2, 9, 9];
    assert_eq!(instance_vote(&labels, &instances), [1, 1, 5, -1, -1, -1, 3, 3]);
}

/// Scores and labels of the evaluator; returns the labels above the case's threshold.
fn classified(golden: &Golden, text: TextRows<'_>) -> Vec<i32> {
    let feat = golden.f32s("in.feat");
    let features = FeatureSlice::new(&feat, 768).unwrap();
    let scores = cosine_scores(&features, text).unwrap();
    let logits = golden.f32s("mid.logits_first_rows");
    all_close(&scores[..logits.len()], &logits, LOGIT_ATOL, "logits");
    let plain = classify(&features, text, &ZeroShotOptions::default()).unwrap();
    assert_eq!(plain.labels, golden.ints::<i32>("mid.argmax"));
    assert_eq!((plain.num_unusable, plain.num_withheld), (0, 0));
    let sigmoid: Vec<f32> = plain.scores.iter().map(|s| 1.0 / (1.0 + (-s).exp())).collect();
    all_close(&sigmoid, &golden.f32s("mid.max_prob"), METRIC_ATOL, "max_prob");

    let threshold = golden.config()["confidence_threshold"].as_f64().unwrap() as f32;
    let min_cosine = Some(sigmoid_threshold_to_cosine(threshold));
    let unknown = UnknownRule { min_cosine, min_margin: None };
    let options = ZeroShotOptions { unknown, candidates: None };
    let found = classify(&features, text, &options).unwrap();
    assert_eq!(found.labels, golden.ints::<i32>("mid.pred_after_threshold"));
    assert_eq!(golden.number("below_threshold"), found.num_withheld);
    found.labels
}

/// Neighbors and votes; returns the labels of `query`.
fn voted(golden: &Golden, labels: &[i32], query: &[[f32; 3]], num_classes: usize) -> Vec<i32> {
    let (coord, valid) = (golden.rows::<3>("in.coord"), mask(golden, "in.valid_feat_mask"));
    let k = golden.number("vote_k");
    let voters = coord.iter().zip(&valid).filter(|(_, v)| **v);
    let tree = KdTree::new(&voters.map(|(c, _)| *c).collect::<Vec<_>>()).unwrap();
    let near: Vec<_> = query.iter().map(|&q| tree.nearest(q, k)).collect();
    let rows: Vec<u32> = near.iter().flatten().map(|n| n.row).collect();
    assert_eq!(rows, golden.ints::<u32>("mid.knn_index_into_valid"));
    let far: Vec<f32> =
        near.iter().map(|n| n.last().unwrap().distance_squared.sqrt() as f32).collect();
    all_close(&far, &golden.f32s("mid.knn_dist25"), DISTANCE_ATOL, "knn_dist25");
    let voted = vote(&coord, labels, Some(&valid), query, k, num_classes).unwrap();
    assert_eq!(voted, golden.ints::<i32>("mid.pred_after_voting"));
    voted
}

/// On points; with a threshold that some scores are below; the hook of several data sets; with instances
/// and a map of labels.
#[test]
fn evaluator() {
    for case in ["scannet20_pc", "scannet20_thr", "scannet200_multi", "matterport21_nopc_inst"] {
        let Some(golden) = Golden::network(&format!("j_{case}")) else { return };
        let units = published_texts(golden.config()["text"].as_str().unwrap()).unwrap();
        let text = TextRows::new(&units, 768).unwrap();
        let num_classes = text.num_classes();
        assert_eq!(golden.number("n_classes"), num_classes);
        let labels = classified(&golden, text);
        let (query, truth) = match golden.has("in.pc_coord") {
            true => (golden.rows("in.pc_coord"), golden.ints::<i32>("in.pc_segment")),
            false => (golden.rows("in.coord"), golden.ints("in.segment")),
        };
        let mut labels = voted(&golden, &labels, &query, num_classes);

        // What the hook does to single data sets after the vote.
        if golden.has("in.instance") {
            labels = instance_vote(&labels, &golden.ints::<i32>("in.instance"));
        }
        if let Some(map) = golden.config()["pred_label_mapping"].as_object() {
            for label in &mut labels {
                let to = map.get(&label.to_string()).map(|to| to.as_i64().unwrap() as i32);
                *label = to.unwrap_or(*label);
            }
        }
        // The evaluator of several data sets excludes nothing, by mistake.
        let excluded = match golden.config()["multi"].as_bool().unwrap() {
            true => vec![],
            false => golden.numbers("excluded_indices"),
        };
        let mut confusion =
            ConfusionMatrix::new(num_classes).unwrap().with_excluded(&excluded).unwrap();
        confusion.update((&labels, &truth)).unwrap();
        assert_eq!(confusion.counts(), golden.ints::<u64>("out.confusion"));
        assert_eq!(confusion.unassigned(), golden.ints::<u64>("out.fn_ignore"));
        let report = confusion.evaluator_report();
        let measurements = report.measurements();
        assert_eq!(measurements.len(), 5);
        for m in measurements {
            same_metrics(&golden, &[(&format!("out.metric.{}", m.name), Some(m.value))]);
        }
        same_metrics(&golden, &[("out.current_metric_value", report.foreground_mean_iou)]);
    }
}

#[test]
fn tester() {
    for case in ["j_voting", "j_voting_k1"] {
        let Some(golden) = Golden::network(case) else { return };
        let (k, num_classes) = (golden.number("k"), golden.number("num_classes"));
        let (coord, label) = (golden.rows::<3>("in.coord"), golden.ints::<i32>("in.label"));
        let (query, valid) = (golden.rows::<3>("in.query"), mask(&golden, "in.valid"));

        let voted = vote(&coord, &label, Some(&valid), &query, k, num_classes).unwrap();
        assert_eq!(voted, golden.ints::<i32>("out.vote_query"));
        let own = vote(&coord, &label, None, &coord, k, num_classes).unwrap();
        assert_eq!(own, golden.ints::<i32>("out.vote_self"));
        let by_instance = instance_vote(&voted, &golden.ints::<i32>("in.instance"));
        assert_eq!(by_instance, golden.ints::<i32>("out.cluster_vote"));

        let mut confusion = ConfusionMatrix::new(num_classes).unwrap();
        confusion.update((&voted, &golden.ints::<i32>("in.gt"))).unwrap();
        let report = confusion.tester_report();
        let counts = |name: &str, count: fn(&TesterClass) -> u64| {
            let got: Vec<u64> = report.classes.iter().map(count).collect();
            assert_eq!(got, golden.ints::<u64>(name), "{name}");
        };
        counts("out.intersection", |c| c.intersection);
        counts("out.union", |c| c.union);
        counts("out.target", |c| c.target);
        let shares = |name: &str, share: fn(&TesterClass) -> Option<f64>| {
            let got = report.classes.iter().map(|c| share(c).unwrap_or(0.0) as f32);
            all_close(&got.collect::<Vec<_>>(), &golden.f32s(name), METRIC_ATOL, name);
        };
        shares("out.iou", |c| c.iou);
        shares("out.acc", |c| c.accuracy);
        same_metrics(
            &golden,
            &[
                ("out.miou_present", report.mean_iou),
                ("out.macc_present", report.mean_accuracy),
                ("out.all_acc", report.all_accuracy),
            ],
        );
    }
}
