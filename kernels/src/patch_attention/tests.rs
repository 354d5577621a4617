use super::*;
use crate::patches::cut;
use crate::reference;
use rand::{Rng, SeedableRng};

fn random(len: usize, seed: u64, scale: f32) -> Vec<f32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0f32) * scale).collect()
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
    for p in &patches.patches {
        let rows: Vec<usize> = (p.start..p.start + p.len)
            .map(|s| order[patches.pad[s] as usize] as usize)
            .collect();
        let part = reference::attention_segment(qkv, heads.count, heads.dim, &rows);
        for (i, &row) in rows[..p.own].iter().enumerate() {
            out[row * c..(row + 1) * c].copy_from_slice(&part[i * c..(i + 1) * c]);
        }
    }
    out
}

#[test]
fn agrees_with_f64_at_all_sizes_and_logit_scales() {
    for (counts, k, heads) in [
        (vec![1], 64, Heads { count: 2, dim: 16 }),
        (vec![2, 63], 64, Heads { count: 1, dim: 8 }),
        (vec![64, 65, 10, 200], 64, Heads { count: 2, dim: 48 }),
        (vec![129], 64, Heads { count: 3, dim: 12 }),
    ] {
        let (patches, order) = setup(&counts, k);
        for scale in [1e-20, 1.0, 60.0, 1e4] {
            let qkv = random(order.len() * 3 * heads.channels(), 1, scale);
            let mut out = vec![f32::NAN; order.len() * heads.channels()];
            forward(&qkv, heads, &patches, &order, &mut out);
            let want = slow(&qkv, heads, &patches, &order);
            let mut bad = 0;
            for (g, w) in out.iter().zip(&want) {
                assert!(g.is_finite());
                if (f64::from(*g) - w).abs() > 1e-4 * f64::from(scale) {
                    bad += 1;
                }
            }
            // With logits of 1e8 two keys may tie within rounding; elsewhere none may differ.
            assert!(bad == 0 || scale > 1e3, "{counts:?} at {scale}: {bad}");
            assert!(bad * 50 <= out.len(), "{counts:?} at {scale}: {bad}");
        }
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
