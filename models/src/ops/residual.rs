//! Residual connections.

use super::{Pass, cpu_slice, forward_on_device, here, make, read};
use crate::device::off_host;
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor, bail};
use rayon::prelude::*;
use std::sync::Arc;

/// Rows that one task adds.
const BLOCK: usize = 256;

struct AddScaledRows {
    factors: Option<Arc<Vec<f32>>>,
}

impl AddScaledRows {
    /// `out = x · factor of its row [+ residual]`
    fn scaled(&self, x: &[f32], c: usize, out: &mut [f32], residual: Option<&[f32]>) {
        let block = BLOCK * c;
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
    }
}

impl CustomOp2 for AddScaledRows {
    fn name(&self) -> &'static str {
        "add_scaled_rows"
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let x = cpu_slice("add_scaled_rows", s1, l1)?;
        let residual = cpu_slice("add_scaled_rows", s2, l2)?;
        let (n, c) = l1.shape().dims2()?;
        if l1.shape() != l2.shape() || self.factors.as_ref().is_some_and(|f| f.len() != n) {
            bail!("add_scaled_rows: {:?} and {:?} differ", l1.shape(), l2.shape());
        }
        let mut out = vec![0f32; x.len()];
        if c > 0 {
            self.scaled(x, c, &mut out, Some(residual));
        }
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
    forward_on_device!(CustomOp2);
    fn bwd(
        &self,
        x: &Tensor,
        _: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        if self.factors.is_none() {
            return Ok((Some(grad.clone()), Some(grad.clone())));
        }
        let (n, c) = x.dims2()?;
        let device = here("add_scaled_rows", Pass::Backward, x);
        let dx = read("add_scaled_rows", grad, |g| {
            make(device, (n, c), |out| {
                if c > 0 {
                    self.scaled(g, c, out, None);
                }
            })
        })?;
        Ok((Some(dx), Some(grad.clone())))
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
    if off_host(x.device()) {
        let n = x.dims2()?.0;
        if x.shape() != residual.shape() || factors.as_ref().is_some_and(|f| f.len() != n) {
            bail!("add_scaled_rows: {:?} and {:?} differ", x.shape(), residual.shape());
        }
        // By candle's operations.
        return match factors {
            Some(f) => x.broadcast_mul(&Tensor::from_slice(&f, (n, 1), x.device())?)? + residual,
            None => x + residual,
        };
    }
    x.contiguous()?.apply_op2(&residual.contiguous()?, AddScaledRows { factors })
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
