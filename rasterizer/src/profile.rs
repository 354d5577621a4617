//! What is in a scene that a renderer could leave out: one parallel look at its values.

use crate::Gaussians;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Opacity below which a Gaussian is never drawn, with every preset.
pub const FAINT: f32 = 1.0 / 255.0;

/// Rows that one task looks at; fixed, as what is found does not depend on the number of threads.
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

/// How much the higher bands of the harmonics can change a colour.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HarmonicsProfile {
    /// Degree that is stored.
    pub degree: u8,
    /// `tail[L]`: no colour channel of a drawable Gaussian changes by more if the bands above `L`
    /// are left out; infinite where a coefficient is not finite. A lower bound of it where
    /// `rows < ` all of them.
    pub tail: [f32; 4],
    /// Rows looked at: all, or fewer if they already need every band.
    pub rows: usize,
    /// A row for which the last entry of `tail` above 0 was reached.
    pub witness: Option<u32>,
}

/// What one look at all Gaussians finds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneProfile {
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Centre, quaternion, scale or opacity is NaN or infinite: never drawn.
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
    /// Looks at every Gaussian once.
    ///
    /// The harmonics are most of the bytes of a scene. A probe of 4096 evenly spread rows comes
    /// first; if one of them needs every band, the others need not be read.
    ///
    /// # Errors
    /// If the arrays do not have one row per Gaussian, as [`Gaussians::check`].
    pub fn scan(gaussians: &Gaussians) -> Result<Self, crate::RasterError> {
        gaussians.check()?;
        let n = gaussians.len();
        let blocks: Vec<Found> = (0..n.div_ceil(BLOCK))
            .into_par_iter()
            .map(|b| Found::of(gaussians, b * BLOCK..((b + 1) * BLOCK).min(n)))
            .collect();
        let found = blocks.iter().fold(Found::default(), |all, block| all.join(block));
        Ok(found.into_profile(n, scan_harmonics(gaussians)))
    }

    /// Whether all drawable Gaussians are spheres to within `tolerance` of their radius.
    pub fn is_isotropic(&self, tolerance: f32) -> bool {
        self.anisotropy <= tolerance
    }
}

/// Numbers of a block of rows; joined in order, although no order changes them.
#[derive(Clone, Copy)]
struct Found {
    not_finite: usize,
    faint: usize,
    no_direction: usize,
    unrotated: usize,
    quat_off_unit: f32,
    anisotropy: f32,
    scale_min: f32,
    scale_max: f32,
    scale_histogram: [usize; 32],
    opacity_max: f32,
    opacity_histogram: [usize; 10],
}

impl Default for Found {
    fn default() -> Self {
        Self {
            not_finite: 0,
            faint: 0,
            no_direction: 0,
            unrotated: 0,
            quat_off_unit: 0.0,
            anisotropy: 0.0,
            scale_min: f32::INFINITY,
            scale_max: 0.0,
            scale_histogram: [0; 32],
            opacity_max: 0.0,
            opacity_histogram: [0; 10],
        }
    }
}

impl Found {
    fn of(gaussians: &Gaussians, rows: std::ops::Range<usize>) -> Self {
        let mut found = Self::default();
        for i in rows {
            found.add(
                gaussians.means[i],
                gaussians.quats[i],
                gaussians.scales[i],
                gaussians.opacities[i],
            );
        }
        found
    }

    #[inline(always)]
    fn add(&mut self, mean: [f32; 3], quat: [f32; 4], scale: [f32; 3], opacity: f32) {
        // Finite numbers times 0 are 0; everything else is NaN.
        let zero: f32 = mean.iter().chain(&quat).chain(&scale).map(|v| v * 0.0).sum();
        if zero + opacity * 0.0 != 0.0 {
            self.not_finite += 1;
            return;
        }
        if opacity < FAINT {
            self.faint += 1;
            return;
        }
        let [w, x, y, z] = quat;
        let norm = w * w + x * x + y * y + z * z;
        self.no_direction += usize::from(norm < MIN_QUAT);
        self.unrotated += usize::from(x == 0.0 && y == 0.0 && z == 0.0);
        self.quat_off_unit = self.quat_off_unit.max((norm - 1.0).abs());
        let [a, b, c] = scale.map(f32::abs);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        // Zero scales are equal to each other.
        let excess = if high == low { 0.0 } else { (high - low) / low };
        self.anisotropy = self.anisotropy.max(excess);
        self.scale_min = self.scale_min.min(low);
        self.scale_max = self.scale_max.max(high);
        // The exponent of a float is its octave.
        let octave = (high.to_bits() >> 23) as i32 - 127;
        self.scale_histogram[(octave + 24).clamp(0, 31) as usize] += 1;
        self.opacity_max = self.opacity_max.max(opacity);
        self.opacity_histogram[((opacity * 10.0) as usize).min(9)] += 1;
    }

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

    fn into_profile(self, gaussians: usize, harmonics: HarmonicsProfile) -> SceneProfile {
        SceneProfile {
            gaussians,
            not_finite: self.not_finite,
            faint: self.faint,
            drawable: gaussians - self.not_finite - self.faint,
            no_direction: self.no_direction,
            unrotated: self.unrotated,
            quat_off_unit: self.quat_off_unit,
            anisotropy: self.anisotropy,
            scale_min: self.scale_min,
            scale_max: self.scale_max,
            scale_histogram: self.scale_histogram,
            opacity_max: self.opacity_max,
            opacity_histogram: self.opacity_histogram,
            harmonics,
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
    let step = (n / PROBE).max(1);
    let mut probe = Tails::default();
    for i in (0..n).step_by(step).filter(|&i| gaussians.opacities[i] >= FAINT) {
        probe.add(i as u32, tails(gaussians, i));
    }
    // The last band by itself already counts: nothing can be left out, whatever the others say.
    if probe.tail[usize::from(degree) - 1] >= crate::plan::HARMONICS_LIMIT {
        return profile(probe, n.div_ceil(step));
    }
    let blocks: Vec<Tails> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map(|b| {
            let mut found = Tails::default();
            for i in b * BLOCK..((b + 1) * BLOCK).min(n) {
                if gaussians.opacities[i] >= FAINT {
                    found.add(i as u32, tails(gaussians, i));
                }
            }
            found
        })
        .collect();
    profile(blocks.iter().fold(Tails::default(), |all, b| all.join(b)), n)
}

/// How much a colour channel of a Gaussian can change by leaving out the bands above 0, 1, 2, 3.
fn tails(gaussians: &Gaussians, i: usize) -> [f32; 4] {
    let width = 3 * gaussians.sh_len();
    let higher = &gaussians.sh[i * width + 3..(i + 1) * width];
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
