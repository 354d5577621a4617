use crate::{ROWS, in_any_order, random};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::classify::{Classes, classify};
use scenesplat_device::ops::neighbors;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_metrics as metrics;

crate::support::on_grid! {
    classes_are_those_of_the_cpu
    neighbours_and_votes_are_those_of_the_cpu
    points_on_lattices_planes_and_in_one_place
}

/// Unit rows, of which the last is the first again.
fn texts(classes: usize, dim: usize) -> Vec<f32> {
    let mut text = random(classes * dim, 1);
    text.copy_within(..dim, (classes - 1) * dim);
    scenesplat_kernels::normalize::normalize_rows(&mut text, dim);
    text
}

fn check_classes(features: &[f32], dim: usize, classes: usize, options: &metrics::ZeroShotOptions) {
    let (rows, text) = (features.len() / dim, texts(classes, dim));
    let of_rows = metrics::FeatureSlice::new(features, dim).unwrap();
    let want =
        metrics::classify(&of_rows, metrics::TextRows::new(&text, dim).unwrap(), options).unwrap();
    let candidates: Vec<u32> = match &options.candidates {
        Some(mask) => mask.iter().map(|&c| u32::from(c)).collect(),
        None => vec![1; classes],
    };
    let sizes = Classes {
        rows: rows as u32,
        dim: dim as u32,
        classes: classes as u32,
        min_cosine: options.unknown.min_cosine,
        min_margin: options.unknown.min_margin,
    };
    let (labels, scores, margins) = in_any_order(|l| {
        let (features, text) = (l.upload_values(features)?, l.upload_values(&text)?);
        let found = classify(l, &features, &text, &l.upload_values(&candidates)?, sizes)?;
        Ok((
            l.download_values::<i32>(&found.labels, rows)?,
            l.download_values::<f32>(&found.scores, rows)?,
            l.download_values::<f32>(&found.margins, rows)?,
        ))
    });
    for row in 0..rows {
        let what = format!("row {row} of {rows}, {classes} classes of {dim} channels");
        assert!((scores[row] - want.scores[row]).abs() < 1e-6, "{what}: {}", scores[row]);
        let (margin, other) = (margins[row], want.margins[row]);
        assert!(margin == other || (margin - other).abs() < 1e-6, "{what}: {margin}, {other}");
        // Rounding decides only between classes, or at limits, that are nearer than it.
        let near = |limit: Option<f32>, value: f32| limit.is_some_and(|l| (l - value).abs() < 1e-6);
        let unsure = margin < 1e-6 && margin > 0.0
            || near(sizes.min_cosine, scores[row])
            || near(sizes.min_margin, margin);
        assert!(labels[row] == want.labels[row] || unsure, "{what}: class {}", labels[row]);
    }
}

fn classes_are_those_of_the_cpu() {
    let all = metrics::ZeroShotOptions::default();
    for n in ROWS {
        check_classes(&random(n * 48, 2), 48, 9, &all);
    }
    check_classes(&random(70 * 770, 3), 770, 33, &all);
    // Equal texts: the smaller class; rows without a direction; norms of any size.
    let mut hard = random(40 * 20, 4);
    let text = texts(5, 20);
    hard[..20].copy_from_slice(&text[..20]);
    hard[20..40].fill(0.0);
    hard[40] = f32::NAN;
    hard[65] = f32::INFINITY;
    hard[80..100].iter_mut().for_each(|v| *v *= 1e-38);
    hard[100..120].iter_mut().for_each(|v| *v *= 1e37);
    check_classes(&hard, 20, 5, &all);
    let candidates = |mask: &[bool]| metrics::ZeroShotOptions {
        candidates: Some(mask.to_vec()),
        unknown: metrics::UnknownRule { min_cosine: Some(0.1), min_margin: Some(0.05) },
    };
    check_classes(&hard, 20, 5, &candidates(&[false, true, false, true, true]));
    check_classes(&hard, 20, 5, &candidates(&[false, false, true, false, false]));
}

fn points(n: usize, seed: u64) -> Vec<[f32; 3]> {
    random(3 * n, seed).as_chunks::<3>().0.to_vec()
}

fn check_vote(reference: &[[f32; 3]], queries: &[[f32; 3]], k: usize) {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    let labels: Vec<i32> = reference.iter().map(|_| rng.random_range(-1..4)).collect();
    let tree = KdTree::new(reference).unwrap();
    let want: Vec<Vec<u32>> = queries
        .iter()
        .map(|q| {
            let near = tree.nearest(*q, k);
            let mut rows: Vec<u32> = near.iter().map(|n| n.row).collect();
            rows.resize(k, u32::MAX);
            rows
        })
        .collect();
    let winners = metrics::vote(reference, &labels, None, queries, k, 4).unwrap();
    let (found, voted) = in_any_order(|l| {
        let reference_in = l.upload_values(reference)?;
        let cells = neighbors::sort_points(l, &reference_in, reference.len() as u32)?;
        let (queries_in, labels) = (l.upload_values(queries)?, l.upload_values(&labels)?);
        let m = queries.len() as u32;
        let found = neighbors::nearest(l, &cells, &queries_in, m, k as u32)?;
        let voted = neighbors::vote(l, &found, &labels, m, k as u32)?;
        Ok((
            l.download_values::<u32>(&found, queries.len() * k)?,
            l.download_values::<i32>(&voted, queries.len())?,
        ))
    });
    assert_eq!(found, want.concat(), "{} points, {} queries, {k}", reference.len(), queries.len());
    assert_eq!(voted, winners);
}

fn neighbours_and_votes_are_those_of_the_cpu() {
    for n in ROWS {
        check_vote(&points(n, 7), &points(60, 8), 25);
    }
    check_vote(&points(500, 7), &[], 5);
    // Queries far outside, and more neighbors than points.
    let mut queries = points(20, 9);
    queries.extend([[50.0, -3.0, 0.0], [0.0, 0.0, -1e6], [-2.0, 0.0, 2.0]]);
    check_vote(&points(700, 10), &queries, 3);
    check_vote(&points(10, 10), &queries, 32);
}

fn points_on_lattices_planes_and_in_one_place() {
    // Equal distances everywhere: the smaller row is nearer.
    let lattice: Vec<[f32; 3]> =
        (0..729).map(|i| [(i % 9) as f32, (i / 9 % 9) as f32, (i / 81) as f32]).collect();
    check_vote(&lattice, &lattice[300..340], 7);
    let plane: Vec<[f32; 3]> = points(900, 11).iter().map(|p| [p[0], 0.5, p[2]]).collect();
    check_vote(&plane, &points(40, 12), 25);
    check_vote(&vec![[1.0, 2.0, 3.0]; 300], &points(10, 13), 25);
    // Nearly all in one cell, because of one far point.
    let mut crowded: Vec<[f32; 3]> = points(600, 14).iter().map(|p| p.map(|v| v * 0.01)).collect();
    crowded[17] = [1e5, -1e5, 3.0];
    check_vote(&crowded, &crowded[..50], 25);
}
