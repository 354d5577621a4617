//! Pictures of a synthetic room with true depth, a scene made of them, and what it is worth.
//!
//! ```sh
//! cargo run --release -p scenesplat-optimisation --example optimise_room -- OUT \
//!     [room=closed] [size=320x240] [steps=2000] [seed=1] [frames=120] [gaussians=1500000] [initial=60000] \
//!     [cap=100000] [preset=scenesplat] [depth=1] [scale=0.02] [opacity=0] [half=0] [threads=0] [until=0] \
//!     [scene=FILE [cameras=FILE]]
//! ```
//!
//! Writes `room.ply`, `cameras.json`, `images/`, `depth/`, `initial.ply`, `result.ply`, pictures of truth, result and error, and
//! prints a line of JSON with the figures. With `labels=1` also what `evaluate` and `lift-labels` read: `truth/` and
//! `made/` (both with the labels of the room, of the result those of the nearest point within 5 cm), `classes.txt`,
//! and `segments/` with maps of the classes and their vectors in the words of the rooms. `until` stops after that many steps and goes on from the checkpoint.
//!
//! A room is `closed` (points of its surfaces, so close that light passes nowhere: depth is that of the surface)
//! or `captured` (what training left of one: gaps, floaters). With `scene` a scene of a file is drawn instead,
//! from its own cameras or from all around.

use rayon::prelude::*;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_optimisation::cost::set_cap;
use scenesplat_optimisation::depth_loss::DepthOutliers;
use scenesplat_optimisation::initial::{from_points, neighbour_log_scales};
use scenesplat_optimisation::{
    Colors, DepthKind, DepthTerm, MeanScore, Model, OptimiseError, OptimiseSettings, Optimiser,
    TrainingFrame, fused_points, lifted, score_frame,
};
use scenesplat_rasterizer::{DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render};
use scenesplat_rooms::{
    CLASSES, ClassId, SyntheticRoom, SyntheticRoomSettings, Vocabulary, generate,
};
use scenesplat_scene::formats::cameras::write_cameras_json;
use scenesplat_scene::formats::inria_ply::write_inria_ply;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use scenesplat_scene::vector::{cross, dot};
use scenesplat_scene::{
    Camera, Distortion, GaussianScene, ReadOptions, open_cameras, open_scene, robust_bounds,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// Names of the words.
const WORDS: &str = "room size steps seed frames gaussians initial cap preset depth scale opacity half threads until \
                     labels scene cameras";

/// What the words of the command line say.
struct Words(BTreeMap<String, String>);

impl Words {
    fn number(&self, name: &str, default: f64) -> Result<f64, Failed> {
        self.0
            .get(name)
            .map_or(Ok(default), |v| v.parse().map_err(|e| format!("{name}={v}: {e}").into()))
    }
}

/// The room that is photographed.
fn room(words: &Words, seed: u64) -> Result<SyntheticRoom, Failed> {
    let closed = match words.0.get("room").map_or("closed", String::as_str) {
        "closed" => true,
        "captured" => false,
        other => return Err(format!("room={other}: closed or captured").into()),
    };
    let mut room = generate(&SyntheticRoomSettings {
        seed,
        num_gaussians: Some(words.number("gaussians", 1_500_000.0)? as usize),
        points_share: f64::from(u8::from(closed)) as f32,
        ..SyntheticRoomSettings::default()
    })?;
    if closed {
        // Seven discs over every point of a surface: a thousandth of the light passes.
        let scales = neighbour_log_scales(&room.scene.coord, 1.3)?;
        for (to, wide) in room.scene.log_scale.iter_mut().zip(scales) {
            *to = [wide, wide, wide - std::f32::consts::LN_10];
        }
        room.scene.opacity_logit.fill(6.0);
    }
    Ok(room)
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
    looking(i, [width, height], 0.55 * f64::from(width), at, forward)
}

/// A camera at a place that looks along `forward` (unit, not straight up), level with the ground.
fn looking(
    i: usize,
    [width, height]: [u32; 2],
    focal: f64,
    at: [f64; 3],
    forward: [f64; 3],
) -> Camera {
    let length = (forward[0].powi(2) + forward[1].powi(2)).sqrt();
    let right = [forward[1] / length, -forward[0] / length, 0.0];
    let rotation = [right, cross(forward, right), forward];
    Camera {
        name: format!("frame_{i:04}"),
        width,
        height,
        fx: focal,
        fy: focal,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        distortion: Distortion::None,
        rotation,
        translation: rotation.map(|r| -dot(r, at)),
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
    // A spiral from pole to pole; neighbors in number are the golden angle apart.
    let z = 0.9 * (1.0 - (2 * i + 1) as f64 / n as f64);
    let (turn, across) = (2.399_963 * i as f64, (1.0 - z * z).sqrt());
    let forward = [-across * turn.cos(), -across * turn.sin(), -z];
    let at = [0, 1, 2].map(|k| middle[k] - 2.2 * radius * forward[k]);
    looking(i, [size; 2], f64::from(size), at, forward)
}

/// The frame that a camera takes: 8 bits of color, millimeters of depth.
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
        alpha: None,
        depth: Some(depth),
        mask: None,
    })
}

/// Whether a camera stands free: at most a third of its picture is empty, a twentieth nearer than 40 cm.
fn sees_a_room(frame: &TrainingFrame) -> bool {
    let depth = frame.depth.as_deref().unwrap_or_default();
    let share = |is: fn(f32) -> bool| {
        depth.iter().filter(|z| is(**z)).count() as f64 / depth.len().max(1) as f64
    };
    share(|z| z == 0.0) <= 1.0 / 3.0 && share(|z| z > 0.0 && z < 0.4) <= 0.05
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

/// Length of the vectors of classes.
const WORD_DIM: usize = 64;
/// What is farther than this from every point of the room has no label, meters.
const NEAR: f64 = 0.05;

/// Labels of the room on its Gaussians, on the result's, and on the pixels of the frames.
fn write_labels(
    out: &Path,
    room: &GaussianScene,
    result: &GaussianScene,
    frames: &[TrainingFrame],
) -> Result<(), Failed> {
    let segment = room.segment.as_ref().ok_or("labels=1: this scene has no labels")?;
    let tree = KdTree::new(&room.coord)?;
    let nearest = |points: &[[f32; 3]]| {
        tree.map_nearest(
            points,
            1,
            || (),
            |(), _, near| {
                let near = near.first().filter(|n| n.distance_squared < NEAR * NEAR);
                near.map_or(-1, |n| segment[n.row as usize])
            },
        )
    };
    write_npy_folder(room, &out.join("truth"), true)?;
    let made = GaussianScene { segment: Some(nearest(&result.coord)), ..result.clone() };
    write_npy_folder(&made, &out.join("made"), true)?;
    let names: Vec<&str> = CLASSES.iter().map(|class| class.name).collect();
    std::fs::write(out.join("classes.txt"), names.join("\n"))?;
    let words = Vocabulary::new(WORD_DIM)?;
    let vectors: Vec<f32> =
        ClassId::ALL.iter().flat_map(|class| words.class_target(*class)).collect();
    std::fs::create_dir_all(out.join("segments"))?;
    for frame in frames {
        let depth = frame.depth.as_deref().unwrap_or_default();
        // What was not measured lies in the camera, and gets no label below.
        let points: Vec<_> = depth.iter().enumerate().map(|(i, &z)| lifted(frame, i, z)).collect();
        let mut labels = nearest(&points);
        labels.iter_mut().zip(depth).filter(|(_, z)| **z == 0.0).for_each(|(l, _)| *l = -1);
        let size = [frame.view.height as usize, frame.view.width as usize];
        let path = |kind: &str| out.join(format!("segments/{}_{kind}.npy", frame.name));
        write_npy(&path("s"), &size, &labels)?;
        write_npy(&path("f"), &[ClassId::ALL.len(), WORD_DIM], &vectors)?;
    }
    Ok(())
}

fn mean_of(optimiser: &Optimiser, frames: &[TrainingFrame]) -> Result<MeanScore, OptimiseError> {
    let settings = optimiser.settings();
    let degree = settings.sh_degree_at(optimiser.steps_done().saturating_sub(1));
    let score = |frame| Ok(score_frame(optimiser.model(), frame, settings, degree)?.0);
    let scores: Result<Vec<_>, OptimiseError> = frames.iter().map(score).collect();
    Ok(MeanScore::of(&scores?))
}

/// The scene that is photographed, and what its cameras take.
fn photographed(
    words: &Words,
    seed: u64,
    size: [u32; 2],
) -> Result<(GaussianScene, Vec<(TrainingFrame, Camera)>), Failed> {
    let shoot_all = |scene: &GaussianScene, cameras: Vec<Camera>| -> Result<Vec<_>, Failed> {
        let drawn = Gaussians::from_scene(scene)?;
        cameras.into_par_iter().map(|c| Ok((shoot(&drawn, &c)?, c))).collect()
    };
    if let Some(path) = words.0.get("scene") {
        let (scene, cameras) = real(path.as_ref(), words, size)?;
        let shot = shoot_all(&scene, cameras)?;
        return Ok((scene, shot));
    }
    let n = words.number("frames", 120.0)? as usize;
    let room = room(words, seed)?;
    // Places in furniture and behind walls are passed by.
    let more = 2 * n;
    let cameras = (0..more).map(|i| camera(&room, i, more, size)).collect();
    let mut free = shoot_all(&room.scene, cameras)?;
    free.retain(|(frame, _)| sees_a_room(frame));
    if free.len() < n {
        return Err(format!("{} of {more} places are free, {n} are needed", free.len()).into());
    }
    let shot = (0..n).map(|i| free[i * free.len() / n].clone()).collect();
    Ok((room.scene, shot))
}

fn settings(words: &Words) -> Result<OptimiseSettings, Failed> {
    let preset = match words.0.get("preset").map_or("scenesplat", String::as_str) {
        "scenesplat" => OptimiseSettings::scenesplat(),
        "gsplat-mcmc" => OptimiseSettings::gsplat_mcmc(),
        "gsplat-default" => OptimiseSettings::gsplat_default(),
        other => return Err(format!("preset={other}: there is none of that name").into()),
    };
    let base = preset.with_steps(words.number("steps", 2000.0)? as u64);
    let weight = base.depth.map_or(0.0, |term| term.weight.into());
    let weight = words.number("depth", weight)? as f32;
    let (kind, outliers) = (DepthKind::Accumulated, DepthOutliers::MedianRule);
    let mut settings = OptimiseSettings {
        depth: (weight > 0.0).then_some(DepthTerm { weight, kind, outliers }),
        scale_reg: words.number("scale", base.scale_reg.into())? as f32,
        opacity_reg: words.number("opacity", base.opacity_reg.into())? as f32,
        half_steps: words.number("half", 0.0)? as u64,
        ..base
    };
    set_cap(&mut settings, words.number("cap", 100_000.0)? as usize);
    Ok(settings)
}

/// What the steps begin with.
fn first_model(
    words: &Words,
    truth: &GaussianScene,
    train: &[TrainingFrame],
    settings: &OptimiseSettings,
) -> Result<Model, Failed> {
    let most = words.number("initial", 60_000.0)? as usize;
    let (mut points, mut colors) = fused_points(train, most);
    if points.is_empty() {
        // Nothing takes half of the light: some of its centers, as matched pictures would give.
        let some = |i: &usize| i.is_multiple_of(truth.len().div_ceil(most.max(1)).max(1));
        points = (0..truth.len()).filter(some).map(|i| truth.coord[i]).collect();
        eprintln!("no depth: begins with {} of the scene's centers", points.len());
        colors = vec![[0.5; 3]; points.len()];
    }
    Ok(from_points(&points, &colors, &settings.initial, settings.seed)?)
}

/// Seconds of all steps, those until 28 dB, and the course of the PSNR.
struct Course {
    seconds: f64,
    to_28: Option<f64>,
    curve: Vec<serde_json::Value>,
}

fn learn(
    optimiser: &mut Optimiser,
    [train, test]: [&[TrainingFrame]; 2],
    (until, folder): (u64, &Path),
) -> Result<Course, Failed> {
    let settings = *optimiser.settings();
    let mut course = Course { seconds: 0.0, to_28: None, curve: Vec::new() };
    let every = (settings.steps / 8).max(1);
    while optimiser.steps_done() < settings.steps {
        let start = Instant::now();
        optimiser.step(train)?;
        course.seconds += start.elapsed().as_secs_f64();
        let (done, seconds) = (optimiser.steps_done(), course.seconds);
        if done == until {
            let place = optimiser.save(folder, train, 1)?;
            *optimiser = Optimiser::resume(&place, train, Some(settings))?;
        }
        if done % every == 0 || done == settings.steps {
            let mean = mean_of(optimiser, &test[..test.len().min(5)])?;
            let (psnr, count) = (mean.psnr.unwrap_or(f64::NAN), optimiser.model().len());
            eprintln!("step {done}: {psnr:.2} dB, {count} Gaussians, {seconds:.1} s");
            course.to_28 = course.to_28.or((psnr >= 28.0).then_some(seconds));
            course.curve.push(serde_json::json!([seconds, done, psnr]));
        }
    }
    Ok(course)
}

/// FNV-1a of all parameters: equal for any number of threads, and after a resume.
fn hash(model: &Model) -> u64 {
    let g = model.gaussians();
    let all = g.means.as_flattened().iter().chain(model.logits()).chain(&g.sh);
    let start = 0xcbf2_9ce4_8422_2325u64;
    let mix = |h: u64, b: u8| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
    all.flat_map(|v| v.to_le_bytes()).fold(start, mix)
}

fn run(out: &Path, words: &Words) -> Result<(), Failed> {
    let size = words.0.get("size").map_or("320x240", String::as_str);
    let (w, h) = size.split_once('x').ok_or("size=WxH")?;
    let size: [u32; 2] = [w.parse::<u32>()?, h.parse::<u32>()?];
    let seed = words.number("seed", 1.0)? as u64;
    for folder in ["images", "depth"] {
        std::fs::create_dir_all(out.join(folder))?;
    }
    let (truth, shot) = photographed(words, seed, size)?;
    write_inria_ply(&truth, &[], &out.join("room.ply"))?;
    let cameras: Vec<Camera> = shot.iter().map(|(_, camera)| camera.clone()).collect();
    write_cameras_json(&cameras, &out.join("cameras.json"))?;
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (i, (frame, _)) in shot.into_iter().enumerate() {
        write_frame(out, &frame)?;
        if i % 6 == 0 { &mut test } else { &mut train }.push(frame);
    }
    let settings = settings(words)?;
    let model = first_model(words, &truth, &train, &settings)?;
    let first = model.len();
    write_inria_ply(&model.to_scene(), &[], &out.join("initial.ply"))?;
    let mut optimiser = Optimiser::new(model, &train, settings)?;
    let (until, folder) = (words.number("until", 0.0)? as u64, out.join("checkpoints"));
    let Course { seconds, to_28, curve } =
        learn(&mut optimiser, [&train, &test], (until, &folder))?;
    let scene = optimiser.model().to_scene();
    write_inria_ply(&scene, &[], &out.join("result.ply"))?;
    if words.number("labels", 0.0)? > 0.0 {
        write_labels(out, &truth, &scene, &train)?;
    }
    let degree = settings.sh_degree_at(settings.steps);
    for frame in test.iter().step_by(7) {
        let (_, drawn) = score_frame(optimiser.model(), frame, &settings, degree)?;
        let picture = compared(&drawn.rgb.unwrap_or_default(), frame);
        std::fs::write(out.join(format!("compared_{}.png", frame.name)), picture.encode_png()?)?;
    }
    let figures = serde_json::json!({
        "room": seed, "size": size, "first": first, "gaussians": optimiser.model().len(),
        "steps": settings.steps, "seconds_per_step": seconds / settings.steps as f64,
        "seconds_to_28_db": to_28, "test": mean_of(&optimiser, &test)?,
        "train": mean_of(&optimiser, &train[..train.len().min(20)])?,
        "curve": curve, "hash": format!("{:016x}", hash(optimiser.model())),
        "depth_weight": settings.depth.map_or(0.0, |term| term.weight),
        "scale_reg": settings.scale_reg, "opacity_reg": settings.opacity_reg,
    });
    println!("{figures}");
    Ok(())
}

fn main() -> Result<(), Failed> {
    let mut args = std::env::args().skip(1);
    let out = PathBuf::from(args.next().ok_or("give a folder for the results")?);
    let word = |w: String| -> Result<(String, String), Failed> {
        let (name, value) = w.split_once('=').ok_or_else(|| format!("{w}: NAME=VALUE"))?;
        let known = WORDS.split(' ').any(|word| word == name);
        known
            .then(|| (name.to_owned(), value.to_owned()))
            .ok_or_else(|| format!("{w}: one of {WORDS}").into())
    };
    let words = Words(args.map(word).collect::<Result<_, _>>()?);
    match words.number("threads", 0.0)? as usize {
        0 => run(&out, &words),
        threads => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
            pool.install(|| run(&out, &words))
        }
    }
}
