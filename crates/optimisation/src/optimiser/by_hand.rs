//! Steps put together from their parts.

use super::*;
use crate::frame::tests::{frame, view};
use crate::initial::{InitialSettings, from_points};
use crate::relocation::Relocation;
use crate::{Background, Colors, DefaultSettings, McmcSettings, Rates, Regularisers, SsimPadding};
use scenesplat_rasterizer::RasterSettings;
use scenesplat_rasterizer::backward::trace;

/// Two frames of other sizes with depth, one of them transparent in part, the other masked.
fn frames() -> Vec<TrainingFrame> {
    let made = |(i, (width, height)): (usize, (u32, u32))| {
        let mut view = view(width, height);
        (view.fy, view.world_to_camera[0][3]) = (1.1 * width as f32, 0.2 * i as f32 - 0.1);
        let mut frame = frame(view, Some(2.0));
        let pixels = view.pixels();
        frame.name = format!("frame {i}");
        frame.rgb =
            Colors::Bytes((0..3 * pixels).map(|k| ((i + 3) * k * 37 % 121) as u8).collect());
        frame.depth = Some((0..pixels).map(|k| 1.2 + 0.01 * (k % 90) as f32).collect());
        frame
    };
    let mut frames: Vec<_> = [(24, 14), (18, 20)].into_iter().enumerate().map(made).collect();
    frames[0].alpha = Some((0..24 * 14).map(|k| 120 + (k % 136) as u8).collect());
    frames[1].mask = Some((0..18 * 20).map(|k| u8::from(k % 7 != 0)).collect());
    frames
}

fn model(initial: &InitialSettings) -> Model {
    let points: Vec<[f32; 3]> = (0..40)
        .map(|i| [0.15 * (i % 8) as f32 - 0.5, 0.2 * (i / 8) as f32 - 0.4, 0.1 * (i % 3) as f32])
        .collect();
    let colors: Vec<[f32; 3]> = (0..40).map(|i| [0.2, 0.02 * i as f32, 0.7]).collect();
    from_points(&points, &colors, initial, 3).unwrap()
}

/// Everything of a step that has no memory of its own.
struct ByHand {
    model: Model,
    adam: Adam,
    doubling: DoublingState,
    exposure: Exposure,
}

impl ByHand {
    fn new(model: Model, frames: usize) -> Self {
        let adam = Adam::new(&model, AdamSettings::default());
        let exposure = Exposure::new(frames);
        Self { model, adam, doubling: DoublingState::default(), exposure }
    }

    fn step(&mut self, s: &OptimiseSettings, scale: f64, t: u64, f: &TrainingFrame, number: usize) {
        let behind = s.background.at(s.seed, t, f.alpha.is_some());
        let raster = RasterSettings {
            background: (behind != [0.0; 3]).then_some(behind),
            near: s.near,
            far: s.far,
            antialiased: s.antialiased,
            ..RasterSettings::gsplat_1_6()
        };
        // One more band every `sh_every` steps, up to 2.
        let degree = (t / s.sh_every).min(2) as u8;
        let request = TraceRequest { rgb: true, depth: true, sh_degree: Some(degree) };
        let g = &self.model.gaussians;
        let traced = trace(g, &f.view, &raster, request).unwrap();
        let drawn = traced.picture.rgb.as_deref().unwrap();
        let (mut pred, mut back, mut truth) = (drawn.to_vec(), behind.to_vec(), Vec::new());
        if s.exposure {
            self.exposure.apply(number, drawn, &mut pred);
            self.exposure.apply(number, &behind, &mut back);
        }
        f.put_over([back[0], back[1], back[2]], &mut truth);
        let size = [f.view.width as usize, f.view.height as usize];
        let weights = ImageWeights { ssim: s.ssim, padding: s.ssim_border };
        let mut comparison = ImageComparison::new(size[0], size[1], weights).unwrap();
        let mut slope = vec![0.0; pred.len()];
        comparison.compare(&pred, &truth, f.mask.as_deref(), &mut slope).unwrap();
        if s.exposure {
            self.exposure.learn(number, drawn, &mut slope, s.rates.exposure);
        }
        let mut upstream = Upstream { rgb: Some(&slope), ..Upstream::default() };
        let mut of_depth = vec![0.0; size[0] * size[1]];
        if let Some(term) = s.depth {
            let is_accumulated = term.kind == DepthKind::Accumulated;
            let p = &traced.picture;
            let of = if is_accumulated { &p.depth_accumulated } else { &p.depth_expected };
            let (of, measured, mask) =
                (of.as_deref().unwrap(), f.depth.as_deref().unwrap(), f.mask.as_deref());
            let scratch = &mut DepthScratch::default();
            depth_loss(of, measured, mask, term.outliers, term.weight, scratch, &mut of_depth)
                .unwrap();
            if is_accumulated {
                upstream.depth_accumulated = Some(&of_depth);
            } else {
                upstream.depth_expected = Some(&of_depth);
            }
        }
        let mut slopes = Gradients::zeros(g, 0);
        if let Strategy::Default(_) = s.strategy {
            slopes.screen = vec![[0.0; 2]; g.means.len()];
        }
        let (mask, to) = (GradMask::all(), &mut slopes);
        Workspace::new().backward(g, &f.view, &raster, &traced, &upstream, mask, to).unwrap();
        if let Strategy::Default(_) = s.strategy {
            let size = [f.view.width, f.view.height];
            self.doubling.add(&slopes.screen, &traced.projected.index, size);
        }
        let at = |t: u64| s.rates.means * scale * s.rates.means_end.powf(t as f64 / s.steps as f64);
        let r = &s.rates;
        let rates = Rates {
            means: at(t),
            scales: r.scales,
            quats: r.quats,
            opacities: r.opacities,
            sh0: r.sh0,
            sh_rest: r.sh_rest,
        };
        let regularisers = Regularisers { opacity: s.opacity_reg, scale: s.scale_reg };
        if s.order == StepOrder::Gsplat16 {
            self.adam.step(&mut self.model, &mut slopes, &rates, regularisers, degree);
        }
        let rate = at(t + u64::from(s.order == StepOrder::Gsplat16));
        let refined = match &s.strategy {
            Strategy::Mcmc(mcmc) => {
                let refined = mcmc.refine(&mut self.model, &mut self.adam, s.seed, t);
                mcmc.shake(&mut self.model, rate, s.seed, t);
                refined
            }
            Strategy::Default(of) => {
                of.refine(&mut self.doubling, (&mut self.model, &mut self.adam), scale, s.seed, t)
            }
            Strategy::Fixed => Refined::default(),
        };
        if s.order == StepOrder::Gsplat13 && !refined.is_any() {
            self.adam.step(&mut self.model, &mut slopes, &rates, regularisers, degree);
        }
    }
}

fn cases() -> [(OptimiseSettings, f64); 3] {
    let base = OptimiseSettings::scenesplat();
    let mcmc =
        McmcSettings { cap: 47, refine_start: 1, refine_every: 2, ..McmcSettings::default() };
    let authors = OptimiseSettings {
        steps: 9,
        strategy: Strategy::Mcmc(mcmc),
        scene_scale: SceneScale::Fixed(2.0),
        sh_every: 2,
        ssim: 0.3,
        initial: InitialSettings { sh_degree: 2, ..base.initial },
        opacity_reg: 0.03,
        ..base
    };
    let term = DepthTerm { weight: 0.4, kind: DepthKind::Expected, ..base.depth.unwrap() };
    let later = OptimiseSettings {
        order: StepOrder::Gsplat16,
        strategy: Strategy::Mcmc(McmcSettings { relocation: Relocation::Gsplat16, ..mcmc }),
        scene_scale: SceneScale::FromCameras,
        ssim_border: SsimPadding::Zero,
        depth: Some(term),
        near: 2.05,
        antialiased: false,
        background: Background::Fixed([0.3, 0.6, 0.1]),
        exposure: true,
        ..authors
    };
    let doubling =
        DefaultSettings { refine_start: 1, refine_every: 3, reset_every: 5, ..Default::default() };
    let plain = OptimiseSettings {
        strategy: Strategy::Default(doubling),
        depth: None,
        far: 2.15,
        background: Background::Random,
        ..authors
    };
    // Cameras 0.2 apart: 1.1 times 0.1.
    [(authors, 2.0), (later, 1.1 * 0.1), (plain, 2.0)]
}

#[test]
fn a_step_is_its_parts_one_after_the_other() {
    let frames = frames();
    for (case, (settings, scale)) in cases().into_iter().enumerate() {
        let model = model(&settings.initial);
        let mut optimiser = Optimiser::new(model.clone(), &frames, settings).unwrap();
        assert!((optimiser.scene_scale() / scale - 1.0).abs() < 1e-6, "{case}");
        let scale = optimiser.scene_scale();
        let mut by_hand = ByHand::new(model, frames.len());
        for t in 0..7 {
            let number = optimiser.next_frame(2);
            let before = by_hand.model.len();
            let report = optimiser.step(&frames).unwrap();
            by_hand.step(&settings, scale, t, &frames[number], number);
            assert_eq!(optimiser.model(), &by_hand.model, "case {case}, step {t}");
            assert_eq!(optimiser.adam, by_hand.adam, "case {case}, step {t}");
            assert_eq!(
                (report.step, report.frame, report.gaussians),
                (t, number, by_hand.model.len())
            );
            assert_eq!(report.gaussians + report.refined.removed, before + report.refined.added);
            assert!(report.visible > 0 && report.visible <= before);
            assert_eq!(report.depth.count > 0, settings.depth.is_some());
            assert!((report.psnr() + 10.0 * report.image.mse.log10()).abs() < 1e-12);
        }
        if settings.exposure {
            assert_eq!(optimiser.exposure(), &by_hand.exposure);
        }
        assert_eq!(
            (optimiser.steps_done(), optimiser.doubling == by_hand.doubling),
            (7, true),
            "{case}"
        );
        // What is beside the pictures: λ times the mean of each.
        let g = optimiser.model().gaussians();
        let mean = |v: &[f32]| v.iter().map(|v| f64::from(*v)).sum::<f64>() / v.len() as f64;
        let want = f64::from(settings.opacity_reg) * mean(&g.opacities)
            + f64::from(settings.scale_reg) * mean(g.scales.as_flattened());
        assert!((optimiser.regularisation() - want).abs() < 1e-12 && want > 0.0);
    }
}

#[test]
fn frames_are_shuffled_from_the_last_place_down() {
    let mut order = FrameOrder::default();
    for epoch in [0u64, 1, 5] {
        let counter = Counter::new(9, Purpose::Order, epoch);
        let mut want: Vec<usize> = (0..7).collect();
        for last in (1..7).rev() {
            let unit = counter.units(last)[0];
            want.swap(last, (unit * (last + 1) as f64) as usize);
        }
        let found: Vec<usize> = (0..7).map(|i| order.at(9, 7 * epoch + i, 7)).collect();
        assert_eq!(found, want, "{epoch}");
    }
    // Of another number of frames the order is another.
    assert_eq!(order.at(9, 35, 3), FrameOrder::default().at(9, 35, 3));
}

#[test]
fn small_pictures_are_not_halved() {
    let settings = OptimiseSettings { half_steps: 2, ..OptimiseSettings::scenesplat() };
    // The mirrored border needs six pixels: 12 × 13 has them at half the size, 12 × 11 and 11 × 12 have not.
    for (size, is_halved) in [((12, 13), true), ((12, 11), false), ((11, 12), false)] {
        let frames = [frame(view(size.0, size.1), Some(2.0))];
        let mut optimiser = Optimiser::new(model(&settings.initial), &frames, settings).unwrap();
        for step in 0..3 {
            optimiser.step(&frames).unwrap();
            assert_eq!(optimiser.half.is_some(), is_halved && step < 2, "{size:?} {step}");
        }
    }
}

#[test]
fn what_cannot_begin_or_go_on_is_refused_by_name() {
    let settings = OptimiseSettings::scenesplat();
    let (frames, model) = (frames(), model(&settings.initial));
    let refused = |model: Model, frames: &[TrainingFrame], settings| {
        Optimiser::new(model, frames, settings).unwrap_err().to_string()
    };
    assert!(
        refused(model.clone(), &[], settings)
            .starts_with("no frame to learn from is left: there are 0")
    );
    let error = refused(Model::new(3), &frames, settings);
    assert!(error.starts_with("no point to begin with: the model has 0 Gaussians"), "{error}");
    let error = refused(Model::new(3), &frames, OptimiseSettings { steps: 0, ..settings });
    assert!(error.starts_with("steps is 0"), "{error}");
    let mut other = settings;
    other.initial.sh_degree = 2;
    assert!(
        refused(model.clone(), &frames, other).starts_with("degree of the model's harmonics is 3")
    );
    let mut bad = frames.clone();
    bad[1].mask = Some(vec![1]);
    assert!(refused(model.clone(), &bad, settings).contains("mask: expected 360 values, got 1"));
    // A loss that is no number leaves everything as it was.
    let mut endless = frames[1].clone();
    endless.rgb = Colors::Floats(vec![3e38; 3 * 18 * 20]);
    let mut optimiser = Optimiser::new(model.clone(), &frames, settings).unwrap();
    let error = optimiser.step_with(&endless, 1).unwrap_err().to_string();
    assert!(error.starts_with("step 0, frame \"frame 1\": the loss is"), "{error}");
    assert_eq!((optimiser.steps_done(), optimiser.model()), (0, &model));
    let mut whole = Optimiser::new(model, &frames, settings).unwrap();
    assert_eq!(optimiser.step(&frames).unwrap(), whole.step(&frames).unwrap());
    assert_eq!(optimiser.model(), whole.model());
}
