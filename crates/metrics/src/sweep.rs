//! A second implementation of the neighbor vote that shares no search with the first: slabs along
//! one axis, each sorted along a second, and for each query a walk to both sides until one axis
//! alone is too far. Several times slower than the tree, and still fit for whole scenes.

use crate::{IGNORE, MetricError};
use rayon::prelude::*;
use scenesplat_kernels::neighbors::distance_squared;

/// Voters per slab. A wall across the first axis puts many slabs at the same place; the second axis
/// then keeps each visit short.
const SLAB_SIZE: usize = 2048;

#[derive(Clone, Copy)]
struct Voter {
    coord: [f32; 3],
    row: usize,
}

/// As [`vote`](crate::vote); the arguments have been checked but for the voters' coordinates.
pub(crate) fn vote_by_sweep(
    reference: &[[f32; 3]],
    labels: &[i32],
    valid: Option<&[bool]>,
    query: &[[f32; 3]],
    k: usize,
) -> Result<Vec<i32>, MetricError> {
    let mut voters: Vec<Voter> = (0..reference.len())
        .filter(|&row| valid.is_none_or(|valid| valid[row]))
        // Adding 0 turns -0 into 0, so that equal coordinates sort as equal.
        .map(|row| Voter { coord: reference[row].map(|v| v + 0.0), row })
        .collect();
    if let Some(&Voter { coord: value, row }) =
        voters.iter().find(|v| !v.coord.iter().all(|c| c.is_finite()))
    {
        return Err(MetricError::NonFinite { what: "reference coord", row, value });
    }
    let axes = axes_by_extent(&voters);
    voters.par_sort_unstable_by(|a, b| {
        let along = |i: usize| a.coord[axes[i]].total_cmp(&b.coord[axes[i]]);
        along(0).then_with(|| along(1)).then_with(|| along(2)).then_with(|| a.row.cmp(&b.row))
    });
    // Of many points at one place only the first k can ever be among the k nearest.
    let mut kept: Vec<Voter> = voters
        .chunk_by(|a, b| a.coord == b.coord)
        .flat_map(|same| same.iter().take(k))
        .copied()
        .collect();
    let slabs: Vec<Slab<'_>> = kept.chunks_mut(SLAB_SIZE).map(|s| Slab::new(s, axes)).collect();
    let answer = |&query: &[f32; 3]| majority(&nearest(&slabs, axes, query, k), labels);
    Ok(query.par_iter().map(answer).collect())
}

/// Consecutive voters along the first axis, rising along the second.
struct Slab<'a> {
    first: f32,
    last: f32,
    voters: &'a [Voter],
}

impl<'a> Slab<'a> {
    fn new(voters: &'a mut [Voter], [along, across, _]: [usize; 3]) -> Self {
        let ends = |v: Option<&Voter>| v.map_or(0.0, |v| v.coord[along]);
        let (first, last) = (ends(voters.first()), ends(voters.last()));
        voters.sort_unstable_by(|a, b| a.coord[across].total_cmp(&b.coord[across]));
        Self { first, last, voters }
    }
}

/// Rows of the `k` nearest voters. The slabs rise along the first axis.
fn nearest(slabs: &[Slab<'_>], axes: [usize; 3], query: [f32; 3], k: usize) -> Vec<usize> {
    let [along, across, _] = axes;
    let mut best: Vec<(f64, usize)> = Vec::new();
    let place = f64::from(query[along]);
    let middle = slabs.partition_point(|slab| slab.last < query[along]);
    let (below, above) = slabs.split_at(middle);
    for slab in above {
        if too_far(f64::from(slab.first) - place, k, &best) {
            break;
        }
        visit(slab.voters, across, query, k, &mut best);
    }
    for slab in below.iter().rev() {
        if too_far(place - f64::from(slab.last), k, &best) {
            break;
        }
        visit(slab.voters, across, query, k, &mut best);
    }
    best.into_iter().map(|(_, row)| row).collect()
}

/// Whether nothing at this distance along one axis, or beyond, can be among the `k` best.
fn too_far(gap: f64, k: usize, best: &[(f64, usize)]) -> bool {
    gap > 0.0 && best.len() == k && best.last().is_some_and(|last| gap * gap > last.0)
}

fn visit(voters: &[Voter], axis: usize, query: [f32; 3], k: usize, best: &mut Vec<(f64, usize)>) {
    let middle = voters.partition_point(|v| v.coord[axis] < query[axis]);
    let (below, above) = voters.split_at(middle);
    walk(below.iter().rev(), axis, query, k, best);
    walk(above.iter(), axis, query, k, best);
}

/// Goes away from the query, keeping the `k` best of (squared distance, row), sorted.
fn walk<'a>(
    voters: impl Iterator<Item = &'a Voter>,
    axis: usize,
    query: [f32; 3],
    k: usize,
    best: &mut Vec<(f64, usize)>,
) {
    for voter in voters {
        let gap = f64::from(voter.coord[axis]) - f64::from(query[axis]);
        if too_far(gap.abs(), k, best) {
            return;
        }
        let candidate = (distance_squared(voter.coord, query), voter.row);
        let place = best.partition_point(|kept| *kept < candidate);
        if place < k {
            best.truncate(k - 1);
            best.insert(place, candidate);
        }
    }
}

/// The most frequent label but -1, the smallest of several; -1 if there is none.
fn majority(rows: &[usize], labels: &[i32]) -> i32 {
    let mut votes: Vec<i32> = rows.iter().map(|&row| labels[row]).filter(|&l| l >= 0).collect();
    votes.sort_unstable();
    let mut best: &[i32] = &[];
    for run in votes.chunk_by(|a, b| a == b) {
        if run.len() > best.len() {
            best = run;
        }
    }
    best.first().copied().unwrap_or(IGNORE)
}

/// The axes, the widest first.
fn axes_by_extent(voters: &[Voter]) -> [usize; 3] {
    let extent = |i: &usize| {
        let values = || voters.iter().map(|v| f64::from(v.coord[*i]));
        values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
    };
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| extent(b).total_cmp(&extent(a)));
    axes
}

#[cfg(test)]
mod tests {
    use super::*;

    // A step of a linear congruential generator, its upper bits.
    fn next(state: &mut u64) -> u64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        *state >> 40
    }

    #[test]
    fn slabs_and_the_tree_find_the_same_neighbours() {
        let state = &mut 7;
        let coord: Vec<[f32; 3]> = (0..3 * SLAB_SIZE)
            .map(|_| {
                let cell = |state: &mut u64| (next(state) % 40) as f32 * 0.1;
                [
                    cell(state),
                    cell(state),
                    if next(state).is_multiple_of(2) { 0.0 } else { cell(state) },
                ]
            })
            .collect();
        let labels: Vec<i32> = coord.iter().map(|_| next(state) as i32 % 6 - 1).collect();
        let query = &coord[..200];
        for k in [1, 25] {
            let got = vote_by_sweep(&coord, &labels, None, query, k).unwrap();
            assert_eq!(got, crate::vote(&coord, &labels, None, query, k, 5).unwrap());
        }
    }
}
