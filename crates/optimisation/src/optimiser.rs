//! The step: draw, compare, pull back, update, refine.

use crate::depth_loss::{DepthLoss, DepthScratch, depth_loss};
use crate::error::{OptimiseError, within};
use crate::exposure::Exposure;
use crate::frame::{TrainingFrame, scale_of_cameras};
use crate::image_loss::{ImageComparison, ImageLoss, ImageWeights};
use crate::random::{Counter, Purpose};
use crate::settings::{DepthKind, DepthTerm, OptimiseSettings, SceneScale, StepOrder, Strategy};
use crate::strategy::{DoublingState, Refined};
use crate::{Adam, AdamSettings, Model};
use scenesplat_rasterizer::Rendered;
use scenesplat_rasterizer::backward::{
    GradMask, Gradients, Trace, TraceRequest, Upstream, Workspace,
};

/// What a step did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepReport {
    /// Number of the step, from 0.
    pub step: u64,
    /// Number of the frame.
    pub frame: usize,
    /// L1, SSIM and their sum.
    pub image: ImageLoss,
    /// Depth; no pixel counts where there is no such loss.
    pub depth: DepthLoss,
    /// Gaussians after it.
    pub gaussians: usize,
    /// Gaussians in the picture.
    pub visible: usize,
    /// What the strategy did.
    pub refined: Refined,
}

impl StepReport {
    /// Of the picture as it was drawn, before the update; dB.
    pub fn psnr(&self) -> f64 {
        -10.0 * self.image.mse.log10()
    }
}

/// A scene in the making.
///
/// A step depends on settings, frames, its number and the state before it, and on nothing else.
#[derive(Debug)]
pub struct Optimiser {
    pub(crate) settings: OptimiseSettings,
    pub(crate) scene_scale: f64,
    pub(crate) model: Model,
    pub(crate) adam: Adam,
    pub(crate) doubling: DoublingState,
    pub(crate) exposure: Exposure,
    pub(crate) step: u64,
    gradients: Gradients,
    order: FrameOrder,
    buffers: Buffers,
    /// The picture of the last step, and memory of drawing and pulling back.
    trace: Trace,
    workspace: Workspace,
    /// A frame at half the size.
    half: Option<TrainingFrame>,
}

/// Memory that steps use again.
#[derive(Debug, Default)]
struct Buffers {
    /// One for each size of pictures.
    comparisons: Vec<ImageComparison>,
    truth: Vec<f32>,
    exposed: Vec<f32>,
    slope: Vec<f32>,
    depth_slope: Vec<f32>,
    depth: DepthScratch,
}

impl Optimiser {
    /// Begins with a model.
    ///
    /// # Errors
    /// If there is no frame or no Gaussian, or a setting or a frame is out of range.
    pub fn new(
        model: Model,
        frames: &[TrainingFrame],
        settings: OptimiseSettings,
    ) -> Result<Self, OptimiseError> {
        settings.check()?;
        if frames.is_empty() {
            let problem = "there are 0".to_owned();
            let help = "give cameras whose pictures are there";
            return Err(OptimiseError::NoFrames { problem, help });
        }
        frames.iter().try_for_each(TrainingFrame::check)?;
        if model.is_empty() {
            let problem = "the model has 0 Gaussians".to_owned();
            let help = "give points, depth, or ask for random ones";
            return Err(OptimiseError::NoPoints { problem, help });
        }
        model.gaussians().check()?;
        let degree = model.gaussians().sh_degree;
        let good = degree == settings.initial.sh_degree;
        within("degree of the model's harmonics", degree.into(), good, "that of the settings")?;
        let scene_scale = match settings.scene_scale {
            SceneScale::Fixed(scale) => scale,
            SceneScale::FromCameras => scale_of_cameras(frames),
        };
        let adam = Adam::new(&model, AdamSettings::default());
        let mut this = Self {
            settings,
            scene_scale,
            adam,
            gradients: Gradients::default(),
            doubling: DoublingState::default(),
            exposure: Exposure::new(if settings.exposure { frames.len() } else { 0 }),
            order: FrameOrder::default(),
            buffers: Buffers::default(),
            trace: Trace::default(),
            workspace: Workspace::new(),
            half: None,
            step: 0,
            model,
        };
        this.fit_gradients();
        Ok(this)
    }

    /// The Gaussians as they are.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// What it does.
    pub fn settings(&self) -> &OptimiseSettings {
        &self.settings
    }

    /// How large the scene is taken to be.
    pub fn scene_scale(&self) -> f64 {
        self.scene_scale
    }

    /// Steps so far.
    pub fn steps_done(&self) -> u64 {
        self.step
    }

    /// Exposures of the frames; empty unless they are learned.
    pub fn exposure(&self) -> &Exposure {
        &self.exposure
    }

    /// `λ · mean(opacity) + λ · mean(scale)`: what the loss has beside the pictures.
    pub fn regularisation(&self) -> f64 {
        let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len().max(1) as f64;
        let g = self.model.gaussians();
        f64::from(self.settings.opacity_reg) * mean(&g.opacities)
            + f64::from(self.settings.scale_reg) * mean(g.scales.as_flattened())
    }

    /// The frame of the next step: every epoch another order, each frame once.
    pub fn next_frame(&mut self, frames: usize) -> usize {
        self.order.at(self.settings.seed, self.step, frames)
    }

    /// One step with the frame whose turn it is.
    ///
    /// # Errors
    /// As [`step_with`](Self::step_with).
    pub fn step(&mut self, frames: &[TrainingFrame]) -> Result<StepReport, OptimiseError> {
        let number = self.next_frame(frames.len());
        self.step_with(&frames[number], number)
    }

    /// One step with a frame and its number.
    ///
    /// # Errors
    /// If the loss is not finite, or the rasterizer refuses what it is given. The state is then that of
    /// the step before.
    pub fn step_with(
        &mut self,
        frame: &TrainingFrame,
        number: usize,
    ) -> Result<StepReport, OptimiseError> {
        let least = self.settings.ssim_border.least_side() as u32;
        let large = (frame.view.width / 2).min(frame.view.height / 2) >= least.max(1);
        if self.step < self.settings.half_steps && large {
            let half = match self.half.take() {
                Some(mut half) => {
                    frame.halve_into(&mut half);
                    half
                }
                None => frame.halved(),
            };
            let report = self.step_at(&half, number);
            self.half = Some(half);
            return report;
        }
        self.half = None;
        self.step_at(frame, number)
    }

    /// One step with a frame of the size that is drawn.
    fn step_at(
        &mut self,
        frame: &TrainingFrame,
        number: usize,
    ) -> Result<StepReport, OptimiseError> {
        let report = self.pull(frame, number)?;
        let refined = self.update([frame.view.width, frame.view.height])?;
        self.step += 1;
        Ok(StepReport { refined, gaussians: self.model.len(), ..report })
    }

    /// Draws, compares, and adds the derivatives to `gradients`.
    fn pull(&mut self, frame: &TrainingFrame, number: usize) -> Result<StepReport, OptimiseError> {
        let settings = &self.settings;
        let behind = settings.background.at(settings.seed, self.step, frame.alpha.is_some());
        let raster = settings.raster_on(behind);
        let term = settings.depth_loss();
        let measured = term.and_then(|term| Some((term, frame.depth.as_ref()?)));
        let request = TraceRequest {
            rgb: true,
            depth: measured.is_some(),
            sh_degree: Some(settings.sh_degree_at(self.step)),
        };
        let (workspace, traced) = (&mut self.workspace, &mut self.trace);
        workspace.trace(&self.model.gaussians, &frame.view, &raster, request, traced)?;
        let rgb = traced.picture.rgb.as_deref().unwrap_or_default();
        let b = &mut self.buffers;
        b.slope.resize(rgb.len(), 0.0);
        let mask = frame.mask.as_deref();
        let mut behind_truth = behind;
        if settings.exposure {
            // What is behind is exposed as the picture is, so that it says nothing about exposure.
            self.exposure.apply(number, &behind, &mut b.exposed);
            behind_truth.copy_from_slice(&b.exposed);
            self.exposure.apply(number, rgb, &mut b.exposed);
        }
        frame.put_over(behind_truth, &mut b.truth);
        let pred = if settings.exposure { &b.exposed[..] } else { rgb };
        let size = [frame.view.width as usize, frame.view.height as usize];
        let comparison = comparison(&mut b.comparisons, size, settings.image())?;
        let image = comparison.compare(pred, &b.truth, mask, &mut b.slope)?;
        let depth = match measured {
            Some((term, measured)) => compare_depth(term, &traced.picture, measured, mask, b)?,
            None => DepthLoss::default(),
        };
        if let Some(value) = [image.loss, depth.mean].into_iter().find(|v| !v.is_finite()) {
            let (step, frame) = (self.step, frame.name.clone());
            return Err(OptimiseError::NotFinite { step, frame, value });
        }
        if settings.exposure {
            self.exposure.learn(number, rgb, &mut b.slope, settings.rates.exposure);
        }
        let of = |kind| measured.filter(|m| m.0.kind == kind).map(|_| &b.depth_slope[..]);
        let upstream = Upstream {
            rgb: Some(&b.slope),
            depth_accumulated: of(DepthKind::Accumulated),
            depth_expected: of(DepthKind::Expected),
            ..Upstream::default()
        };
        let (model, all) = (&self.model.gaussians, GradMask::all());
        let gradients = &mut self.gradients;
        workspace.backward(model, &frame.view, &raster, traced, &upstream, all, gradients)?;
        Ok(StepReport {
            step: self.step,
            frame: number,
            image,
            depth,
            visible: traced.projected.len(),
            ..StepReport::default()
        })
    }

    /// Adam and the strategy, in their order.
    fn update(&mut self, size: [u32; 2]) -> Result<Refined, OptimiseError> {
        let rates = self.settings.rates_at(self.step, self.scene_scale);
        if matches!(self.settings.strategy, Strategy::Default(_)) {
            self.doubling.add(&self.gradients.screen, &self.trace.projected.index, size);
        }
        let refined = match self.settings.order {
            StepOrder::Gsplat13 => {
                let refined = self.refine(rates.means);
                if !refined.is_any() {
                    self.adam_step(&rates);
                }
                refined
            }
            StepOrder::Gsplat16 => {
                self.adam_step(&rates);
                let next = self.settings.means_rate(self.step + 1, self.scene_scale);
                self.refine(next)
            }
        };
        if refined.is_any() {
            self.fit_gradients();
        } else {
            self.gradients.screen.fill([0.0; 2]);
        }
        Ok(refined)
    }

    fn adam_step(&mut self, rates: &crate::Rates) {
        let degree = self.settings.sh_degree_at(self.step);
        let regularisers = self.settings.regularisers();
        self.adam.step(&mut self.model, &mut self.gradients, rates, regularisers, degree);
    }

    fn refine(&mut self, means_rate: f64) -> Refined {
        let (seed, step) = (self.settings.seed, self.step);
        let both = (&mut self.model, &mut self.adam);
        match &self.settings.strategy {
            Strategy::Mcmc(mcmc) => {
                let refined = mcmc.refine(both.0, both.1, seed, step);
                mcmc.shake(&mut self.model, means_rate, seed, step);
                refined
            }
            Strategy::Default(settings) => {
                settings.refine(&mut self.doubling, both, self.scene_scale, seed, step)
            }
            Strategy::Fixed => Refined::default(),
        }
    }

    /// Makes the gradients zeros of the model's size.
    pub(crate) fn fit_gradients(&mut self) {
        let (n, g) = (self.model.len(), &mut self.gradients);
        let screen = if matches!(self.settings.strategy, Strategy::Default(_)) { n } else { 0 };
        zeros(&mut g.means, n);
        zeros(&mut g.quats, n);
        zeros(&mut g.scales, n);
        zeros(&mut g.opacities, n);
        zeros(&mut g.sh, n * self.model.sh_stride());
        zeros(&mut g.screen, screen);
    }
}

/// Compares drawn with measured depth; the derivative goes to the buffers.
fn compare_depth(
    term: DepthTerm,
    picture: &Rendered,
    measured: &[f32],
    mask: Option<&[u8]>,
    b: &mut Buffers,
) -> Result<DepthLoss, OptimiseError> {
    let drawn = match term.kind {
        DepthKind::Accumulated => picture.depth_accumulated.as_deref(),
        DepthKind::Expected => picture.depth_expected.as_deref(),
    };
    let (drawn, slope) = (drawn.unwrap_or_default(), &mut b.depth_slope);
    slope.resize(drawn.len(), 0.0);
    depth_loss(drawn, measured, mask, term.outliers, term.weight, &mut b.depth, slope)
}

/// The comparison of pictures of that size.
fn comparison(
    all: &mut Vec<ImageComparison>,
    size: [usize; 2],
    weights: ImageWeights,
) -> Result<&mut ImageComparison, OptimiseError> {
    let at = all.iter().position(|c| c.size() == size).unwrap_or(all.len());
    if at == all.len() {
        all.push(ImageComparison::new(size[0], size[1], weights)?);
    }
    Ok(&mut all[at])
}

fn zeros<T: Copy + Default>(values: &mut Vec<T>, len: usize) {
    values.clear();
    values.resize(len, T::default());
}

/// Which frame comes when.
#[derive(Debug, Default)]
struct FrameOrder {
    epoch: Option<u64>,
    order: Vec<usize>,
}

impl FrameOrder {
    fn at(&mut self, seed: u64, step: u64, frames: usize) -> usize {
        let (epoch, place) = (step / frames as u64, (step % frames as u64) as usize);
        if self.epoch != Some(epoch) || self.order.len() != frames {
            self.epoch = Some(epoch);
            self.order.clear();
            self.order.extend(0..frames);
            let counter = Counter::new(seed, Purpose::Order, epoch);
            for last in (1..frames).rev() {
                let [word, ..] = counter.words(last);
                let other = (u64::from(word) * (last as u64 + 1)) >> 32;
                self.order.swap(last, other as usize);
            }
        }
        self.order[place]
    }
}

#[cfg(test)]
mod by_hand;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Colors;
    use crate::frame::tests::view;
    use crate::initial::from_points;

    /// Steps at half the size are steps with frames that were halved before.
    #[test]
    fn half_steps_are_steps_of_halved_frames() {
        let pixels = 48 * 40;
        let frame = |i: usize| TrainingFrame {
            name: format!("{i}"),
            view: view(48, 40),
            rgb: Colors::Bytes((0..3 * pixels).map(|k| ((i + 1) * k * 37 % 251) as u8).collect()),
            alpha: None,
            depth: Some(vec![1.5 + 0.5 * i as f32; pixels]),
            mask: None,
        };
        let frames: Vec<_> = (0..3).map(frame).collect();
        let halved: Vec<_> = frames.iter().map(TrainingFrame::halved).collect();
        let points: Vec<[f32; 3]> = (0..200)
            .map(|i| [0.1 * (i % 20) as f32 - 1.0, 0.2 * (i / 20) as f32 - 1.0, 0.0])
            .collect();
        let settings = OptimiseSettings { half_steps: 6, ..OptimiseSettings::scenesplat() };
        let initial = settings.initial;
        let model = from_points(&points, &vec![[0.5; 3]; 200], &initial, 1).unwrap();
        let full = OptimiseSettings { half_steps: 0, ..settings };
        let mut warm = Optimiser::new(model.clone(), &frames, settings).unwrap();
        let mut by_hand = Optimiser::new(model.clone(), &halved, full).unwrap();
        for _ in 0..6 {
            assert_eq!(warm.step(&frames).unwrap(), by_hand.step(&halved).unwrap());
        }
        assert_eq!(warm.model(), by_hand.model());
        assert_ne!(warm.model(), &model);
        // Then at full size.
        assert_ne!(warm.step(&frames).unwrap().image, by_hand.step(&halved).unwrap().image);
    }

    #[test]
    fn every_epoch_has_every_frame_once() {
        let mut order = FrameOrder::default();
        let mut epochs = Vec::new();
        for epoch in 0..3u64 {
            let mut seen: Vec<usize> = (0..10).map(|i| order.at(5, 10 * epoch + i, 10)).collect();
            epochs.push(seen.clone());
            seen.sort_unstable();
            assert_eq!(seen, (0..10).collect::<Vec<_>>());
        }
        assert_ne!(epochs[0], epochs[1]);
        // The same without what came before: a resume.
        assert_eq!(FrameOrder::default().at(5, 23, 10), epochs[2][3]);
    }

    /// One Gaussian, in front of the camera (z = 0) or behind it (−5).
    fn alone(z: f32, settings: &OptimiseSettings) -> Model {
        let quat = [1.0, 0.0, 0.0, 0.0];
        let stored = crate::Stored { mean: [0.0, 0.0, z], log_scale: [-1.0; 3], quat, logit: -6.0 };
        let harmonics = 3 * (usize::from(settings.initial.sh_degree) + 1).pow(2);
        Model::from_arrays(&[stored], vec![0.3; harmonics], settings.initial.sh_degree).unwrap()
    }

    #[test]
    fn noise_after_adam_has_the_rate_of_the_next_step() {
        // Few steps, so that the rate falls by a third from one to the next.
        let settings = OptimiseSettings {
            order: StepOrder::Gsplat16,
            strategy: Strategy::Mcmc(crate::McmcSettings::default()),
            steps: 10,
            scene_scale: SceneScale::Fixed(1.0),
            half_steps: 0,
            ..OptimiseSettings::scenesplat()
        };
        let Strategy::Mcmc(mcmc) = settings.strategy else { panic!("not MCMC") };
        // Behind the camera no picture pulls at it.
        let frames = [crate::frame::tests::frame(view(16, 12), None)];
        let mut optimiser = Optimiser::new(alone(-5.0, &settings), &frames, settings).unwrap();
        optimiser.step(&frames).unwrap();
        let strength = (settings.means_rate(1, 1.0) * mcmc.noise) as f32;
        let g = optimiser.model().gaussians();
        let xi = Counter::new(settings.seed, Purpose::Noise, 0).normals(0);
        let by = crate::noise::displacement(g.quats[0], g.scales[0], g.opacities[0], xi, strength);
        for axis in 0..2 {
            let (found, want) = (g.means[0][axis], by[axis]);
            assert!((found - want).abs() < 1e-5 * want.abs() && want != 0.0, "{found} {want}");
        }
    }

    #[test]
    fn what_pulls_on_the_picture_is_counted_once() {
        let settings = OptimiseSettings {
            strategy: Strategy::Default(crate::DefaultSettings::default()),
            half_steps: 0,
            ..OptimiseSettings::scenesplat()
        };
        // Off the middle, before a picture that is brighter to one side.
        let mut frame = crate::frame::tests::frame(view(24, 20), None);
        frame.rgb = Colors::Bytes((0..3 * 24 * 20).map(|k| (k / 3 % 24 * 10) as u8).collect());
        let frames = [frame];
        let mut model = alone(0.0, &settings);
        model.set_shape(0, 0.5, [0.2; 3]);
        let mut optimiser = Optimiser::new(model, &frames, settings).unwrap();
        optimiser.step(&frames).unwrap();
        let first = optimiser.doubling.sum[0];
        assert!(first > 0.0);
        optimiser.step(&frames).unwrap();
        // The second pull is about as strong as the first; added up it would be twice that.
        let second = optimiser.doubling.sum[0] - first;
        assert!((second / first - 1.0).abs() < 0.3, "{first} {second}");
    }

    #[test]
    fn what_is_behind_a_transparent_picture_is_exposed_like_the_drawn_background() {
        let settings = OptimiseSettings {
            exposure: true,
            background: crate::Background::Fixed([0.5, 0.25, 0.75]),
            half_steps: 0,
            ..OptimiseSettings::scenesplat()
        };
        // A picture of nothing, and nothing to draw: what is behind is all there is, whatever the exposure.
        let mut frame = crate::frame::tests::frame(view(16, 12), None);
        frame.alpha = Some(vec![0; 16 * 12]);
        let frames = [frame];
        let mut optimiser = Optimiser::new(alone(-5.0, &settings), &frames, settings).unwrap();
        optimiser.exposure.values = vec![0.8, 0.9, 0.7, 0.05, 0.0, 0.1];
        let report = optimiser.step(&frames).unwrap();
        assert!(report.image.l1.abs() < 1e-6, "{:?}", report.image);
    }
}
