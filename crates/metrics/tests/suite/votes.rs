//! Neighbor votes against the obvious version, on inputs that tie, repeat and degenerate.

use crate::reference;
use crate::support::{gridded_room, in_all_pools, random_labels, rng};
use rand::Rng;
use scenesplat_metrics::{KdTree, MetricError, SceneTruth, VoteRule, vote};

#[test]
fn equals_sorting_all_distances() {
    for seed in 0..40 {
        let rng = &mut rng(seed);
        let n = [0, 1, 2, 3, 17, 33, 200, 700][seed as usize % 8];
        let coord = gridded_room(rng, n);
        let labels = random_labels(rng, n, 6);
        let valid: Vec<bool> = (0..n).map(|_| rng.random_bool(0.8)).collect();
        let mut query = gridded_room(rng, 60);
        query.push([1e6, -1e6, 0.1]);
        for k in [1, 2, 25, 1000] {
            for valid in [None, Some(&valid[..])] {
                let got = vote(&coord, &labels, valid, &query, k, 6).unwrap();
                let expected = reference::vote(&coord, &labels, valid, &query, k);
                assert_eq!(got, expected, "seed {seed}, n {n}, k {k}, mask {}", valid.is_some());
            }
        }
    }
}

#[test]
fn neighbours_are_exact_where_distances_tie() {
    let rng = &mut rng(3);
    let coord = gridded_room(rng, 2000);
    let tree = KdTree::new(&coord).unwrap();
    for query in gridded_room(rng, 50) {
        let got: Vec<u32> = tree.nearest(query, 40).iter().map(|n| n.row).collect();
        assert_eq!(got, reference::nearest(&coord, query, 40));
    }
}

#[test]
fn thread_count_does_not_matter() {
    let rng = &mut rng(5);
    let coord = gridded_room(rng, 5000);
    let labels = random_labels(rng, 5000, 9);
    in_all_pools(|| vote(&coord, &labels, None, &coord, 25, 9).unwrap());
}

#[test]
fn a_hundred_thousand_coincident_points() {
    const N: usize = 100_000;
    let coord = vec![[1.5, 0.0, -2.0]; N];
    // The 25 smallest rows decide: 13 of them say 4.
    let labels: Vec<i32> = (0..N).map(|i| if i < 13 { 4 } else { 1 }).collect();
    let voted = vote(&coord, &labels, None, &coord, 25, 5).unwrap();
    assert!(voted.iter().all(|&l| l == 4));
}

#[test]
fn coplanar_and_collinear_points() {
    for fixed in [1_usize, 2] {
        let rng = &mut rng(11);
        let coord: Vec<[f32; 3]> = (0..20_000)
            .map(|_| {
                let free: f32 = rng.random_range(0.0..4.0);
                std::array::from_fn(|i| if i < fixed { 7.0 } else { free })
            })
            .collect();
        let labels = random_labels(rng, coord.len(), 3);
        let query = &coord[..100];
        let got = vote(&coord, &labels, None, query, 25, 3).unwrap();
        assert_eq!(got, reference::vote(&coord, &labels, None, query, 25));
    }
}

#[test]
fn extreme_coordinates() {
    let huge = f32::MAX;
    let coord = [[huge; 3], [-huge; 3], [0.0; 3], [1e-40, 0.0, -0.0], [-1e-40, 0.0, 0.0]];
    let labels = [0, 1, 2, 3, 4];
    for k in 1..=6 {
        let got = vote(&coord, &labels, None, &coord, k, 5).unwrap();
        assert_eq!(got, reference::vote(&coord, &labels, None, &coord, k), "k {k}");
    }
}

#[test]
fn nothing_to_vote() {
    let query = [[0.0; 3]; 3];
    assert_eq!(vote(&[], &[], None, &query, 25, 4).unwrap(), [-1, -1, -1]);
    let coord = [[0.0; 3], [1.0; 3]];
    assert_eq!(vote(&coord, &[-1, -1], None, &query, 25, 4).unwrap(), [-1, -1, -1]);
    assert_eq!(vote(&coord, &[1, 2], Some(&[false; 2]), &query, 1, 4).unwrap(), [-1, -1, -1]);
    assert!(vote(&coord, &[1, 2], None, &[], 1, 4).unwrap().is_empty());
}

#[test]
fn malformed_inputs_are_named() {
    let coord = [[0.0; 3], [1.0; 3]];
    let bad = [[0.0; 3], [0.0, f32::INFINITY, 0.0]];
    let text = |r: Result<Vec<i32>, MetricError>| r.unwrap_err().to_string();
    assert_eq!(
        text(vote(&coord, &[0, 4], None, &coord, 1, 4)),
        "reference labels[1] is 4, expected -1 or a class below 4"
    );
    assert_eq!(
        text(vote(&coord, &[0], None, &coord, 1, 4)),
        "reference labels: expected 2 rows, got 1"
    );
    assert_eq!(
        text(vote(&coord, &[0, 0], Some(&[true]), &coord, 1, 4)),
        "valid mask: expected 2 rows, got 1"
    );
    assert_eq!(text(vote(&coord, &[0, 0], None, &coord, 0, 4)), "k is 0, expected 1 to 4096");
    assert!(text(vote(&coord, &[0, 0], None, &bad, 1, 4)).starts_with("query coord[1]"));
    assert!(text(vote(&bad, &[0, 0], None, &coord, 1, 4)).starts_with("reference coord[1]"));
    // A voter that does not vote may be anywhere.
    assert_eq!(vote(&bad, &[0, 0], Some(&[true, false]), &coord, 1, 4).unwrap(), [0, 0]);
    assert!(text(vote(&coord, &[0, 0], None, &coord, 1, 0)).starts_with("0 classes"));
}

#[test]
fn what_was_withheld_comes_back_only_where_it_may() {
    let coord = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let truth = SceneTruth::new(&coord, Some(&[1, 1, 1]), None, 2).unwrap().unwrap();
    let after = |keep_withheld| {
        let rule = VoteRule { keep_withheld, ..VoteRule::of(3) };
        truth.carry(vec![1, -1, 1], &rule).unwrap()
    };
    assert_eq!(after(true), [1, -1, 1]);
    assert_eq!(after(false), [1, 1, 1]);
}
