//! Space-filling curves, sorting, and the orders of voxels.

use crate::doctor::case::Case;
use crate::doctor::noise::Noise;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::serialization::{Curve, MAX_DEPTH, argsort, codes, depth_of, invert};
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use std::collections::BTreeSet;

const CURVES: [Curve; 4] = Curve::ALL;

/// Codes to sort: name, values.
const LISTS: [(&str, fn() -> Vec<u64>); 6] = [
    ("noise", || list(30_000, u64::MAX)),
    ("ties", || list(30_000, 16)),
    ("all-equal", || vec![u64::MAX; 20_000]),
    ("outlier", || {
        let mut all = list(30_000, 1 << 20);
        all[777] = 1 << 62;
        all
    }),
    ("sorted-already", || (0..20_000).chain((0..20_000).rev()).collect()),
    ("0-and-1-rows", || vec![42]),
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("curves-visit-each-cell-once", each_cell_once),
        case("hilbert-steps-are-of-one-cell", hilbert_steps),
        case("morton-interleaves-bits", morton_bits),
        case("curves-at-21-bits", last_cells),
        case("curves-at-depth-0", depth_0),
        case("equal-codes-keep-their-order", ties),
        case("pooled-voxels-are-halved", pooled),
        case("a-scene-keeps-its-depth-in-a-batch", batch_depth),
    ];
    cases.extend(
        LISTS.iter().map(|&(name, make)| case(format!("sort-{name}"), move |t| sorts(t, &make()))),
    );
    cases
}

fn cloud(cells: &[[i32; 3]], offsets: &[usize]) -> Result<SerializedCloud, Failure> {
    let depth = CurveDepth::PerScene;
    Ok(SerializedCloud::new(cells.to_vec(), offsets.to_vec(), &CURVES, depth)?)
}

fn each_cell_once(_: &Trial<'_>) -> Result<(), Failure> {
    let cells = cube(3);
    for curve in CURVES {
        let found: BTreeSet<u64> = codes(curve, &cells, 3).into_iter().collect();
        ensure!(found.len() == 512, "{}: {} codes for 512 cells", curve.name(), found.len());
        ensure!(found.last() == Some(&511), "{}: codes have gaps", curve.name());
    }
    Ok(())
}

fn hilbert_steps(_: &Trial<'_>) -> Result<(), Failure> {
    for depth in 1..=4 {
        let mut cells = cube(depth);
        cells.sort_by_key(|cell| codes(Curve::Hilbert, &[*cell], depth)[0]);
        let step = |w: &[[i32; 3]]| (0..3).map(|a| (w[0][a] - w[1][a]).abs()).sum::<i32>();
        let jump = cells.windows(2).position(|w| step(w) != 1);
        ensure!(jump.is_none(), "depth {depth}: a jump after code {jump:?}");
    }
    Ok(())
}

fn morton_bits(_: &Trial<'_>) -> Result<(), Failure> {
    let mut rng = Noise::new(1);
    for _ in 0..2000 {
        let cell = [(); 3].map(|()| rng.below(1 << MAX_DEPTH) as i32);
        let bit = |a: usize, i: u32| u64::from(cell[a] as u32 >> i & 1);
        let at = |i| (bit(0, i) << 2 | bit(1, i) << 1 | bit(2, i)) << (3 * i);
        let want: u64 = (0..MAX_DEPTH).map(at).sum();
        let got = codes(Curve::Z, &[cell], MAX_DEPTH)[0];
        ensure!(got == want, "{cell:?}: {got}, {want} is right");
        let turned = codes(Curve::ZTrans, &[[cell[1], cell[0], cell[2]]], MAX_DEPTH)[0];
        ensure!(turned == want, "the transposed order of {cell:?} swaps other axes");
    }
    Ok(())
}

fn last_cells(_: &Trial<'_>) -> Result<(), Failure> {
    let last = (1 << MAX_DEPTH) - 1;
    let cells = [[last; 3], [last, 0, 0], [0, last, 0], [0, 0, last], [last - 1; 3], [0; 3]];
    ensure!(depth_of(&cells)? == MAX_DEPTH, "depth {}", depth_of(&cells)?);
    for curve in CURVES {
        let found: BTreeSet<u64> = codes(curve, &cells, MAX_DEPTH).into_iter().collect();
        ensure!(found.len() == cells.len(), "{}: codes fall together", curve.name());
        ensure!(found.iter().all(|c| *c < 1 << 63), "{}: a code beyond 63 bits", curve.name());
    }
    for bad in [[last + 1, 0, 0], [0, -1, 0], [0, 0, i32::MIN], [i32::MAX; 3]] {
        ensure!(depth_of(&[[0; 3], bad]).is_err(), "{bad:?} is taken");
    }
    Ok(())
}

fn depth_0(_: &Trial<'_>) -> Result<(), Failure> {
    ensure!(depth_of(&[[0; 3]; 4])? == 0, "a single cell has a depth");
    for curve in CURVES {
        ensure!(codes(curve, &[[0; 3]; 4], 0) == [0; 4], "{}: a code above 0", curve.name());
    }
    let (pooled, groups) = cloud(&[[0; 3]], &[0, 1])?.pool(1);
    ensure!(pooled.len() == 1 && groups.len() == 1, "one voxel does not stay one");
    Ok(())
}

fn ties(trial: &Trial<'_>) -> Result<(), Failure> {
    let mut cells = vec![[3, 1, 2]; 700];
    cells.extend(vec![[1, 1, 1]; 700]);
    let orders = trial.same_on_threads(|| {
        let cloud = cloud(&cells, &[0, cells.len()])?;
        Ok((0..4).map(|i| cloud.order(i).order.to_vec()).collect::<Vec<_>>())
    })?;
    for order in orders {
        let kept = order[..700].is_sorted() && order[700..].is_sorted();
        ensure!(kept, "equal codes changed their order");
    }
    Ok(())
}

fn batch_depth(_: &Trial<'_>) -> Result<(), Failure> {
    let (near, far) = (cube(2), vec![[1_000_000, 5, 7], [0; 3]]);
    let n = near.len();
    let alone = cloud(&near, &[0, n])?;
    let both = cloud(&[near, far].concat(), &[0, n, n + 2])?;
    for i in 0..4 {
        ensure!(both.codes(i)[..n] == *alone.codes(i), "codes depend on a batch mate");
        ensure!(both.order(i).order[..n] == alone.order(i).order[..], "orders do");
    }
    Ok(())
}

/// All cells of a cube of so many bits.
fn cube(depth: u32) -> Vec<[i32; 3]> {
    let side = 1 << depth;
    let mut cells = Vec::new();
    for x in 0..side {
        for y in 0..side {
            cells.extend((0..side).map(|z| [x, y, z]));
        }
    }
    cells
}

fn list(n: usize, below: u64) -> Vec<u64> {
    let mut rng = Noise::new(n as u64 ^ below);
    (0..n).map(|_| rng.next() % below).collect()
}

fn sorts(trial: &Trial<'_>, codes: &[u64]) -> Result<(), Failure> {
    let order = trial.same_on_threads(|| Ok(argsort(codes)))?;
    let mut want: Vec<u32> = (0..codes.len() as u32).collect();
    // The standard library's sort is stable.
    want.sort_by_key(|&row| codes[row as usize]);
    let wrong = order.iter().zip(&want).position(|(a, b)| a != b);
    ensure!(order.len() == want.len() && wrong.is_none(), "another order from place {wrong:?} on");
    let inverse = invert(&order);
    let back = (0..codes.len()).all(|row| order[inverse[row] as usize] as usize == row);
    ensure!(back, "the inverse is none");
    ensure!(argsort(&[]).is_empty(), "no row has an order");
    Ok(())
}

fn pooled(trial: &Trial<'_>) -> Result<(), Failure> {
    let mut rng = Noise::new(3);
    let cells: BTreeSet<[i32; 3]> =
        (0..3000).map(|_| [(); 3].map(|()| rng.below(40) as i32)).collect();
    let cells: Vec<[i32; 3]> = cells.into_iter().collect();
    let (coarse, inverse) = trial.same_on_threads(|| {
        let (coarse, groups) = cloud(&cells, &[0, cells.len()])?.pool(1);
        Ok((coarse.grid_coord().to_vec(), groups.inverse().to_vec()))
    })?;
    for (row, cell) in cells.iter().enumerate() {
        let parent = coarse[inverse[row] as usize];
        ensure!(parent == cell.map(|v| v >> 1), "{cell:?} came into {parent:?}");
    }
    let distinct: BTreeSet<[i32; 3]> = coarse.iter().copied().collect();
    ensure!(distinct.len() == coarse.len(), "a coarse voxel is there twice");
    Ok(())
}
