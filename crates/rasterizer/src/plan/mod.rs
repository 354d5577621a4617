//! Which parts of rendering a scene and a request call for.
//!
//! [`SceneProfile::scan`] reads the scene once. [`RenderPlan::auto`] leaves out what the scene
//! does not have or the request does not ask for; every [`Decision`] carries its evidence and a
//! bound of the change it makes to the picture. [`RenderPlan::full`] leaves out nothing.
//!
//! A plan answers only the requests it was made for. A request for more is refused by name
//! ([`PlanError::NotPlanned`]); [`RenderPlan::upgraded`] makes the plan that serves both.
//!
//! ```
//! use scenesplat_rasterizer::{
//!     Gaussians, PlanRequest, RasterSettings, RenderPlan, RenderRequest, SceneProfile, View,
//! };
//!
//! let gaussians = Gaussians {
//!     means: vec![[0.0, 0.0, 2.0]],
//!     quats: vec![[1.0, 0.0, 0.0, 0.0]],
//!     scales: vec![[0.1; 3]],
//!     opacities: vec![0.9],
//!     sh: vec![1.0; 12],
//!     sh_degree: 1,
//! };
//! let profile = SceneProfile::scan(&gaussians)?;
//! let request = PlanRequest::new(RenderRequest::rgb());
//! let plan = RenderPlan::auto(&profile, RasterSettings::default(), request)?;
//! println!("{plan}");
//! let view = View {
//!     world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
//!     fx: 50.0, fy: 50.0, cx: 16.0, cy: 16.0, width: 32, height: 32,
//! };
//! let picture = plan.prepare(gaussians)?.render(&view, &RenderRequest::rgb())?;
//! assert_eq!(picture.work.rotated, 0); // a sphere: its quaternion is never read
//! # Ok::<(), scenesplat_rasterizer::PlanError>(())
//! ```

mod decide;
mod prepared;
mod text;

pub use prepared::Prepared;

pub use crate::profile::HARMONICS_LIMIT;
use crate::{DepthRequest, RasterError, RasterSettings, RenderRequest, SceneProfile};

/// Scales of a Gaussian that differ by less, relatively, are equal: a few roundings of f32.
pub const ISOTROPY_LIMIT: f32 = 1e-6;

/// Why a plan cannot be made or used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The request asks for something the plan left out.
    #[error("{what} was not planned; make the plan with it (`RenderPlan::upgraded`)")]
    NotPlanned {
        /// Which output.
        what: &'static str,
    },
    /// The plan belongs to another scene.
    #[error("the plan is for a scene of {planned} Gaussians, this one has {got}")]
    OtherScene {
        /// Gaussians of the scene that was profiled.
        planned: usize,
        /// Gaussians of the scene given.
        got: usize,
    },
    /// The renderer refuses.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

/// For which values a backward pass will follow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NeededGradients {
    /// Centers.
    pub means: bool,
    /// Quaternions.
    pub quats: bool,
    /// Scales.
    pub scales: bool,
    /// Opacities.
    pub opacities: bool,
    /// Harmonics.
    pub sh: bool,
}

impl NeededGradients {
    /// All of them.
    pub const ALL: Self =
        Self { means: true, quats: true, scales: true, opacities: true, sh: true };

    /// Whether there is any.
    pub fn any(self) -> bool {
        self != Self::default()
    }
}

/// What will be asked of a plan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PlanRequest {
    /// Outputs of a render; `sh_degree` is the highest band that is wanted.
    pub render: RenderRequest,
    /// Gradients that will follow. Bands that are 0 and spheres still have gradients.
    pub gradients: NeededGradients,
}

impl PlanRequest {
    /// A render without gradients.
    pub fn new(render: RenderRequest) -> Self {
        Self { render, gradients: NeededGradients::default() }
    }

    /// What serves both.
    fn union(self, other: Self) -> Self {
        let (a, b) = (self.render, other.render);
        let (ga, gb) = (self.gradients, other.gradients);
        Self {
            render: RenderRequest {
                rgb: a.rgb || b.rgb,
                depth: DepthRequest {
                    accumulated: a.depth.accumulated || b.depth.accumulated,
                    expected: a.depth.expected || b.depth.expected,
                    median: a.depth.median || b.depth.median,
                },
                contributions: a.contributions || b.contributions,
                last: a.last || b.last,
                // No limit is more than any limit.
                sh_degree: a.sh_degree.zip(b.sh_degree).map(|(a, b)| a.max(b)),
            },
            gradients: NeededGradients {
                means: ga.means || gb.means,
                quats: ga.quats || gb.quats,
                scales: ga.scales || gb.scales,
                opacities: ga.opacities || gb.opacities,
                sh: ga.sh || gb.sh,
            },
        }
    }
}

/// How far a decision can move a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// Not at all.
    Exact,
    /// Only by the rounding of f32, as another order of the same sums would.
    Rounding,
    /// A color channel by at most this.
    Color(f32),
}

/// One thing that was decided.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// About what.
    pub effect: &'static str,
    /// What will be done.
    pub verdict: String,
    /// Because of what.
    pub evidence: String,
    /// What it changes against [`RenderPlan::full`].
    pub bound: Bound,
}

/// What will be computed, and why not the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderPlan {
    /// Settings as given, with `isotropic` and `background` decided.
    pub settings: RasterSettings,
    /// What was asked for.
    pub request: PlanRequest,
    /// Highest band of the harmonics that is evaluated.
    pub sh_degree: u8,
    /// Whether Gaussians that are never drawn are taken out beforehand.
    pub drop_faint: bool,
    /// Each with evidence and bound.
    pub decisions: Vec<Decision>,
    is_full: bool,
    profile: SceneProfile,
    given: RasterSettings,
}

impl RenderPlan {
    /// The least that serves the request.
    ///
    /// # Errors
    /// What [`RasterSettings::check`] refuses, and harmonics above degree 3.
    pub fn auto(
        profile: &SceneProfile,
        settings: RasterSettings,
        request: PlanRequest,
    ) -> Result<Self, PlanError> {
        Self::checked(&settings, &request)?;
        Ok(decide::auto(profile, settings, request))
    }

    /// Everything that cannot change the picture: all bands asked for, rotations of spheres, a
    /// black background, all depths, and Gaussians that are never drawn.
    ///
    /// # Errors
    /// As [`auto`](Self::auto).
    pub fn full(
        profile: &SceneProfile,
        settings: RasterSettings,
        request: PlanRequest,
    ) -> Result<Self, PlanError> {
        Self::checked(&settings, &request)?;
        Ok(decide::full(profile, settings, request))
    }

    fn checked(settings: &RasterSettings, request: &PlanRequest) -> Result<(), RasterError> {
        settings.check()?;
        match request.render.sh_degree.filter(|&d| d > 3) {
            Some(degree) => Err(RasterError::Degree { degree }),
            None => Ok(()),
        }
    }

    /// Whether it leaves out nothing.
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// The plan that serves what this one serves and another request too.
    ///
    /// # Errors
    /// As [`auto`](Self::auto).
    pub fn upgraded(&self, more: PlanRequest) -> Result<Self, PlanError> {
        let request = self.request.union(more);
        let make = if self.is_full { Self::full } else { Self::auto };
        make(&self.profile, self.given, request)
    }

    /// The sum of all bounds: a color channel of [`full`](Self::full) differs by at most this,
    /// rounding aside.
    pub fn bound(&self) -> f32 {
        let bound = |d: &Decision| if let Bound::Color(c) = d.bound { c } else { 0.0 };
        self.decisions.iter().map(bound).sum()
    }

    /// Whether the plan serves a request.
    ///
    /// # Errors
    /// Names the first output that was not planned.
    pub fn check(&self, request: &RenderRequest) -> Result<(), PlanError> {
        let planned = self.effective();
        let have = |what, asked: bool, has: bool| {
            if asked && !has { Err(PlanError::NotPlanned { what }) } else { Ok(()) }
        };
        have("color", request.rgb, planned.rgb)?;
        let (a, b) = (request.depth, planned.depth);
        have("accumulated depth", a.accumulated, b.accumulated)?;
        have("expected depth", a.expected, b.expected)?;
        have("median depth", a.median, b.median)?;
        have("weights per Gaussian", request.contributions, planned.contributions)?;
        have("the last Gaussian per pixel", request.last, planned.last)?;
        // A limit of the plan that the evidence did not set.
        let limit = self.request.render.sh_degree.unwrap_or(3);
        let asked = request.sh_degree.unwrap_or(3).min(self.profile.harmonics.degree);
        have("a higher band of the harmonics", request.rgb && asked > limit, false)
    }

    /// All outputs that the plan has.
    fn effective(&self) -> RenderRequest {
        let mut request = self.request.render;
        if self.is_full {
            request.depth = DepthRequest { accumulated: true, expected: true, median: true };
        }
        request
    }
}
