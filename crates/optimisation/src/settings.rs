//! What optimisation does, with the values of two trainers.

use crate::background::Background;
use crate::depth_loss::DepthOutliers;
use crate::error::{OptimiseError, within};
use crate::image_loss::{ImageWeights, SsimPadding};
use crate::initial::InitialSettings;
use crate::relocation::Relocation;
use crate::strategy::{DefaultSettings, McmcSettings};
use crate::{Rates, Regularisers};
use scenesplat_rasterizer::RasterSettings;
use serde::{Deserialize, Serialize};

/// In which order a step is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum StepOrder {
    /// Strategy with the learning rate of this step, then Adam, which does nothing on steps where the
    /// strategy moved Gaussians: their derivatives were lost there.
    #[serde(rename = "gsplat-1.3")]
    Gsplat13,
    /// Adam, then the strategy with the learning rate of the next step.
    #[serde(rename = "gsplat-1.6")]
    Gsplat16,
}

/// How Gaussians come and go.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// Dead ones are moved to others, some are added, all are shaken.
    Mcmc(McmcSettings),
    /// Those with large gradients on the picture are doubled, transparent ones are removed.
    Default(DefaultSettings),
    /// Neither.
    Fixed,
}

/// How large the scene is, in its units: learning rates of centers grow with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneScale {
    /// This; 1 for rooms in meters.
    Fixed(f64),
    /// 1.1 times the largest distance of a camera from the mean of all.
    FromCameras,
}

/// Which depth a measured depth is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthKind {
    /// `Σ w z`, as the data set's authors.
    Accumulated,
    /// `Σ w z / Σ w`.
    Expected,
}

/// A loss of depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthTerm {
    /// λ, per unit of the scene.
    pub weight: f32,
    /// What is compared.
    pub kind: DepthKind,
    /// What does not count.
    pub outliers: DepthOutliers,
}

/// First learning rates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseRates {
    /// Of the centers, times the scale of the scene.
    pub means: f64,
    /// Factor that the rate of the centers has at the end.
    pub means_end: f64,
    /// Of the logarithms of the scales.
    pub scales: f64,
    /// Of the quaternions.
    pub quats: f64,
    /// Of the logits.
    pub opacities: f64,
    /// Of the first harmonic.
    pub sh0: f64,
    /// Of the others.
    pub sh_rest: f64,
    /// Of gains and offsets of pictures, where they are learned.
    pub exposure: f64,
}

impl Default for BaseRates {
    fn default() -> Self {
        Self {
            means: 1.6e-4,
            means_end: 0.01,
            scales: 5e-3,
            quats: 1e-3,
            opacities: 5e-2,
            sh0: 2.5e-3,
            sh_rest: 2.5e-3 / 20.0,
            exposure: 1e-3,
        }
    }
}

/// Everything that decides what optimisation does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiseSettings {
    /// Steps, one picture each.
    pub steps: u64,
    /// Of all random numbers.
    pub seed: u64,
    /// How Gaussians come and go.
    pub strategy: Strategy,
    /// In which order.
    pub order: StepOrder,
    /// First learning rates.
    pub rates: BaseRates,
    /// How large the scene is.
    pub scene_scale: SceneScale,
    /// Steps after which one more band of harmonics is used; 0 uses all from the first step.
    pub sh_every: u64,
    /// λ of SSIM in the loss.
    pub ssim: f32,
    /// How SSIM treats borders.
    #[serde(with = "padding_name")]
    pub ssim_border: SsimPadding,
    /// Depth loss, for frames with depth.
    pub depth: Option<DepthTerm>,
    /// λ of the mean opacity.
    pub opacity_reg: f32,
    /// λ of the mean standard deviation.
    pub scale_reg: f32,
    /// The first Gaussians.
    pub initial: InitialSettings,
    /// Depth from which Gaussians are drawn, units of the scene.
    pub near: f32,
    /// Depth up to which they are.
    pub far: f32,
    /// Whether opacities make up for the low-pass; then renders of the result have to, too.
    pub antialiased: bool,
    /// What is behind everything.
    pub background: Background,
    /// First steps that use pictures of half the size.
    pub half_steps: u64,
    /// Whether each picture has a gain and an offset per channel of its own.
    pub exposure: bool,
}

impl OptimiseSettings {
    /// The public settings of the data set's authors (`mcmc --strategy.cap-max 1500000 --depth_loss
    /// --scale_reg 0.02 --opacity_reg 0`, gsplat 1.3).
    pub fn scenesplat() -> Self {
        Self {
            steps: 30_000,
            seed: 42,
            strategy: Strategy::Mcmc(McmcSettings {
                cap: 1_500_000,
                relocation: Relocation::Gsplat15,
                few: 10_000,
                ..McmcSettings::default()
            }),
            order: StepOrder::Gsplat13,
            rates: BaseRates::default(),
            scene_scale: SceneScale::Fixed(1.0),
            sh_every: 1000,
            ssim: 0.2,
            ssim_border: SsimPadding::Reflect,
            depth: Some(DepthTerm {
                weight: 1.0,
                kind: DepthKind::Accumulated,
                outliers: DepthOutliers::MedianRule,
            }),
            opacity_reg: 0.0,
            scale_reg: 0.02,
            initial: InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 3, random_quats: true },
            near: 0.01,
            far: 100.0,
            antialiased: true,
            background: Background::Auto,
            half_steps: 0,
            exposure: false,
        }
    }

    /// The preset `mcmc` of gsplat 1.6.
    pub fn gsplat_mcmc() -> Self {
        Self {
            strategy: Strategy::Mcmc(McmcSettings {
                relocation: Relocation::Gsplat16,
                ..McmcSettings::default()
            }),
            order: StepOrder::Gsplat16,
            scene_scale: SceneScale::FromCameras,
            ssim_border: SsimPadding::Valid,
            depth: None,
            opacity_reg: 0.01,
            scale_reg: 0.01,
            initial: InitialSettings { scale: 0.1, ..Self::scenesplat().initial },
            far: 1e10,
            antialiased: false,
            ..Self::scenesplat()
        }
    }

    /// The preset `default` of gsplat 1.6: doubling and removing.
    pub fn gsplat_default() -> Self {
        Self {
            strategy: Strategy::Default(DefaultSettings::default()),
            opacity_reg: 0.0,
            scale_reg: 0.0,
            initial: InitialSettings { opacity: 0.1, scale: 1.0, ..Self::scenesplat().initial },
            ..Self::gsplat_mcmc()
        }
    }

    /// Shortens or lengthens everything that is counted in steps, as the preset's share of its steps.
    pub fn with_steps(mut self, steps: u64) -> Self {
        let factor = steps as f64 / self.steps.max(1) as f64;
        let scaled = |v: u64| ((v as f64 * factor).round() as u64).max(1);
        match &mut self.strategy {
            Strategy::Mcmc(s) => {
                s.refine_start = scaled(s.refine_start);
                s.refine_stop = scaled(s.refine_stop);
            }
            Strategy::Default(s) => {
                s.refine_start = scaled(s.refine_start);
                s.refine_stop = scaled(s.refine_stop);
                s.reset_every = scaled(s.reset_every).max(s.refine_every);
            }
            Strategy::Fixed => {}
        }
        self.sh_every = if self.sh_every == 0 { 0 } else { scaled(self.sh_every) };
        self.half_steps = (self.half_steps as f64 * factor).round() as u64;
        self.steps = steps;
        self
    }

    /// The depth loss, if it weighs anything.
    pub fn depth_loss(&self) -> Option<DepthTerm> {
        self.depth.filter(|term| term.weight > 0.0)
    }

    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), OptimiseError> {
        let at_least_0 = "finite, at least 0";
        let rates = [
            ("rate of the centers", self.rates.means),
            ("rate of the scales", self.rates.scales),
            ("rate of the quaternions", self.rates.quats),
            ("rate of the opacities", self.rates.opacities),
            ("rate of the first harmonic", self.rates.sh0),
            ("rate of the harmonics", self.rates.sh_rest),
            ("rate of the exposure", self.rates.exposure),
            ("opacity_reg", self.opacity_reg.into()),
            ("scale_reg", self.scale_reg.into()),
            ("depth weight", self.depth.map_or(0.0, |d| d.weight).into()),
        ];
        for (field, value) in rates {
            within(field, value, value.is_finite() && value >= 0.0, at_least_0)?;
        }
        let end = self.rates.means_end;
        within("means_end", end, end > 0.0 && end <= 1.0, "above 0, at most 1")?;
        within("steps", self.steps as f64, self.steps > 0, "at least 1")?;
        within(
            "weight of SSIM",
            self.ssim.into(),
            (0.0..=1.0).contains(&self.ssim),
            "from 0 to 1",
        )?;
        if let SceneScale::Fixed(scale) = self.scene_scale {
            within("scene_scale", scale, scale.is_finite() && scale > 0.0, "finite and above 0")?;
        }
        match &self.strategy {
            Strategy::Mcmc(settings) => settings.check()?,
            Strategy::Default(settings) => settings.check()?,
            Strategy::Fixed => {}
        }
        self.background.check()?;
        self.raster().check()?;
        Ok(())
    }

    /// How pictures are drawn: the constants of gsplat 1.6, so that renders of the result look as it did.
    pub fn raster(&self) -> RasterSettings {
        self.raster_on(self.background.shown())
    }

    /// The same on a background.
    pub(crate) fn raster_on(&self, background: [f32; 3]) -> RasterSettings {
        RasterSettings {
            background: (background != [0.0; 3]).then_some(background),
            near: self.near,
            far: self.far,
            antialiased: self.antialiased,
            ..RasterSettings::gsplat_1_6()
        }
    }

    /// What pictures are compared by.
    pub fn image(&self) -> ImageWeights {
        ImageWeights { ssim: self.ssim, padding: self.ssim_border }
    }

    /// The regularizers.
    pub fn regularisers(&self) -> Regularisers {
        Regularisers { opacity: self.opacity_reg, scale: self.scale_reg }
    }

    /// The rate of the centers at a step, for a scene of that scale: it falls by the same factor each
    /// step, to `means_end` after the last.
    pub fn means_rate(&self, step: u64, scene_scale: f64) -> f64 {
        let decay = self.rates.means_end.powf(step as f64 / self.steps as f64);
        self.rates.means * scene_scale * decay
    }

    /// Rates of all groups at a step.
    pub fn rates_at(&self, step: u64, scene_scale: f64) -> Rates {
        let r = &self.rates;
        Rates {
            means: self.means_rate(step, scene_scale),
            scales: r.scales,
            quats: r.quats,
            opacities: r.opacities,
            sh0: r.sh0,
            sh_rest: r.sh_rest,
        }
    }

    /// The highest band of harmonics at a step.
    pub fn sh_degree_at(&self, step: u64) -> u8 {
        let highest = self.initial.sh_degree;
        step.checked_div(self.sh_every).map_or(highest, |bands| bands.min(highest.into()) as u8)
    }
}

/// Borders by their names.
mod padding_name {
    use super::SsimPadding;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(value: &SsimPadding, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(value.name())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<SsimPadding, D::Error> {
        let name = String::deserialize(d)?;
        let found = SsimPadding::ALL.into_iter().find(|padding| padding.name() == name);
        found.ok_or_else(|| {
            D::Error::custom(format!("{name:?}: valid, reflect and zero are borders"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_by_hand() {
        let settings = OptimiseSettings::scenesplat();
        // The reference: 1.6e-4 · 0.01^(t / 30000).
        for (step, want) in [(0, 1.6e-4), (1000, 1.372_313_437_745_430_7e-4), (15_000, 1.6e-5)] {
            let got = settings.means_rate(step, 1.0);
            assert!((got / want - 1.0).abs() < 1e-12, "{step}: {got}");
        }
        assert_eq!(
            [0, 999, 1000, 2999, 3000, 30_000].map(|t| settings.sh_degree_at(t)),
            [0, 0, 1, 2, 3, 3]
        );
        let short = settings.with_steps(3000);
        assert_eq!(
            (short.sh_every, short.means_rate(1500, 2.0)),
            (100, 2.0 * settings.means_rate(15_000, 1.0))
        );
        for preset in
            [settings, OptimiseSettings::gsplat_mcmc(), OptimiseSettings::gsplat_default(), short]
        {
            preset.check().unwrap();
            let text = serde_json::to_string(&preset).unwrap();
            assert_eq!(serde_json::from_str::<OptimiseSettings>(&text).unwrap(), preset);
        }
    }

    #[test]
    fn bad_numbers_are_named() {
        let good = OptimiseSettings::scenesplat();
        let bad = [
            (OptimiseSettings { scale_reg: f32::NAN, ..good }, "scale_reg"),
            (OptimiseSettings { steps: 0, ..good }, "steps"),
            (OptimiseSettings { ssim: 1.5, ..good }, "SSIM"),
            (OptimiseSettings { near: -1.0, ..good }, "near"),
            (OptimiseSettings { scene_scale: SceneScale::Fixed(0.0), ..good }, "scene_scale"),
        ];
        for (settings, name) in bad {
            let error = settings.check().unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
