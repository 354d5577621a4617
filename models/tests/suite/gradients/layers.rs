//! Layers that the modules do not cover, with all their parameters.

use super::check::{
    BF16_EPS, F32_EPS, Statistics, Values, check_normed, check_part, flat, store, var,
};
use super::slow;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::Precision;
use scenesplat_models::layers::{BatchNorm, BatchNormConstants, Linear, LinearNorm, NormKind};
use scenesplat_models::{Compute, Mode};

const ROWS: usize = 14;

#[test]
pub fn linear() {
    for (precision, eps) in [(Precision::F32, F32_EPS), (Precision::Bf16, BF16_EPS)] {
        for bias in [true, false] {
            let store = store();
            let compute = Compute { precision, ..Compute::default() };
            let layer = Linear::with(compute, 5, 7, bias, store.builder()).unwrap();
            let (x, r) = (var("x", &[ROWS, 5]), var("r", &[ROWS, 7]));
            let product = |v: &Values| {
                slow::linear(&v["x"], 5, &v["weight"], v.get("bias").map(Vec::as_slice))
            };
            let case = format!("linear {precision}, bias {bias}");
            let out = layer.forward(&x).unwrap();
            check_part(&case, eps, &store, &[("x", &x)], &out, product);
            let out = layer.forward_residual(&x, Some(&r)).unwrap();
            let case = format!("{case}, residual");
            check_part(&case, eps, &store, &[("x", &x), ("r", &r)], &out, |v| {
                slow::add(&product(v), &v["r"])
            });
            let out = layer.forward_gelu(&x, None).unwrap();
            let case = format!("{case}, gelu");
            check_part(&case, eps, &store, &[("x", &x)], &out, |v| slow::gelu(&product(v)));
        }
    }
}

#[test]
pub fn what_a_batch_norm_remembers() {
    // Neither 0.5 nor so small that rounding hides it.
    let constants = BatchNormConstants { eps: 1e-3, momentum: 0.2 };
    for rows in [2, ROWS] {
        let store = store();
        let layer = BatchNorm::with(constants, 6, store.builder()).unwrap();
        let x = var("x", &[rows, 6]);
        let remembered = |what: &str| flat(&store.buffers()[what]);
        let before = ["running_mean", "running_var", "num_batches_tracked"].map(remembered);
        layer.forward(&x, Mode::Eval).unwrap();
        assert_eq!(before[1], remembered("running_var"), "evaluation moves nothing");
        layer.forward(&x, Mode::Train).unwrap();
        let x = flat(&x);
        let n = rows as f64;
        for c in 0..6 {
            let column: Vec<f64> = x.iter().skip(c).step_by(6).copied().collect();
            let mean = column.iter().sum::<f64>() / n;
            // Divided by one less than the rows.
            let var = column.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            for (what, old, new) in
                [("running_mean", before[0][c], mean), ("running_var", before[1][c], var)]
            {
                let (got, want) = (remembered(what)[c], 0.8 * old + 0.2 * new);
                assert!((got - want).abs() < 1e-6, "{what}, {rows} rows: {got}, by hand {want}");
            }
        }
        assert_eq!(remembered("num_batches_tracked")[0], before[2][0] + 1.0);
    }
}

#[test]
pub fn linear_norm() {
    for mode in [Mode::Train, Mode::Eval] {
        let store = store();
        let vb = store.builder();
        let layer =
            LinearNorm::new(Compute::default(), NormKind::Batch, 5, 6, vb.pp("0"), vb.pp("1"))
                .unwrap();
        let x = var("x", &[ROWS, 5]);
        let given = Statistics::of(&store, "1.", mode);
        let out = layer.forward(&x, mode).unwrap();
        let biases: &[&str] = if mode == Mode::Train { &["0.bias"] } else { &[] };
        check_normed(&format!("linear norm {mode:?}"), &store, biases, &[("x", &x)], &out, |v| {
            let y = slow::linear(&v["x"], 5, &v["0.weight"], Some(&v["0.bias"]));
            slow::gelu(&slow::batch_norm(&y, &v["1.weight"], &v["1.bias"], given.get()))
        });
    }
}

/// What each row of a branch is multiplied with.
pub fn drop_factors(rate: f64, rows: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let keep = 1.0 - rate;
    let kept = |()| if rng.random::<f64>() < keep { 1.0 / keep } else { 0.0 };
    (0..rows).map(|_| ()).map(kept).collect()
}
