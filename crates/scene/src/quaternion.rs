//! Turns as unit quaternions `w, x, y, z`.

use crate::frame::transposed;
use crate::similarity::matrix_to_quat;
use crate::vector::{cross, dot, rotation};

/// The unit quaternion `w, x, y, z` that turns +z to a unit vector by the shortest way.
pub fn quat_from_z_to([x, y, z]: [f64; 3]) -> [f64; 4] {
    let w = 1.0 + z;
    if w < 1e-9 {
        // Half a turn about any horizontal axis.
        return [0.0, 1.0, 0.0, 0.0];
    }
    let norm = (w * w + x * x + y * y).sqrt();
    [w / norm, -y / norm, x / norm, 0.0]
}

/// The axes from the shortest to the longest; of equals the first of the three comes first.
pub(crate) fn axes_by_size(size: [f32; 3]) -> [usize; 3] {
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| size[a].total_cmp(&size[b]));
    order
}

/// Which way the first of the ways to write an ellipsoid looks: any direction, far from the axes.
const SIDE: [f64; 3] = [0.5, 0.4, 0.77];

/// One of the 24 ways to write an ellipsoid as sizes and quaternion `w, x, y, z` (`w ≥ 0`), drawn by its look and
/// the ratios of its sizes, and thus the same whichever of the 24 is given, and in any place and unit.
///
/// Scenes spell ellipsoids by the habit of what made them, near the identity or not; a network that
/// was trained on all spellings reads this one as it has learned to. A fixed choice, such as normals
/// that all look up, would be another habit.
///
/// A quaternion without length, and sizes that are not numbers, come back as they are. Axes of equal
/// length keep their order, so that spellings of a disc or a ball stay several.
///
/// # Shapes
/// - `scale`: standard deviations along the principal axes, any unit
/// - `look`: color and opacity, any range: what a Gaussian keeps wherever it lies
pub fn drawn_axes(scale: [f32; 3], quat: [f32; 4], look: [f32; 4]) -> ([f32; 3], [f32; 4]) {
    let q = quat.map(f64::from);
    let squared = q.iter().map(|v| v * v).sum::<f64>();
    if !(squared.is_finite() && squared > 0.0) || scale.iter().any(|s| s.is_nan()) {
        return (scale, quat);
    }
    let norm = squared.sqrt();
    let columns = transposed(&rotation(q.map(|v| v / norm)));
    // One of the 24 first, the same for all: sizes ascending, the first two axes to one side.
    let order = axes_by_size(scale);
    let to_side = |v: [f64; 3]| if dot(v, SIDE) < 0.0 { v.map(|c| -c) } else { v };
    let [first, second] = [0, 1].map(|k| to_side(columns[order[k]]));
    let axes = [first, second, cross(first, second)];
    let sizes = order.map(|k| scale[k]);
    // Which of them: by what neither a spelling nor a pose changes, and rounding hardly ever: ratios to one part in
    // a thousand.
    let rough = [1, 2].map(|k| sizes[k] / sizes[0]).map(|ratio| {
        if ratio.is_finite() { u64::from(ratio.to_bits().saturating_add(1 << 12) >> 13) } else { 0 }
    });
    let looks = look.map(|v| u64::from(v.to_bits()));
    let bits = rough.into_iter().chain(looks).fold(0x9e37_79b9_7f4a_7c15_u64, |hash, v| {
        let mixed = (hash ^ v).wrapping_mul(0xd134_2543_de82_ef95);
        mixed ^ (mixed >> 29)
    });
    let draw = (bits >> 33) % 24;
    let (shift, way) = ((draw % 3) as usize, draw / 3);
    let (is_swapped, signs) = (way >= 4, way % 4);
    let mut picked = [shift, (shift + 1) % 3, (shift + 2) % 3];
    if is_swapped {
        picked.swap(0, 1);
    }
    // Two axes turned round, or none; an exchange is made a rotation by turning round the third as well.
    let sign = |k: usize| {
        let is_turned = match signs {
            0 => false,
            1 => k != 2,
            2 => k != 1,
            _ => k != 0,
        };
        if is_turned != (is_swapped && k == 2) { -1.0 } else { 1.0 }
    };
    let turned = [0, 1, 2].map(|k| axes[picked[k]].map(|c| sign(k) * c));
    let quat = one_sign(matrix_to_quat(&transposed(&turned)));
    (picked.map(|k| sizes[k]), quat.map(|v| v as f32))
}

/// Of the two signs of a unit quaternion the one with `w ≥ 0`; of half a turn, where `w` is 0 but for a fifth of a
/// degree, the one whose first large component is positive, so that rounding does not decide.
fn one_sign(quat: [f64; 4]) -> [f64; 4] {
    const HALF_TURN: f64 = 2e-3;
    // The largest component of half a turn is at least √⅓; of as large ones the first counts.
    const LARGE: f64 = 0.9;
    let most = quat.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let first = quat.iter().find(|v| v.abs() >= LARGE * most).copied().unwrap_or(1.0);
    let decides = if quat[0].abs() < HALF_TURN { first } else { quat[0] };
    if decides < 0.0 { quat.map(|v| -v) } else { quat }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::similarity::quat_product;

    /// All 24 ways to write an ellipsoid.
    fn spellings(scale: [f32; 3], quat: [f32; 4]) -> Vec<([f32; 3], [f32; 4])> {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let mut all = vec![(scale, quat)];
        // Quarter turns about x and z reach all.
        let turns = [([half, half, 0.0, 0.0], [0, 2, 1]), ([half, 0.0, 0.0, half], [1, 0, 2])];
        let mut next = 0;
        while next < all.len() {
            let (scale, quat) = all[next];
            for (turn, order) in turns {
                let turned = quat_product(quat.map(f64::from), turn.map(|v| v as f32));
                let new = (order.map(|i| scale[i]), turned);
                let same = |old: &([f32; 3], [f32; 4])| {
                    let near: f32 = (0..4).map(|i| old.1[i] * new.1[i]).sum();
                    near.abs() > 0.999
                };
                if !all.iter().any(same) {
                    all.push(new);
                }
            }
            next += 1;
        }
        all
    }

    /// R·diag(s²)·Rᵀ
    fn covariance(scale: [f32; 3], quat: [f32; 4]) -> [[f64; 3]; 3] {
        let m = rotation(quat.map(f64::from));
        let s = scale.map(|s| f64::from(s * s));
        [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| m[i][k] * s[k] * m[j][k]).sum()))
    }

    #[test]
    fn all_spellings_of_an_ellipsoid_become_one() {
        let quats = [[0.9, 0.1, -0.3, 0.2], [0.1, 0.7, 0.5, -0.4], [-0.3, 0.2, 0.8, 0.4]];
        for (i, quat) in quats.into_iter().enumerate() {
            let quat = quat_product([1.0, 0.0, 0.0, 0.0], quat);
            let (scale, look) = ([0.3, 0.02, 0.1], [1.0, i as f32, -0.4, 0.9]);
            let all = spellings(scale, quat);
            assert_eq!(all.len(), 24);
            let (due_scale, due) = drawn_axes(scale, quat, look);
            assert!(due[0] >= -2e-3);
            for (scale, quat) in all {
                let (found_scale, found) = drawn_axes(scale, quat, look);
                assert_eq!(found_scale, due_scale);
                assert!((0..4).all(|i| (found[i] - due[i]).abs() < 1e-5), "{found:?} {due:?}");
                let (a, b) = (covariance(scale, quat), covariance(found_scale, found));
                assert!((0..9).all(|i| (a[i / 3][i % 3] - b[i / 3][i % 3]).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn a_small_turn_changes_a_quaternion_little() {
        let angle = 1e-4f64;
        let small = [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()];
        for i in 0..200u16 {
            let look = [f32::from(i), 1.0, 2.0, 1.0];
            // Along the axes, where many spellings are half a turn.
            let (_, due) = drawn_axes([0.3, 0.02, 0.1], [1.0, 0.0, 0.0, 0.0], look);
            for turn in [small, [small[0], 0.0, 0.0, -small[3]]] {
                let quat = quat_product(turn, [1.0, 0.0, 0.0, 0.0]);
                let (_, found) = drawn_axes([0.3, 0.02, 0.1], quat, look);
                assert!((0..4).all(|k| (found[k] - due[k]).abs() < 1e-3), "{found:?} {due:?}");
            }
        }
    }

    #[test]
    fn each_spelling_is_drawn_about_as_often() {
        let (scale, quat) =
            ([0.3, 0.02, 0.1], quat_product([1.0, 0.0, 0.0, 0.0], [0.9, 0.1, -0.3, 0.2]));
        let mut counts = [0u32; 24];
        let all = spellings(scale, quat);
        for i in 0..2400u16 {
            let (_, found) =
                drawn_axes(scale, quat, [f32::from(i % 256), f32::from(i / 256), 2.0, 1.0]);
            let same = |s: &([f32; 3], [f32; 4])| {
                (0..4).map(|k| s.1[k] * found[k]).sum::<f32>().abs() > 0.999
            };
            counts[all.iter().position(same).expect("one of the 24")] += 1;
        }
        assert!(counts.iter().all(|n| (60..=140).contains(n)), "{counts:?}");
    }

    #[test]
    fn another_unit_hardly_ever_draws_another_one() {
        let quat = quat_product([1.0, 0.0, 0.0, 0.0], [0.9, 0.1, -0.3, 0.2]);
        for unit in [0.3048, 1.0 / 0.3048, 1000.0] {
            let changed = (0..2000u16).filter(|i| {
                let x = 0.0037 * f32::from(*i);
                let (scale, look) = ([0.31 + 0.01 * x, 0.021, 0.1], [x, 1.3 - x, 0.7 * x, 1.0]);
                let (_, a) = drawn_axes(scale, quat, look);
                let (_, b) = drawn_axes(scale.map(|s| unit * s), quat, look);
                (0..4).any(|k| (a[k] - b[k]).abs() > 1e-3)
            });
            assert!(changed.count() < 20);
        }
    }

    #[test]
    fn what_is_no_ellipsoid_comes_back() {
        for (scale, quat) in [([1.0; 3], [0.0; 4]), ([1.0; 3], [f32::INFINITY, 0.0, 0.0, 0.0])] {
            assert_eq!(drawn_axes(scale, quat, [0.0; 4]), (scale, quat));
        }
        let (scale, quat) = drawn_axes([f32::NAN, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.0; 4]);
        assert!(scale[0].is_nan() && quat == [1.0, 0.0, 0.0, 0.0]);
        assert!(drawn_axes([1.0; 3], [f32::NAN; 4], [0.0; 4]).1[0].is_nan());
    }
}
