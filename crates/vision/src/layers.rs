//! Layers of frozen weights on rows of values.

use rayon::prelude::*;
use scenesplat_kernels::activation::{exp_in_place, gelu_in_place};
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, mlp};
use scenesplat_kernels::layer_norm;
use scenesplat_kernels::normalize::normalize_rows;

/// `y = x · Wᵀ + b`
#[derive(Debug)]
pub(crate) struct Linear {
    pub weight: PackedMatrix,
    pub bias: Vec<f32>,
}

impl Linear {
    /// `[N, in] → [N, out]`
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        self.with(x, false, None)
    }

    /// `forward(x) + residual`
    pub fn plus(&self, x: &[f32], residual: &[f32]) -> Vec<f32> {
        self.with(x, false, Some(residual))
    }

    fn with(&self, x: &[f32], gelu: bool, residual: Option<&[f32]>) -> Vec<f32> {
        let rows = x.len() / self.weight.k();
        let mut out = vec![0.0; rows * self.weight.n()];
        gemm(x, &self.weight, Epilogue { bias: Some(&self.bias), gelu, residual }, &mut out);
        out
    }

    /// Bytes of the weight.
    pub fn bytes(&self) -> usize {
        self.weight.bytes()
    }
}

/// LayerNorm over the channels of each row.
#[derive(Debug)]
pub(crate) struct Norm {
    pub weight: Vec<f32>,
    pub bias: Vec<f32>,
    pub eps: f32,
}

impl Norm {
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; x.len()];
        layer_norm::forward(x, None, &self.weight, &self.bias, self.eps, &mut out);
        out
    }
}

/// `second(gelu(first(x))) + residual` with the exact GELU, without all hidden rows in memory.
pub(crate) fn mlp_gelu(x: &[f32], first: &Linear, second: &Linear, residual: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; residual.len()];
    let epilogue = Epilogue { bias: Some(&second.bias), gelu: false, residual: Some(residual) };
    mlp(x, (&first.weight, &first.bias), &second.weight, epilogue, &mut out);
    out
}

/// Linear layers with a ReLU between each two.
#[derive(Debug)]
pub(crate) struct ReluMlp(pub Vec<Linear>);

impl ReluMlp {
    pub fn forward(&self, x: &[f32]) -> Vec<f32> {
        let mut x = x.to_vec();
        for (index, layer) in self.0.iter().enumerate() {
            x = layer.forward(&x);
            if index + 1 < self.0.len() {
                x.iter_mut().for_each(|v| *v = v.max(0.0));
            }
        }
        x
    }
}

/// The exact GELU of every value.
pub(crate) fn gelu(values: &mut [f32]) {
    const BLOCK: usize = 1 << 15;
    values.par_chunks_mut(BLOCK).for_each(gelu_in_place);
}

/// Adds `b` to `a`, value by value.
pub(crate) fn add(a: &mut [f32], b: &[f32]) {
    debug_assert_eq!(a.len(), b.len());
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
}

/// The approximate GELU of every value: `x · σ(2√(2/π) · (x + 0.044715 x³))`, which is
/// `x/2 · (1 + tanh(√(2/π) · (x + 0.044715 x³)))`.
pub(crate) fn gelu_tanh(values: &mut [f32]) {
    const BLOCK: usize = 1 << 12;
    // 2√(2/π)
    const FACTOR: f32 = 1.595_769;
    values.par_chunks_mut(BLOCK).for_each_init(
        || vec![0f32; BLOCK],
        |powers, values| {
            let powers = &mut powers[..values.len()];
            for (power, x) in powers.iter_mut().zip(&*values) {
                *power = -FACTOR * (x + 0.044_715 * x * x * x);
            }
            exp_in_place(powers);
            for (x, power) in values.iter_mut().zip(&*powers) {
                *x /= 1.0 + power;
            }
        },
    );
}

/// Brings rows to unit length; the number of the first that has no direction, if one has none: zeros, or numbers that
/// are not finite. `rows`: `[N, width]`
pub(crate) fn to_directions(rows: &mut [f32], width: usize) -> Result<(), usize> {
    let has_none =
        |row: &[f32]| row.iter().all(|v| *v == 0.0) || row.iter().any(|v| !v.is_finite());
    if let Some(row) = rows.chunks_exact(width).position(has_none) {
        return Err(row);
    }
    normalize_rows(rows, width);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_without_direction_are_found() {
        let mut rows = vec![3.0, 4.0, 0.0, 1e-20, -2e30, 0.0];
        assert_eq!(to_directions(&mut rows, 2), Ok(()));
        assert_eq!(rows, [0.6, 0.8, 0.0, 1e-8, -1.0, 0.0]);
        for none in [0.0, -0.0, f32::NAN, f32::INFINITY] {
            let mut rows = vec![1.0, 0.0, none, 0.0];
            assert_eq!(to_directions(&mut rows, 2), Err(1), "{none}");
        }
    }

    #[test]
    fn the_approximate_gelu_is_the_definitions_in_f64() {
        let x: Vec<f32> = (-4000..=4000).map(|i| i as f32 / 300.0).collect();
        let mut y = x.clone();
        gelu_tanh(&mut y);
        for (x, y) in x.iter().zip(&y) {
            let v = f64::from(*x);
            let inner = (2.0 / std::f64::consts::PI).sqrt() * (v + 0.044_715 * v.powi(3));
            let want = 0.5 * v * (1.0 + inner.tanh());
            assert!((f64::from(*y) - want).abs() < 2e-6 * v.abs().max(1.0), "{x}: {y} {want}");
        }
        let mut far = [1e30f32, -1e10, 0.0];
        gelu_tanh(&mut far);
        assert_eq!(far, [1e30, 0.0, 0.0]);
        let mut two = [1.0f32];
        gelu_tanh(&mut two);
        // Not the exact one, 0.841345.
        assert!((two[0] - 0.841_192).abs() < 1e-6);
    }
}
