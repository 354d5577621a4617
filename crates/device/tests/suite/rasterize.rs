use crate::{Buffer, Grid, GridError};
use crate::{assert_near, in_any_order};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::rasterize::{
    self, Gaussians, MOST_PAIRS, Picture, RasterizeError, Settings, View,
};
use scenesplat_rasterizer as cpu;

crate::support::on_grid! {
    pictures_are_those_of_the_cpu
    what_cannot_be_drawn_is_counted
    pairs_that_no_memory_holds_are_refused
}

/// A cloud in front of the camera, beside it and behind.
fn cloud(n: usize, degree: u8, seed: u64) -> cpu::Gaussians {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut out = cpu::Gaussians { sh_degree: degree, ..cpu::Gaussians::default() };
    let width = 3 * (usize::from(degree) + 1).pow(2);
    for _ in 0..n {
        let mut number = |low: f32, high: f32| rng.random_range(low..high);
        let depth = number(-1.0, 8.0);
        out.means.push([number(-1.0, 1.0) * depth, number(-0.8, 0.8) * depth, depth]);
        out.quats.push(std::array::from_fn(|_| number(-1.0, 1.0)));
        out.scales.push(std::array::from_fn(|_| number(-6.0, -1.0).exp()));
        out.opacities.push(number(0.0, 1.05));
        out.sh.extend((0..width).map(|_| number(-0.6, 0.9)));
    }
    out
}

fn view(width: u32, height: u32) -> cpu::View {
    // Turned about the vertical axis, and moved.
    let (sin, cos) = 0.1f32.sin_cos();
    cpu::View {
        world_to_camera: [[cos, 0.0, sin, 0.1], [0.0, 1.0, 0.0, -0.05], [-sin, 0.0, cos, 0.3]],
        fx: 60.0,
        fy: 55.0,
        cx: width as f32 * 0.5 + 1.0,
        cy: height as f32 * 0.5,
        width,
        height,
    }
}

fn settings_of(s: &cpu::RasterSettings) -> Settings {
    Settings {
        depth: [s.near, s.far],
        near_excluded: s.near_excluded,
        eps2d: s.eps2d,
        alpha_max: s.alpha_max,
        alpha_cut: s.alpha_cut,
        stop_above: if s.stop_excluded { s.stop.next_down() } else { s.stop },
        circle: match s.extent {
            cpu::ExtentRule::Ellipse => None,
            cpu::ExtentRule::Circle { sigma, floor } => Some([sigma, floor]),
        },
        normalize_quats: s.normalize_quats,
        centred_tangents: s.centred_tangents,
        antialias_floor: s.antialiased.then_some(s.antialias_floor),
        background: s.background.unwrap_or_default(),
        isotropic: s.isotropic,
    }
}

fn render(
    l: &Grid,
    gaussians: &cpu::Gaussians,
    view: &cpu::View,
    settings: &cpu::RasterSettings,
    degree: u8,
) -> Result<Picture<Buffer>, RasterizeError<GridError>> {
    let means = l.upload_values(&gaussians.means)?;
    let quats = l.upload_values(&gaussians.quats)?;
    let scales = l.upload_values(&gaussians.scales)?;
    let opacities = l.upload_values(&gaussians.opacities)?;
    let sh = l.upload_values(&gaussians.sh)?;
    let scene = Gaussians {
        means: &means,
        quats: &quats,
        scales: &scales,
        opacities: &opacities,
        sh: &sh,
        sh_degree: gaussians.sh_degree.into(),
        count: gaussians.means.len() as u32,
    };
    let device_view = View {
        world_to_camera: view.world_to_camera,
        focal: [view.fx, view.fy],
        centre: [view.cx, view.cy],
        size: [view.width, view.height],
    };
    rasterize::render(l, &scene, &device_view, &settings_of(settings), Some(degree.into()))
}

fn check(gaussians: &cpu::Gaussians, view: &cpu::View, settings: &cpu::RasterSettings, degree: u8) {
    let request = cpu::RenderRequest {
        depth: cpu::DepthRequest { accumulated: true, expected: false, median: true },
        sh_degree: Some(degree),
        ..cpu::RenderRequest::rgb()
    };
    let want = cpu::render(gaussians, view, settings, &request).unwrap();
    let pixels = view.pixels();
    let (rgb, rest, culled) = in_any_order(|l| {
        let picture = render(l, gaussians, view, settings, degree).map_err(|e| match e {
            RasterizeError::Launch(e) => e,
            other => panic!("{other}"),
        })?;
        Ok((
            l.download_values::<f32>(&picture.rgb, 3 * pixels)?,
            [
                l.download_values::<f32>(&picture.transmittance, pixels)?,
                l.download_values::<f32>(&picture.depth, pixels)?,
                l.download_values::<f32>(&picture.median_depth, pixels)?,
            ],
            picture.culled,
        ))
    });
    // A cloud covers something.
    let covered = want.transmittance.iter().filter(|t| **t < 0.5).count();
    assert!(gaussians.means.len() < 300 || covered > pixels / 10, "{covered} of {pixels} pixels");
    let c = want.culled;
    let counts = [c.not_finite, c.depth, c.outside, c.zero_quat, c.overflow, c.opacity, c.color];
    let got = [
        culled.not_finite,
        culled.depth,
        culled.outside,
        culled.zero_quat,
        culled.overflow,
        culled.opacity,
        culled.color,
    ];
    assert_eq!(got.map(|v| v as usize), counts);
    let what = format!("{} Gaussians, {} × {}", gaussians.means.len(), view.width, view.height);
    assert_near(&rgb, &want.rgb.unwrap(), 2e-5, &format!("color, {what}"));
    assert_near(&rest[0], &want.transmittance, 2e-5, &format!("transmittance, {what}"));
    assert_near(&rest[1], &want.depth_accumulated.unwrap(), 5e-5, &format!("depth, {what}"));
    // A pixel whose light is a half but for rounding may take the next Gaussian.
    let medians = want.depth_median.unwrap();
    let off = rest[2].iter().zip(&medians).filter(|(g, w)| (*g - *w).abs() > 1e-5).count();
    assert!(off <= pixels / 1000, "median depth, {what}: {off} pixels");
}

fn pictures_are_those_of_the_cpu() {
    let gsplat = cpu::RasterSettings::gsplat_1_6();
    for n in [0, 1, 2, 1025] {
        check(&cloud(n, 1, 1), &view(40, 33), &gsplat, 1);
    }
    check(&cloud(300, 3, 2), &view(16, 16), &gsplat, 3);
    check(&cloud(300, 2, 3), &view(1, 1), &gsplat, 0);
    let other = cpu::RasterSettings {
        antialiased: true,
        background: Some([0.2, 0.5, 1.0]),
        ..cpu::RasterSettings::gsplat_1_4()
    };
    check(&cloud(500, 2, 4), &view(50, 20), &other, 2);
    check(&cloud(500, 0, 5), &view(50, 20), &cpu::RasterSettings::inria(), 0);
}

fn what_cannot_be_drawn_is_counted() {
    let mut hard = cloud(400, 1, 6);
    hard.means[0][1] = f32::NAN;
    hard.means[1][2] = f32::INFINITY;
    hard.scales[2][0] = f32::NAN;
    hard.quats[3] = [0.0; 4];
    hard.quats[4][2] = f32::INFINITY;
    hard.opacities[5] = f32::NAN;
    hard.opacities[6] = 1e-4;
    hard.opacities[7] = 3.0;
    // In the middle of the picture, with a color that is none.
    hard.means[8] = [0.0, 0.0, 3.0];
    hard.opacities[8] = 0.9;
    hard.sh[8 * 12] = f32::NAN;
    hard.means[9] = [0.0, 0.0, 2.0];
    hard.scales[9] = [1e20; 3];
    // The same depth twice: the smaller row is in front.
    hard.means[10] = [0.0, 0.0, 1.0];
    hard.means[11] = [0.0, 0.0, 1.0];
    check(&hard, &view(40, 33), &cpu::RasterSettings::gsplat_1_6(), 1);
}

fn pairs_that_no_memory_holds_are_refused() {
    // 1024 × 1024 tiles, all covered by each of 600 Gaussians.
    let mut wide = cloud(600, 0, 7);
    for i in 0..600 {
        wide.means[i] = [0.0, 0.0, 2.0];
        wide.scales[i] = [1e4; 3];
        wide.opacities[i] = 0.9;
    }
    let view = view(16_384, 16_384);
    let gsplat = cpu::RasterSettings::gsplat_1_6();
    let error = render(crate::grid(0), &wide, &view, &gsplat, 0).err().unwrap();
    assert!(
        matches!(error, RasterizeError::TooManyPairs { pairs } if pairs > MOST_PAIRS),
        "{error}"
    );
}
