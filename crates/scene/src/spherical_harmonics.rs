//! Real spherical harmonics as splat files use them, and their rotation.

use crate::frame::Matrix3;

/// Highest degree that any format holds.
pub const MAX_DEGREE: usize = 4;

/// Coefficients of the bands 1 to [`MAX_DEGREE`].
const MAX_REST: usize = (MAX_DEGREE + 1) * (MAX_DEGREE + 1) - 1;

/// The basis functions of bands 1 to 4 in direction `d` (unit), from m = −l to l in each band.
///
/// Condon–Shortley signs, as in the original rasterizer: band 1 is `−C1 y, C1 z, −C1 x`.
pub fn rest_basis(d: [f64; 3]) -> [f64; MAX_REST] {
    let [x, y, z] = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let c1 = 0.488_602_511_902_919_9;
    [
        -c1 * y,
        c1 * z,
        -c1 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
        2.503_342_941_796_704_6 * x * y * (xx - yy),
        -1.770_130_769_779_930_4 * y * z * (3.0 * xx - yy),
        0.946_174_695_757_560_1 * x * y * (7.0 * zz - 1.0),
        -0.669_046_543_557_289_2 * y * z * (7.0 * zz - 3.0),
        0.105_785_546_915_204_31 * (zz * (35.0 * zz - 30.0) + 3.0),
        -0.669_046_543_557_289_2 * x * z * (7.0 * zz - 3.0),
        0.473_087_347_878_780_05 * (xx - yy) * (7.0 * zz - 1.0),
        -1.770_130_769_779_930_4 * x * z * (xx - 3.0 * yy),
        0.625_835_735_449_176_1 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)),
    ]
}

/// What a rotation or reflection of the scene does to the coefficients of each band.
#[derive(Debug, Clone)]
pub struct ShRotation {
    /// One square matrix per band, row by row. Band l is `[2l + 1, 2l + 1]`.
    bands: [Vec<f64>; MAX_DEGREE],
}

impl ShRotation {
    /// For the orthogonal matrix `m`: the function that was `f(d)` becomes `f(mᵀ d)`.
    ///
    /// A band of harmonics is closed under rotation, so the new coefficients are those that agree
    /// with the old function in enough directions: a small least-squares problem, solved in f64.
    pub fn new(m: &Matrix3) -> Self {
        let directions = fibonacci_sphere(64);
        let bands = std::array::from_fn(|band| {
            let first = (band + 1) * (band + 1) - 1;
            let size = 2 * band + 3;
            // Normal equations G·X = H with G = ΣYᵀY, H = ΣY(d)ᵀ Y(mᵀd).
            let mut gram = vec![0.0; size * size];
            let mut right = vec![0.0; size * size];
            for &d in &directions {
                let back = [0, 1, 2].map(|j| m[0][j] * d[0] + m[1][j] * d[1] + m[2][j] * d[2]);
                let (here, there) = (rest_basis(d), rest_basis(back));
                let (here, there) = (&here[first..first + size], &there[first..first + size]);
                for i in 0..size {
                    for j in 0..size {
                        gram[i * size + j] += here[i] * here[j];
                        right[i * size + j] += here[i] * there[j];
                    }
                }
            }
            let mut solved = solve(gram, right, size);
            for value in &mut solved {
                // Axis flips and swaps are made of −1, 0 and 1; rounding must not blur them.
                let nearest = value.round();
                if (*value - nearest).abs() < 1e-12 {
                    *value = nearest;
                }
            }
            solved
        });
        Self { bands }
    }

    /// Rotates the coefficients of one Gaussian, `[K, 3]` with K of degree `degree`.
    pub fn apply(&self, rest: &mut [f32]) {
        let mut first = 0;
        for matrix in &self.bands {
            let size = matrix.len().isqrt();
            let Some(band) = rest.get_mut(first * 3..(first + size) * 3) else { return };
            let mut out = [0.0f64; (2 * MAX_DEGREE + 1) * 3];
            for i in 0..size {
                for j in 0..size {
                    let factor = matrix[i * size + j];
                    if factor != 0.0 {
                        for c in 0..3 {
                            out[i * 3 + c] += factor * f64::from(band[j * 3 + c]);
                        }
                    }
                }
            }
            for (value, new) in band.iter_mut().zip(out) {
                *value = new as f32;
            }
            first += size;
        }
    }
}

/// Nearly even directions, none of them special to any axis.
fn fibonacci_sphere(count: usize) -> Vec<[f64; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let r = (1.0 - z * z).sqrt();
            let angle = golden * i as f64 + 0.3;
            [r * angle.cos(), r * angle.sin(), z]
        })
        .collect()
}

/// Solves `a · x = b` for square matrices by elimination with pivots; `a` is well conditioned.
fn solve(mut a: Vec<f64>, mut b: Vec<f64>, n: usize) -> Vec<f64> {
    for col in 0..n {
        let pivot = (col..n).max_by(|&i, &j| a[i * n + col].abs().total_cmp(&a[j * n + col].abs()));
        let pivot = pivot.unwrap_or(col);
        for j in 0..n {
            a.swap(col * n + j, pivot * n + j);
            b.swap(col * n + j, pivot * n + j);
        }
        let inverse = 1.0 / a[col * n + col];
        for i in (0..n).filter(|&i| i != col) {
            let factor = a[i * n + col] * inverse;
            for j in 0..n {
                a[i * n + j] -= factor * a[col * n + j];
                b[i * n + j] -= factor * b[col * n + j];
            }
        }
    }
    for i in 0..n {
        let inverse = 1.0 / a[i * n + i];
        b[i * n..(i + 1) * n].iter_mut().for_each(|v| *v *= inverse);
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;

    fn rotation(axis: [f64; 3], angle: f64) -> Matrix3 {
        let [x, y, z] = axis;
        let (s, c) = angle.sin_cos();
        let t = 1.0 - c;
        [
            [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
            [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
            [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
        ]
    }

    #[test]
    fn the_basis_is_orthonormal() {
        // A fine even sampling integrates products of degree 8 to far below the tolerance.
        let directions = fibonacci_sphere(200_000);
        let weight = 4.0 * std::f64::consts::PI / directions.len() as f64;
        let mut gram = [[0.0; MAX_REST]; MAX_REST];
        for &d in &directions {
            let y = rest_basis(d);
            for i in 0..MAX_REST {
                for j in 0..MAX_REST {
                    gram[i][j] += y[i] * y[j] * weight;
                }
            }
        }
        for i in 0..MAX_REST {
            for j in 0..MAX_REST {
                let due = if i == j { 1.0 } else { 0.0 };
                assert!((gram[i][j] - due).abs() < 1e-6, "{i} {j} {}", gram[i][j]);
            }
        }
    }

    #[test]
    fn a_rotated_function_is_the_old_one_seen_from_the_old_direction() {
        let s = 1.0 / 3f64.sqrt();
        let mirror = Frame::CANONICAL.matrix_to("LDF".parse().unwrap());
        for m in [rotation([s, s, s], 0.7), rotation([0.0, 0.6, 0.8], -2.9), mirror] {
            let rotate = ShRotation::new(&m);
            let old: Vec<f32> = (0..MAX_REST * 3).map(|i| ((i * 37 % 19) as f32) - 9.0).collect();
            let mut new = old.clone();
            rotate.apply(&mut new);
            for d in fibonacci_sphere(33) {
                let back = [0, 1, 2].map(|j| m[0][j] * d[0] + m[1][j] * d[1] + m[2][j] * d[2]);
                let value = |basis: [f64; MAX_REST], rest: &[f32]| -> f64 {
                    basis.iter().zip(rest.chunks(3)).map(|(b, c)| b * f64::from(c[1])).sum()
                };
                let (a, b) = (value(rest_basis(d), &new), value(rest_basis(back), &old));
                assert!((a - b).abs() < 2e-5, "{a} {b}");
            }
        }
    }

    #[test]
    fn axis_flips_are_signs() {
        let flip = Frame::CANONICAL.matrix_to(Frame::RUB);
        let mut rest: Vec<f32> = (0..MAX_REST * 3).map(|i| 0.1 + i as f32).collect();
        let before = rest.clone();
        ShRotation::new(&flip).apply(&mut rest);
        let signs = "--+-++-+-+--+-+";
        for (k, sign) in signs.chars().enumerate() {
            let due = if sign == '+' { before[k * 3] } else { -before[k * 3] };
            assert_eq!(rest[k * 3], due, "coefficient {k}");
        }
    }

    #[test]
    fn lower_degrees_are_rotated_alike() {
        let m = rotation([0.0, 0.0, 1.0], 1.0);
        let rotate = ShRotation::new(&m);
        let full: Vec<f32> = (0..MAX_REST * 3).map(|i| (i as f32).sin()).collect();
        let mut all = full.clone();
        rotate.apply(&mut all);
        for degree in 0..=4usize {
            let k = (degree + 1) * (degree + 1) - 1;
            let mut some = full[..k * 3].to_vec();
            rotate.apply(&mut some);
            assert_eq!(some, all[..k * 3]);
        }
    }
}
