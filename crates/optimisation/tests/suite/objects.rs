//! An object from pictures alone: no points, no depths.

use scenesplat_optimisation::initial::{InitialSettings, from_points};
use scenesplat_optimisation::{
    Colors, Model, OptimiseSettings, Optimiser, TrainingFrame, points_in_view, score_frame, thin,
};
use scenesplat_rasterizer::{RasterSettings, RenderRequest, View, render};

const SIDE: u32 = 40;

/// From around it, at three heights.
fn view(i: u32) -> View {
    let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 24.0).sin_cos();
    let eye = glam::DVec3::new(cos, sin, 0.3 * f64::from(i % 3) - 0.2);
    let z = -eye.normalize();
    let x = z.cross(glam::DVec3::Z).normalize();
    let row = |axis: glam::DVec3| [axis.x, axis.y, axis.z, -axis.dot(eye)].map(|v| v as f32);
    let side = SIDE as f32;
    View {
        world_to_camera: [row(x), row(z.cross(x)), row(z)],
        fx: 1.2 * side,
        fy: 1.2 * side,
        cx: side / 2.0,
        cy: side / 2.0,
        width: SIDE,
        height: SIDE,
    }
}

/// 64 balls in a cube, of eight colors.
fn object() -> Model {
    let place = |i: usize| [i % 4, i / 4 % 4, i / 16].map(|k| 0.1 * k as f32 - 0.15);
    let color = |i: usize| [0, 1, 2].map(|c| if (i >> c) & 1 == 1 { 0.9 } else { 0.1 });
    let (points, colors): (Vec<_>, Vec<_>) = (0..64).map(|i| (place(i), color(i))).unzip();
    let settings = InitialSettings { opacity: 0.95, scale: 0.4, sh_degree: 0, random_quats: false };
    from_points(&points, &colors, &settings, 1).unwrap()
}

fn frame(i: u32, object: &Model) -> TrainingFrame {
    let view = view(i);
    let settings = RasterSettings::gsplat_1_6();
    let picture = render(object.gaussians(), &view, &settings, &RenderRequest::rgb()).unwrap();
    TrainingFrame {
        name: i.to_string(),
        view,
        rgb: Colors::Floats(picture.rgb.unwrap()),
        alpha: None,
        depth: None,
        mask: None,
    }
}

/// The default preset learns an object from random points where the cameras look; from points around the cameras it
/// learned nothing.
#[test]
fn the_default_preset_learns_from_random_points() {
    let object = object();
    let frames: Vec<_> = (0..24).map(|i| frame(i, &object)).collect();
    let settings = OptimiseSettings::scenesplat().with_steps(500);
    let ((points, colors), place) = points_in_view(&frames, 500, 1).unwrap();
    assert!(place.contains("that the cameras look at"), "{place}");
    let model = from_points(&points, &colors, &thin(settings.initial), 1).unwrap();
    let mut optimiser = Optimiser::new(model, &frames, settings).unwrap();
    for _ in 0..500 {
        optimiser.step(&frames).unwrap();
    }
    let psnr = |frame: &TrainingFrame| {
        score_frame(optimiser.model(), frame, &settings, 3).unwrap().0.psnr.unwrap()
    };
    let mean = frames.iter().map(psnr).sum::<f64>() / frames.len() as f64;
    println!("{mean:.2} dB, {} Gaussians", optimiser.model().len());
    assert!(mean > 22.0, "{mean:.2} dB");
}
