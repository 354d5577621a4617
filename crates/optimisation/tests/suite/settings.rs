//! What the presets are, and what they lead to at each step.

use scenesplat_optimisation::depth_loss::DepthOutliers;
use scenesplat_optimisation::initial::InitialSettings;
use scenesplat_optimisation::relocation::Relocation;
use scenesplat_optimisation::{
    Background, BaseRates, DefaultSettings, DepthKind, DepthTerm, McmcSettings, OptimiseSettings,
    Rates, SceneScale, SsimPadding, StepOrder, Strategy,
};
use scenesplat_rasterizer::RasterSettings;

fn authors() -> OptimiseSettings {
    OptimiseSettings::scenesplat()
}

/// Numbers of optimise.md, sections 1 to 4.
#[test]
fn presets_have_the_documented_numbers() {
    let rates = BaseRates {
        means: 1.6e-4,
        means_end: 0.01,
        scales: 5e-3,
        quats: 1e-3,
        opacities: 5e-2,
        sh0: 2.5e-3,
        sh_rest: 1.25e-4,
        exposure: 1e-3,
    };
    let mcmc = McmcSettings {
        cap: 1_500_000,
        noise: 5e5,
        refine_start: 500,
        refine_stop: 25_000,
        refine_every: 100,
        min_opacity: 0.005,
        relocation: Relocation::Gsplat15,
        few: 10_000,
    };
    let (kind, outliers) = (DepthKind::Accumulated, DepthOutliers::MedianRule);
    let want = OptimiseSettings {
        steps: 30_000,
        seed: 42,
        strategy: Strategy::Mcmc(mcmc),
        order: StepOrder::Gsplat13,
        rates,
        scene_scale: SceneScale::Fixed(1.0),
        sh_every: 1000,
        ssim: 0.2,
        ssim_border: SsimPadding::Reflect,
        depth: Some(DepthTerm { weight: 1.0, kind, outliers }),
        opacity_reg: 0.0,
        scale_reg: 0.02,
        initial: InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 3, random_quats: true },
        near: 0.01,
        far: 100.0,
        antialiased: true,
        background: Background::Auto,
        half_steps: 0,
        exposure: false,
    };
    assert_eq!(authors(), want);
    let gsplat = OptimiseSettings {
        strategy: Strategy::Mcmc(McmcSettings {
            cap: 1_000_000,
            relocation: Relocation::Gsplat16,
            few: 0,
            ..mcmc
        }),
        order: StepOrder::Gsplat16,
        scene_scale: SceneScale::FromCameras,
        ssim_border: SsimPadding::Valid,
        depth: None,
        opacity_reg: 0.01,
        scale_reg: 0.01,
        initial: InitialSettings { scale: 0.1, ..want.initial },
        far: 1e10,
        antialiased: false,
        ..want
    };
    assert_eq!(OptimiseSettings::gsplat_mcmc(), gsplat);
    let default = OptimiseSettings {
        strategy: Strategy::Default(DefaultSettings::default()),
        opacity_reg: 0.0,
        scale_reg: 0.0,
        initial: InitialSettings { opacity: 0.1, scale: 1.0, ..want.initial },
        ..gsplat
    };
    assert_eq!(OptimiseSettings::gsplat_default(), default);
}

#[test]
fn a_shorter_run_has_all_its_steps_in_proportion() {
    let base = OptimiseSettings { half_steps: 4000, ..authors() };
    // A tenth; 37 of 1000, rounded; never 0.
    let short = base.with_steps(3037);
    let Strategy::Mcmc(mcmc) = short.strategy else { panic!("not MCMC") };
    assert_eq!((short.steps, short.sh_every, short.half_steps), (3037, 101, 405));
    assert_eq!(
        (mcmc.refine_start, mcmc.refine_stop, mcmc.refine_every, mcmc.cap),
        (51, 2531, 100, 1_500_000)
    );
    let one = OptimiseSettings { half_steps: 1, ..base }.with_steps(1);
    let Strategy::Mcmc(mcmc) = one.strategy else { panic!("not MCMC") };
    assert_eq!((one.sh_every, one.half_steps, mcmc.refine_start, mcmc.refine_stop), (1, 0, 1, 1));
    let long =
        OptimiseSettings { sh_every: 0, ..OptimiseSettings::gsplat_default() }.with_steps(60_000);
    let Strategy::Default(doubling) = long.strategy else { panic!("not the default") };
    assert_eq!((long.sh_every, doubling.refine_start, doubling.refine_stop), (0, 1000, 30_000));
    assert_eq!((doubling.reset_every, doubling.refine_every), (6000, 100));
    // Opacities are not set back more often than Gaussians are doubled.
    let Strategy::Default(doubling) = OptimiseSettings::gsplat_default().with_steps(300).strategy
    else {
        panic!("not the default")
    };
    assert_eq!((doubling.reset_every, doubling.refine_stop), (100, 150));
    let rest = OptimiseSettings { strategy: Strategy::Fixed, ..base }.with_steps(15_000);
    assert_eq!((rest.strategy, rest.sh_every), (Strategy::Fixed, 500));
}

#[test]
fn what_a_step_has_of_the_settings() {
    let s = OptimiseSettings { opacity_reg: 0.3, near: 0.5, far: 7.0, ..authors() };
    // Half way the factor is √0.01.
    let want = Rates {
        means: 1.6e-4 * 2.5 * 0.1,
        scales: 5e-3,
        quats: 1e-3,
        opacities: 5e-2,
        sh0: 2.5e-3,
        sh_rest: 1.25e-4,
    };
    let found = s.rates_at(15_000, 2.5);
    assert!((found.means / want.means - 1.0).abs() < 1e-12);
    assert_eq!(Rates { means: want.means, ..found }, want);
    assert_eq!(s.rates_at(0, 2.0).means, 3.2e-4);
    let all = OptimiseSettings { sh_every: 0, ..s };
    assert_eq!([0, 1].map(|t| all.sh_degree_at(t)), [3, 3]);
    let mut low = s;
    low.initial.sh_degree = 1;
    assert_eq!([0, 1000, 9000].map(|t| low.sh_degree_at(t)), [0, 1, 1]);
    let raster =
        RasterSettings { near: 0.5, far: 7.0, antialiased: true, ..RasterSettings::gsplat_1_6() };
    assert_eq!(s.raster(), raster);
    let white = OptimiseSettings {
        background: Background::Fixed([1.0, 0.5, 0.0]),
        antialiased: false,
        ..s
    };
    let want = RasterSettings { background: Some([1.0, 0.5, 0.0]), antialiased: false, ..raster };
    assert_eq!(white.raster(), want);
    assert_eq!((s.image().ssim, s.image().padding), (0.2, SsimPadding::Reflect));
    assert_eq!((s.regularisers().opacity, s.regularisers().scale), (0.3, 0.02));
    let term = s.depth.unwrap();
    assert_eq!(s.depth_loss(), Some(term));
    let none = OptimiseSettings { depth: Some(DepthTerm { weight: 0.0, ..term }), ..s };
    assert_eq!(
        (none.depth_loss(), OptimiseSettings { depth: None, ..s }.depth_loss()),
        (None, None)
    );
}

#[test]
fn every_number_out_of_its_range_is_named() {
    let good = authors();
    let (mcmc, doubling) = (
        McmcSettings { cap: 0, ..Default::default() },
        DefaultSettings { refine_every: 0, ..Default::default() },
    );
    let rates = |change: &dyn Fn(&mut BaseRates)| {
        let mut settings = good;
        change(&mut settings.rates);
        settings
    };
    let depth = DepthTerm { weight: -1.0, ..good.depth.unwrap() };
    let cases = [
        (rates(&|r| r.means = -1.0), "rate of the centers is -1"),
        (rates(&|r| r.scales = f64::NAN), "rate of the scales is NaN"),
        (rates(&|r| r.quats = f64::INFINITY), "rate of the quaternions is inf"),
        (rates(&|r| r.opacities = -2.0), "rate of the opacities is -2"),
        (rates(&|r| r.sh0 = -3.0), "rate of the first harmonic is -3"),
        (rates(&|r| r.sh_rest = -4.0), "rate of the harmonics is -4"),
        (rates(&|r| r.exposure = -5.0), "rate of the exposure is -5"),
        (rates(&|r| r.means_end = 0.0), "means_end is 0"),
        (rates(&|r| r.means_end = 1.5), "means_end is 1.5"),
        (OptimiseSettings { opacity_reg: -1.0, ..good }, "opacity_reg is -1"),
        (OptimiseSettings { scale_reg: -1.0, ..good }, "scale_reg is -1"),
        (OptimiseSettings { depth: Some(depth), ..good }, "depth weight is -1"),
        (OptimiseSettings { ssim: -0.5, ..good }, "weight of SSIM is -0.5"),
        (
            OptimiseSettings { scene_scale: SceneScale::Fixed(f64::INFINITY), ..good },
            "scene_scale is inf",
        ),
        (OptimiseSettings { strategy: Strategy::Mcmc(mcmc), ..good }, "cap is 0"),
        (OptimiseSettings { strategy: Strategy::Default(doubling), ..good }, "refine_every is 0"),
        (
            OptimiseSettings { background: Background::Fixed([0.0, 2.0, 0.0]), ..good },
            "background is 2",
        ),
        (OptimiseSettings { far: 0.005, ..good }, "far"),
    ];
    for (settings, want) in cases {
        let error = settings.check().unwrap_err().to_string();
        assert!(error.starts_with(want), "{error}, not {want}");
    }
    let mut edges = rates(&|r| (r.means, r.means_end) = (0.0, 1.0));
    (edges.ssim, edges.steps, edges.opacity_reg) = (1.0, 1, 0.0);
    edges.check().unwrap();
}

#[test]
fn settings_are_written_by_their_names() {
    let text = serde_json::to_value(authors()).unwrap();
    assert_eq!(text["order"], "gsplat-1.3");
    assert_eq!(text["ssim_border"], "reflect");
    assert_eq!(text["scene_scale"]["fixed"], 1.0);
    assert_eq!(text["depth"]["kind"], "accumulated");
    assert_eq!(text["depth"]["outliers"], "median_rule");
    assert_eq!(text["strategy"]["mcmc"]["relocation"], "gsplat-1.5");
    let gsplat = serde_json::to_value(OptimiseSettings::gsplat_default()).unwrap();
    assert_eq!(
        (&gsplat["order"], &gsplat["scene_scale"]),
        (&"gsplat-1.6".into(), &"from_cameras".into())
    );
    assert!(gsplat["strategy"]["default"].is_object());
    let mut wrong = text;
    wrong["ssim_border"] = "mirror".into();
    let error = serde_json::from_value::<OptimiseSettings>(wrong).unwrap_err().to_string();
    assert!(error.contains("\"mirror\": valid, reflect and zero are borders"), "{error}");
}
