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
    let at = |i: usize, k: usize| rows[i * width + k];
    let small = n.min(width);
    let mut factor = vec![0.0; small * small];
    for i in 0..small {
        for j in 0..=i {
            let sum: f64 = if n <= width {
                (0..width).map(|k| at(i, k) * at(j, k)).sum()
            } else {
                (0..n).map(|k| at(k, i) * at(k, j)).sum()
            };
            factor[i * small + j] = scale * sum + f64::from(u8::from(i == j));
        }
    }
    let value = cholesky(&mut factor, small)?;
    // scale · (I + scale Z Zᵀ)⁻¹ Z, or the same with the inverse on the other side.
    let mut gradient = vec![0.0; n * width];
    let mut solution = vec![0.0; small];
    let (lines, stride, step) = if n <= width { (width, 1, width) } else { (n, width, 1) };
    for line in 0..lines {
        let place = |i: usize| line * stride + i * step;
        for (i, x) in solution.iter_mut().enumerate() {
            *x = scale * rows[place(i)];
        }
        solve(&factor, small, &mut solution);
        for (i, x) in solution.iter().enumerate() {
            gradient[place(i)] = *x;
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
