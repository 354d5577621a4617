//! Products of vectors of three numbers, and the matrix of a quaternion.
//!
//! One place for all crates of the workspace, on arrays as scenes hold them, in f32 and f64. Every sum
//! has the order written here: results of whole programs depend on it to the last bit.

use std::ops::{Add, Mul, Sub};

/// `a · b`, added from the first to the last.
#[inline(always)]
pub fn dot<T: Copy + Add<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`
#[inline(always)]
pub fn cross<T: Copy + Sub<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The rotation matrix, rows first, of a quaternion `w, x, y, z` of norm 1.
///
/// With another norm it is none: the matrix then is that of `1 − 2(y² + z²)` and so on all the same, as
/// renderers without normalization have it.
#[inline(always)]
pub fn rotation<T>([w, x, y, z]: [T; 4]) -> [[T; 3]; 3]
where
    T: Copy + From<u8> + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let (one, two) = (T::from(1), T::from(2));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_by_hand() {
        assert_eq!(dot([1.0, 2.0, 3.0], [4.0, -5.0, 6.0]), 12.0);
        assert_eq!(cross([1.0f32, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_eq!(cross([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]), [-3.0, 6.0, -3.0]);
    }

    #[test]
    fn rotations_by_hand() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn about z takes x to y.
        let m = rotation([half, 0.0, 0.0, half]);
        let turned = m.map(|row| dot(row, [1.0, 0.0, 0.0]));
        for (got, want) in turned.into_iter().zip([0.0, 1.0, 0.0]) {
            assert!((got - want).abs() < 1e-15, "{m:?}");
        }
        assert_eq!(rotation([1.0f32, 0.0, 0.0, 0.0])[1], [0.0, 1.0, 0.0]);
        // A half turn, w = 0.
        assert_eq!(rotation([0.0, 1.0, 0.0, 0.0])[2], [0.0, 0.0, -1.0]);
    }
}
