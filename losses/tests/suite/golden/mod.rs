//! Agreement with numbers that the original losses computed: values, gradients and hard cases.

mod classes;
mod features;
mod self_supervised;

use candle_core::{Device, Tensor, Var};
use scenesplat_test_support::Golden;

fn tensor(g: &Golden, name: &str) -> Tensor {
    Tensor::from_vec(g.f32s(name), g.shape(name), &Device::Cpu).unwrap()
}

fn var(g: &Golden, name: &str) -> Var {
    Var::from_tensor(&tensor(g, name)).unwrap()
}

fn mask(g: &Golden) -> Vec<bool> {
    g.f64s("in.mask").iter().map(|v| *v != 0.0).collect()
}

fn compare(g: &Golden, name: &str, got: &Tensor) {
    g.compare(name, &crate::support::wide(got));
}

/// Compares a loss with `out.loss`, and its gradients with `grad.*`, by the names of their variables.
fn check(g: &Golden, loss: &Tensor, vars: &[(&str, &Var)]) {
    compare(g, "out.loss", loss);
    let grads = loss.backward().unwrap();
    for (name, var) in vars {
        compare(g, &format!("grad.{name}"), grads.get(var).unwrap());
    }
}
