//! Operations.

use super::check::{BF16_EPS, F32_EPS, Values, check, cloud, flat, var};
use super::slow;
use crate::support::devices::here;
use candle_core::{DType, Tensor, Var};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::PackedMatrix;
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::cut;
use scenesplat_kernels::segment::Reduce;
use scenesplat_kernels::sparse_conv::PackedConv;
use scenesplat_models::ops;
use std::sync::Arc;

const PRECISIONS: [(Precision, f64); 3] = [
    (Precision::F32, F32_EPS),
    // Two bf16 for each f32 keep 16 of its 24 bits.
    (Precision::F32Split, 1e-4),
    (Precision::Bf16, BF16_EPS),
];

/// Variables of which the last is a bias.
fn with_and_without_bias<'a, 'b>(
    all: &'a [(&'b str, &'b Var); 3],
) -> [&'a [(&'b str, &'b Var)]; 2] {
    [all, &all[..2]]
}

#[test]
pub fn linear() {
    for (precision, eps) in PRECISIONS {
        for (n, k, m) in [(1, 1, 1), (7, 5, 3), (33, 17, 20)] {
            let (x, w, b) = (var("x", &[n, k]), var("w", &[m, k]), var("b", &[m]));
            for vars in with_and_without_bias(&[("x", &x), ("w", &w), ("b", &b)]) {
                let bias = vars.get(2).map(|_| b.as_tensor());
                let out = ops::linear_with(precision, &x, &w, bias).unwrap();
                check(&format!("linear {precision} {n}·{k}·{m}"), eps, vars, &out, |v| {
                    slow::linear(&v["x"], k, &v["w"], v.get("b").map(Vec::as_slice))
                });
            }
        }
    }
}

#[test]
pub fn gelu() {
    // Up to ±5, where it is nearly 0 and nearly x.
    let x = Var::from_tensor(&(var("x", &[40, 3]).as_tensor() * 5.0).unwrap()).unwrap();
    let out = ops::gelu(&x).unwrap();
    check("gelu", F32_EPS, &[("x", &x)], &out, |v| slow::gelu(&v["x"]));
}

#[test]
pub fn layer_norm() {
    for (n, c) in [(1, 3), (9, 5), (20, 48)] {
        let (x, w, b) = (var("x", &[n, c]), var("w", &[c]), var("b", &[c]));
        let out = ops::layer_norm(&x, &w, &b, 1e-5).unwrap();
        let case = format!("layer_norm {n}·{c}");
        check(&case, F32_EPS, &[("x", &x), ("w", &w), ("b", &b)], &out, |v| {
            slow::layer_norm(&v["x"], &v["w"], &v["b"])
        });
    }
}

#[test]
pub fn batch_norm() {
    for (n, c) in [(3, 1), (9, 5), (40, 24)] {
        let (x, w, b) = (var("x", &[n, c]), var("w", &[c]), var("b", &[c]));
        let vars = [("x", &x), ("w", &w), ("b", &b)];
        let statistics = ops::batch_statistics(&x).unwrap();
        let out = ops::batch_norm(&x, &w, &b, statistics, 1e-3).unwrap();
        check(&format!("batch_norm {n}·{c}"), F32_EPS, &vars, &out, |v| {
            slow::batch_norm(&v["x"], &v["w"], &v["b"], None)
        });
        let (mean, spread) = (flat(&var("mean", &[c])), flat(&var("var", &[c])));
        let spread: Vec<f64> = spread.iter().map(|v| 1.2 + v).collect();
        let statistics = ops::BatchStatistics::constant(mean.clone(), spread.clone());
        let out = ops::batch_norm(&x, &w, &b, statistics, 1e-3).unwrap();
        check(&format!("batch_norm {n}·{c}, given statistics"), F32_EPS, &vars, &out, |v| {
            slow::batch_norm(&v["x"], &v["w"], &v["b"], Some((&mean, &spread)))
        });
    }
}

#[test]
pub fn l2_normalize() {
    for (n, c) in [(6, 1), (5, 7), (4, 96)] {
        let x = var("x", &[n, c]);
        let out = ops::l2_normalize(&x).unwrap();
        if c == 1 {
            // The sign: nothing moves it.
            let grads = out.sum_all().unwrap().backward().unwrap();
            assert!(flat(grads.get(&x).unwrap()).iter().all(|g| g.abs() < 1e-6));
            continue;
        }
        check(&format!("l2_normalize {n}·{c}"), F32_EPS, &[("x", &x)], &out, |v| {
            slow::l2_normalize(&v["x"], c)
        });
    }
}

#[test]
pub fn sparse_conv() {
    let cloud = cloud();
    for (precision, eps) in PRECISIONS {
        for (k, cin, cout) in [(3, 3, 4), (3, 8, 5), (5, 2, 3)] {
            let map = cloud.kernel_map(k).unwrap();
            let x = var("x", &[cloud.len(), cin]);
            let (w, b) = (var("w", &[cout, k, k, k, cin]), var("b", &[cout]));
            for vars in with_and_without_bias(&[("x", &x), ("w", &w), ("b", &b)]) {
                let bias = vars.get(2).map(|_| b.as_tensor());
                let out = ops::sparse_conv_with(precision, &x, &w, bias, map.clone()).unwrap();
                check(
                    &format!("sparse_conv {precision} {k}³ {cin}→{cout}"),
                    eps,
                    vars,
                    &out,
                    |v| {
                        let bias = v.get("b").map(Vec::as_slice);
                        slow::conv(&v["x"], cin, &v["w"], bias, &cloud, k)
                    },
                );
            }
        }
    }
}

#[test]
pub fn patch_attention() {
    // Scenes smaller than a patch, of one, of several with a filled-up last one.
    let offsets = [0, 3, 11, 30];
    let order: Arc<Vec<u32>> =
        Arc::new(offsets.windows(2).flat_map(|s| (s[0] as u32..s[1] as u32).rev()).collect());
    for (precision, eps) in PRECISIONS {
        for (heads, patch) in [
            (Heads { count: 1, dim: 4 }, 8),
            (Heads { count: 2, dim: 3 }, 7),
            (Heads { count: 3, dim: 8 }, 64),
        ] {
            let patches = Arc::new(cut(&offsets, patch));
            let qkv = var("qkv", &[30, 3 * heads.channels()]);
            // Logits that matter.
            let qkv = Var::from_tensor(&(qkv.as_tensor() * 1.5).unwrap()).unwrap();
            let out = ops::patch_attention(precision, &qkv, heads, patches.clone(), order.clone())
                .unwrap();
            let case = format!("patch_attention {precision} {heads:?} {patch}");
            check(&case, eps, &[("qkv", &qkv)], &out, |v| {
                slow::attention(&v["qkv"], heads, &patches, &order)
            });
        }
    }
}

#[test]
pub fn permute_rows() {
    // Not its own inverse, or a gradient by the order itself would do.
    let order: Vec<u32> = (0..13).map(|i| i * 5 % 13).collect();
    let mut inverse = vec![0; 13];
    order.iter().enumerate().for_each(|(i, r)| inverse[*r as usize] = i as u32);
    let x = var("x", &[13, 3]);
    let out = ops::permute_rows(&x, Arc::new(order.clone()), Arc::new(inverse)).unwrap();
    check("permute_rows", F32_EPS, &[("x", &x)], &out, |v| slow::gather(&v["x"], 3, &order));
}

#[test]
pub fn add_scaled_rows() {
    // Rows of more than one task.
    let n = 300;
    let (x, r) = (var("x", &[n, 2]), var("r", &[n, 2]));
    let factors: Vec<f32> = (0..n).map(|i| [0.0, 1.25, 3.0][i % 3]).collect();
    let wide: Vec<f64> = factors.iter().map(|f| f64::from(*f)).collect();
    for (case, factors, wide) in
        [("scaled", Some(Arc::new(factors)), wide), ("plain", None, vec![1.0; n])]
    {
        let out = ops::add_scaled_rows(&x, factors, &r).unwrap();
        check(&format!("add_scaled_rows {case}"), F32_EPS, &[("x", &x), ("r", &r)], &out, |v| {
            slow::add_scaled(&v["x"], &wide, &v["r"])
        });
    }
}

#[test]
fn residuals_of_another_shape_are_refused() {
    let [a, b] = [2, 3].map(|n| Tensor::zeros((n, 2), DType::F32, &here()).unwrap());
    assert!(ops::add_scaled_rows(&a, None, &b).is_err());
    let none = Tensor::zeros((0, 3), DType::F32, &here()).unwrap();
    assert_eq!(ops::add_scaled_rows(&none, None, &none).unwrap().dims(), [0, 3]);
}

#[test]
pub fn segments() {
    let cloud = cloud();
    let (_, groups) = cloud.pool(1);
    let groups = Arc::new(groups);
    assert!(groups.len() > 3 && groups.len() < cloud.len() - 3, "groups of several rows");
    let (x, y) = (var("x", &[cloud.len(), 5]), var("y", &[groups.len(), 5]));
    for how in [Reduce::Mean, Reduce::Max, Reduce::Sum] {
        let out = ops::segment_reduce(&x, groups.clone(), how).unwrap();
        check(&format!("segment_reduce {how:?}"), F32_EPS, &[("x", &x)], &out, |v| {
            slow::reduce(&v["x"], 5, &groups, how)
        });
    }
    let out = ops::expand_groups(&y, groups.clone()).unwrap();
    check("expand_groups", F32_EPS, &[("y", &y)], &out, |v: &Values| {
        slow::gather(&v["y"], 5, groups.inverse())
    });
}

/// Operations of packed weights have no gradient, and say so instead of losing it.
#[test]
fn frozen_operations_refuse() {
    let cloud = cloud();
    let x = var("x", &[cloud.len(), 4]);
    let matrix = PackedMatrix::from_strided(&[0.5; 16], 4, 4, 1, 4);
    let bias = [0.0; 4];
    let conv = PackedConv::with_precision(Precision::F32, &[0.5; 4 * 27 * 4], 4, 4, 27);
    let map = cloud.kernel_map(3).unwrap();
    type Frozen<'a> = &'a dyn Fn(&Tensor) -> candle_core::Result<Tensor>;
    let operations: [(&str, Frozen<'_>); 4] = [
        ("linear", &|x| ops::linear_frozen(x, &matrix, Some(&bias), false, None)),
        ("mlp", &|x| ops::mlp_frozen(x, (&matrix, &bias), (&matrix, &bias), &x.detach())),
        ("layer_norm", &|x| ops::layer_norm_frozen(x, &[1.0; 4], &bias, 1e-5, None)),
        ("sparse_conv", &|x| ops::sparse_conv_frozen(x, &conv, None, &map)),
    ];
    for (name, operation) in operations {
        let message = operation(&x).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("no gradient"), "{message}");
        assert_eq!(operation(&x.detach()).unwrap().dims(), x.dims());
    }
    // So do residuals that want one.
    let zeros = Tensor::zeros(x.dims(), x.dtype(), &here()).unwrap();
    assert!(ops::linear_frozen(&zeros, &matrix, None, false, Some(&x)).is_err());
    assert!(ops::layer_norm_frozen(&zeros, &[1.0; 4], &bias, 1e-5, Some(&x)).is_err());
    assert!(ops::mlp_frozen(&zeros, (&matrix, &bias), (&matrix, &bias), &x).is_err());
}
