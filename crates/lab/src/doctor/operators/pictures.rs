//! The rasterizer on Gaussians of every kind, and what compares pictures.

use super::compare::{Wide, compare};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::{Noise, noise};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_metrics::image::{ImageView, SsimPadding, psnr, ssim};
use scenesplat_rasterizer::{Gaussians, RasterSettings, RenderRequest, Rendered, View, render};

const WIDTH: u32 = 40;
const HEIGHT: u32 = 30;

/// Looks along +z from the origin.
fn view() -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        fx: 60.0,
        fy: 50.0,
        cx: 0.52 * WIDTH as f32,
        cy: 0.47 * HEIGHT as f32,
        width: WIDTH,
        height: HEIGHT,
    }
}

/// One Gaussian, gray.
fn one(mean: [f32; 3], scale: [f32; 3], opacity: f32) -> Gaussians {
    Gaussians {
        means: vec![mean],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![scale],
        opacities: vec![opacity],
        sh: vec![1.0; 3],
        sh_degree: 0,
    }
}

fn draw(scene: &Gaussians) -> Result<Rendered, Failure> {
    let request = RenderRequest { contributions: true, ..RenderRequest::rgb() };
    let out = render(scene, &view(), &RasterSettings::default(), &request)?;
    let rgb = out.rgb.as_deref().unwrap_or_default();
    ensure!(rgb.iter().all(|v| v.is_finite()), "a color is not finite");
    let inside = out.transmittance.iter().all(|t| (0.0..=1.0).contains(t));
    ensure!(inside, "a transmittance is outside of 0 to 1");
    let c = out.culled;
    let left_out =
        c.not_finite + c.zero_quat + c.depth + c.overflow + c.opacity + c.outside + c.color;
    ensure!(
        left_out + out.work.visible == scene.len(),
        "{} Gaussians, {} drawn and {left_out} counted as left out",
        scene.len(),
        out.work.visible
    );
    Ok(out)
}

/// Whether the first Gaussian is in the picture.
fn visible(scene: &Gaussians) -> Result<bool, Failure> {
    let out = draw(scene)?;
    Ok(out.contributions.is_some_and(|c| c.sum[0] > 0.0))
}

const MIDDLE: [f32; 3] = [0.0, 0.0, 2.0];

/// Gaussians that are drawn (`true`), or left out and counted: name, Gaussian.
const SHAPES: [(bool, &str, fn() -> Gaussians); 13] = [
    (true, "scale-1e-8", || one(MIDDLE, [1e-8; 3], 0.8)),
    (true, "scale-0", || one(MIDDLE, [0.0; 3], 0.8)),
    (true, "disc-and-needle", || one(MIDDLE, [10.0, 1e-6, 0.0], 0.8)),
    (true, "scale-1e6", || one(MIDDLE, [1e6; 3], 0.8)),
    (false, "scale-max", || one(MIDDLE, [f32::MAX; 3], 0.8)),
    (true, "at-the-near-plane", || one([0.0, 0.0, 0.010_001], [1e-4; 3], 0.8)),
    (false, "behind-the-near-plane", || one([0.0, 0.0, 0.009_99], [1e-4; 3], 0.8)),
    (false, "at-the-camera", || one([0.0; 3], [0.1; 3], 0.8)),
    (true, "far-away", || one([0.0, 0.0, 1e9], [1e7; 3], 0.8)),
    (true, "half-turn", || turned([0.0, -30.0, 40.0, 0.0])),
    (false, "zero-quaternion", || turned([0.0; 4])),
    (true, "alpha-1", || one(MIDDLE, [0.1; 3], 1.0)),
    (false, "alpha-0", || one(MIDDLE, [0.1; 3], 0.0)),
];

fn turned(quat: [f32; 4]) -> Gaussians {
    Gaussians { quats: vec![quat], ..one(MIDDLE, [0.1; 3], 0.8) }
}

pub(super) fn cases() -> Vec<Case> {
    let shape = |(is_drawn, name, make): (bool, &str, fn() -> Gaussians)| {
        case(format!("picture-of-{name}"), move |_| {
            let drawn = visible(&make())?;
            ensure!(drawn == is_drawn, "drawn: {drawn}, expected {is_drawn}");
            Ok(())
        })
    };
    let mut cases: Vec<Case> = SHAPES.map(shape).into();
    cases.extend([
        case("picture-with-bad-values", bad_values),
        case("picture-beside-bad-values", bad_neighbours),
        case("transmittance-of-10000-layers", layers),
        case("one-gaussian-by-the-book", by_the_book),
        case("picture-on-threads", |t| {
            let scene = random(300, 5);
            t.one_and_many(|| Ok(draw(&scene)?.rgb.unwrap_or_default()))?;
            Ok(())
        }),
        case("metrics-of-equal-pictures", equal_pictures),
        case("ssim-of-constant-pictures", constant_pictures),
    ]);
    cases
}

fn equal_pictures(_: &Trial<'_>) -> Result<(), Failure> {
    let values: Vec<f32> = noise(3 * 24 * 20, 6, 1.0).iter().map(|v| v.abs()).collect();
    let picture = || ImageView::new(&values, 24, 20, 3);
    ensure!(psnr(picture()?, picture()?)? == f64::INFINITY, "PSNR is finite");
    for padding in SsimPadding::ALL {
        let same = ssim(picture()?, picture()?, padding)?;
        ensure!((same - 1.0).abs() < 1e-6, "SSIM {same}, padding {padding}");
    }
    Ok(())
}

fn constant_pictures(_: &Trial<'_>) -> Result<Finding, Failure> {
    let (a, b) = (vec![0.25; 3 * 24 * 20], vec![0.75; 3 * 24 * 20]);
    let (a, b) = (ImageView::new(&a, 24, 20, 3)?, ImageView::new(&b, 24, 20, 3)?);
    let (x, y, c1) = (0.25f64, 0.75f64, 1e-4);
    let want = (2.0 * x * y + c1) / (x * x + y * y + c1);
    let got = ssim(a, b, SsimPadding::Valid)?;
    compare(&[got as f32], &[Wide::own(want)], |_| "SSIM".to_owned())
}

/// Gaussians of all kinds in front of the camera.
fn random(rows: usize, seed: u64) -> Gaussians {
    let mut rng = Noise::new(seed);
    let mut scene = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for _ in 0..rows {
        scene.means.push([rng.float() * 2.0, rng.float() * 2.0, 2.5 + 2.6 * rng.float()]);
        scene.quats.push([(); 4].map(|()| rng.float()));
        scene.scales.push([(); 3].map(|()| (2.0 * rng.float() - 3.0).exp()));
        scene.opacities.push(0.5 + 0.5 * rng.float());
        scene.sh.extend([(); 12].map(|()| 0.3 * rng.float()));
    }
    scene
}

fn append(scene: &mut Gaussians, more: Gaussians) {
    scene.means.extend(more.means);
    scene.quats.extend(more.quats);
    scene.scales.extend(more.scales);
    scene.opacities.extend(more.opacities);
    scene.sh.extend(more.sh);
}

fn bad_values(_: &Trial<'_>) -> Result<(), Failure> {
    let good = one(MIDDLE, [0.1; 3], 0.8);
    ensure!(visible(&good)?, "a good Gaussian is not drawn");
    let attributes: [(&str, usize, fn(&mut Gaussians, usize) -> &mut f32); 4] = [
        ("mean", 3, |scene, k| &mut scene.means[0][k]),
        ("scale", 3, |scene, k| &mut scene.scales[0][k]),
        ("colour", 3, |scene, k| &mut scene.sh[k]),
        ("quaternion", 4, |scene, k| &mut scene.quats[0][k]),
    ];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (what, count, value) in attributes {
            for k in 0..count {
                let mut scene = good.clone();
                *value(&mut scene, k) = bad;
                ensure!(!visible(&scene)?, "a Gaussian with a {what} of {bad} is drawn");
            }
        }
    }
    Ok(())
}

fn bad_neighbours(_: &Trial<'_>) -> Result<(), Failure> {
    let good = random(60, 1);
    let mut bad = random(60, 2);
    for i in 0..60 {
        let value = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3];
        match i % 5 {
            0 => bad.means[i][i % 2] = value,
            1 => bad.scales[i][i % 3] = value,
            2 => bad.quats[i][i % 4] = value,
            3 => bad.opacities[i] = f32::NAN,
            _ => bad.sh[12 * i + i % 12] = value,
        }
    }
    let mut both = good.clone();
    append(&mut both, bad);
    let (alone, both) = (draw(&good)?, draw(&both)?);
    ensure!(alone.rgb == both.rgb, "colors changed");
    ensure!(alone.transmittance == both.transmittance, "transmittance changed");
    Ok(())
}

/// Large faint Gaussians behind each other: (1 − α)^n at the middle of the picture.
fn layers(_: &Trial<'_>) -> Result<Finding, Failure> {
    let alpha = 0.005f32;
    let n = 10_000;
    let mut scene = Gaussians::default();
    for i in 0..n {
        append(&mut scene, one([0.0, 0.0, 2.0 + 1e-3 * i as f32], [1e4; 3], alpha));
    }
    let settings = RasterSettings { stop: 0.0, ..RasterSettings::default() };
    let out = render(&scene, &view(), &settings, &RenderRequest::rgb())?;
    let middle = (HEIGHT / 2 * WIDTH + WIDTH / 2) as usize;
    let want = f64::from(n as u32) * (-f64::from(alpha)).ln_1p();
    // Compared as logarithms: 10⁴ roundings of 6e-8 each.
    let got = f64::from(out.transmittance[middle]).ln();
    let text = format!("ln of the transmittance {got}, f64 {want}");
    Ok(Finding::of(((got - want) / want).abs(), text))
}

/// A round Gaussian in front of the camera, by hand.
fn by_the_book(_: &Trial<'_>) -> Result<Finding, Failure> {
    let (sigma, depth, opacity) = (0.1, 2.0, 0.8);
    let out = draw(&one([0.0, 0.0, depth], [sigma; 3], opacity))?;
    let (view, settings) = (view(), RasterSettings::default());
    let eps = f64::from(settings.eps2d);
    let spread = |f: f32| (f64::from(f) * f64::from(sigma) / f64::from(depth)).powi(2) + eps;
    let (a, b) = (spread(view.fx), spread(view.fy));
    // The zeroth harmonic is 0.2820948.
    let color = 0.5 + 0.282_094_791_773_878_14;
    let rgb = out.rgb.unwrap_or_default();
    let mut found = Finding::right();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let dx = f64::from(x) + 0.5 - f64::from(view.cx);
            let dy = f64::from(y) + 0.5 - f64::from(view.cy);
            let alpha = f64::from(opacity) * (-0.5 * (dx * dx / a + dy * dy / b)).exp();
            let cut = f64::from(settings.alpha_cut);
            if (alpha / cut - 1.0).abs() < 2e-3 {
                // Whether it counts here is within rounding.
                continue;
            }
            let want = if alpha < cut { 0.0 } else { alpha * color };
            let got = rgb[3 * (y * WIDTH + x) as usize];
            found.add((f64::from(got) - want).abs(), || {
                format!("pixel {x}, {y}: {got}, f64 {want}")
            });
        }
    }
    ensure!(rgb.iter().any(|v| *v > 0.1), "nothing is drawn");
    Ok(found)
}
