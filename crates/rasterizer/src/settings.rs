//! The constants that differ between rasterizers, and the presets.

use crate::RasterError;
use scenesplat_kernels::simd::Isa;

/// Which tiles a Gaussian is drawn in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ExtentRule {
    /// Those that its ellipse `α ≥ alpha_cut` meets: loses no pixel. gsplat since 1.5 (whose
    /// rectangles and ellipse walks only differ in tiles where nothing passes the cut).
    Ellipse,
    /// Those that meet the square of half a side `⌈sigma · √λmax⌉`,
    /// `λmax = m + √max(floor, m² − det)`: the picture is cut off at tile edges beyond it. Inria and gsplat
    /// before 1.5.
    Circle {
        /// Standard deviations; 3.
        sigma: f32,
        /// Least value under the root, px⁴; Inria 0.1, gsplat 1.4 0.01.
        floor: f32,
    },
}

/// Constants of a render. The default is [`gsplat_1_6`](Self::gsplat_1_6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RasterSettings {
    /// Nearest depth drawn, units of the world, above 0.
    pub near: f32,
    /// Whether a center exactly at `near` is not drawn.
    pub near_excluded: bool,
    /// Farthest depth drawn.
    pub far: f32,
    /// Variance added to the projected covariance, px², above 0.
    pub eps2d: f32,
    /// Largest α of one Gaussian at one pixel, below 1.
    pub alpha_max: f32,
    /// Below this α a Gaussian does not count at a pixel, above 0.
    pub alpha_cut: f32,
    /// A pixel stops, without the Gaussian at hand, when its transmittance would fall to this.
    pub stop: f32,
    /// Whether the pixel goes on if the transmittance would be exactly `stop`.
    pub stop_excluded: bool,
    /// Which tiles a Gaussian is drawn in.
    pub extent: ExtentRule,
    /// Whether quaternions are normalized; without it a longer one makes a larger Gaussian.
    pub normalize_quats: bool,
    /// Whether the tangents in the Jacobian are limited about the middle of the picture instead of
    /// about the principal point.
    pub centred_tangents: bool,
    /// Whether the opacity makes up for `eps2d`: `o · √(det Σ₂ / det Σ′)`.
    pub antialiased: bool,
    /// Least value of that factor.
    pub antialias_floor: f32,
    /// Color behind everything; `None` is black, and nothing is added.
    pub background: Option<[f32; 3]>,
    /// The caller's promise that the three scales of every Gaussian are equal: quaternions are not
    /// read (a zero quaternion then hides nothing) and the first scale counts.
    pub isotropic: bool,
    /// The best instruction set to use; what the CPU lacks, or `SCENESPLAT_ISA` excludes, is not.
    pub isa: Isa,
}

impl Default for RasterSettings {
    fn default() -> Self {
        Self::gsplat_1_6()
    }
}

impl RasterSettings {
    /// gsplat 1.6.0 (90d7b4b).
    pub fn gsplat_1_6() -> Self {
        Self {
            near: 0.01,
            near_excluded: false,
            far: 1e10,
            eps2d: 0.3,
            alpha_max: 0.99,
            alpha_cut: 1.0 / 255.0,
            stop: 1e-4,
            stop_excluded: false,
            extent: ExtentRule::Ellipse,
            normalize_quats: true,
            centred_tangents: false,
            antialiased: false,
            antialias_floor: 0.005,
            background: None,
            isotropic: false,
            isa: Isa::Amx,
        }
    }

    /// gsplat 1.5.0 to 1.5.3.
    pub fn gsplat_1_5() -> Self {
        Self { alpha_max: 0.999, antialias_floor: 0.0, ..Self::gsplat_1_6() }
    }

    /// gsplat 1.4.0, which label collection was run with.
    pub fn gsplat_1_4() -> Self {
        Self { extent: ExtentRule::Circle { sigma: 3.0, floor: 0.01 }, ..Self::gsplat_1_5() }
    }

    /// Inria's `diff-gaussian-rasterization` (59f5f77).
    pub fn inria() -> Self {
        Self {
            near: 0.2,
            near_excluded: true,
            far: f32::INFINITY,
            stop_excluded: true,
            extent: ExtentRule::Circle { sigma: 3.0, floor: 0.1 },
            normalize_quats: false,
            centred_tangents: true,
            antialias_floor: 0.005,
            ..Self::gsplat_1_6()
        }
    }

    /// The instruction set that is used.
    pub fn isa(&self) -> Isa {
        self.isa.min(Isa::current())
    }

    /// A pixel goes on while its transmittance would be above this.
    pub(crate) fn stop_above(&self) -> f32 {
        if self.stop_excluded { self.stop.next_down() } else { self.stop }
    }

    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), RasterError> {
        let check = |field, value: f32, good: bool, range| {
            let value = f64::from(value);
            if good { Ok(()) } else { Err(RasterError::Number { field, value, range }) }
        };
        check("near", self.near, self.near > 0.0 && self.near.is_finite(), "finite and above 0")?;
        check("far", self.far, self.far > self.near, "above near")?;
        let eps = self.eps2d > 0.0 && self.eps2d.is_finite();
        check("eps2d", self.eps2d, eps, "finite and above 0")?;
        let max = self.alpha_max > 0.0 && self.alpha_max < 1.0;
        check("alpha_max", self.alpha_max, max, "between 0 and 1")?;
        let cut = self.alpha_cut > 0.0 && self.alpha_cut < self.alpha_max;
        check("alpha_cut", self.alpha_cut, cut, "between 0 and alpha_max")?;
        let stop = self.stop >= 0.0 && self.stop < 1.0;
        check("stop", self.stop, stop, "from 0 to below 1")?;
        let floor = (0.0..=1.0).contains(&self.antialias_floor);
        check("antialias_floor", self.antialias_floor, floor, "from 0 to 1")?;
        if let ExtentRule::Circle { sigma, floor } = self.extent {
            check("extent sigma", sigma, sigma > 0.0 && sigma.is_finite(), "finite and above 0")?;
            check("extent floor", floor, floor >= 0.0 && floor.is_finite(), "finite, at least 0")?;
        }
        for value in self.background.iter().flatten() {
            check("background", *value, value.is_finite(), "finite")?;
        }
        Ok(())
    }
}
