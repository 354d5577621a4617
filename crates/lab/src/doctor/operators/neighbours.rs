//! Nearest neighbors and the votes of labels among them, against all distances sorted.

use crate::doctor::case::Case;
use crate::doctor::noise::{Noise, points};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_metrics::{keep_withheld, vote};
use std::collections::BTreeMap;

/// Points to search: name, points.
const CLOUDS: [(&str, fn() -> Vec<[f32; 3]>); 5] = [
    ("noise", || points(1500, 1, 1.0)),
    ("lattice", || (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(|v| v as f32)).collect()),
    ("copies", || points(60, 2, 1.0).repeat(20)),
    ("far-from-the-origin", || {
        points(800, 3, 20.0).into_iter().map(|p| p.map(|v| v + 1e6)).collect()
    }),
    ("huge-and-tiny", || {
        let mut rng = Noise::new(4);
        let sizes = [1e-42, 1e-20, 1.0, 1e15, 3e38];
        (0..600).map(|i| [(); 3].map(|()| rng.float() * sizes[i % 5])).collect()
    }),
];

/// Squared distance in f64.
fn squared(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2)).sum()
}

/// Rows by distance, then number.
fn nearest(points: &[[f32; 3]], query: [f32; 3], k: usize) -> Vec<u32> {
    let mut all: Vec<(f64, u32)> =
        points.iter().zip(0..).map(|(p, row)| (squared(*p, query), row)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.into_iter().take(k).map(|(_, row)| row).collect()
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = CLOUDS
        .iter()
        .map(|&(name, points)| case(format!("neighbours-{name}"), move |t| check(t, &points())))
        .collect();
    cases.extend([
        case("vote-with-fewer-points-than-k", few_voters),
        case("vote-against-all-distances", all_distances),
        case("vote-with-ties", |_| {
            let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let found = vote(&points, &[3, 1, 3, 1], None, &[[0.0; 3]], 4, 4)?;
            ensure!(found == [1], "{found:?}");
            Ok(())
        }),
        case("vote-without-a-voter", |_| {
            let found = vote(&[[0.0; 3]; 2], &[1, 0], Some(&[false; 2]), &[[0.0; 3]], 3, 2)?;
            ensure!(found == [-1], "{found:?}");
            let found = vote(&[], &[], None, &[[0.0; 3]], 3, 2)?;
            ensure!(found == [-1], "no point: {found:?}");
            ensure!(vote(&[], &[], None, &[], 3, 2)?.is_empty(), "no query");
            Ok(())
        }),
        case("vote-with-bad-input", |_| {
            let one = [[0.0; 3]];
            ensure!(vote(&one, &[2], None, &one, 1, 2).is_err(), "class 2 of 2 is taken");
            ensure!(vote(&one, &[0, 0], None, &one, 1, 2).is_err(), "two labels for a point");
            let nan = [[f32::NAN, 0.0, 0.0]];
            ensure!(vote(&nan, &[0], None, &one, 1, 2).is_err(), "a point that is not finite");
            ensure!(vote(&one, &[0], None, &nan, 1, 2).is_err(), "a query that is not finite");
            Ok(())
        }),
        case("withheld-labels-stay-withheld", |_| {
            let mut after = [3, 1, 2, 0];
            keep_withheld(&[3, -1, 2, -1], &mut after);
            ensure!(after == [3, -1, 2, -1], "{after:?}");
            Ok(())
        }),
    ]);
    cases
}

fn few_voters(trial: &Trial<'_>) -> Result<(), Failure> {
    let points = points(4, 5, 1.0);
    for k in [1, 4, 5, 25, 4096] {
        let found =
            trial.same_on_threads(|| Ok(vote(&points, &[2, 2, 1, -1], None, &points, k, 3)?))?;
        ensure!(k < 4 || found == [2; 4], "k = {k}: {found:?}");
    }
    for k in [0, 4097, usize::MAX] {
        ensure!(vote(&points, &[0; 4], None, &points, k, 3).is_err(), "k = {k} is taken");
    }
    Ok(())
}

fn all_distances(trial: &Trial<'_>) -> Result<(), Failure> {
    let (points, query) = (points(700, 6, 0.5), points(300, 7, 0.6));
    let mut rng = Noise::new(8);
    let labels: Vec<i32> = (0..700).map(|_| rng.below(6) as i32 - 1).collect();
    let valid: Vec<bool> = (0..700).map(|_| rng.below(4) > 0).collect();
    for (k, valid) in [(1, None), (8, None), (25, Some(&valid[..]))] {
        let found = trial.same_on_threads(|| Ok(vote(&points, &labels, valid, &query, k, 5)?))?;
        let want = votes(&points, &labels, valid, &query, k);
        let wrong = found.iter().zip(&want).position(|(a, b)| a != b);
        ensure!(wrong.is_none(), "k = {k}: query {wrong:?} got another label");
    }
    Ok(())
}

fn check(trial: &Trial<'_>, points: &[[f32; 3]]) -> Result<(), Failure> {
    trial.keep("points", points.as_flattened())?;
    let tree = KdTree::new(points)?;
    let mut queries: Vec<[f32; 3]> = points.iter().copied().step_by(5).collect();
    queries.push([0.1, -0.2, 0.3]);
    for k in [1, 7, 25] {
        let found = trial.same_on_threads(|| {
            Ok(tree.map_nearest(
                &queries,
                k,
                || (),
                |(), _, near| near.iter().map(|n| n.row).collect::<Vec<u32>>(),
            ))
        })?;
        for (query, found) in queries.iter().zip(found) {
            let want = nearest(points, *query, k);
            ensure!(found == want, "k = {k}, query {query:?}: {found:?}, {want:?} is right");
            let alone: Vec<u32> = tree.nearest(*query, k).iter().map(|n| n.row).collect();
            ensure!(alone == want, "k = {k}, query {query:?} alone: {alone:?}");
        }
    }
    Ok(())
}

fn votes(
    points: &[[f32; 3]],
    labels: &[i32],
    valid: Option<&[bool]>,
    query: &[[f32; 3]],
    k: usize,
) -> Vec<i32> {
    let rows: Vec<usize> = (0..points.len()).filter(|&r| valid.is_none_or(|v| v[r])).collect();
    let voters: Vec<[f32; 3]> = rows.iter().map(|&r| points[r]).collect();
    let of = |query: &[f32; 3]| {
        let mut counts = BTreeMap::new();
        for near in nearest(&voters, *query, k) {
            let label = labels[rows[near as usize]];
            if label >= 0 {
                *counts.entry(label).or_insert(0) += 1;
            }
        }
        let most = counts.values().max().copied();
        counts.iter().find(|(_, n)| Some(**n) == most).map_or(-1, |(label, _)| *label)
    };
    query.iter().map(of).collect()
}
