//! Ten steps of a small scene, and what a step may depend on.

use crate::support::{golden, number};
use scenesplat_optimisation::{
    Background, BaseRates, Colors, McmcSettings, Model, OptimiseError, OptimiseSettings, Optimiser,
    SceneScale, SsimPadding, StepOrder, Stored, Strategy, TrainingFrame, newest_checkpoint,
};
use scenesplat_rasterizer::View;
use scenesplat_test_support::{Golden, compare_relative as compare};

fn frames(golden: &Golden) -> Vec<TrainingFrame> {
    let (lens, poses) = (golden.f32s("train_K"), golden.f32s("train_V"));
    let target = golden.f32s("train_target");
    let frame = |(i, pose): (usize, &[f32])| {
        let row = |r: usize| [pose[4 * r], pose[4 * r + 1], pose[4 * r + 2], pose[4 * r + 3]];
        let view = View {
            world_to_camera: [row(0), row(1), row(2)],
            fx: lens[0],
            fy: lens[4],
            cx: lens[2],
            cy: lens[5],
            width: 48,
            height: 32,
        };
        let rgb = &target[i * 4608..(i + 1) * 4608];
        TrainingFrame {
            name: format!("frame {i}"),
            view,
            rgb: Colors::Floats(rgb.to_vec()),
            alpha: None,
            depth: None,
            mask: None,
        }
    };
    poses.chunks_exact(16).enumerate().map(frame).collect()
}

fn model(golden: &Golden) -> Model {
    let (means, quats) =
        (golden.rows::<3>("train_init_means"), golden.rows::<4>("train_init_quats"));
    let (logs, logits) = (golden.rows::<3>("train_init_logs"), golden.f32s("train_init_logit"));
    let row =
        |i: usize| Stored { mean: means[i], log_scale: logs[i], quat: quats[i], logit: logits[i] };
    let rows: Vec<Stored> = (0..means.len()).map(row).collect();
    Model::from_arrays(&rows, golden.f32s("train_init_sh"), 3).unwrap()
}

/// The settings of the fixture: a fixed number of Gaussians, all bands, no noise.
fn settings() -> OptimiseSettings {
    let base = OptimiseSettings::gsplat_mcmc();
    OptimiseSettings {
        strategy: Strategy::Fixed,
        order: StepOrder::Gsplat16,
        // 2.4e-4 for the centers.
        scene_scale: SceneScale::Fixed(1.5),
        rates: BaseRates::default(),
        sh_every: 0,
        ssim_border: SsimPadding::Zero,
        opacity_reg: 0.01,
        scale_reg: 0.01,
        ..base
    }
}

#[test]
fn ten_steps() {
    let Some(golden) = golden() else { return };
    let frames = frames(&golden);
    let mut optimiser = Optimiser::new(model(&golden), &frames, settings()).unwrap();
    for step in 0..10usize {
        let regularisation = optimiser.regularisation();
        let report = optimiser.step_with(&frames[step % 2], step % 2).unwrap();
        let loss = report.image.loss + regularisation;
        let want = number(&golden, &format!("/train/losses/{step}"));
        println!("step {step}: {loss:.8} {want:.8}");
        assert!((loss - want).abs() < 1e-4 * want, "step {step}: {loss} {want}");
        let psnr = number(&golden, &format!("/train/psnr_before_step/{step}"));
        assert!((report.psnr() - psnr).abs() < 1e-3, "step {step}: {} dB {psnr}", report.psnr());
    }
    let g = optimiser.model().gaussians();
    compare("means", g.means.as_flattened(), &golden.f64s("train_final_means"), 1e-3);
    compare("quats", g.quats.as_flattened(), &golden.f64s("train_final_quats"), 1e-3);
    compare(
        "logs",
        optimiser.model().log_scales().as_flattened(),
        &golden.f64s("train_final_logs"),
        1e-3,
    );
    compare("logits", optimiser.model().logits(), &golden.f64s("train_final_logit"), 1e-3);
    compare("sh", &g.sh, &golden.f64s("train_final_sh"), 1e-3);
}

/// A run of MCMC on the small scene, with noise and moves every fifth step.
fn lively(order: StepOrder, exposure: bool) -> OptimiseSettings {
    let mcmc = McmcSettings {
        cap: 300,
        refine_start: 3,
        refine_stop: 1000,
        refine_every: 5,
        ..McmcSettings::default()
    };
    OptimiseSettings {
        strategy: Strategy::Mcmc(mcmc),
        order,
        exposure,
        sh_every: 4,
        steps: 40,
        background: Background::Random,
        ..settings()
    }
}

fn run(optimiser: &mut Optimiser, frames: &[TrainingFrame], until: u64) {
    while optimiser.steps_done() < until {
        optimiser.step(frames).unwrap();
    }
}

#[test]
fn neither_threads_nor_a_resume_change_a_bit() {
    let Some(golden) = golden() else { return };
    let frames = frames(&golden);
    let folder = tempfile::tempdir().unwrap();
    for (order, exposure) in [(StepOrder::Gsplat13, false), (StepOrder::Gsplat16, true)] {
        let settings = lively(order, exposure);
        let on = |threads: usize, work: &(dyn Fn() -> Optimiser + Sync)| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
        };
        let whole = || {
            let mut optimiser = Optimiser::new(model(&golden), &frames, settings).unwrap();
            run(&mut optimiser, &frames, 23);
            optimiser
        };
        let (one, three) = (on(1, &whole), on(3, &whole));
        assert_eq!(one.model(), three.model());
        assert!(one.model().len() > 220, "Gaussians were added: {}", one.model().len());
        let root = folder.path().join(format!("{order:?}"));
        let interrupted = || {
            let mut optimiser = Optimiser::new(model(&golden), &frames, settings).unwrap();
            run(&mut optimiser, &frames, 11);
            let place = optimiser.save(&root, &frames, 2).unwrap();
            assert_eq!(newest_checkpoint(&root).unwrap(), Some(place.clone()));
            let mut optimiser = Optimiser::resume(&place, &frames, Some(settings)).unwrap();
            run(&mut optimiser, &frames, 23);
            optimiser
        };
        let resumed = on(2, &interrupted);
        assert_eq!(one.model(), resumed.model());
        assert_eq!(one.exposure(), resumed.exposure());
        let place = newest_checkpoint(&root).unwrap().unwrap();
        let other = OptimiseSettings { seed: 1, ..settings };
        let error = Optimiser::resume(&place, &frames, Some(other)).unwrap_err().to_string();
        assert!(error.contains("other settings"), "{error}");
        let error = Optimiser::resume(&place, &frames[..1], None).unwrap_err().to_string();
        assert!(error.contains("of 2 frames"), "{error}");
        std::fs::write(place.join("arrays.safetensors"), b"short").unwrap();
        let error = Optimiser::resume(&place, &frames, None).unwrap_err();
        assert!(matches!(error, OptimiseError::Checkpoint { .. }), "{error}");
    }
}

/// Only the newest checkpoints are kept.
#[test]
fn old_checkpoints_go() {
    let Some(golden) = golden() else { return };
    let frames = frames(&golden);
    let folder = tempfile::tempdir().unwrap();
    let mut optimiser = Optimiser::new(model(&golden), &frames, settings()).unwrap();
    for _ in 0..4 {
        optimiser.step(&frames).unwrap();
        optimiser.save(folder.path(), &frames, 2).unwrap();
    }
    let mut names: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["step-000000003", "step-000000004"]);
}
