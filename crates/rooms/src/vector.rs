//! Vectors of three numbers.

pub(crate) use scenesplat_scene::vector::{cross, dot};

pub(crate) type V3 = [f64; 3];

/// Upwards.
pub(crate) const Z: V3 = [0.0, 0.0, 1.0];

pub(crate) fn add(a: V3, b: V3) -> V3 {
    std::array::from_fn(|i| a[i] + b[i])
}

pub(crate) fn sub(a: V3, b: V3) -> V3 {
    std::array::from_fn(|i| a[i] - b[i])
}

pub(crate) fn times(a: V3, by: f64) -> V3 {
    a.map(|v| v * by)
}

/// `a + b · by`
pub(crate) fn add_times(a: V3, b: V3, by: f64) -> V3 {
    std::array::from_fn(|i| a[i] + b[i] * by)
}

pub(crate) fn mix(a: V3, b: V3, share: f64) -> V3 {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * share)
}

pub(crate) fn length(a: V3) -> f64 {
    dot(a, a).sqrt()
}

/// The unit vector of `a`; `or` if `a` has no direction.
pub(crate) fn unit_or(a: V3, or: V3) -> V3 {
    let norm = length(a);
    if norm > 1e-9 { a.map(|v| v / norm) } else { or }
}

/// Two unit vectors that make a right-handed system with a unit vector `w`: `u × v = w`.
pub(crate) fn basis(w: V3) -> [V3; 2] {
    let help = if w[2].abs() < 0.9 { Z } else { [1.0, 0.0, 0.0] };
    let u = unit_or(cross(help, w), [1.0, 0.0, 0.0]);
    [u, cross(w, u)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{direction, sample_rng};

    #[test]
    fn bases_are_right_handed() {
        let mut rng = sample_rng(1, 2, 3);
        for _ in 0..100 {
            let w = direction(&mut rng);
            let [u, v] = basis(w);
            assert!(length(sub(cross(u, v), w)) < 1e-12 && dot(u, v).abs() < 1e-12);
        }
        assert_eq!(unit_or([0.0; 3], Z), Z);
    }
}
