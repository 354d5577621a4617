//! What comes out: gradients, and which of them are wanted.

use super::BackwardError;
use crate::Gaussians;
use crate::gaussians::expect;

/// Which gradients are wanted. Geometry is all but the harmonics; without any of it, only
/// the weights of the pixels are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GradMask {
    /// Of the centers.
    pub means: bool,
    /// Of the quaternions.
    pub quats: bool,
    /// Of the scales.
    pub scales: bool,
    /// Of the opacities.
    pub opacities: bool,
    /// Of the harmonics.
    pub sh: bool,
    /// Whether the centers also get what flows through the direction that a color is seen from.
    /// gsplat 1.6 has it on; it was 4 % of the gradient of the centers on synthetic scenes.
    pub sh_direction: bool,
}

impl Default for GradMask {
    fn default() -> Self {
        Self::all()
    }
}

impl GradMask {
    /// Everything.
    pub fn all() -> Self {
        Self {
            means: true,
            quats: true,
            scales: true,
            opacities: true,
            sh: true,
            sh_direction: true,
        }
    }

    /// Nothing; to switch on single groups.
    pub fn none() -> Self {
        Self {
            means: false,
            quats: false,
            scales: false,
            opacities: false,
            sh: false,
            sh_direction: false,
        }
    }

    /// Color only: geometry frozen.
    pub fn sh_only() -> Self {
        Self { sh: true, ..Self::none() }
    }

    /// Whether anything needs the derivative of α.
    pub(crate) fn geometry(self) -> bool {
        self.means || self.quats || self.scales || self.opacities
    }
}

/// Gradients with respect to activated values, in the layout of [`Gaussians`].
///
/// For stored values: `∂/∂log s = s · ∂/∂s`, `∂/∂logit = o (1 − o) · ∂/∂o`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gradients {
    /// `[N, 3]`
    pub means: Vec<[f32; 3]>,
    /// Of quaternions as given, `wxyz`: orthogonal to them if the settings normalize. `[N, 4]`
    pub quats: Vec<[f32; 4]>,
    /// `[N, 3]`
    pub scales: Vec<[f32; 3]>,
    /// `[N]`
    pub opacities: Vec<f32>,
    /// `[N, K, 3]`; 0 in bands above the degree that was drawn.
    pub sh: Vec<f32>,
    /// `[N, dim]`; empty without features.
    pub features: Vec<f32>,
    /// Of the centers on the picture, per pixel: what tells a strategy where a scene lacks Gaussians.
    /// Empty unless the caller makes room for it; needs the geometry of the mask. `[N, 2]`
    pub screen: Vec<[f32; 2]>,
}

impl Gradients {
    /// Zeros for these Gaussians, with `dim` features each.
    pub fn zeros(gaussians: &Gaussians, dim: usize) -> Self {
        let n = gaussians.len();
        Self {
            means: vec![[0.0; 3]; n],
            quats: vec![[0.0; 4]; n],
            scales: vec![[0.0; 3]; n],
            opacities: vec![0.0; n],
            sh: vec![0.0; gaussians.sh.len()],
            features: vec![0.0; n * dim],
            screen: Vec::new(),
        }
    }

    pub(crate) fn check(&self, gaussians: &Gaussians, dim: usize) -> Result<(), BackwardError> {
        let n = gaussians.len();
        expect("gradients of the means", n, self.means.len())?;
        expect("gradients of the quats", n, self.quats.len())?;
        expect("gradients of the scales", n, self.scales.len())?;
        expect("gradients of the opacities", n, self.opacities.len())?;
        expect("gradients of the sh", gaussians.sh.len(), self.sh.len())?;
        expect("gradients of the features", n * dim, self.features.len())?;
        if !self.screen.is_empty() {
            expect("gradients on the screen", n, self.screen.len())?;
        }
        Ok(())
    }
}
