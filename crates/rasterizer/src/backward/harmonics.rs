//! From the gradient of a Gaussian's color to those of its harmonics and of the direction that it
//! is seen from.

use crate::spherical_harmonics::basis;

// Normalization constants, as gsplat rounds them (1.6.0, 90d7b4b).
const P: f32 = 0.488_602_52;
const Q: f32 = 0.546_274_2;
const R: f32 = -1.092_548_5;
const E: f32 = -0.590_043_6;
const F: f32 = 1.445_305_7;
const KZ: f32 = -2.285_229;
const KO: f32 = 0.457_045_8;
const Z3: f32 = 1.865_881_7;
const Z1: f32 = 1.119_529;

/// `Σ_k t_k ∇B_k`, the coordinates of the direction being independent.
#[inline(always)]
fn slope<const K: usize>([x, y, z]: [f32; 3], t: &[f32; K]) -> [f32; 3] {
    let mut g = [0.0f32; 3];
    if K >= 4 {
        g = [-P * t[3], -P * t[1], P * t[2]];
    }
    if K >= 9 {
        g[0] += 2.0 * Q * (y * t[4] + x * t[8]) + R * z * t[7];
        g[1] += 2.0 * Q * (x * t[4] - y * t[8]) + R * z * t[5];
        g[2] += R * (y * t[5] + x * t[7]) + 2.0 * 0.946_174_7 * z * t[6];
    }
    if K >= 16 {
        let (zz, c1, s1) = (z * z, x * x - y * y, 2.0 * x * y);
        let (k, dk) = (KZ * zz + KO, 2.0 * KZ * z);
        // ∂S2 = 3·(S1, C1), ∂C2 = 3·(C1, −S1)
        g[0] +=
            3.0 * E * (s1 * t[9] + c1 * t[15]) + 2.0 * F * z * (y * t[10] + x * t[14]) + k * t[13];
        g[1] +=
            3.0 * E * (c1 * t[9] - s1 * t[15]) + 2.0 * F * z * (x * t[10] - y * t[14]) + k * t[11];
        g[2] += F * (s1 * t[10] + c1 * t[14])
            + dk * (y * t[11] + x * t[13])
            + (3.0 * Z3 * zz - Z1) * t[12];
    }
    g
}

/// Which of the gradients of a color are wanted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub harmonics: bool,
    pub direction: bool,
}

/// Adds the gradients of one Gaussian's first `K` harmonics to `of_sh` (`[K or more, 3]`), and
/// gives back that of its mean.
///
/// `to` goes from the camera to the mean. A channel whose value before the clamp is below 0 has no
/// gradient; at exactly 0 it has one (as a clamp in PyTorch), so that a black Gaussian can learn.
#[inline(always)]
fn pull_back_at<const K: usize>(
    sh: &[f32],
    to: [f32; 3],
    of_color: [f32; 3],
    wanted: Wanted,
    of_sh: &mut [f32],
) -> [f32; 3] {
    let squared = to[0] * to[0] + to[1] * to[1] + to[2] * to[2];
    let inverse = if squared > 0.0 { 1.0 / squared.sqrt() } else { 0.0 };
    let direction = to.map(|v| v * inverse);
    let basis = basis::<K>(to);
    let mut color = [0.5f32; 3];
    for k in 0..K {
        for ch in 0..3 {
            color[ch] += basis[k] * sh[3 * k + ch];
        }
    }
    let v = [0, 1, 2].map(|ch| if color[ch] >= 0.0 { of_color[ch] } else { 0.0 });
    if wanted.harmonics {
        for k in 0..K {
            for ch in 0..3 {
                of_sh[3 * k + ch] += basis[k] * v[ch];
            }
        }
    }
    if K == 1 || !wanted.direction {
        return [0.0; 3];
    }
    let mut t = [0.0f32; K];
    for k in 1..K {
        t[k] = v[0] * sh[3 * k] + v[1] * sh[3 * k + 1] + v[2] * sh[3 * k + 2];
    }
    let slope = slope::<K>(direction, &t);
    let along = slope[0] * direction[0] + slope[1] * direction[1] + slope[2] * direction[2];
    [0, 1, 2].map(|i| (slope[i] - along * direction[i]) * inverse)
}

/// [`pull_back_at`] of the degree.
#[inline]
pub(crate) fn pull_back(
    degree: u8,
    sh: &[f32],
    to: [f32; 3],
    of_color: [f32; 3],
    wanted: Wanted,
    of_sh: &mut [f32],
) -> [f32; 3] {
    match degree {
        0 => pull_back_at::<1>(sh, to, of_color, wanted, of_sh),
        1 => pull_back_at::<4>(sh, to, of_color, wanted, of_sh),
        2 => pull_back_at::<9>(sh, to, of_color, wanted, of_sh),
        _ => pull_back_at::<16>(sh, to, of_color, wanted, of_sh),
    }
}
