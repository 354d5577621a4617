//! Softmax attention inside patches.

use super::compare::{Wide, compare, gradient, wide};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::noise;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::{Heads, backward, forward_with};
use scenesplat_kernels::patches::{Patches, cut};

const HEADS: Heads = Heads { count: 2, dim: 16 };
/// Channels of all heads.
const C: usize = 32;

/// Rows in an order that is none of theirs.
fn order(rows: usize) -> Vec<u32> {
    // A step that shares no factor with the number of rows visits each once.
    let gcd = |mut a: usize, mut b: usize| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let step = (rows / 3 + 1..).find(|step| gcd(*step, rows) == 1).unwrap_or(1);
    (0..rows).map(|i| (i * step % rows) as u32).collect()
}

/// Value of part 0 (query), 1 (key) or 2 (value) of a row.
fn part(qkv: &[f32], row: usize, part: usize, head: usize, channel: usize) -> f64 {
    f64::from(qkv[row * 3 * C + part * C + head * HEADS.dim + channel])
}

/// The definition in f64; errors are measured against the largest value of the patch.
fn reference(qkv: &[f32], patches: &Patches, order: &[u32]) -> Vec<Wide> {
    let mut out = vec![Wide::of(0.0, 0.0); order.len() * C];
    for patch in patches.patches() {
        let slots = patch.start..patch.start + patch.len;
        let rows: Vec<usize> =
            patches.pad()[slots].iter().map(|&p| order[p as usize] as usize).collect();
        for head in 0..HEADS.count {
            for &row in &rows[..patch.own] {
                let weights = softmax(qkv, row, &rows, head);
                for c in 0..HEADS.dim {
                    let values = || rows.iter().map(|&r| part(qkv, r, 2, head, c));
                    let value = values().zip(&weights).map(|(v, w)| v * w).sum();
                    let scale = values().fold(0.0, |m: f64, v| m.max(v.abs()));
                    out[row * C + head * HEADS.dim + c] = Wide::of(value, scale);
                }
            }
        }
    }
    out
}

fn softmax(qkv: &[f32], row: usize, keys: &[usize], head: usize) -> Vec<f64> {
    let score = |key: &usize| {
        let dot: f64 =
            (0..HEADS.dim).map(|c| part(qkv, row, 0, head, c) * part(qkv, *key, 1, head, c)).sum();
        dot / f64::from(HEADS.dim as u32).sqrt()
    };
    let scores: Vec<f64> = keys.iter().map(score).collect();
    let largest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let exps: Vec<f64> = scores.iter().map(|s| (s - largest).exp()).collect();
    let sum: f64 = exps.iter().sum();
    exps.iter().map(|e| e / sum).collect()
}

fn attend(
    trial: &Trial<'_>,
    precision: Precision,
    qkv: &[f32],
    offsets: &[usize],
    patch: usize,
) -> Result<Finding, Failure> {
    trial.keep("qkv", qkv)?;
    let order = order(qkv.len() / (3 * C));
    let patches = cut(offsets, patch);
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; order.len() * C];
        forward_with(precision, qkv, HEADS, &patches, &order, &mut out);
        Ok(out)
    })?;
    let want = reference(qkv, &patches, &order);
    compare(&got, &want, |i| format!("row {}, channel {}", i / C, i % C))
}

/// Sets queries (0), keys (1) or values (2) by row and channel.
fn set(qkv: &mut [f32], which: usize, value: impl Fn(usize, usize) -> f32) {
    for (row, qkv) in qkv.chunks_exact_mut(3 * C).enumerate() {
        for c in 0..C {
            qkv[which * C + c] = value(row, c);
        }
    }
}

/// A name behind that of the precision, and a check at any precision.
type Row = (&'static str, fn(&Trial<'_>, Precision) -> Result<Finding, Failure>);

const AT_EVERY_PRECISION: &[Row] = &[
    ("", |t, p| attend(t, p, &noise(150 * 3 * C, 1, 1.0), &[0, 150], 48)),
    ("-patch-borders", patch_borders),
    ("-equal-keys", |t, p| {
        let mut qkv = noise(64 * 3 * C, 3, 1.0);
        // Scores of −64·√16 for every pair; exact in bf16.
        set(&mut qkv, 0, |_, _| 8.0);
        set(&mut qkv, 1, |_, _| -8.0);
        attend(t, p, &qkv, &[0, 64], 64)
    }),
    ("-logits-of-60000", |t, p| {
        // Row i's query points at key i mod 16 alone: it wins by 6e4.
        let mut qkv = noise(16 * 3 * C, 4, 1.0);
        set(&mut qkv, 0, |row, c| if c % 16 == row { 512.0 } else { 0.0 });
        set(&mut qkv, 1, |row, c| if c % 16 == row { 468.75 } else { 0.0 });
        attend(t, p, &qkv, &[0, 16], 16)
    }),
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![case("attention-f32-logits-of-1e30", huge_logits)];
    for precision in Precision::ALL {
        cases.extend(AT_EVERY_PRECISION.iter().map(|&(name, check)| {
            case(format!("attention-{precision}{name}"), move |t| check(t, precision))
        }));
    }
    cases.push(case("attention-nan-in-a-patch", nan_in_a_patch));
    cases.push(case("attention-gradient", attention_gradient));
    cases
}

fn huge_logits(trial: &Trial<'_>) -> Result<Finding, Failure> {
    // Three blocks of keys, so that the largest score is often not in the first.
    let mut qkv = noise(150 * 3 * C, 8, 1.0);
    for row in qkv.chunks_exact_mut(3 * C) {
        row[..2 * C].iter_mut().for_each(|v| *v *= 1e15);
    }
    attend(trial, Precision::F32, &qkv, &[0, 150], 150)
}

fn patch_borders(trial: &Trial<'_>, precision: Precision) -> Result<Finding, Failure> {
    let mut found = Finding::right();
    for offsets in [&[0, 1][..], &[0, 2], &[0, 15, 16], &[0, 16, 33], &[0, 31, 31, 48, 50]] {
        let rows = offsets.last().copied().unwrap_or(0);
        let qkv = noise(rows * 3 * C, 2, 1.0);
        found.join(attend(trial, precision, &qkv, offsets, 16)?);
    }
    Ok(found)
}

fn nan_in_a_patch(_: &Trial<'_>) -> Result<(), Failure> {
    let clean = noise(96 * 3 * C, 5, 1.0);
    let (order, patches) = (order(96), cut(&[0, 96], 16));
    let run = |qkv: &[f32]| {
        let mut out = vec![0.0; 96 * C];
        forward_with(Precision::F32, qkv, HEADS, &patches, &order, &mut out);
        out
    };
    let bad_row = order[20] as usize;
    let mut bad = clean.clone();
    bad[bad_row * 3 * C + C] = f32::NAN;
    let (clean, bad) = (run(&clean), run(&bad));
    for (position, &row) in order.iter().enumerate() {
        let at = row as usize * C..(row as usize + 1) * C;
        let same_patch = position / 16 == 20 / 16;
        if same_patch {
            let first_head = &bad[at.start..at.start + 16];
            ensure!(first_head.iter().all(|v| v.is_nan()), "row {row} hides a NaN");
        } else {
            ensure!(bad[at.clone()] == clean[at], "row {row} of another patch changed");
        }
    }
    Ok(())
}

fn attention_gradient(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let rows = 32;
    let (qkv, upstream) = (noise(rows * 3 * C, 6, 1.0), noise(rows * C, 7, 1.0));
    let (order, patches) = (order(rows), cut(&[0, rows], 16));
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; rows * 3 * C];
        backward(&qkv, HEADS, &patches, &order, &upstream, &mut out);
        Ok(out)
    })?;
    let mut want = vec![0.0; rows * 3 * C];
    let scale = 1.0 / f64::from(HEADS.dim as u32).sqrt();
    for keys in order.chunks_exact(16) {
        let keys: Vec<usize> = keys.iter().map(|&row| row as usize).collect();
        for head in 0..HEADS.count {
            for &row in &keys {
                let p = softmax(&qkv, row, &keys, head);
                let up = |c: usize| f64::from(upstream[row * C + head * HEADS.dim + c]);
                let dp: Vec<f64> = keys
                    .iter()
                    .map(|&k| (0..HEADS.dim).map(|c| up(c) * part(&qkv, k, 2, head, c)).sum())
                    .collect();
                let mean: f64 = dp.iter().zip(&p).map(|(d, p)| d * p).sum();
                for (j, &key) in keys.iter().enumerate() {
                    let ds = p[j] * (dp[j] - mean) * scale;
                    for c in 0..HEADS.dim {
                        let at =
                            |row: usize, part: usize| row * 3 * C + part * C + head * HEADS.dim + c;
                        want[at(row, 0)] += ds * part(&qkv, key, 1, head, c);
                        want[at(key, 1)] += ds * part(&qkv, row, 0, head, c);
                        want[at(key, 2)] += p[j] * up(c);
                    }
                }
            }
        }
    }
    gradient(&wide(&got), &want)
}
