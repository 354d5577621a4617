//! Rows without arithmetic: orders, voxels, pairs, neighbors.

use super::stopwatch::time;
use super::{Measured, Request, checks};
use anyhow::{Context, Result};
use scenesplat::kernels::bench_room as room;
use scenesplat::kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat::kernels::kernel_map::KernelMap;
use scenesplat::kernels::neighbors::{KdTree, distance_squared};
use scenesplat::kernels::reference::{hilbert_code, morton_code};
use scenesplat::kernels::serialization::Curve;
use scenesplat::kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use std::collections::HashSet;

/// Neighbors asked for.
const NEIGHBORS: usize = 25;

/// Codes, order and inverse along four curves.
pub(super) fn serialize(n: usize, request: &Request) -> Result<Measured> {
    let cells = room::fine_cells(n);
    let mut cloud = None;
    let measured = time(request, || {
        cloud = None;
        // The cells are handed over, so each pass copies them: a sixth of the bytes.
        let new =
            SerializedCloud::new(cells.clone(), vec![0, n], &Curve::ALL, CurveDepth::PerScene);
        cloud = Some(new?);
        Ok(())
    })?;
    let cloud = cloud.context("no pass")?;
    let depth = cloud.depth()[0];
    let rows = checks::some_rows(n, 2000);
    let mut wrong = 0;
    for (i, curve) in Curve::ALL.into_iter().enumerate() {
        let codes = cloud.codes(i);
        for &row in &rows {
            let [x, y, z] = cells[row].map(|v| v as u32);
            let code = match curve {
                Curve::Z => morton_code([x, y, z], depth),
                Curve::ZTrans => morton_code([y, x, z], depth),
                Curve::Hilbert => hilbert_code([x, y, z], depth),
                Curve::HilbertTrans => hilbert_code([y, x, z], depth),
            };
            wrong += usize::from(codes[row] != code);
        }
        // Ascending codes, equal ones by row.
        let order = &cloud.order(i).order;
        wrong += order
            .windows(2)
            .filter(|w| {
                let key = |row: u32| (codes[row as usize], row);
                key(w[0]) >= key(w[1])
            })
            .count();
    }
    let of = 4 * (rows.len() + n - 1);
    Ok(Measured {
        size: n,
        // Cells in; codes, order and inverse of four curves out.
        bytes: ((12 + 4 * 16) * n) as u64,
        accuracy: Some(checks::wrong_share(wrong, of, "codes bit by bit and places")),
        ..measured
    })
}

/// Points grouped by voxel of 2 cm.
pub(super) fn grid_sample(n: usize, request: &Request) -> Result<Measured> {
    let points = room::points(n);
    let grid_size = f64::from(room::VOXEL);
    let mut groups = None;
    let measured = time(request, || {
        groups = None;
        groups = Some(voxel_groups(&points, grid_size, KeyOrder::Morton)?);
        Ok(())
    })?;
    let groups = groups.context("no pass")?;
    let cell = |row: usize| points[row].map(|v| (f64::from(v) / grid_size).floor());
    let wrong = (0..n).filter(|&row| {
        let voxel = groups.inverse[row] as usize;
        let found: [f64; 3] = std::array::from_fn(|axis| {
            f64::from(groups.grid_coord[voxel][axis]) + groups.min_cell[axis]
        });
        found != cell(row)
    });
    let wrong = wrong.count();
    let distinct: HashSet<[i32; 3]> = groups.grid_coord.iter().copied().collect();
    let twice = groups.num_voxels() - distinct.len();
    Ok(Measured {
        size: n,
        // Points in; order and voxel of each out.
        bytes: 20 * n as u64,
        accuracy: Some(checks::wrong_share(wrong + twice, n, "cells by division")),
        ..measured
    })
}

/// The pairs of a convolution over 3³ voxels.
pub(super) fn kernel_map(n: usize, request: &Request) -> Result<Measured> {
    let voxels = room::voxels(n);
    let mut map = None;
    let measured = time(request, || {
        map = None;
        map = Some(KernelMap::build(&voxels, &[0, n], 3)?);
        Ok(())
    })?;
    let map = map.context("no pass")?;
    let occupied: HashSet<[i32; 3]> = voxels.iter().copied().collect();
    let (mut wrong, mut expected) = (0, 0);
    for tap in 0..27 {
        let step = [tap / 9, tap / 3 % 3, tap % 3].map(|v| v as i32 - 1);
        let beside = |v: [i32; 3]| -> [i32; 3] { std::array::from_fn(|i| v[i] + step[i]) };
        let (input, output) = map.tap_pairs(tap);
        let pairs = input.iter().zip(&output);
        wrong +=
            pairs.filter(|(i, o)| voxels[**i as usize] != beside(voxels[**o as usize])).count();
        let there = voxels.iter().filter(|v| occupied.contains(&beside(**v))).count();
        wrong += there.abs_diff(input.len());
        expected += there;
    }
    Ok(Measured {
        size: n,
        // Voxels in; two row numbers a pair out.
        bytes: (12 * n + 8 * map.num_pairs()) as u64,
        accuracy: Some(checks::wrong_share(wrong, expected, "pairs by look-up")),
        ..measured
    })
}

/// The 25 nearest of `n` points for each of `n` other points, tree prebuilt.
pub(super) fn neighbors(n: usize, request: &Request) -> Result<Measured> {
    let points = room::points(2 * n);
    let (reference, query) = points.split_at(n);
    let tree = KdTree::new(reference)?;
    let mut found: Vec<[u32; NEIGHBORS]> = Vec::new();
    let measured = time(request, || {
        found = Vec::new();
        found = tree.map_nearest(
            query,
            NEIGHBORS,
            || (),
            |(), _, near| std::array::from_fn(|i| near.get(i).map_or(u32::MAX, |n| n.row)),
        );
        Ok(())
    })?;
    let rows = checks::some_rows(n, 20);
    let mut wrong = 0;
    for &row in &rows {
        let key = |r: u32| (distance_squared(reference[r as usize], query[row]), r);
        let mut all: Vec<(f64, u32)> = (0..n as u32).map(key).collect();
        let nearer = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        all.select_nth_unstable_by(NEIGHBORS - 1, nearer);
        all.truncate(NEIGHBORS);
        all.sort_by(nearer);
        wrong += all.iter().zip(found[row]).filter(|(want, got)| want.1 != *got).count();
    }
    Ok(Measured {
        size: n,
        // Points and queries in, 25 rows a query out.
        bytes: ((12 + 12 + 4 * NEIGHBORS) * n) as u64,
        accuracy: Some(checks::wrong_share(wrong, NEIGHBORS * rows.len(), "all distances")),
        ..measured
    })
}
