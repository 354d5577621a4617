//! Gaussians as they are drawn: activated values, one array per property.

use crate::RasterError;
use rayon::prelude::*;
use scenesplat_scene::GaussianScene;

/// The most Gaussians of one call: row numbers are `u32` with one value to spare.
const MAX_ROWS: usize = u32::MAX as usize - 1;

/// Gaussians with activated values, every array with `N` rows.
///
/// Values may be anything: rows that cannot be drawn (not finite, without a direction, without
/// opacity) are left out of the picture and counted in [`CullCounts`](crate::CullCounts).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gaussians {
    /// Centers in the world, its units. `[N, 3]`
    pub means: Vec<[f32; 3]>,
    /// Orientation `w, x, y, z`, any norm above 1e-6. `[N, 4]`
    pub quats: Vec<[f32; 4]>,
    /// Standard deviations along the axes, units of the world, ≥ 0 (the sign does not matter). `[N, 3]`
    pub scales: Vec<[f32; 3]>,
    /// In `0..=1`; more counts as 1. `[N]`
    pub opacities: Vec<f32>,
    /// Spherical harmonics, `[N, K, 3]` flattened, `K = (sh_degree + 1)²`, red, green, blue last.
    pub sh: Vec<f32>,
    /// Degree of `sh`, 0 to 3.
    pub sh_degree: u8,
}

impl Gaussians {
    /// Activates a scene: `exp` of the scales, the sigmoid of the opacities, the DC color in
    /// front of the higher bands.
    ///
    /// Rows whose harmonics are not finite get opacity 0: they would otherwise hide what is behind
    /// them in passes without color.
    ///
    /// # Errors
    /// Harmonics of degree 4 ([`RasterError::Degree`]), arrays of different length.
    pub fn from_scene(scene: &GaussianScene) -> Result<Self, RasterError> {
        if scene.sh_degree > 3 {
            return Err(RasterError::Degree { degree: scene.sh_degree });
        }
        let n = scene.len();
        let rest = 3 * scene.sh_rest_len();
        expect("log_scale", n, scene.log_scale.len())?;
        expect("quat", n, scene.quat.len())?;
        expect("opacity_logit", n, scene.opacity_logit.len())?;
        expect("sh_dc", n, scene.sh_dc.len())?;
        expect("sh_rest", n * rest, scene.sh_rest.len())?;
        let width = 3 + rest;
        let mut sh = vec![0.0; n * width];
        sh.par_chunks_mut(width).enumerate().with_min_len(4096).for_each(|(i, row)| {
            row[..3].copy_from_slice(&scene.sh_dc[i]);
            row[3..].copy_from_slice(&scene.sh_rest[i * rest..(i + 1) * rest]);
        });
        let opacity = |i: usize| {
            let row = &sh[i * width..(i + 1) * width];
            if row.iter().all(|v| v.is_finite()) { scene.opacity(i) } else { 0.0 }
        };
        let all = || (0..n).into_par_iter().with_min_len(4096);
        let opacities = all().map(opacity).collect();
        let scales = all().map(|i| scene.scale(i)).collect();
        let gaussians = Self {
            means: scene.coord.clone(),
            quats: scene.quat.clone(),
            scales,
            opacities,
            sh,
            sh_degree: scene.sh_degree,
        };
        gaussians.check()?;
        Ok(gaussians)
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Harmonics per Gaussian and channel: `(sh_degree + 1)²`.
    pub fn sh_len(&self) -> usize {
        let side = usize::from(self.sh_degree) + 1;
        side * side
    }

    /// Checks that all arrays have the same number of rows and the degree is one that is drawn.
    ///
    /// # Errors
    /// Names the array with what was expected.
    pub fn check(&self) -> Result<(), RasterError> {
        if self.sh_degree > 3 {
            return Err(RasterError::Degree { degree: self.sh_degree });
        }
        let n = self.len();
        if n > MAX_ROWS {
            return Err(RasterError::TooMany { what: "Gaussians", count: n, limit: MAX_ROWS });
        }
        expect("quats", n, self.quats.len())?;
        expect("scales", n, self.scales.len())?;
        expect("opacities", n, self.opacities.len())?;
        expect("sh", n * 3 * self.sh_len(), self.sh.len())
    }
}

/// That an array has as many values as it should.
pub(crate) fn expect(field: &'static str, expected: usize, got: usize) -> Result<(), RasterError> {
    if got == expected { Ok(()) } else { Err(RasterError::Length { field, expected, got }) }
}
