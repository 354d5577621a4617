//! From gradients of a projected Gaussian to gradients of its mean, quaternion and scales.
//!
//! With `c = r₁ × r₂` for the rows `r₁`, `r₂` of `V = J·R·Rq·diag(s)`, every matrix product that
//! a textbook derivation needs collapses: `Σ′⁻¹V = [ε r₁ + r₂×c ; ε r₂ + c×r₁] / det Σ′`, without the
//! cancellation of `Σ′₂₂ r₁ − Σ′₁₂ r₂`. Neither `Σ` nor its gradient is ever formed.

use scenesplat_scene::vector::{cross, dot, rotation};

/// Gradients of what the projection gives, for one visible Gaussian.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct RowGradient {
    /// Of the picture position. 1/px
    pub mean2d: [f32; 2],
    /// Of the three stored entries of the conic.
    pub conic: [f32; 3],
    /// Of the opacity after compensation.
    pub opacity: f32,
    /// Of the camera-space depth, as blended into a depth picture.
    pub depth: f32,
}

/// What of a view and its settings the chain rule needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lens {
    /// Rotation, world to camera.
    pub rotation: [[f32; 3]; 3],
    /// Translation, world to camera.
    pub translation: [f32; 3],
    /// `fx`, `fy` in px.
    pub focal: [f32; 2],
    /// Lowest and highest tangent of a direction, per axis, that the Jacobian sees.
    pub tangent: [[f32; 2]; 2],
    /// Low-pass variance ε. px²
    pub eps2d: f32,
    /// Lower bound of the antialias factor, if there is one.
    pub floor: Option<f32>,
    /// Whether quaternions are brought to length 1 first.
    pub normalize: bool,
}

/// One Gaussian, as the projection reads it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    /// World-space mean.
    pub mean: [f32; 3],
    /// `wxyz`, any norm.
    pub quat: [f32; 4],
    /// Standard deviations along the axes.
    pub scale: [f32; 3],
    /// Before compensation.
    pub opacity: f32,
}

/// Gradients of one Gaussian's geometry.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct ShapeGradient {
    pub mean: [f32; 3],
    pub quat: [f32; 4],
    pub scale: [f32; 3],
    pub opacity: f32,
}

type Vec3 = [f32; 3];
type Mat3 = [[f32; 3]; 3];

/// `x·a + y·b`
#[inline(always)]
fn combine(x: f32, a: Vec3, y: f32, b: Vec3) -> Vec3 {
    [x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]]
}

/// `Mᵀ·v`
#[inline(always)]
fn transposed_times(m: &Mat3, v: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| m[0][k] * v[0] + m[1][k] * v[1] + m[2][k] * v[2])
}

#[inline(always)]
fn times(m: &Mat3, v: Vec3) -> Vec3 {
    m.map(|row| dot(row, v))
}

/// Gradient of the quaternion that [`rotation`] was given, from that of the matrix.
#[inline(always)]
fn quaternion_gradient([w, x, y, z]: [f32; 4], a: &Mat3) -> [f32; 4] {
    let (d21, d02, d10) = (a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1]);
    let (s10, s20, s21) = (a[1][0] + a[0][1], a[2][0] + a[0][2], a[2][1] + a[1][2]);
    [
        2.0 * (x * d21 + y * d02 + z * d10),
        2.0 * (y * s10 + z * s20 + w * d21 - 2.0 * x * (a[1][1] + a[2][2])),
        2.0 * (x * s10 + z * s21 + w * d02 - 2.0 * y * (a[0][0] + a[2][2])),
        2.0 * (x * s20 + y * s21 + w * d10 - 2.0 * z * (a[0][0] + a[1][1])),
    ]
}

/// The Jacobian of the projection at the clamped direction, and what its gradient needs.
struct Jacobian {
    /// Camera-space mean.
    at: Vec3,
    inverse_z: f32,
    /// Clamped tangents, and whether they are the mean's own.
    tangent: [f32; 2],
    inside: [bool; 2],
    /// Entries `[0][0]`, `[1][1]`.
    diagonal: [f32; 2],
    /// Entries `[0][2]`, `[1][2]`.
    third: [f32; 2],
}

impl Jacobian {
    #[inline(always)]
    fn new(lens: &Lens, mean: Vec3) -> Self {
        let r = times(&lens.rotation, mean);
        let at = [0, 1, 2].map(|i| r[i] + lens.translation[i]);
        let inverse_z = 1.0 / at[2];
        let own = [at[0] * inverse_z, at[1] * inverse_z];
        let tangent = [0, 1].map(|i| own[i].max(lens.tangent[i][0]).min(lens.tangent[i][1]));
        let inside = [0, 1].map(|i| own[i] >= lens.tangent[i][0] && own[i] <= lens.tangent[i][1]);
        let diagonal = [0, 1].map(|i| lens.focal[i] * inverse_z);
        let third = [0, 1].map(|i| -diagonal[i] * tangent[i]);
        Self { at, inverse_z, tangent, inside, diagonal, third }
    }

    /// Rows of `J·m`.
    #[inline(always)]
    fn times(&self, m: &Mat3) -> [Vec3; 2] {
        [0, 1].map(|i| combine(self.diagonal[i], m[i], self.third[i], m[2]))
    }

    /// Adds to the gradient of the camera-space mean what flows through the Jacobian.
    ///
    /// `own` and `third` are the gradients of the entries `[i][i]` and `[i][2]`. The third entry is
    /// `−f·t/z`; outside the limits `t` is a constant, inside it is `x/z`.
    #[inline(always)]
    fn pull_back(&self, lens: &Lens, own: [f32; 2], third: [f32; 2], camera: &mut Vec3) {
        let iz2 = self.inverse_z * self.inverse_z;
        for i in 0..2 {
            let f = lens.focal[i] * iz2;
            let from_third = f * self.tangent[i] * third[i];
            camera[2] -= f * own[i];
            if self.inside[i] {
                camera[i] -= f * third[i];
                camera[2] += 2.0 * from_third;
            } else {
                camera[2] += from_third;
            }
        }
    }
}

/// Gradient with respect to the rows of `V` from that of the conic and of the antialias factor.
#[inline(always)]
fn footprint_gradient(
    lens: &Lens,
    v: [Vec3; 2],
    conic: [f32; 3],
    compensation: Option<(f32, f32)>,
) -> [Vec3; 2] {
    let [r1, r2] = v;
    let c = cross(r1, r2);
    let (det2, n1, n2) = (dot(c, c), dot(r1, r1), dot(r2, r2));
    let eps = lens.eps2d;
    let det = det2 + eps * (n1 + n2) + eps * eps;
    let inverse = 1.0 / det;
    // adj(Σ₂)·V
    let adjoint = [cross(r2, c), cross(c, r1)];
    let whitened = [
        combine(eps * inverse, r1, inverse, adjoint[0]),
        combine(eps * inverse, r2, inverse, adjoint[1]),
    ];
    let [ca, cb, cc] = [(n2 + eps) * inverse, -dot(r1, r2) * inverse, (n1 + eps) * inverse];
    let [ga, gb, gc] = [conic[0], 0.5 * conic[1], conic[2]];
    // −2·Ci·G, by rows
    let m = [
        [-2.0 * (ca * ga + cb * gb), -2.0 * (ca * gb + cb * gc)],
        [-2.0 * (cb * ga + cc * gb), -2.0 * (cb * gb + cc * gc)],
    ];
    let mut out = m.map(|[p, q]| combine(p, whitened[0], q, whitened[1]));
    if let Some((rho, gradient)) = compensation {
        // d(ρ²)/dV = 2·[(det′ − det)·adj(Σ₂) − ε·det·I]·V / det′²
        let k = gradient / rho * inverse;
        let (to_adjoint, to_v) = (k * ((det - det2) * inverse), -k * eps * (det2 * inverse));
        for (out, (adjoint, row)) in out.iter_mut().zip(adjoint.into_iter().zip(v)) {
            let more = combine(to_adjoint, adjoint, to_v, row);
            *out = combine(1.0, *out, 1.0, more);
        }
    }
    out
}

/// Gradients of a Gaussian's geometry from those of its projection.
///
/// `compensation` is the antialias factor that the forward pass used (1 without antialiasing). At
/// its floor no gradient flows through it, as automatic differentiation of a maximum would have it;
/// gsplat's kernel lets one through.
#[inline(always)]
pub(crate) fn pull_back(
    lens: &Lens,
    shape: &Shape,
    compensation: f32,
    row: &RowGradient,
) -> ShapeGradient {
    let squared = shape.quat.iter().map(|q| q * q).sum::<f32>();
    let inverse_norm = if lens.normalize { 1.0 / squared.sqrt() } else { 1.0 };
    let quat = shape.quat.map(|q| q * inverse_norm);
    let own = rotation(quat);
    let jacobian = Jacobian::new(lens, shape.mean);
    // P = J·R, B = P·Rq, V = B·diag(s)
    let p = jacobian.times(&lens.rotation);
    let b = p.map(|row| transposed_times(&own, row));
    let v = b.map(|row| [0, 1, 2].map(|k| row[k] * shape.scale[k]));

    let mut out = ShapeGradient { opacity: row.opacity, ..Default::default() };
    let mut through_factor = None;
    if let Some(floor) = lens.floor {
        out.opacity *= compensation;
        if compensation > floor {
            through_factor = Some((compensation, shape.opacity * row.opacity));
        }
    }
    let of_v = footprint_gradient(lens, v, row.conic, through_factor);
    out.scale = [0, 1, 2].map(|k| of_v[0][k] * b[0][k] + of_v[1][k] * b[1][k]);
    let of_b = of_v.map(|row| [0, 1, 2].map(|k| row[k] * shape.scale[k]));
    let of_own = [0, 1, 2].map(|i| combine(p[0][i], of_b[0], p[1][i], of_b[1]));
    let raw = quaternion_gradient(quat, &of_own);
    out.quat = if lens.normalize {
        let along: f32 = (0..4).map(|i| raw[i] * quat[i]).sum();
        [0, 1, 2, 3].map(|i| (raw[i] - along * quat[i]) * inverse_norm)
    } else {
        raw
    };

    // Rows of the gradient of J: of_b·Rqᵀ·Rᵀ, of which two entries each exist.
    let of_p = of_b.map(|row| times(&own, row));
    let own_entry = [0, 1].map(|i| dot(of_p[i], lens.rotation[i]));
    let third_entry = [0, 1].map(|i| dot(of_p[i], lens.rotation[2]));
    let [u, v] = row.mean2d;
    let of_depth =
        jacobian.diagonal[0] * u * jacobian.at[0] + jacobian.diagonal[1] * v * jacobian.at[1];
    let mut camera = [
        jacobian.diagonal[0] * u,
        jacobian.diagonal[1] * v,
        row.depth - of_depth * jacobian.inverse_z,
    ];
    jacobian.pull_back(lens, own_entry, third_entry, &mut camera);
    out.mean = transposed_times(&lens.rotation, camera);
    out
}
