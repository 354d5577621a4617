//! Residual connections.

use super::{Array, Operation, apply, gradients};
use crate::device::off_host;
use candle_core::{Result, Shape, Tensor, bail};
use rayon::prelude::*;
use std::sync::Arc;

/// Rows that one task adds.
const BLOCK: usize = 256;

struct AddScaledRows {
    factors: Option<Arc<Vec<f32>>>,
}

impl AddScaledRows {
    /// `x · factor of its row [+ residual]`
    fn scaled(&self, x: &[f32], c: usize, residual: Option<&[f32]>) -> Vec<f32> {
        let (mut out, block) = (vec![0.0; x.len()], (BLOCK * c).max(1));
        out.par_chunks_mut(block).enumerate().for_each(|(i, out)| {
            let at = i * block..i * block + out.len();
            let x = &x[at.clone()];
            match &self.factors {
                Some(factors) => {
                    let rows = out.chunks_exact_mut(c).zip(x.chunks_exact(c));
                    for ((out, x), factor) in rows.zip(&factors[i * BLOCK..]) {
                        out.iter_mut().zip(x).for_each(|(o, x)| *o = x * factor);
                    }
                }
                None => out.copy_from_slice(x),
            }
            if let Some(residual) = residual {
                out.iter_mut().zip(&residual[at]).for_each(|(o, r)| *o += r);
            }
        });
        out
    }
}

impl Operation for AddScaledRows {
    const NAME: &'static str = "add_scaled_rows";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (n, _) = inputs[0].dims2()?;
        if inputs[0] != inputs[1] || self.factors.as_ref().is_some_and(|f| f.len() != n) {
            bail!("add_scaled_rows: {:?} and {:?} differ", inputs[0], inputs[1]);
        }
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let ((x, dims), (residual, _)) = (inputs[0], inputs[1]);
        Ok(self.scaled(x, dims[1], Some(residual)))
    }
    fn gradients(&self, inputs: &[&Tensor], grad: &Tensor) -> Result<Vec<Tensor>> {
        let of_x = match self.factors {
            Some(_) => gradients(self, &inputs[..1], grad)?,
            None => vec![grad.clone()],
        };
        Ok([of_x, vec![grad.clone()]].concat())
    }
    /// Of the rows with factors alone.
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        Ok(vec![self.scaled(grad, inputs[0].1[1], None)])
    }
}

/// `factor · x + residual`, a factor for each row, or 1 without factors; one pass.
///
/// # Shapes
/// `x`, `residual`: `[N, C]` · `factors`: `[N]` · returns `[N, C]`
///
/// # Errors
/// If shapes differ or a tensor is not f32.
pub fn add_scaled_rows(
    x: &Tensor,
    factors: Option<Arc<Vec<f32>>>,
    residual: &Tensor,
) -> Result<Tensor> {
    let scaled = AddScaledRows { factors };
    if !off_host(x.device()) {
        return apply(scaled, &[x, &residual.contiguous()?]);
    }
    // By candle's operations.
    let (n, _) = x.dims2()?;
    scaled.shape(&[x.shape(), residual.shape()])?;
    match scaled.factors {
        Some(f) => x.broadcast_mul(&Tensor::from_slice(&f, (n, 1), x.device())?)? + residual,
        None => x + residual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn values_and_gradients() {
        for (n, c) in [(0, 3), (1, 1), (2, 5), (700, 3)] {
            let values =
                |k: f32| -> Vec<f32> { (0..n * c).map(|i| (i as f32 * k).sin()).collect() };
            let var = |k| Var::from_vec(values(k), (n, c), &Device::Cpu).unwrap();
            let (x, r, direction) = (var(0.3), var(0.7), var(1.1));
            let factors: Vec<f32> = (0..n).map(|i| [0.0, 1.25, 2.0][i % 3]).collect();
            for factors in [None, Some(Arc::new(factors))] {
                let out = add_scaled_rows(&x, factors.clone(), &r).unwrap();
                let grads = (&out * &*direction).unwrap().sum_all().unwrap().backward().unwrap();
                let flat = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
                let factor = |i: usize| factors.as_ref().map_or(1.0, |f| f[i / c]);
                let (x_values, r_values, d) = (values(0.3), values(0.7), values(1.1));
                let out = flat(&out);
                for i in 0..n * c {
                    assert_eq!(out[i], x_values[i] * factor(i) + r_values[i]);
                }
                if n > 0 {
                    let (dx, dr) = (flat(grads.get(&x).unwrap()), flat(grads.get(&r).unwrap()));
                    assert_eq!(dr, d);
                    for i in 0..n * c {
                        assert_eq!(dx[i], d[i] * factor(i));
                    }
                }
            }
        }
        let [a, b] = [2, 3].map(|n| Tensor::zeros((n, 2), candle_core::DType::F32, &Device::Cpu));
        assert!(add_scaled_rows(&a.unwrap(), None, &b.unwrap()).is_err());
    }
}
