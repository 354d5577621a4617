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
