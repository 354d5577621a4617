//! Submanifold convolution, groups of rows, turned queries.

use super::compare::{Wide, compare, gradients};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::{Noise, noise};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::Precision;
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use scenesplat_kernels::sparse_conv::{PackedConv, backward_input, backward_weight, forward};
use std::collections::{BTreeMap, BTreeSet};

/// Voxels of one or several scenes.
struct Voxels {
    cells: Vec<[i32; 3]>,
    offsets: Vec<usize>,
}

impl Voxels {
    fn one(cells: Vec<[i32; 3]>) -> Self {
        let offsets = vec![0, cells.len()];
        Self { cells, offsets }
    }

    fn random(count: usize, seed: u64) -> Vec<[i32; 3]> {
        let mut rng = Noise::new(seed);
        let mut taken = BTreeSet::new();
        while taken.len() < count {
            taken.insert([(); 3].map(|()| rng.below(9) as i32));
        }
        let mut cells: Vec<[i32; 3]> = taken.into_iter().collect();
        rng.shuffle(&mut cells);
        cells
    }

    /// Input row of each output row and tap.
    fn pairs(&self, kernel: usize) -> Vec<(usize, usize, usize)> {
        let half = kernel as i32 / 2;
        let mut pairs = Vec::new();
        for scene in self.offsets.windows(2) {
            let rows: BTreeMap<[i32; 3], usize> =
                (scene[0]..scene[1]).map(|row| (self.cells[row], row)).collect();
            for out in scene[0]..scene[1] {
                for tap in 0..kernel.pow(3) {
                    let k = kernel;
                    let step = [tap / (k * k), tap / k % k, tap % k].map(|s| s as i32 - half);
                    let cell = std::array::from_fn(|a| self.cells[out][a] + step[a]);
                    if let Some(&input) = rows.get(&cell) {
                        pairs.push((out, tap, input));
                    }
                }
            }
        }
        pairs
    }
}

const SCENES: &[(&str, fn() -> Voxels)] = &[
    ("dense", || Voxels::one(Voxels::random(400, 1))),
    ("one-voxel", || Voxels::one(vec![[0; 3]])),
    ("two-scenes", || {
        let (a, b) = (Voxels::random(150, 2), Voxels::random(90, 3));
        let offsets = vec![0, 150, 150, 240];
        Voxels { cells: [a, b].concat(), offsets }
    }),
    ("corner-of-the-grid", || {
        let last = (1 << 21) - 1;
        let mut cells: Vec<[i32; 3]> =
            Voxels::random(80, 4).into_iter().map(|c| c.map(|v| last - v)).collect();
        cells.extend(Voxels::random(80, 5));
        Voxels::one(cells)
    }),
];

const CIN: usize = 64;
const COUT: usize = 70;

pub(super) fn convolutions() -> Vec<Case> {
    let dense = SCENES.iter().map(|&(name, voxels)| {
        case(format!("convolution-{name}"), move |t| {
            let mut found = convolve(t, &voxels(), 3, Precision::F32)?;
            found.join(convolve(t, &voxels(), 5, Precision::F32)?);
            Ok(found)
        })
    });
    let precisions = [Precision::F32Split, Precision::Bf16, Precision::Int8].map(|precision| {
        case(format!("convolution-{precision}"), move |t| {
            convolve(t, &Voxels::one(Voxels::random(300, 6)), 3, precision)
        })
    });
    let others = [
        case("convolution-duplicate-voxels", duplicates),
        case("convolution-gradient", conv_gradient),
    ];
    dense.chain(precisions).chain(others).collect()
}

pub(super) fn segments() -> Vec<Case> {
    vec![
        case("segment-mean", |t| reduced(t, Reduce::Mean)),
        case("segment-max", |t| reduced(t, Reduce::Max)),
        case("segment-sum", |t| reduced(t, Reduce::Sum)),
        case("segment-max-gradient-of-ties", |_| {
            let groups = Groups::new(vec![0, 1, 2, 3], vec![0, 3, 4])?;
            let mut dx = vec![0.0; 4];
            let x = [1.0, 5.0, 5.0, -2.0];
            reduce_backward(&x, 1, &groups, Reduce::Max, &[3.0, 7.0], &mut dx);
            ensure!(dx == [0.0, 3.0, 0.0, 7.0], "gradient {dx:?}");
            Ok(())
        }),
    ]
}

fn map(voxels: &Voxels, kernel: usize) -> Result<KernelMap, Failure> {
    Ok(KernelMap::build(&voxels.cells, &voxels.offsets, kernel)?)
}

fn convolve(
    trial: &Trial<'_>,
    voxels: &Voxels,
    kernel: usize,
    precision: Precision,
) -> Result<Finding, Failure> {
    let (n, taps) = (voxels.cells.len(), kernel.pow(3));
    let x = noise(n * CIN, 7, 1.0);
    let (weight, bias) = (noise(COUT * taps * CIN, 8, 0.2), noise(COUT, 9, 1.0));
    trial.keep("x", &x)?;
    trial.keep("weight", &weight)?;
    let packed = PackedConv::with_precision(precision, &weight, CIN, COUT, taps);
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; n * COUT];
        forward(&map(voxels, kernel)?, &x, &packed, Some(&bias), &mut out);
        Ok(out)
    })?;
    let mut want: Vec<Wide> = (0..n * COUT).map(|i| Wide::own(f64::from(bias[i % COUT]))).collect();
    for (out, tap, input) in voxels.pairs(kernel) {
        let x = &x[input * CIN..(input + 1) * CIN];
        for (c, sum) in want[out * COUT..(out + 1) * COUT].iter_mut().enumerate() {
            let w = &weight[(c * taps + tap) * CIN..][..CIN];
            x.iter().zip(w).for_each(|(x, w)| sum.add(f64::from(*x) * f64::from(*w)));
        }
    }
    compare(&got, &want, |i| format!("voxel {}, channel {}", i / COUT, i % COUT))
}

fn duplicates(trial: &Trial<'_>) -> Result<(), Failure> {
    let mut cells = Voxels::random(200, 10);
    cells.extend_from_within(..60);
    let voxels = Voxels::one(cells);
    ensure!(map(&voxels, 3)?.has_duplicates(), "rows that share a voxel are not noticed");
    let pairs = trial.same_on_threads(|| {
        let map = map(&voxels, 3)?;
        Ok((0..27).map(|tap| map.tap_pairs(tap)).collect::<Vec<_>>())
    })?;
    // The first row stands for the voxel; each row is its own center.
    for (input, output) in pairs {
        for (i, o) in input.iter().zip(&output) {
            ensure!(*i < 200 || i == o, "row {i}, a copy, is an input of row {o}");
        }
    }
    Ok(())
}

fn conv_gradient(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let voxels = Voxels::one(Voxels::random(250, 11));
    let (n, cin, cout, taps) = (250, 6, 9, 27);
    let (x, up) = (noise(n * cin, 12, 1.0), noise(n * cout, 13, 1.0));
    let weight = noise(cout * taps * cin, 14, 0.3);
    let map = map(&voxels, 3)?;
    let got = trial.one_and_many(|| {
        let mut dx = vec![0.0; n * cin];
        backward_input(Precision::F32, &map, &up, &weight, cin, cout, &mut dx);
        let mut dw = vec![0.0; weight.len()];
        backward_weight(Precision::F32, &map, &x, &up, cin, cout, &mut dw);
        dx.extend(dw);
        Ok(dx)
    })?;
    let (mut dx, mut dw) = (vec![0.0; n * cin], vec![0.0; weight.len()]);
    for (out, tap, input) in voxels.pairs(3) {
        for c in 0..cout {
            let up = f64::from(up[out * cout + c]);
            for i in 0..cin {
                let at = (c * taps + tap) * cin + i;
                dx[input * cin + i] += up * f64::from(weight[at]);
                dw[at] += up * f64::from(x[input * cin + i]);
            }
        }
    }
    gradients(&got, &[dx, dw])
}

/// Groups of 1, of 2 and of many rows, in no order.
fn reduced(trial: &Trial<'_>, how: Reduce) -> Result<Finding, Failure> {
    let (n, c) = (5000, 19);
    let mut rng = Noise::new(15);
    let mut rows: Vec<u32> = (0..n as u32).collect();
    rng.shuffle(&mut rows);
    let mut offsets = vec![0, 1, 3, 2000];
    while offsets.last().is_some_and(|last| *last < n as u32) {
        let last = offsets.last().copied().unwrap_or(0);
        offsets.push((last + 1 + rng.below(12) as u32).min(n as u32));
    }
    let groups = Groups::new(rows, offsets)?;
    let mut x = noise(n * c, 16, 1.0);
    if how == Reduce::Max {
        x[777 * c + 3] = f32::NAN;
    }
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; groups.len() * c];
        reduce(&x, c, &groups, how, &mut out);
        Ok(out)
    })?;
    let mut want = Vec::new();
    for group in groups.offsets().windows(2) {
        let rows = &groups.rows()[group[0] as usize..group[1] as usize];
        for channel in 0..c {
            let values = || rows.iter().map(|&r| f64::from(x[r as usize * c + channel]));
            let count = f64::from(rows.len() as u32);
            let magnitude: f64 = values().map(f64::abs).sum();
            want.push(match how {
                Reduce::Max if values().any(f64::is_nan) => Wide::own(f64::NAN),
                Reduce::Max => Wide::own(values().fold(f64::NEG_INFINITY, f64::max)),
                Reduce::Mean => Wide::of(values().sum::<f64>() / count, magnitude / count),
                Reduce::Sum => Wide::of(values().sum(), magnitude),
            });
        }
    }
    compare(&got, &want, |i| format!("group {}, channel {}", i / c, i % c))
}
