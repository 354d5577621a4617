//! Group c: submanifold convolution with its gradients.

use crate::support::Tensors;
use candle_core::Var;
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_models::ops;
use scenesplat_test_support::Golden;
use std::sync::Arc;

#[test]
pub fn forward_and_gradients() {
    for case in ["k3_c6_8", "k5_c11_8", "k3_c32_32", "k3_dense_block", "k5_isolated", "k3_far"] {
        let Some(g) = Golden::network(&format!("c_{case}")) else { return };
        let indices: Vec<i32> = g.ints("in.indices");
        let rows: &[[i32; 4]] = indices.as_chunks().0;
        // Scenes are contiguous; count the rows of each.
        let mut offsets = vec![0];
        for scene in 0..=rows[rows.len() - 1][0] {
            offsets.push(rows.iter().filter(|row| row[0] <= scene).count());
        }
        let cells: Vec<[i32; 3]> = rows.iter().map(|&[_, x, y, z]| [x, y, z]).collect();
        let map = Arc::new(KernelMap::build(&cells, &offsets, g.number("k")).unwrap());
        let var = |name: &str| Var::from_tensor(&g.tensor(name)).unwrap();
        let (x, w) = (var("in.feat"), var("w.weight"));
        let bias = g.has("w.bias").then(|| var("w.bias"));
        let bias_tensor = bias.as_ref().map(|b| b.as_tensor());
        let out = ops::sparse_conv(x.as_tensor(), w.as_tensor(), bias_tensor, map).unwrap();
        g.compare_tensor("out", &out);
        let loss = (out * g.tensor("in.R")).unwrap().sum_all().unwrap();
        let grads = loss.backward().unwrap();
        g.compare_tensor("grad.feat", grads.get(&x).unwrap());
        g.compare_tensor("grad.weight", grads.get(&w).unwrap());
        if let Some(b) = &bias {
            g.compare_tensor("grad.bias", grads.get(b).unwrap());
        }
    }
}
