//! Pictures of a synthetic room with true depth, a scene made of them, and what it is worth.
//!
//! ```sh
//! cargo run --release -p scenesplat-optimisation --example synthetic_room -- OUT \
//!     [size=320x240] [steps=2000] [seed=1] [frames=120] [gaussians=150000] [initial=60000] [cap=100000] \
//!     [depth=1] [scale=0.02] [opacity=0] [threads=0] [until=0] [scene=FILE [cameras=FILE]]
//! ```
//!
//! Writes `room.ply`, `cameras.json`, `images/`, `depth/`, `result.ply`, pictures of truth, result and error, and
//! prints a line of JSON with the figures. `until` stops after that many steps and goes on from the checkpoint.
//! With `scene` a scene of a file is drawn instead of a room, from its own cameras or from all around.

use rayon::prelude::*;
use scenesplat_optimisation::cost::set_cap;
use scenesplat_optimisation::initial::from_points;
use scenesplat_optimisation::{
    Colors, DepthTerm, MeanScore, Model, OptimiseError, OptimiseSettings, Optimiser, TrainingFrame,
    fused_points, score_frame,
};
use scenesplat_rasterizer::{DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render};
use scenesplat_rooms::{SyntheticRoom, SyntheticRoomSettings, generate};
use scenesplat_scene::formats::cameras::write_cameras_json;
use scenesplat_scene::formats::inria_ply::write_inria_ply;
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use scenesplat_scene::{
    Camera, Distortion, GaussianScene, ReadOptions, open_cameras, open_scene, robust_bounds,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// What the words of the command line say.
struct Words(BTreeMap<String, String>);

impl Words {
    fn number(&self, name: &str, default: f64) -> Result<f64, Failed> {
        self.0
            .get(name)
            .map_or(Ok(default), |v| v.parse().map_err(|e| format!("{name}={v}: {e}").into()))
    }
}

/// A camera of the room: at a place of a figure of eight, looking across the middle.
fn camera(room: &SyntheticRoom, i: usize, n: usize, [width, height]: [u32; 2]) -> Camera {
    let t = i as f64 / n as f64 * std::f64::consts::TAU;
    let size = room.size.map(f64::from);
    let at = [
        size[0] * (0.5 + 0.28 * t.cos()),
        size[1] * (0.5 + 0.28 * (2.0 * t).sin()),
        (size[2] * (0.55 + 0.15 * (3.0 * t).sin())).min(size[2] - 0.3),
    ];
    // Twice around while the camera goes once.
    let yaw = 2.0 * t + 0.6 * (5.0 * t).sin();
    let pitch = 0.35 * (4.0 * t).cos() - 0.15;
    let forward = [yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin()];
    let right = [yaw.sin(), -yaw.cos(), 0.0];
    let down = [
        forward[1] * right[2] - forward[2] * right[1],
        forward[2] * right[0] - forward[0] * right[2],
        forward[0] * right[1] - forward[1] * right[0],
    ];
    let rotation = [right, down, forward];
    let translation = rotation.map(|r| -(r[0] * at[0] + r[1] * at[1] + r[2] * at[2]));
    let f = 0.55 * f64::from(width);
    Camera {
        name: format!("frame_{i:04}"),
        width,
        height,
        fx: f,
        fy: f,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        distortion: Distortion::None,
        rotation,
        translation,
    }
}

/// A scene of a file, and the cameras it came with, for pictures of that height.
fn real(
    path: &Path,
    words: &Words,
    [_, height]: [u32; 2],
) -> Result<(GaussianScene, Vec<Camera>), Failed> {
    let options = ReadOptions { sh_rest: true, ..ReadOptions::default() };
    let scene = open_scene(path, &options)?.scene;
    let Some(list) = words.0.get("cameras") else {
        let n = words.number("frames", 120.0)? as usize;
        let cameras = (0..n).map(|i| around(&scene, i, n, height)).collect();
        return Ok((scene, cameras));
    };
    let mut cameras = open_cameras(list.as_ref())?.cameras;
    for (i, camera) in cameras.iter_mut().enumerate() {
        let by = f64::from(height) / f64::from(camera.height);
        let width = (f64::from(camera.width) * by).round();
        let across = width / f64::from(camera.width);
        (camera.fx, camera.cx) = (camera.fx * across, camera.cx * across);
        (camera.fy, camera.cy) = (camera.fy * by, camera.cy * by);
        (camera.width, camera.height) = (width as u32, height);
        camera.name = format!("frame_{i:04}");
    }
    Ok((scene, cameras))
}

/// A camera of many that are spread evenly around a scene, square pictures.
fn around(scene: &GaussianScene, i: usize, n: usize, size: u32) -> Camera {
    let bounds = robust_bounds(&scene.coord);
    let radius = 0.5 * bounds.extent().iter().map(|e| e * e).sum::<f64>().sqrt();
    let middle = [0, 1, 2].map(|k| 0.5 * (bounds.low[k] + bounds.high[k]));
    // A spiral from pole to pole; neighbours in number are the golden angle apart.
    let z = 0.9 * (1.0 - (2 * i + 1) as f64 / n as f64);
    let (turn, across) = (2.399_963 * i as f64, (1.0 - z * z).sqrt());
    let forward = [-across * turn.cos(), -across * turn.sin(), -z];
    let length = (forward[0].powi(2) + forward[1].powi(2)).sqrt();
    let right = [forward[1] / length, -forward[0] / length, 0.0];
    let down = [
        forward[1] * right[2] - forward[2] * right[1],
        forward[2] * right[0] - forward[0] * right[2],
        forward[0] * right[1] - forward[1] * right[0],
    ];
    let rotation = [right, down, forward];
    let at = [0, 1, 2].map(|k| middle[k] - 2.2 * radius * forward[k]);
    let half = f64::from(size) / 2.0;
    Camera {
        name: format!("frame_{i:04}"),
        width: size,
        height: size,
        fx: 2.0 * half,
        fy: 2.0 * half,
        cx: half,
        cy: half,
        distortion: Distortion::None,
        rotation,
        translation: rotation.map(|r| -(r[0] * at[0] + r[1] * at[1] + r[2] * at[2])),
    }
}

/// The frame that a camera takes: 8 bits of colour, millimetres of depth.
fn shoot(room: &Gaussians, camera: &Camera) -> Result<TrainingFrame, Failed> {
    let view = View::from_camera(camera)?;
    let depth = DepthRequest { expected: true, ..DepthRequest::default() };
    let request = RenderRequest { depth, ..RenderRequest::rgb() };
    let raster = RasterSettings { near: 0.05, ..RasterSettings::default() };
    let drawn = render(room, &view, &raster, &request)?;
    let byte = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rgb: Vec<u8> = drawn.rgb.unwrap_or_default().iter().map(byte).collect();
    // What less than half of the light met has no depth.
    let millimetres =
        |(z, t): (&f32, &f32)| if *t < 0.5 { (z * 1000.0).round() / 1000.0 } else { 0.0 };
    let depth = drawn.depth_expected.unwrap_or_default();
    let depth: Vec<f32> = depth.iter().zip(&drawn.transmittance).map(millimetres).collect();
    Ok(TrainingFrame {
        name: camera.name.clone(),
        view,
        rgb: Colors::Bytes(rgb),
        depth: Some(depth),
        mask: None,
    })
}

fn write_frame(out: &Path, frame: &TrainingFrame) -> Result<(), Failed> {
    let (width, height) = (frame.view.width, frame.view.height);
    let Colors::Bytes(rgb) = &frame.rgb else { return Ok(()) };
    let pixels = rgb.as_chunks::<3>().0.to_vec();
    let picture = RgbPicture::from_pixels(width, height, pixels).ok_or("a picture has pixels")?;
    std::fs::write(out.join(format!("images/{}.png", frame.name)), picture.encode_png()?)?;
    let steps =
        |d: &Vec<f32>| -> Vec<u16> { d.iter().map(|z| (z * 1000.0).round() as u16).collect() };
    let steps = Samples::Sixteen(frame.depth.as_ref().map(steps).unwrap_or_default());
    let depth = Picture::new(width, height, Channels::Gray, steps).ok_or("a depth has pixels")?;
    std::fs::write(out.join(format!("depth/{}.png", frame.name)), depth.encode_png()?)?;
    Ok(())
}

/// Truth, result and four times the error.
fn compared(rgb: &[f32], frame: &TrainingFrame) -> RgbPicture {
    let (width, height) = (frame.view.width, frame.view.height);
    RgbPicture::from_fn(3 * width, height, |x, y| {
        let at = 3 * (y * width + x % width) as usize;
        [0, 1, 2].map(|c| {
            let (truth, result) = (frame.rgb.at(at + c), rgb[at + c]);
            let shown = [truth, result, 4.0 * (truth - result).abs()][(x / width) as usize];
            (shown.clamp(0.0, 1.0) * 255.0).round() as u8
        })
    })
}

fn mean_of(optimiser: &Optimiser, frames: &[TrainingFrame]) -> Result<MeanScore, OptimiseError> {
    let settings = optimiser.settings();
    let degree = settings.sh_degree_at(optimiser.steps_done().saturating_sub(1));
    let score = |frame| Ok(score_frame(optimiser.model(), frame, settings, degree)?.0);
    let scores: Result<Vec<_>, OptimiseError> = frames.iter().map(score).collect();
    Ok(MeanScore::of(&scores?))
}

fn run(out: &Path, words: &Words) -> Result<(), Failed> {
    let size = words.0.get("size").map_or("320x240", String::as_str);
    let (w, h) = size.split_once('x').ok_or("size=WxH")?;
    let size: [u32; 2] = [w.parse::<u32>()?, h.parse::<u32>()?];
    let seed = words.number("seed", 1.0)? as u64;
    let n = words.number("frames", 120.0)? as usize;
    for folder in ["images", "depth"] {
        std::fs::create_dir_all(out.join(folder))?;
    }
    let (scene, cameras) = match words.0.get("scene") {
        Some(path) => real(path.as_ref(), words, size)?,
        None => {
            let room = generate(&SyntheticRoomSettings {
                seed,
                num_gaussians: Some(words.number("gaussians", 150_000.0)? as usize),
                points_share: 0.0,
                ..SyntheticRoomSettings::default()
            })?;
            let cameras = (0..n).map(|i| camera(&room, i, n, size)).collect();
            (room.scene, cameras)
        }
    };
    write_inria_ply(&scene, &[], &out.join("room.ply"))?;
    let drawn = Gaussians::from_scene(&scene)?;
    write_cameras_json(&cameras, &out.join("cameras.json"))?;
    let shot: Result<Vec<_>, Failed> = cameras.par_iter().map(|c| shoot(&drawn, c)).collect();
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (i, frame) in shot?.into_iter().enumerate() {
        write_frame(out, &frame)?;
        if i % 6 == 0 { &mut test } else { &mut train }.push(frame);
    }
    let base = OptimiseSettings::scenesplat().with_steps(words.number("steps", 2000.0)? as u64);
    let weight = words.number("depth", 1.0)? as f32;
    let mut settings = OptimiseSettings {
        depth: base.depth.map(|term| DepthTerm { weight, ..term }),
        scale_reg: words.number("scale", base.scale_reg.into())? as f32,
        opacity_reg: words.number("opacity", base.opacity_reg.into())? as f32,
        ..base
    };
    set_cap(&mut settings, words.number("cap", 100_000.0)? as usize);
    let (points, colors) = fused_points(&train, words.number("initial", 60_000.0)? as usize);
    let model: Model = from_points(&points, &colors, &settings.initial, settings.seed)?;
    let first = model.len();
    let mut optimiser = Optimiser::new(model, &train, settings)?;
    let until = words.number("until", 0.0)? as u64;
    let (mut seconds, mut curve, mut to_28) = (0.0, Vec::new(), None);
    let every = (settings.steps / 8).max(1);
    while optimiser.steps_done() < settings.steps {
        let start = Instant::now();
        optimiser.step(&train)?;
        seconds += start.elapsed().as_secs_f64();
        let done = optimiser.steps_done();
        if done == until {
            let place = optimiser.save(&out.join("checkpoints"), &train, 1)?;
            optimiser = Optimiser::resume(&place, &train, Some(settings))?;
        }
        if done % every == 0 || done == settings.steps {
            let mean = mean_of(&optimiser, &test[..test.len().min(5)])?;
            let psnr = mean.psnr.unwrap_or(f64::NAN);
            eprintln!(
                "step {done}: {psnr:.2} dB, {} Gaussians, {seconds:.1} s",
                optimiser.model().len()
            );
            to_28 = to_28.or((psnr >= 28.0).then_some(seconds));
            curve.push(serde_json::json!([seconds, done, psnr]));
        }
    }
    let scene = optimiser.model().to_scene();
    write_inria_ply(&scene, &[], &out.join("result.ply"))?;
    let degree = settings.sh_degree_at(settings.steps);
    for frame in test.iter().step_by(7) {
        let (_, drawn) = score_frame(optimiser.model(), frame, &settings, degree)?;
        let picture = compared(&drawn.rgb.unwrap_or_default(), frame);
        std::fs::write(out.join(format!("compared_{}.png", frame.name)), picture.encode_png()?)?;
    }
    let g = optimiser.model().gaussians();
    // FNV-1a of all parameters: equal for any number of threads, and after a resume.
    let all = g.means.as_flattened().iter().chain(optimiser.model().logits()).chain(&g.sh);
    let hash = all
        .flat_map(|v| v.to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    let figures = serde_json::json!({
        "room": seed, "size": size, "first": first, "gaussians": optimiser.model().len(),
        "steps": settings.steps, "seconds_per_step": seconds / settings.steps as f64,
        "seconds_to_28_db": to_28, "test": mean_of(&optimiser, &test)?,
        "train": mean_of(&optimiser, &train[..train.len().min(20)])?,
        "curve": curve, "hash": format!("{hash:016x}"),
        "depth_weight": weight, "scale_reg": settings.scale_reg, "opacity_reg": settings.opacity_reg,
    });
    println!("{figures}");
    Ok(())
}

fn main() -> Result<(), Failed> {
    let mut args = std::env::args().skip(1);
    let out = PathBuf::from(args.next().ok_or("give a folder for the results")?);
    let word = |w: String| w.split_once('=').map(|(k, v)| (k.to_owned(), v.to_owned()));
    let words = Words(args.filter_map(word).collect());
    match words.number("threads", 0.0)? as usize {
        0 => run(&out, &words),
        threads => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
            pool.install(|| run(&out, &words))
        }
    }
}
