//! `scenesplat render`

mod args;
mod cameras;
mod effects;
mod free;
mod parse;

use crate::error::refuse;
use crate::session::Session;
use anyhow::{Context, Result};
pub use args::Args;
use args::PlanArg;
use cameras::{Shot, Shots};
use clap::ValueEnum;
use effects::Effects;
#[cfg(feature = "mcp")]
pub(super) use parse::parse_point;
pub(super) use parse::{parse_color, parse_fov, parse_size};
use scenesplat::datasets::effects::pictures::DrawnPicture;
use scenesplat::preview::{depth_picture, depth_steps, picture_of, write_png, write_png16};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest,
    SceneProfile,
};
use scenesplat::scene::{Camera, GaussianScene, LoadedScene, ReadOptions, guess_up};
use scenesplat_lab::capture::ScenePictures;
use scenesplat_lab::compensation::render_section;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    if args.fov.is_some() && args.eye.is_none() && args.inside.is_none() {
        refuse!("--fov goes with --eye and --target, or with --inside");
    }
    let session = Session::start(&args.shared, line)?;
    // Wrong cameras are said before a large scene is read.
    session.outputs.reads_any([Some(args.scene.as_path()), args.cameras.as_deref()])?;
    let read = args.cameras.as_ref().map(|path| cameras::read(path, args)).transpose()?;
    session.outputs.open_folder(&[])?;
    let options = ReadOptions { sh_rest: true, ..args.source.options() };
    let LoadedScene { scene, stated_up, .. } = session.open_with(&args.scene, &options)?.loaded;
    let up = || args.up.unwrap_or_else(|| guess_up(&scene, stated_up).direction);
    let shots = match read {
        Some(shots) => shots.relative_to(scene.origin),
        None => free::of_scene(&scene, up(), args)?,
    };
    let mut names: Vec<String> =
        shots.list.iter().map(|shot| format!("{}.png", shot.name)).collect();
    if !args.effect.split_for_pictures().1.is_empty() {
        names.push("effects.json".to_owned());
    }
    if !args.keeps_cameras() {
        names.push("cameras.json".to_owned());
    }
    session.outputs.open_folder(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
    for note in &shots.notes {
        session.progress.say(note);
    }
    let origin = scene.origin;
    let (scene, mut effects) = Effects::on(&session, args, (scene, stated_up), &shots)?;
    let prepared = prepare(&session, args, scene, &shots, effects.needs_depth())?;
    let (lost, empty) = draw(&session, args, &prepared, &shots.list, &mut effects)?;
    if !args.keeps_cameras() {
        session.write("cameras.json", |path| cameras::write(&shots.list, origin, path))?;
    }
    effects.tell(&session)?;
    if let Some(first) = empty.first() {
        session.warn(format!(
            "{} of {} pictures show no Gaussian, {first} first; are the cameras in the frame of the \
             scene?",
            empty.len(),
            shots.list.len()
        ));
    }
    if lost > 0 {
        session.warn(format!(
            "{lost} depths do not fit 16 bits and were written as 0; give a smaller --depth-scale"
        ));
    }
    if let [Shot { camera: Camera { width, height, .. }, .. }, ..] = &shots.list[..] {
        session
            .tell(format!("{} pictures, the first of {width} x {height} pixels", shots.list.len()));
    }
    session.finish()
}

/// Draws and writes the pictures: how many depths were lost, and which pictures are empty.
fn draw<'a>(
    session: &Session<'_>,
    args: &Args,
    prepared: &Prepared,
    shots: &'a [Shot],
    effects: &mut Effects,
) -> Result<(usize, Vec<&'a str>)> {
    let pictures = ScenePictures::new(prepared);
    let _stage = session.receipt.stage("render");
    let (mut lost, mut empty) = (0, Vec::new());
    for (k, shot) in shots.iter().enumerate() {
        session.check_stop()?;
        let done = k as f64 / shots.len() as f64;
        session.progress.advance(&format!("render {}", shot.name), done);
        let picture = effects.take(&pictures, shot)?;
        lost += write(session, args, shot, &picture)?;
        if pictures.take_visible() == 0 {
            empty.push(shot.name.as_str());
        }
    }
    session.progress.finish();
    Ok((lost, empty))
}

/// Activates the scene, plans, and says the plan.
fn prepare(
    session: &Session<'_>,
    args: &Args,
    scene: GaussianScene,
    shots: &Shots,
    needs_depth: bool,
) -> Result<Prepared> {
    let _stage = session.receipt.stage("plan");
    let antialiased = args.antialiased.unwrap_or(scene.antialiased);
    let mut gaussians = Gaussians::from_scene(&scene)?;
    drop(scene);
    if let Some(ceiling) = shots.ceiling {
        for (opacity, mean) in gaussians.opacities.iter_mut().zip(&gaussians.means) {
            if ceiling.hides(*mean) {
                *opacity = 0.0;
            }
        }
    }
    let preset = args.preset.settings();
    let settings = RasterSettings {
        antialiased,
        background: args.background,
        near: near(args, shots),
        ..preset
    };
    let depth = DepthRequest { expected: args.depth || needs_depth, ..DepthRequest::default() };
    let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
    let profile = SceneProfile::scan(&gaussians)?;
    let plan = match args.plan {
        PlanArg::Auto => RenderPlan::auto(&profile, settings, request)?,
        PlanArg::Full => RenderPlan::full(&profile, settings, request)?,
    };
    session.progress.detail(plan.to_string());
    session.receipt.plan(gaussians.means.len(), render_section(&plan));
    let name = args.preset.to_possible_value();
    let name = name.as_ref().map_or("", |v| v.get_name());
    session.receipt.setting("preset", name, "constants of the renderer");
    session.receipt.setting("plan", &plan, "what is computed, and why not the rest");
    if args.depth {
        session.receipt.setting("depth_scale", args.depth_scale, "16-bit steps per unit");
    }
    Ok(plan.prepare(gaussians)?)
}

/// Depth from which on Gaussians are drawn.
fn near(args: &Args, shots: &Shots) -> f32 {
    let preset = args.preset.settings().near;
    shots.near.map_or(preset, |near| preset.max(near as f32))
}

/// Writes the pictures of a camera; gives the number of depths that do not fit.
fn write(session: &Session<'_>, args: &Args, shot: &Shot, picture: &DrawnPicture) -> Result<usize> {
    let (width, height) = (shot.camera.width, shot.camera.height);
    let rgb = picture_of(&picture.rgb, width, height).context("a picture has three channels")?;
    session.write(&format!("{}.png", shot.name), |path| write_png(path, &rgb))?;
    let depth = picture.depth.as_ref().filter(|_| args.depth);
    let Some(depth) = depth else { return Ok(0) };
    let (steps, lost) = depth_steps(depth, args.depth_scale);
    let size = [width, height];
    session.write(&format!("depth/{}.png", shot.name), |path| write_png16(path, &steps, size))?;
    session.write(&format!("depth_color/{}.png", shot.name), |path| {
        write_png(path, &depth_picture(depth, width, height))
    })?;
    Ok(lost)
}
