use super::*;
use crate::patches::cut;
use crate::tests as testing;
use scenesplat_test_support::reference;

fn random(len: usize, seed: u64, scale: f32) -> Vec<f32> {
    testing::random(len, seed).into_iter().map(|v| v * scale).collect()
}

fn setup(counts: &[usize], k: usize) -> (Patches, Vec<u32>) {
    let mut offsets = vec![0];
    for n in counts {
        offsets.push(offsets[offsets.len() - 1] + n);
    }
    let n = offsets[counts.len()];
    // Any permutation inside each scene will do: reverse.
    let mut order = Vec::with_capacity(n);
    for s in offsets.windows(2) {
        order.extend((s[0]..s[1]).rev().map(|v| v as u32));
    }
    (cut(&offsets, k), order)
}

fn slow(qkv: &[f32], heads: Heads, patches: &Patches, order: &[u32]) -> Vec<f64> {
    let c = heads.channels();
    let mut out = vec![f64::NAN; order.len() * c];
    for p in patches.patches() {
        let rows: Vec<usize> =
            (p.start..p.start + p.len).map(|s| order[patches.pad()[s] as usize] as usize).collect();
        let part = reference::attention_segment(qkv, heads.count, heads.dim, &rows);
        for (i, &row) in rows[..p.own].iter().enumerate() {
            out[row * c..(row + 1) * c].copy_from_slice(&part[i * c..(i + 1) * c]);
        }
    }
    out
}

/// Largest difference of a result of these lengths and widths, relative to the values. Sums of a
/// thousand rounded terms, exponents rounded by as many units as the head has channels.
const F32_EPS: f64 = 1e-5;
/// Weights and values of 8 bits, logits of size 1 from operands of 8 bits.
const BF16_EPS: f64 = 2e-2;

/// Counts of scenes, patch size, heads: lengths and widths around every register and block.
fn shapes() -> Vec<(Vec<usize>, usize, Heads)> {
    vec![
        (vec![], 64, Heads { count: 2, dim: 16 }),
        (vec![0, 1], 64, Heads { count: 2, dim: 16 }),
        (vec![2, 63], 64, Heads { count: 1, dim: 8 }),
        (vec![64, 65, 10, 200], 64, Heads { count: 2, dim: 48 }),
        (vec![129], 64, Heads { count: 3, dim: 12 }),
        (vec![1030, 70], 1024, Heads { count: 2, dim: 18 }),
        (vec![1100, 47], 1024, Heads { count: 1, dim: 16 }),
        (vec![100, 49], 97, Heads { count: 2, dim: 1 }),
        (vec![150], 110, Heads { count: 1, dim: 7 }),
        (vec![33, 34], 1024, Heads { count: 1, dim: 64 }),
    ]
}

/// Runs `forward_with` on fresh NaN, so that a value never written is seen.
fn run(precision: Precision, qkv: &[f32], heads: Heads, p: &Patches, order: &[u32]) -> Vec<f32> {
    let mut out = vec![f32::NAN; order.len() * heads.channels()];
    forward_with(precision, qkv, heads, p, order, &mut out);
    out
}

#[test]
fn agrees_with_f64_at_all_sizes_and_logit_scales() {
    for (counts, k, heads) in shapes() {
        let (patches, order) = setup(&counts, k);
        for scale in [1e-20, 1.0, 60.0, 1e4] {
            let qkv = random(order.len() * 3 * heads.channels(), 1, scale);
            let out = run(Precision::F32, &qkv, heads, &patches, &order);
            assert_eq!(out, run(Precision::F32Split, &qkv, heads, &patches, &order));
            let want = slow(&qkv, heads, &patches, &order);
            // Logits of scale² are themselves rounded.
            let eps = F32_EPS * f64::from(scale * scale).max(1.0);
            let mut bad = 0;
            for (g, w) in out.iter().zip(&want) {
                assert!(g.is_finite());
                if (f64::from(*g) - w).abs() > eps.min(1e-3) * f64::from(scale) {
                    bad += 1;
                }
            }
            // With logits of 1e8 two keys may tie within rounding; elsewhere none may differ.
            assert!(bad == 0 || scale > 1e3, "{counts:?} {heads:?} at {scale}: {bad}");
            assert!(bad * 50 <= out.len(), "{counts:?} {heads:?} at {scale}: {bad}");
        }
    }
}

#[test]
fn bf16_agrees_with_f64() {
    for (counts, k, heads) in shapes() {
        let (patches, order) = setup(&counts, k);
        for scale in [1e-20, 1.0] {
            let qkv = random(order.len() * 3 * heads.channels(), 1, scale);
            let out = run(Precision::Bf16, &qkv, heads, &patches, &order);
            let want = slow(&qkv, heads, &patches, &order);
            let mut squares = [0f64; 2];
            for (g, w) in out.iter().zip(&want) {
                let error = (f64::from(*g) - w) / f64::from(scale);
                assert!(error.abs() < BF16_EPS, "{counts:?} {heads:?} at {scale}: {g} {w}");
                squares[0] += error * error;
                squares[1] += (w / f64::from(scale)).powi(2);
            }
            assert!(squares[0].sqrt() <= 6e-3 * squares[1].sqrt(), "{counts:?} {squares:?}");
        }
        // One key: its weight is 1, so the result is the rounded value.
        let (patches, order) = setup(&[1], k);
        let qkv = random(3 * heads.channels(), 2, 1.0);
        let out = run(Precision::Bf16, &qkv, heads, &patches, &order);
        for (g, v) in out.iter().zip(&qkv[2 * heads.channels()..]) {
            let rounded = crate::gemm::bf16::widen(crate::gemm::bf16::round(*v));
            assert_eq!(*g, rounded);
        }
    }
}

/// One head whose logits are `factor · steps[j]` for every query.
fn chosen_logits(dim: usize, steps: &[f32], factor: f32) -> (Vec<f32>, Heads) {
    let mut qkv = random(steps.len() * 3 * dim, 5, 1.0);
    for (row, step) in qkv.chunks_exact_mut(3 * dim).zip(steps) {
        row[..2 * dim].fill(0.0);
        row[0] = factor * (dim as f32).sqrt();
        row[dim] = *step;
    }
    (qkv, Heads { count: 1, dim })
}

#[test]
fn huge_and_equal_logits() {
    const N: usize = 333;
    let (patches, order) = setup(&[N], 1024);
    let ramp: Vec<f32> = (0..N).map(|i| i as f32 / N as f32 * 2.0 - 1.0).collect();
    let mut fallen = ramp.clone();
    fallen.reverse();
    let signs: Vec<f32> = (0..N).map(|i| if i * i % 7 < 3 { 1.0 } else { -1.0 }).collect();
    for dim in [1, 7, 16, 48, 64] {
        for (steps, factor) in [
            (&ramp, 1e4f32),
            (&fallen, 1e4),
            (&signs, 1e4),
            (&signs, -1e4),
            (&ramp, -1e4),
            (&ramp, 90.0),
            (&ramp, 1e30),
            (&signs, 0.0),
        ] {
            for precision in [Precision::F32, Precision::Bf16] {
                let (qkv, heads) = chosen_logits(dim, steps, factor);
                let out = run(precision, &qkv, heads, &patches, &order);
                let want = slow(&qkv, heads, &patches, &order);
                // Rounded to bf16, neighboring steps of a ramp become equal: any mean of values.
                let ramp = steps[0].abs() == 1.0 && steps[1].abs() < 1.0;
                let eps = match precision {
                    Precision::Bf16 if ramp => 2.0,
                    Precision::Bf16 => BF16_EPS,
                    // Logits of 1e4 are rounded to 1e-3.
                    _ => {
                        if factor.abs() < 1e3 {
                            3e-5
                        } else {
                            2e-3
                        }
                    }
                };
                for (g, w) in out.iter().zip(&want) {
                    let error = (f64::from(*g) - w).abs();
                    assert!(error < eps, "{dim} {factor} {precision}: {g} {w}");
                }
            }
        }
    }
}

#[test]
fn nan_and_infinity_stay_in_their_patch() {
    const DIM: usize = 16;
    let heads = Heads { count: 2, dim: DIM };
    let (patches, order) = setup(&[200, 70], 64);
    let clean: Vec<f32> = random(270 * 3 * 2 * DIM, 6, 1.0).iter().map(|v| v.abs() + 0.1).collect();
    let grad = random(270 * 2 * DIM, 7, 1.0);
    let mut clean_grad = vec![0.0; clean.len()];
    backward(&clean, heads, &patches, &order, &grad, &mut clean_grad);
    let seen = |row: usize| {
        patches.patches().iter().any(|p| {
            let mut rows = patches.pad()[p.start..p.start + p.len].iter();
            rows.clone().any(|&s| order[s as usize] as usize == row)
                && rows.any(|&s| order[s as usize] == 100)
        })
    };
    for precision in [Precision::F32, Precision::Bf16] {
        let before = run(precision, &clean, heads, &patches, &order);
        for part in 0..3 {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let mut qkv = clean.clone();
                qkv[100 * 6 * DIM + part * 2 * DIM + 3] = bad;
                let out = run(precision, &qkv, heads, &patches, &order);
                let want = slow(&qkv, heads, &patches, &order);
                for (i, (g, w)) in out.iter().zip(&want).enumerate() {
                    // Which of NaN and ±∞ is where is the definition's choice, not ours.
                    assert_eq!(g.is_nan(), w.is_nan(), "{part} {bad} {i}: {g} {w}");
                    if w.is_nan() {
                        assert!(seen(i / (2 * DIM)));
                    } else if w.is_finite() {
                        assert!((f64::from(*g) - w).abs() < BF16_EPS, "{part} {bad} {i}: {g} {w}");
                    } else {
                        assert_eq!(f64::from(*g), *w);
                    }
                    if !seen(i / (2 * DIM)) || i % (2 * DIM) >= DIM {
                        assert_eq!(*g, before[i], "{part} {bad} {i}");
                    }
                }
            }
        }
    }
    let mut qkv = clean;
    qkv[100 * 6 * DIM + 2 * DIM] = f32::NAN;
    let mut dqkv = vec![0.0; qkv.len()];
    backward(&qkv, heads, &patches, &order, &grad, &mut dqkv);
    for (i, (g, c)) in dqkv.iter().zip(&clean_grad).enumerate() {
        // Rows that another patch borrows are seen with it; heads do not mix.
        let hit = i % (2 * DIM) < DIM
            && patches.patches().iter().any(|p| {
                let rows: Vec<usize> = patches.pad()[p.start..p.start + p.len]
                    .iter()
                    .map(|&s| order[s as usize] as usize)
                    .collect();
                rows.contains(&100) && rows.contains(&(i / (6 * DIM)))
            });
        assert_eq!(g.is_nan(), hit, "{i}");
        assert!(hit || g == c, "{i}: {g} {c}");
    }
}

/// Gradient by the formulas, in f64.
fn slow_gradient(qkv: &[f32], heads: Heads, p: &Patches, order: &[u32], grad: &[f32]) -> Vec<f64> {
    let (c, dim) = (heads.channels(), heads.dim);
    let mut out = vec![0.0; qkv.len()];
    for patch in p.patches() {
        let rows: Vec<usize> = (patch.start..patch.start + patch.len)
            .map(|s| order[p.pad()[s] as usize] as usize)
            .collect();
        for (h, &q) in (0..heads.count).flat_map(|h| rows[..patch.own].iter().map(move |q| (h, q)))
        {
            let at = |row: usize, part: usize| row * 3 * c + part * c + h * dim;
            let part = |row, part| &qkv[at(row, part)..at(row, part) + dim];
            let dot = |a: &[f32], b: &[f32]| -> f64 {
                a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
            };
            let g = &grad[q * c + h * dim..q * c + (h + 1) * dim];
            let scale = 1.0 / (dim as f64).sqrt();
            let logits: Vec<f64> =
                rows.iter().map(|&k| dot(part(q, 0), part(k, 1)) * scale).collect();
            let top = logits.iter().copied().fold(f64::MIN, f64::max);
            let total: f64 = logits.iter().map(|l| (l - top).exp()).sum();
            let weights: Vec<f64> = logits.iter().map(|l| (l - top).exp() / total).collect();
            let mean: f64 = rows.iter().zip(&weights).map(|(&k, w)| w * dot(g, part(k, 2))).sum();
            for (&k, w) in rows.iter().zip(&weights) {
                let slope = w * (dot(g, part(k, 2)) - mean) * scale;
                for d in 0..dim {
                    out[at(k, 2) + d] += w * f64::from(g[d]);
                    out[at(k, 1) + d] += slope * f64::from(part(q, 0)[d]);
                    out[at(q, 0) + d] += slope * f64::from(part(k, 1)[d]);
                }
            }
        }
    }
    out
}

#[test]
fn gradients_agree_with_f64_at_all_sizes() {
    for (counts, k, heads) in shapes() {
        let (patches, order) = setup(&counts, k);
        for scale in [1.0, 8.0] {
            let qkv = random(order.len() * 3 * heads.channels(), 1, scale);
            let grad = random(order.len() * heads.channels(), 2, 1.0);
            let mut dqkv = vec![f32::NAN; qkv.len()];
            backward(&qkv, heads, &patches, &order, &grad, &mut dqkv);
            let want = slow_gradient(&qkv, heads, &patches, &order, &grad);
            let size = want.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
            for (i, (g, w)) in dqkv.iter().zip(&want).enumerate() {
                let error = (f64::from(*g) - w).abs();
                assert!(error < 2.0 * F32_EPS * size, "{counts:?} {heads:?} {i}: {g} {w}");
            }
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let heads = Heads { count: 3, dim: 20 };
    let (patches, order) = setup(&[300, 77, 5], 64);
    let qkv = random(order.len() * 180, 8, 3.0);
    let grad = random(order.len() * 60, 9, 1.0);
    let all = |threads: usize| {
        testing::on_threads(threads, || {
            let mut dqkv = vec![0.0; qkv.len()];
            backward(&qkv, heads, &patches, &order, &grad, &mut dqkv);
            let f32 = run(Precision::F32, &qkv, heads, &patches, &order);
            [f32, run(Precision::Bf16, &qkv, heads, &patches, &order), dqkv]
        })
    };
    let one = all(1);
    for threads in [2, 3, 7] {
        assert_eq!(one, all(threads), "{threads} threads");
    }
}

/// The two ways to compute with bf16 operands round alike; sums differ by their order.
#[cfg(target_arch = "x86_64")]
#[test]
fn pairs_agree_with_rounded_operands() {
    if !pairs::has_pairs() {
        eprintln!("not run: no AVX512-BF16 in use");
        return;
    }
    let heads = Heads { count: 1, dim: 23 };
    let (patches, order) = setup(&[150], 64);
    let qkv = random(150 * 69, 10, 2.0);
    let pairs = run(Precision::Bf16, &qkv, heads, &patches, &order);
    let mut plain = vec![f32::NAN; 150 * 23];
    let rows = slot_rows(&patches, &order);
    let mut s = Scratch::new(23, patches.longest());
    for t in 0..patches.patches().len() {
        let task = &Task::new(&qkv, heads, &patches, &rows, t);
        let (s, out) = (&mut s, SharedMut(plain.as_mut_ptr()));
        dispatch_softmax!((task: &Task<'_>, s: &mut Scratch<f32>, out: SharedMut), V, MR, NV =>
            attend::<Rounded<V>, MR, NV>(task, s, out));
    }
    for (a, b) in pairs.iter().zip(&plain) {
        // A sum next to a tie of the rounding of weights may fall to either side.
        assert!((a - b).abs() < 2e-3, "{a} {b}");
    }
}

#[test]
fn gradients_agree_with_differences() {
    let heads = Heads { count: 2, dim: 4 };
    let (patches, order) = setup(&[5, 11, 3], 4);
    let qkv = random(order.len() * 24, 2, 1.0);
    let g = random(order.len() * 8, 3, 1.0);
    let mut dqkv = vec![f32::NAN; qkv.len()];
    backward(&qkv, heads, &patches, &order, &g, &mut dqkv);
    let loss = |qkv: &[f32]| -> f64 {
        slow(qkv, heads, &patches, &order).iter().zip(&g).map(|(o, g)| o * f64::from(*g)).sum()
    };
    for i in 0..qkv.len() {
        let h = 1e-2;
        let (mut up, mut down) = (qkv.clone(), qkv.clone());
        up[i] += h;
        down[i] -= h;
        let want = (loss(&up) - loss(&down)) / f64::from(up[i] - down[i]);
        assert!((f64::from(dqkv[i]) - want).abs() < 2e-4, "{i}: {} {want}", dqkv[i]);
    }
}

#[test]
fn a_scene_does_not_feel_its_batch_mates() {
    let heads = Heads { count: 1, dim: 16 };
    let qkv = random(300 * 48, 4, 1.0);
    let (both, order) = setup(&[200, 100], 64);
    let mut together = vec![0.0; 300 * 16];
    forward(&qkv, heads, &both, &order, &mut together);
    let (one, order) = setup(&[200], 64);
    let mut alone = vec![0.0; 200 * 16];
    forward(&qkv[..200 * 48], heads, &one, &order, &mut alone);
    assert_eq!(alone, together[..200 * 16]);
}
