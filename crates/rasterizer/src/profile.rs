//! What is in a scene that a renderer could leave out: found in one parallel pass over its values.

use crate::Gaussians;
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;
use serde::{Deserialize, Serialize};

/// Opacity below which a Gaussian is never drawn, with every preset.
pub const FAINT: f32 = 1.0 / 255.0;

/// A color change up to half a step of a byte is none.
pub const HARMONICS_LIMIT: f32 = 1.0 / 512.0;

/// Rows of one task; fixed, so that the result does not depend on the number of threads.
const BLOCK: usize = 8192;
/// Rows of the probe that may settle which bands are needed.
const PROBE: usize = 4096;
/// Squared norm below which a quaternion has no direction, as in projection.
const MIN_QUAT: f32 = 1e-12;
/// Largest absolute value over the sphere of each basis function of the bands 1 to 3, rounded up.
const BASIS_MAX: [f32; 15] = [
    0.488_603, 0.488_603, 0.488_603, // band 1
    0.546_275, 0.546_275, 0.630_784, 0.546_275, 0.546_275, // band 2
    0.590_044, 0.556_299, 0.629_390, 0.746_353, 0.629_390, 0.556_299, 0.590_044, // band 3
];

/// How much the higher bands of the harmonics can change a color.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HarmonicsProfile {
    /// Degree that is stored.
    pub degree: u8,
    /// `tail[L]`: no color channel of a drawable Gaussian changes by more if the bands above `L`
    /// are left out; infinite where a coefficient is not finite. A lower bound of it where
    /// `rows < ` all of them.
    pub tail: [f32; 4],
    /// Rows read: all, or fewer if they already need every band.
    pub rows: usize,
    /// A row for which the last entry of `tail` above 0 was reached.
    pub witness: Option<u32>,
}

/// What is in a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneProfile {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Center, quaternion, scale or opacity is NaN or infinite: never drawn.
    pub not_finite: usize,
    /// Opacity below [`FAINT`]: never drawn.
    pub faint: usize,
    /// The others: may be drawn. What follows is about them.
    pub drawable: usize,
    /// Quaternions without a direction; not drawn unless rotations do not matter.
    pub no_direction: usize,
    /// Quaternions that rotate by nothing.
    pub unrotated: usize,
    /// Largest `|‖q‖² − 1|`.
    pub quat_off_unit: f32,
    /// Largest ratio of two scales of a Gaussian, minus 1; 0 if all are spheres.
    pub anisotropy: f32,
    /// Smallest scale, units of the world; infinite without a drawable Gaussian.
    pub scale_min: f32,
    /// Largest scale, units of the world.
    pub scale_max: f32,
    /// Largest scale of each Gaussian by octave: bin `b` holds `2^(b−24) ≤ s < 2^(b−23)`, the
    /// first and the last also what is beyond.
    pub scale_histogram: [usize; 32],
    /// Largest opacity.
    pub opacity_max: f32,
    /// Opacities by tenths.
    pub opacity_histogram: [usize; 10],
    /// The harmonics.
    pub harmonics: HarmonicsProfile,
}

impl SceneProfile {
    /// Reads every Gaussian once.
    ///
    /// The harmonics are most of the bytes of a scene. A probe of up to 4096 evenly spread rows comes
    /// first; as soon as one of them needs every band, the others need not be read.
    ///
    /// # Errors
    /// If the arrays do not have one row per Gaussian, as [`Gaussians::check`].
    pub fn scan(gaussians: &Gaussians) -> Result<Self, crate::RasterError> {
        gaussians.check()?;
        let n = gaussians.len();
        let blocks: Vec<Self> = (0..n.div_ceil(BLOCK))
            .into_par_iter()
            .map(|b| Self::of(gaussians, b * BLOCK..((b + 1) * BLOCK).min(n)))
            .collect();
        let found = blocks.iter().fold(Self::none(), Self::join);
        let drawable = n - found.not_finite - found.faint;
        Ok(Self { gaussians: n, drawable, harmonics: scan_harmonics(gaussians), ..found })
    }

    /// Whether all drawable Gaussians are spheres to within `tolerance` of their radius.
    pub fn is_isotropic(&self, tolerance: f32) -> bool {
        self.anisotropy <= tolerance
    }
}

impl SceneProfile {
    /// Of no Gaussian.
    fn none() -> Self {
        Self {
            gaussians: 0,
            not_finite: 0,
            faint: 0,
            drawable: 0,
            no_direction: 0,
            unrotated: 0,
            quat_off_unit: 0.0,
            anisotropy: 0.0,
            scale_min: f32::INFINITY,
            scale_max: 0.0,
            scale_histogram: [0; 32],
            opacity_max: 0.0,
            opacity_histogram: [0; 10],
            harmonics: HarmonicsProfile { degree: 0, tail: [0.0; 4], rows: 0, witness: None },
        }
    }

    /// Of a block of rows, without their number and harmonics.
    fn of(gaussians: &Gaussians, rows: std::ops::Range<usize>) -> Self {
        let mut found = Self::none();
        let (means, quats) = (&gaussians.means[rows.clone()], &gaussians.quats[rows.clone()]);
        let (scales, opacities) = (&gaussians.scales[rows.clone()], &gaussians.opacities[rows]);
        compiled(
            #[inline(always)]
            || add_rows(&mut found, means, quats, scales, opacities),
        );
        found
    }

    /// Adds another block; no order changes the result.
    fn join(mut self, other: &Self) -> Self {
        self.not_finite += other.not_finite;
        self.faint += other.faint;
        self.no_direction += other.no_direction;
        self.unrotated += other.unrotated;
        self.quat_off_unit = self.quat_off_unit.max(other.quat_off_unit);
        self.anisotropy = self.anisotropy.max(other.anisotropy);
        self.scale_min = self.scale_min.min(other.scale_min);
        self.scale_max = self.scale_max.max(other.scale_max);
        self.opacity_max = self.opacity_max.max(other.opacity_max);
        for (a, b) in self.scale_histogram.iter_mut().zip(other.scale_histogram) {
            *a += b;
        }
        for (a, b) in self.opacity_histogram.iter_mut().zip(other.opacity_histogram) {
            *a += b;
        }
        self
    }
}

/// Rows side by side.
const LANES: usize = 16;
/// Bits of a row's kind.
const COUNTS: u32 = 1;
const NOT_FINITE: u32 = 2;
const NO_DIRECTION: u32 = 4;
const UNROTATED: u32 = 8;

/// What can be said of rows without branches.
#[derive(Default)]
struct SixteenRows {
    kind: [u32; LANES],
    /// Largest scale.
    largest: [f32; LANES],
}

impl SixteenRows {
    #[inline(always)]
    fn look(
        &mut self,
        most: &mut Extremes,
        means: &[[f32; 3]],
        quats: &[[f32; 4]],
        scales: &[[f32; 3]],
        opacities: &[f32],
    ) {
        for i in 0..LANES {
            let ([x, y, z], [qw, qx, qy, qz]) = (means[i], quats[i]);
            let ([a, b, c], opacity) = (scales[i], opacities[i]);
            // Finite numbers times 0 are 0; everything else is NaN.
            let centre = 0.0 * x + 0.0 * y + 0.0 * z;
            let turn = 0.0 * qw + 0.0 * qx + 0.0 * qy + 0.0 * qz;
            let size = 0.0 * a + 0.0 * b + 0.0 * c;
            let finite = (centre + turn + size) + 0.0 * opacity == 0.0;
            let counts = finite & (opacity >= FAINT);
            let norm = qw * qw + qx * qx + qy * qy + qz * qz;
            let [a, b, c] = [a.abs(), b.abs(), c.abs()];
            let smaller = |a: f32, b: f32| if a < b { a } else { b };
            let larger = |a: f32, b: f32| if a > b { a } else { b };
            let (low, top) = (smaller(smaller(a, b), c), larger(larger(a, b), c));
            // Zero scales are equal to each other.
            let excess = if top == low { 0.0 } else { (top - low) / low };
            let only = |v: f32| if counts { v } else { 0.0 };
            let off = only((norm - 1.0).abs());
            most.quat_off_unit[i] = larger(off, most.quat_off_unit[i]);
            most.anisotropy[i] = larger(only(excess), most.anisotropy[i]);
            most.scale_max[i] = larger(only(top), most.scale_max[i]);
            most.opacity_max[i] = larger(only(opacity), most.opacity_max[i]);
            let least = if counts { low } else { f32::INFINITY };
            most.scale_min[i] = smaller(least, most.scale_min[i]);
            self.largest[i] = top;
            let still = (qx == 0.0) & (qy == 0.0) & (qz == 0.0);
            let bit = |is: bool, bit: u32| if is { bit } else { 0 };
            self.kind[i] = bit(counts, COUNTS)
                | bit(!finite, NOT_FINITE)
                | bit(norm < MIN_QUAT, NO_DIRECTION)
                | bit(still, UNROTATED);
        }
    }
}

/// Adds rows.
#[inline(always)]
fn add_rows(
    found: &mut SceneProfile,
    means: &[[f32; 3]],
    quats: &[[f32; 4]],
    scales: &[[f32; 3]],
    opacities: &[f32],
) {
    let mut most = Extremes::none();
    let blocks = means.chunks(LANES).zip(quats.chunks(LANES)).zip(scales.chunks(LANES));
    for (((means, quats), scales), opacities) in blocks.zip(opacities.chunks(LANES)) {
        let n = opacities.len();
        let mut rows = SixteenRows::default();
        if n == LANES {
            // A length that the compiler knows.
            rows.look(&mut most, &means[..LANES], &quats[..LANES], &scales[..LANES], opacities);
        } else {
            let (mut m, mut q) = ([[0.0; 3]; LANES], [[0.0; 4]; LANES]);
            let (mut s, mut o) = ([[0.0; 3]; LANES], [0.0; LANES]);
            m[..n].copy_from_slice(means);
            q[..n].copy_from_slice(quats);
            s[..n].copy_from_slice(scales);
            o[..n].copy_from_slice(opacities);
            rows.look(&mut most, &m, &q, &s, &o);
        }
        for i in 0..n {
            let kind = rows.kind[i];
            if kind & COUNTS == 0 {
                let lost = kind & NOT_FINITE > 0;
                *if lost { &mut found.not_finite } else { &mut found.faint } += 1;
                continue;
            }
            found.no_direction += usize::from(kind & NO_DIRECTION > 0);
            found.unrotated += usize::from(kind & UNROTATED > 0);
            // The exponent of a float is its octave.
            let octave = (rows.largest[i].to_bits() >> 23) as i32 - 127;
            found.scale_histogram[(octave + 24).clamp(0, 31) as usize] += 1;
            found.opacity_histogram[((opacities[i] * 10.0) as usize).min(9)] += 1;
        }
    }
    for k in 0..LANES {
        found.quat_off_unit = found.quat_off_unit.max(most.quat_off_unit[k]);
        found.anisotropy = found.anisotropy.max(most.anisotropy[k]);
        found.scale_max = found.scale_max.max(most.scale_max[k]);
        found.opacity_max = found.opacity_max.max(most.opacity_max[k]);
        found.scale_min = found.scale_min.min(most.scale_min[k]);
    }
}

/// The extremes of a profile, side by side.
struct Extremes {
    quat_off_unit: [f32; LANES],
    anisotropy: [f32; LANES],
    scale_min: [f32; LANES],
    scale_max: [f32; LANES],
    opacity_max: [f32; LANES],
}

impl Extremes {
    fn none() -> Self {
        let [none, least] = [0.0, f32::INFINITY].map(|v| [v; LANES]);
        Self {
            quat_off_unit: none,
            anisotropy: none,
            scale_min: least,
            scale_max: none,
            opacity_max: none,
        }
    }
}

/// Largest tails of a set of rows, and the row of the longest.
#[derive(Clone, Copy, Default)]
struct Tails {
    tail: [f32; 4],
    row: [u32; 4],
}

impl Tails {
    /// Takes the larger of each; of equals the first.
    fn join(mut self, other: &Self) -> Self {
        for l in 0..4 {
            if other.tail[l] > self.tail[l] {
                (self.tail[l], self.row[l]) = (other.tail[l], other.row[l]);
            }
        }
        self
    }

    fn add(&mut self, row: u32, tail: [f32; 4]) {
        *self = self.join(&Self { tail, row: [row; 4] });
    }
}

fn scan_harmonics(gaussians: &Gaussians) -> HarmonicsProfile {
    let (n, degree) = (gaussians.len(), gaussians.sh_degree);
    let profile = |found: Tails, rows: usize| {
        let last = (0..4).rev().find(|&l| found.tail[l] > 0.0);
        let witness = last.map(|l| found.row[l]);
        HarmonicsProfile { degree, tail: found.tail, rows, witness }
    };
    if degree == 0 || n == 0 {
        return profile(Tails::default(), n);
    }
    let step = n.div_ceil(PROBE).max(1);
    let mut probe = Tails::default();
    for (done, i) in (0..n).step_by(step).enumerate() {
        if gaussians.opacities[i] >= FAINT {
            probe.add(i as u32, tails(gaussians, i));
        }
        // The last band by itself counts: nothing can be left out, whatever the others say.
        if probe.tail[usize::from(degree) - 1] >= HARMONICS_LIMIT {
            return profile(probe, done + 1);
        }
    }
    let blocks: Vec<Tails> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map(|b| {
            let rows = b * BLOCK..((b + 1) * BLOCK).min(n);
            let seen = rows.filter(|&i| gaussians.opacities[i] >= FAINT);
            let mut found = Tails::default();
            seen.for_each(|i| found.add(i as u32, tails(gaussians, i)));
            found
        })
        .collect();
    profile(blocks.iter().fold(Tails::default(), |all, b| all.join(b)), n)
}

/// How much a color channel of a Gaussian can change by leaving out the bands above 0, 1, 2, 3.
fn tails(gaussians: &Gaussians, i: usize) -> [f32; 4] {
    let width = 3 * gaussians.sh_len();
    let higher = &gaussians.sh[i * width + 3..(i + 1) * width];
    // Bands that a file has and that were not trained are all 0, of either sign.
    if higher.iter().fold(0, |any, c| any | c.to_bits() << 1) == 0 {
        return [0.0; 4];
    }
    let mut bands = [[0f32; 3]; 4];
    for (k, (coefficient, most)) in higher.as_chunks::<3>().0.iter().zip(BASIS_MAX).enumerate() {
        let band = if k < 3 { 1 } else { 2 + usize::from(k >= 8) };
        for (sum, c) in bands[band].iter_mut().zip(coefficient) {
            *sum += c.abs() * most;
        }
    }
    let mut tail = [0.0; 4];
    let mut above = [0f32; 3];
    for l in (0..3).rev() {
        for (sum, e) in above.iter_mut().zip(bands[l + 1]) {
            *sum += e;
        }
        // `max` would take the number and hide a NaN.
        let worst =
            above.iter().fold(0f32, |m, e| if e.is_nan() { f32::INFINITY } else { m.max(*e) });
        tail[l] = worst;
    }
    tail
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spherical_harmonics::basis;

    #[test]
    fn basis_functions_stay_below_their_bounds_and_reach_them() {
        let mut most = [0f32; 15];
        let steps = 400;
        for i in 0..=steps {
            let theta = std::f32::consts::PI * i as f32 / steps as f32;
            for j in 0..2 * steps {
                let phi = std::f32::consts::PI * j as f32 / steps as f32;
                let d = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
                let b: [f32; 16] = basis::<16>(d);
                for (m, v) in most.iter_mut().zip(&b[1..]) {
                    *m = m.max(v.abs());
                }
            }
        }
        for (k, (most, bound)) in most.iter().zip(BASIS_MAX).enumerate() {
            assert!(*most <= bound && *most > 0.999 * bound, "{k}: {most} {bound}");
        }
    }
}
