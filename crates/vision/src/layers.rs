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

    fn linear(weight: &[f32], cin: usize, bias: &[f32]) -> Linear {
        let weight = PackedMatrix::from_strided(weight, cin, bias.len(), 1, cin);
        Linear { weight, bias: bias.to_vec() }
    }

    fn near(got: &[f32], want: &[f32]) {
        assert_eq!(got.len(), want.len());
        let off = got.iter().zip(want).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max);
        assert!(off < 1e-5, "{got:?} {want:?}");
    }

    #[test]
    fn layers_by_hand() {
        // Two inputs, three outputs, two rows: 1·1 + 2·2 + 10, 3·1 + 4·2 + 20, −1·1 + 0·2 − 30, …
        let layer = linear(&[1.0, 2.0, 3.0, 4.0, -1.0, 0.0], 2, &[10.0, 20.0, -30.0]);
        let x = [1.0, 2.0, -1.0, 0.5];
        near(&layer.forward(&x), &[15.0, 31.0, -31.0, 10.0, 19.0, -29.0]);
        let skip = [0.5, 0.25, 0.125, 1.0, 2.0, 3.0];
        near(&layer.plus(&x, &skip), &[15.5, 31.25, -30.875, 11.0, 21.0, -26.0]);
        // The values 1, 3 and 8 have the mean 4 and the variance 26/3; with an ε of 1/3 the deviation is 3.
        let norm = Norm { weight: vec![3.0, 6.0, 0.3], bias: vec![1.0, 0.0, -1.0], eps: 1.0 / 3.0 };
        near(&norm.forward(&[1.0, 3.0, 8.0]), &[-2.0, -2.0, -0.6]);
        // A ReLU between layers, none behind the last: (2, −3) → (2, 0) → −2 + 0.5.
        let mlp =
            ReluMlp(vec![linear(&[2.0, -3.0], 1, &[0.0, 0.0]), linear(&[-1.0, 7.0], 2, &[0.5])]);
        near(&mlp.forward(&[1.0, -1.0]), &[-1.5, 21.5]);
        // The exact GELU between: gelu(1) = 0.8413447 and gelu(−1) = −0.1586553.
        let (first, second) =
            (linear(&[1.0, -1.0], 1, &[0.0, 0.0]), linear(&[10.0, 100.0], 2, &[3.0]));
        near(&mlp_gelu(&[1.0], &first, &second, &[0.25]), &[8.413_447 - 15.865_53 + 3.25]);
        let mut all = vec![1.0f32; 40_000];
        gelu(&mut all);
        near(&all, &vec![0.841_344_7; 40_000]);
        let mut sum = [1.0, 2.0];
        add(&mut sum, &[0.5, -3.0]);
        assert_eq!(sum, [1.5, -1.0]);
        assert_eq!(layer.bytes(), layer.weight.bytes());
    }
}
