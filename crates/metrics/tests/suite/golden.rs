//! The zero-shot evaluation of the original code, end to end, with real text embeddings.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod original;
mod support;

use original::{instance_vote, remap_labels};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, KdTree, Metric, TextRows, UnknownRule, ZeroShotOptions,
    classify, cosine_scores, sigmoid_threshold_to_cosine, vote,
};
use serde_json::Value;
use std::collections::BTreeMap;
use support::{Golden, all_close, close, shared, unit_rows};

const LOGIT_ATOL: f64 = 2e-6;
const METRIC_ATOL: f64 = 1e-6;
const DISTANCE_ATOL: f64 = 1e-5;

fn config(case: &str) -> Option<Value> {
    let path = shared()?.join("goldens/network/manifest.json");
    let manifest: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let entries = manifest["entries"].as_array().unwrap();
    let file = format!("{case}.safetensors");
    let entry = entries.iter().find(|e| e["file"] == *file).expect("the case is in the manifest");
    Some(entry["config"].clone())
}

fn text_units(name: &str) -> Vec<f32> {
    let path = format!("real/text_embeddings/{name}_text_embeddings_siglip2.safetensors");
    let file = Golden::read(&path).unwrap();
    unit_rows(&file.f32("text_embeddings"), 768)
}

fn evaluator_case(case: &str) {
    let Some(config) = config(case) else { return };
    let golden = Golden::read(&format!("goldens/network/{case}.safetensors")).unwrap();
    let units = text_units(config["text"].as_str().unwrap());
    let text = TextRows::new(&units, 768).unwrap();
    let num_classes = text.num_classes();
    assert_eq!(config["n_classes"], num_classes);

    // Scores and labels.
    let feat = golden.f32("in.feat");
    let features = FeatureSlice::new(&feat, 768).unwrap();
    let scores = cosine_scores(&features, text).unwrap();
    let logits = golden.f32("mid.logits_first_rows");
    all_close(&scores[..logits.len()], &logits, LOGIT_ATOL, "logits");
    let plain = classify(&features, text, &ZeroShotOptions::default()).unwrap();
    assert_eq!(plain.labels, golden.labels("mid.argmax"));
    assert_eq!((plain.num_unusable, plain.num_withheld), (0, 0));
    let sigmoid: Vec<f32> = plain.scores.iter().map(|s| 1.0 / (1.0 + (-s).exp())).collect();
    all_close(&sigmoid, &golden.f32("mid.max_prob"), METRIC_ATOL, "max_prob");

    let threshold = config["confidence_threshold"].as_f64().unwrap() as f32;
    let min_cosine = Some(sigmoid_threshold_to_cosine(threshold));
    let unknown = UnknownRule { min_cosine, min_margin: None };
    let options = ZeroShotOptions { unknown, candidates: None };
    let found = classify(&features, text, &options).unwrap();
    assert_eq!(found.labels, golden.labels("mid.pred_after_threshold"));
    assert_eq!(config["below_threshold"], found.num_withheld);

    // Neighbours, vote.
    let coord = golden.coord("in.coord");
    let valid = golden.mask("in.valid_feat_mask");
    let has_points = golden.has("in.pc_coord");
    let (query, truth) = match has_points {
        true => (golden.coord("in.pc_coord"), golden.labels("in.pc_segment")),
        false => (coord.clone(), golden.labels("in.segment")),
    };
    let k = usize::try_from(config["vote_k"].as_u64().unwrap()).unwrap();
    let voters: Vec<[f32; 3]> =
        coord.iter().zip(&valid).filter(|(_, v)| **v).map(|(c, _)| *c).collect();
    let tree = KdTree::new(&voters).unwrap();
    let near: Vec<_> = query.iter().map(|&q| tree.nearest(q, k)).collect();
    let rows: Vec<u32> = near.iter().flatten().map(|n| n.row).collect();
    assert_eq!(rows, golden.u32("mid.knn_index_into_valid"));
    let far: Vec<f32> =
        near.iter().map(|n| n.last().unwrap().distance_squared.sqrt() as f32).collect();
    all_close(&far, &golden.f32("mid.knn_dist25"), DISTANCE_ATOL, "knn_dist25");
    let mut labels = vote(&coord, &found.labels, Some(&valid), &query, k, num_classes).unwrap();
    assert_eq!(labels, golden.labels("mid.pred_after_voting"));

    // What the hook does to single data sets after the vote.
    if golden.has("in.instance") {
        labels = instance_vote(&labels, &golden.labels("in.instance"));
    }
    if let Some(map) = config["pred_label_mapping"].as_object() {
        let map: BTreeMap<i32, i32> = map
            .iter()
            .map(|(from, to)| (from.parse().unwrap(), to.as_i64().unwrap() as i32))
            .collect();
        remap_labels(&mut labels, &map);
    }

    // Counts and metrics. The multi-dataset evaluator excludes nothing, by mistake.
    let excluded: Vec<usize> = match config["multi"].as_bool().unwrap() {
        true => vec![],
        false => config["excluded_indices"]
            .as_array()
            .unwrap()
            .iter()
            .map(|c| c.as_u64().unwrap() as usize)
            .collect(),
    };
    let mut confusion =
        ConfusionMatrix::new(num_classes).unwrap().with_excluded(&excluded).unwrap();
    confusion.update((&labels, &truth)).unwrap();
    assert_eq!(confusion.counts(), golden.counts("out.confusion"));
    assert_eq!(confusion.unassigned(), golden.counts("out.fn_ignore"));
    let report = confusion.evaluator_report();
    let measurements = report.measurements();
    assert_eq!(measurements.len(), 5);
    for m in &measurements {
        let expected = golden.scalar(&format!("out.metric.{}", m.name));
        close(m.value, expected, METRIC_ATOL, &m.name);
    }
    let current = golden.scalar("out.current_metric_value");
    close(report.foreground_mean_iou.unwrap(), current, METRIC_ATOL, "current_metric_value");
}

#[test]
fn evaluator_scannet20_on_points() {
    evaluator_case("j_scannet20_pc");
}

#[test]
fn evaluator_scannet20_with_a_threshold_that_fires() {
    evaluator_case("j_scannet20_thr");
}

#[test]
fn evaluator_scannet200_of_the_multi_dataset_hook() {
    evaluator_case("j_scannet200_multi");
}

#[test]
fn evaluator_matterport21_with_instances_and_label_map() {
    evaluator_case("j_matterport21_nopc_inst");
}

fn tester_case(case: &str) {
    let Some(config) = config(case) else { return };
    let golden = Golden::read(&format!("goldens/network/{case}.safetensors")).unwrap();
    let k = usize::try_from(config["k"].as_u64().unwrap()).unwrap();
    let num_classes = usize::try_from(config["num_classes"].as_u64().unwrap()).unwrap();
    let (coord, label) = (golden.coord("in.coord"), golden.labels("in.label"));
    let (query, valid) = (golden.coord("in.query"), golden.mask("in.valid"));

    let voted = vote(&coord, &label, Some(&valid), &query, k, num_classes).unwrap();
    assert_eq!(voted, golden.labels("out.vote_query"));
    let own = vote(&coord, &label, None, &coord, k, num_classes).unwrap();
    assert_eq!(own, golden.labels("out.vote_self"));
    let by_instance = instance_vote(&voted, &golden.labels("in.instance"));
    assert_eq!(by_instance, golden.labels("out.cluster_vote"));

    let mut confusion = ConfusionMatrix::new(num_classes).unwrap();
    confusion.update((&voted, &golden.labels("in.gt"))).unwrap();
    let report = confusion.tester_report();
    let column = |f: fn(&scenesplat_metrics::TesterClass) -> u64| -> Vec<u64> {
        report.classes.iter().map(f).collect()
    };
    assert_eq!(column(|c| c.intersection), golden.counts("out.intersection"));
    assert_eq!(column(|c| c.union), golden.counts("out.union"));
    assert_eq!(column(|c| c.target), golden.counts("out.target"));
    let iou: Vec<f32> = report.classes.iter().map(|c| c.iou.unwrap_or(0.0) as f32).collect();
    let acc: Vec<f32> = report.classes.iter().map(|c| c.accuracy.unwrap_or(0.0) as f32).collect();
    all_close(&iou, &golden.f32("out.iou"), METRIC_ATOL, "iou");
    all_close(&acc, &golden.f32("out.acc"), METRIC_ATOL, "acc");
    for (value, name) in [
        (report.mean_iou, "out.miou_present"),
        (report.mean_accuracy, "out.macc_present"),
        (report.all_accuracy, "out.all_acc"),
    ] {
        close(value.unwrap(), golden.scalar(name), METRIC_ATOL, name);
    }
}

#[test]
fn tester_votes_and_counts() {
    tester_case("j_voting");
}

#[test]
fn tester_single_neighbour() {
    tester_case("j_voting_k1");
}
