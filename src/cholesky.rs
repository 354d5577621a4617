//! The Cholesky factor of a positive definite matrix.

/// The lower factor L of a matrix L·Lᵀ, of which the lower half is given; above the diagonal it is 0. `[n, n]`
pub(crate) fn factor(matrix: &[f64], n: usize) -> Vec<f64> {
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| factor[i * n + k] * factor[j * n + k]).sum();
            let rest = matrix[i * n + j] - dot;
            factor[i * n + j] =
                if i == j { rest.max(1e-12).sqrt() } else { rest / factor[j * n + j] };
        }
    }
    factor
}
