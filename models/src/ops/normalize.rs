//! Unit-length rows.

use super::{Array, Operation, apply};
use crate::device::off_host;
use candle_core::{Result, Shape, Tensor};
use scenesplat_kernels::normalize::{norm, normalize_rows};

struct L2Normalize {
    /// Smaller norms count as this; below it the divisor is a constant.
    floor: f64,
}

/// The floor of the kernel.
const EPS: f64 = 1e-12;

impl Operation for L2Normalize {
    const NAME: &'static str = "l2_normalize";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        inputs[0].dims2()?;
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (mut out, c) = (inputs[0].0.to_vec(), inputs[0].1[1]);
        if self.floor <= EPS {
            normalize_rows(&mut out, c);
        } else if c > 0 {
            for row in out.chunks_exact_mut(c) {
                let inverse = 1.0 / norm(row).max(self.floor);
                row.iter_mut().for_each(|v| *v = (f64::from(*v) * inverse) as f32);
            }
        }
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let (x, dims) = inputs[0];
        let c = dims[1];
        let mut dx = vec![0.0; x.len()];
        for ((x, g), dx) in x.chunks_exact(c).zip(grad.chunks_exact(c)).zip(dx.chunks_exact_mut(c))
        {
            let norm = norm(x).max(self.floor);
            // Below the floor the divisor is a constant.
            let along = if norm > self.floor {
                let dot: f64 = x.iter().zip(g).map(|(x, g)| f64::from(*x) * f64::from(*g)).sum();
                dot / norm / norm
            } else {
                0.0
            };
            for j in 0..c {
                dx[j] = ((f64::from(g[j]) - f64::from(x[j]) * along) / norm) as f32;
            }
        }
        Ok(vec![dx])
    }
}

/// `x / max(‖x‖, 1e-12)` for each row; a zero row stays zero.
///
/// # Shapes
/// `x`: `[N, C]` f32 · returns `[N, C]`
///
/// # Errors
/// If the tensor is not a matrix of f32.
pub fn l2_normalize(x: &Tensor) -> Result<Tensor> {
    l2_normalize_above(x, EPS)
}

/// `x / max(‖x‖, floor)` for each row; `floor` is 1e-12 at least. On the calling thread: for few rows.
///
/// # Shapes
/// `x`: `[N, C]` f32 · returns `[N, C]`
///
/// # Errors
/// If the tensor is not a matrix of f32.
pub fn l2_normalize_above(x: &Tensor, floor: f64) -> Result<Tensor> {
    let floor = floor.max(EPS);
    if off_host(x.device()) {
        x.dims2()?;
        return unit_rows(x, floor);
    }
    apply(L2Normalize { floor }, &[x])
}

/// As [`l2_normalize_above`] by candle's operations, with their gradients. What is divided by a norm is divided by the largest
/// magnitude first, so that no square overflows; that divisor has no gradient, for the result does not depend on it.
fn unit_rows(x: &Tensor, floor: f64) -> Result<Tensor> {
    let largest = x.detach().abs()?.max_keepdim(1)?.maximum(floor)?;
    let x = x.broadcast_div(&largest)?;
    let floor = (largest.recip()? * floor)?.sqr()?;
    // The floor goes under the root: at zero its gradient is infinite.
    x.broadcast_div(&x.sqr()?.sum_keepdim(1)?.maximum(&floor)?.sqrt()?)
}
