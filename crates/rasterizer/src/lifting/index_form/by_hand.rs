//! Clusters, numbers and choices worked out by hand.

use super::*;
use crate::lifting::{FinaliseSettings, LabelledPicture, LiftSettings, NO_SEGMENT, SegmentMap};
use crate::{Gaussians, View};

/// Tables of pictures with one direction a segment, degrees.
fn tables(pictures: &[&[f32]]) -> SegmentTables {
    let mut tables = SegmentTables::new(2);
    for picture in pictures {
        let row = |degrees: &f32| [degrees.to_radians().cos(), degrees.to_radians().sin()];
        tables.push(&picture.iter().flat_map(row).collect::<Vec<f32>>()).unwrap();
    }
    tables
}

/// Gaussians that are seen in these segments, equally much.
fn block(seen: &[&[u32]]) -> BlockWeights {
    let mut block = BlockWeights { first: 0, offsets: vec![0], weights: Vec::new() };
    for (gaussian, segments) in (0..).zip(seen) {
        let weight = |&segment: &u32| SegmentWeight { gaussian, segment, weight: 1.0 };
        block.weights.extend(segments.iter().map(weight));
        block.offsets.push(block.weights.len());
    }
    block
}

fn overlaps(seen: &[&[u32]], tables: &SegmentTables) -> Overlaps {
    let mut overlaps = Overlaps::default();
    overlaps.add(&block(seen), tables, 1);
    overlaps
}

fn settings(overlap: f32, cosine: f32) -> IndexSettings {
    IndexSettings { overlap, cosine, ..IndexSettings::default() }
}

/// Two pictures cut six Gaussians in two; a third sees one of each half in one segment; nothing sees the last.
const SEEN: [&[u32]; 6] = [&[0, 2, 4], &[0, 2], &[0, 3], &[1, 3], &[1, 3, 4], &[]];

#[test]
fn overlaps_are_of_what_both_pictures_show() {
    let tables = tables(&[&[0.0, 90.0], &[0.0, 90.0], &[0.0]]);
    let found = overlaps(&SEEN, &tables);
    // 0 and 2 have two of three; 0 and 3 one of five; 4 has two, of which each other one has one.
    let two_thirds = [(0, 2), (1, 3)].map(|(a, b)| (2.0 / 3.0, a, b));
    let halves = [(0, 4), (1, 4), (2, 4), (3, 4)].map(|(a, b)| (0.5, a, b));
    let all = found.edges(&tables, 0.1);
    assert_eq!((&all[..2], &all[2..6]), (&two_thirds[..], &halves[..]));
    assert_eq!(all[6..], [(0.2, 0, 3)]);
    assert_eq!(found.edges(&tables, 0.5), all[..6]);
    assert_eq!(found.edges(&tables, 0.51), two_thirds);
    // Every third Gaussian is sampled: the first and the fourth.
    let mut some = Overlaps::default();
    some.add(&block(&SEEN), &tables, 3);
    assert_eq!(some.edges(&tables, 0.1).len(), 4);
    // The heaviest segment of a picture, the first of equal ones, is the one that it names.
    let mut twice = block(&[&[0, 1, 2]]);
    let of = |block: &BlockWeights| {
        let mut found = Overlaps::default();
        found.add(block, &tables, 1);
        found.edges(&tables, 0.1)
    };
    assert_eq!(of(&twice), [(1.0, 0, 2)]);
    twice.weights[1].weight = 1.5;
    assert_eq!(of(&twice), [(1.0, 1, 2)]);
}

#[test]
fn segments_on_each_other_are_one_cluster_if_they_are_alike() {
    let tables = tables(&[&[0.0, 90.0], &[0.0, 90.0], &[0.0]]);
    let found = overlaps(&SEEN, &tables);
    // The third picture's segment lies on both, and is like the first.
    assert_eq!(found.clusters(&tables, &settings(0.5, 0.8)), [0, 1, 0, 1, 0]);
    assert_eq!(found.clusters(&tables, &settings(0.5, -1.0)), [0; 5]);
    assert_eq!(Overlaps::default().clusters(&tables, &settings(0.5, -1.0)), [0, 1, 2, 3, 4]);
}

#[test]
fn clusters_do_not_drift_from_segment_to_segment() {
    let tables = tables(&[&[0.0], &[30.0], &[60.0]]);
    let found = overlaps(&[&[0, 1, 2]], &tables);
    // The first two are joined, at 15 degrees; the third is 30 from the second, and 45 from both.
    assert_eq!(found.clusters(&tables, &settings(0.5, 0.8)), [0, 0, 2]);
    assert_eq!(found.clusters(&tables, &settings(0.5, 0.7)), [0; 3]);
    // 45 degrees are 0.7071.
    assert_eq!(found.clusters(&tables, &settings(0.5, 0.71)), [0, 0, 2]);
}

#[test]
fn a_picture_is_compared_with_the_next_ones_that_show_the_gaussian() {
    let tables = tables(&[[0.0].as_slice(); 7]);
    let edges = overlaps(&[&[0, 1, 2, 3, 4, 5, 6]], &tables).edges(&tables, 0.5);
    let of_first: Vec<u32> = edges.iter().filter(|edge| edge.1 == 0).map(|edge| edge.2).collect();
    assert_eq!(of_first, [1, 2, 3, 4]);
    // Pictures that do not show it do not count.
    let edges = overlaps(&[&[0, 2, 4, 5, 6]], &tables).edges(&tables, 0.5);
    assert!(edges.contains(&(1.0, 0, 6)), "{edges:?}");
}

#[test]
fn a_gaussian_gets_the_cluster_with_the_most_weight() {
    let tables = tables(&[&[0.0, 0.0], &[0.0, 0.0]]);
    let cluster_of = [0, 1, 1, 3];
    let of = |weights: &[(u32, f32)], total: f64, settings: IndexSettings| {
        let weight = |&(segment, weight)| SegmentWeight { gaussian: 0, segment, weight };
        let weights: Vec<SegmentWeight> = weights.iter().map(weight).collect();
        let found = Choice::of(&weights, &tables, total, &cluster_of, &settings);
        (found.cluster, found.confidence, found.views, found.coverage)
    };
    let all = IndexSettings::default();
    // 1 has 1 + 2 of 5 in two pictures.
    let weights = [(0, 2.0), (1, 1.0), (2, 2.0)];
    assert_eq!(of(&weights, 8.0, all), (Some(1), 0.6, 2, 5.0));
    // Of equal ones the one with the first segment, wherever it comes.
    assert_eq!(of(&[(3, 1.0), (0, 1.0)], 2.0, all).0, Some(0));
    assert_eq!(of(&[(2, 1.0), (3, 1.0)], 2.0, all).0, Some(1));
    assert_eq!(of(&[], 3.0, all), (None, 0.0, 0, 0.0));
    // 5 of 8 are 0.625.
    let with = |min_coverage, min_labelled_share| IndexSettings {
        min_coverage,
        min_labelled_share,
        ..all
    };
    for (settings, cluster) in
        [(with(5.0, 0.62), Some(1)), (with(5.1, 0.0), None), (with(0.0, 0.63), None)]
    {
        assert_eq!(of(&weights, 8.0, settings), (cluster, 0.6, 2, 5.0));
    }
}

#[test]
fn clusters_that_are_used_have_numbers_and_mean_features() {
    assert_eq!(numbered(&[true, false, true]).unwrap(), [0, NO_CLUSTER, 1]);
    assert!(numbered(&[]).unwrap().is_empty());
    let mut used = vec![true; MAX_CLUSTERS];
    assert_eq!(numbered(&used).unwrap().last(), Some(&(NO_CLUSTER - 1)));
    used.extend([false, true]);
    let error = numbered(&used).unwrap_err().to_string();
    assert!(
        error.starts_with("clusters of segments: 65536, ") && error.contains("65535"),
        "{error}"
    );

    let tables = tables(&[&[0.0, 90.0], &[0.0, 90.0]]);
    // Segments 0 and 1 by 3 to 4, segment 2 alone; 3 is of no Gaussian.
    let found =
        features(&[0, 0, 2, 3], &[0, NO_CLUSTER, 1, NO_CLUSTER], &[3.0, 4.0, 0.5, 0.0], &tables);
    for (got, want) in found.iter().zip([0.6, 0.8, 1.0, 0.0]) {
        assert!((got - want).abs() < 1e-6, "{found:?}");
    }
    assert_eq!(found.len(), 4);
    assert_eq!(features(&[0], &[0], &[0.0], &tables), [0.0; 2], "no weight is no direction");
}

/// Balls side by side, and pictures of them that are cut at a column, from places beside each other.
fn lifted(memory: u64, threads: usize, cuts: &[u32]) -> (IndexedLabels, Vec<f32>) {
    let count = 40;
    let gaussians = Gaussians {
        means: (0..count)
            .map(|i| [0.08 * (i as f32 - 19.5), 0.0, 2.0 + 0.01 * (i % 3) as f32])
            .collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        scales: vec![[0.03; 3]; count],
        opacities: vec![0.8; count],
        sh: vec![0.0; 3 * count],
        sh_degree: 0,
    };
    let (width, height) = (64, 16);
    let settings = LiftSettings { memory, ..LiftSettings::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut lifter = Lifter::new(&gaussians, 1, 3, settings).unwrap();
        for (i, &cut) in cuts.iter().enumerate() {
            let x = 0.01 * i as f32;
            let world_to_camera = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
            let view =
                View { world_to_camera, fx: 40.0, fy: 40.0, cx: 32.0, cy: 8.0, width, height };
            let id = |at: u32| match at % width {
                column if column < cut => 0,
                62.. => NO_SEGMENT,
                _ => 1,
            };
            let levels =
                [SegmentMap::new(width, height, (0..width * height).map(id).collect()).unwrap()];
            let features = [1.0, 0.02 * i as f32, 0.0, 0.0, 0.1, 1.0];
            let picture =
                LabelledPicture { view: &view, levels: &levels, features: &features, depth: None };
            lifter.add(&picture).unwrap();
        }
        let full = lifter.collect(0, &FinaliseSettings::default()).unwrap();
        assert!(lifter.indexed(1, &IndexSettings::default()).is_err(), "there is no such level");
        let found = lifter.indexed(0, &IndexSettings::default()).unwrap();
        assert_eq!((&found.views, &found.coverage), (&full.views, &full.coverage));
        (found, full.features)
    })
}

#[test]
fn the_index_form_of_pictures_is_the_full_form_with_fewer_rows() {
    let cuts = [32, 33, 31, 34, 30];
    let (found, full) = lifted(1 << 20, 1, &cuts);
    for (memory, threads) in [(1 << 20, 3), (LiftSettings::least_memory(1), 2)] {
        assert_eq!(lifted(memory, threads, &cuts).0, found, "{memory} bytes, {threads} threads");
    }
    // One cluster for the left things, one for the right ones.
    assert_eq!(found.features.len(), 2 * 3);
    let labelled = found.index.iter().filter(|index| **index != NO_CLUSTER).count();
    assert!(labelled >= 30, "{:?}", found.index);
    for (row, &index) in found.index.iter().enumerate() {
        if index == NO_CLUSTER {
            assert_eq!(found.confidence[row], 0.0);
            continue;
        }
        assert!(found.confidence[row] >= 0.5, "two clusters share it");
        let mean = &found.features[3 * usize::from(index)..][..3];
        let own = &full[3 * row..][..3];
        let cosine: f32 = mean.iter().zip(own).map(|(a, b)| a * b).sum();
        assert!(cosine > 0.7, "{row}: {cosine}");
    }
    // Of one picture each segment is a cluster; of none there is nothing.
    assert_eq!(lifted(1 << 20, 1, &cuts[..1]).0.features.len(), 2 * 3);
    let (nothing, _) = lifted(1 << 20, 2, &[]);
    assert!(nothing.features.is_empty() && nothing.index == [NO_CLUSTER; 40]);
}

#[test]
fn settings_out_of_range_are_named() {
    let usual = IndexSettings::default();
    usual.check().unwrap();
    let bad = [
        (IndexSettings { overlap: 0.0, ..usual }, "overlap: is 0"),
        (IndexSettings { overlap: f32::NAN, ..usual }, "overlap: is NaN"),
        (IndexSettings { cosine: 1.1, ..usual }, "cosine: is 1.1"),
        (IndexSettings { min_coverage: f32::INFINITY, ..usual }, "coverage: is inf"),
        (IndexSettings { min_labelled_share: -0.1, ..usual }, "labeled share: is -0.1"),
    ];
    for (settings, want) in bad {
        let error = settings.check().unwrap_err().to_string();
        assert!(error.starts_with(want), "{error}");
    }
    for good in [
        IndexSettings { overlap: 1.0, cosine: -1.0, ..usual },
        IndexSettings { cosine: 1.0, ..usual },
    ] {
        good.check().unwrap();
    }
}
