//! How many bits the directions of vectors take: the coding rate.

/// `½ log det(I + scale · Zᵀ Z)` and its gradient to `Z`; `None` where too little is left of the
/// identity beside rows so large that the determinant has no digits.
///
/// The matrix of the smaller side is factorised: `det(I + Zᵀ Z) = det(I + Z Zᵀ)`. So fewer rows than
/// channels, which is what batches have, give a matrix that is as regular as it can be. Its pivots are 1
/// at least; one that is not shows that rounding has won.
///
/// # Shapes
/// `rows`: `[n, width]` · returns a value ≥ 0 and `[n, width]`
pub(super) fn half_log_det(
    rows: &[f64],
    n: usize,
    width: usize,
    scale: f64,
) -> Option<(f64, Vec<f64>)> {
    let small = n.min(width);
    if small == 0 {
        return Some((0.0, vec![0.0; n * width]));
    }
    let mut factor = vec![0.0; small * small];
    if n <= width {
        for i in 0..small {
            for j in 0..=i {
                let (one, other) = (&rows[i * width..][..width], &rows[j * width..][..width]);
                factor[i * small + j] = one.iter().zip(other).map(|(a, b)| a * b).sum();
            }
        }
    } else {
        // Row by row: the matrix stays in the cache, many rows are read once.
        for row in rows.chunks_exact(width) {
            for (i, a) in row.iter().enumerate() {
                let line = &mut factor[i * small..][..=i];
                line.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
            }
        }
    }
    for i in 0..small {
        factor[i * small..][..=i].iter_mut().for_each(|v| *v *= scale);
        factor[i * small + i] += 1.0;
    }
    let value = cholesky(&mut factor, small)?;
    // scale · (I + scale Z Zᵀ)⁻¹ Z, or the same with the inverse on the other side.
    let mut gradient = vec![0.0; n * width];
    let inverse = inverse(&factor, small);
    if n <= width {
        for (to, line) in gradient.chunks_exact_mut(width).zip(inverse.chunks_exact(small)) {
            for (weight, row) in line.iter().zip(rows.chunks_exact(width)) {
                to.iter_mut().zip(row).for_each(|(g, v)| *g += scale * weight * v);
            }
        }
    } else {
        for (to, row) in gradient.chunks_exact_mut(width).zip(rows.chunks_exact(width)) {
            for (v, line) in row.iter().zip(inverse.chunks_exact(small)) {
                to.iter_mut().zip(line).for_each(|(g, weight)| *g += scale * v * weight);
            }
        }
    }
    Some((value, gradient))
}

/// Replaces the lower half of `I + P`, P without negative directions, by its Cholesky factor; gives the
/// sum of the logarithms of the diagonal, or `None` if a pivot is below 1 by more than rounding.
fn cholesky(a: &mut [f64], n: usize) -> Option<f64> {
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..i {
            let inner: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            a[i * n + j] = (a[i * n + j] - inner) / a[j * n + j];
        }
        let inner: f64 = (0..i).map(|k| a[i * n + k] * a[i * n + k]).sum();
        let pivot = a[i * n + i] - inner;
        // A comparison that NaN fails, too.
        if !(pivot > 1.0 - 1e-3 && pivot.is_finite()) {
            return None;
        }
        let root = pivot.max(1.0).sqrt();
        a[i * n + i] = root;
        sum += root.ln();
    }
    Some(sum)
}

/// `(L Lᵀ)⁻¹`, which is symmetric. `[n, n]`
fn inverse(factor: &[f64], n: usize) -> Vec<f64> {
    let mut inverse = vec![0.0; n * n];
    for (i, line) in inverse.chunks_exact_mut(n).enumerate() {
        line[i] = 1.0;
        solve(factor, n, line);
    }
    inverse
}

/// `(L Lᵀ)⁻¹ x`, in place.
fn solve(factor: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let inner: f64 = (0..i).map(|k| factor[i * n + k] * x[k]).sum();
        x[i] = (x[i] - inner) / factor[i * n + i];
    }
    for i in (0..n).rev() {
        let inner: f64 = (i + 1..n).map(|k| factor[k * n + i] * x[k]).sum();
        x[i] = (x[i] - inner) / factor[i * n + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_agree_with_the_determinant_by_hand() {
        // I + ZᵀZ of one row (3, 4): 1 + 25.
        let (value, gradient) = half_log_det(&[3.0, 4.0], 1, 2, 1.0).unwrap();
        assert!((value - 0.5 * 26f64.ln()).abs() < 1e-15);
        assert!((gradient[0] - 3.0 / 26.0).abs() < 1e-15, "{gradient:?}");
        // The same as a column: two rows of one channel.
        let (column, slope) = half_log_det(&[3.0, 4.0], 2, 1, 1.0).unwrap();
        assert_eq!((column, slope), (value, gradient));
        // [[1,0],[0,2],[1,1]]: I + ZᵀZ = [[3,1],[1,6]].
        let (value, _) = half_log_det(&[1.0, 0.0, 0.0, 2.0, 1.0, 1.0], 3, 2, 1.0).unwrap();
        assert!((value - 0.5 * 17f64.ln()).abs() < 1e-15);
    }

    #[test]
    fn hard_input() {
        assert_eq!(half_log_det(&[0.0; 6], 2, 3, 9.0), Some((0.0, vec![0.0; 6])));
        assert_eq!(half_log_det(&[], 0, 3, 1.0), Some((0.0, vec![])));
        // Equal rows: rank 1, however many there are.
        let row = [0.6, 0.8, 0.0];
        let (value, _) = half_log_det(&row.repeat(5), 5, 3, 100.0).unwrap();
        assert!((value - 0.5 * 501f64.ln()).abs() < 1e-12, "{value}");
        // Of two equal rows of 10¹² no digit of the identity is left.
        assert_eq!(half_log_det(&[1e12, 1e12], 2, 1, 1.0).map(|v| v.0), Some(0.5 * 2e24f64.ln()));
        assert_eq!(half_log_det(&[1e12, 1e12, 1e12, 1e12], 2, 2, 1.0), None);
        assert_eq!(half_log_det(&[f64::NAN, 1.0], 1, 2, 1.0), None);
    }
}
