//! Group c: submanifold convolution with its gradients.

use crate::support::Golden;
use candle_core::Var;
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_models::ops;
use std::sync::Arc;

#[test]
pub fn forward_and_gradients() {
    for case in ["k3_c6_8", "k5_c11_8", "k3_c32_32", "k3_dense_block", "k5_isolated", "k3_far"] {
        let Some(g) = Golden::open(&format!("c_{case}.safetensors")) else { return };
        let indices = g.ints("in.indices");
        // Scenes are contiguous; count the rows of each.
        let scenes: Vec<i64> = indices.chunks_exact(4).map(|r| r[0]).collect();
        let mut offsets = vec![0];
        for s in 0..=scenes.last().copied().unwrap() {
            offsets.push(scenes.iter().filter(|b| **b <= s).count());
        }
        let cells: Vec<[i32; 3]> =
            indices.chunks_exact(4).map(|r| [r[1] as i32, r[2] as i32, r[3] as i32]).collect();
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
