//! `scenesplat render`

mod args;
mod cameras;
mod free;
mod parse;

use super::WrongUse;
use crate::session::Session;
use anyhow::{Context, Result};
pub use args::Args;
use args::PlanArg;
use cameras::{Shot, Shots};
use clap::ValueEnum;
use scenesplat::preview::{
    depth_picture, depth_steps, rendered_picture, solid_depth, write_png, write_png16,
};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest,
    Rendered, SceneProfile, View,
};
use scenesplat::scene::{GaussianScene, ReadOptions, guess_up};

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    if args.fov.is_some() && args.eye.is_none() && args.inside.is_none() {
        let text = "--fov goes with --eye and --target, or with --inside";
        return Err(WrongUse(text.to_owned()).into());
    }
    let session = Session::start(&args.shared, line)?;
    // Wrong cameras are said before a large scene is read.
    session.outputs.reads_any([Some(args.scene.as_path()), args.cameras.as_deref()])?;
    let read = args.cameras.as_ref().map(|path| cameras::read(path, args)).transpose()?;
    session.make_out(&[])?;
    let options = ReadOptions { sh_rest: true, ..args.source.options() };
    let scene = session.open_with(&args.scene, &options)?.loaded.scene;
    let shots = match read {
        Some(shots) => shots,
        None => {
            let up = args.up.unwrap_or_else(|| guess_up(&scene).axis);
            free::of_scene(&scene, up, args)?
        }
    };
    let names: Vec<String> = shots.list.iter().map(|shot| format!("{}.png", shot.name)).collect();
    session.make_out(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
    for note in &shots.notes {
        session.progress.say(note);
    }
    let prepared = prepare(&session, args, scene, &shots)?;
    let _stage = session.receipt.stage("render");
    let request = prepared.plan().request.render;
    let (mut lost, mut empty) = (0, Vec::new());
    for (k, shot) in shots.list.iter().enumerate() {
        session.check_stop()?;
        let done = k as f64 / shots.list.len() as f64;
        session.progress.advance(&format!("render {}", shot.name), done);
        let view = View::from_camera(&shot.camera)?;
        let picture = prepared.render(&view, &request)?;
        lost += write(&session, args, shot, &picture)?;
        if picture.work.visible == 0 {
            empty.push(shot.name.as_str());
        }
    }
    session.progress.finish();
    drop(_stage);
    if let Some(first) = empty.first() {
        let text = format!(
            "{} of {} pictures show no Gaussian, {first} first; are the cameras in the frame of the \
             scene?",
            empty.len(),
            shots.list.len()
        );
        session.progress.say(&text);
        session.receipt.warning(text);
    }
    if lost > 0 {
        let text = format!(
            "{lost} depths do not fit 16 bits and were written as 0; give a smaller --depth-scale"
        );
        session.progress.say(&text);
        session.receipt.warning(text);
    }
    session.finish()
}

/// Activates the scene, plans, and says the plan.
fn prepare(
    session: &Session<'_>,
    args: &Args,
    scene: GaussianScene,
    shots: &Shots,
) -> Result<Prepared> {
    let _stage = session.receipt.stage("plan");
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
        antialiased: args.antialiased,
        background: args.background,
        near: shots.near.map_or(preset.near, |near| preset.near.max(near as f32)),
        ..preset
    };
    let depth = DepthRequest { expected: args.depth, ..DepthRequest::default() };
    let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
    let profile = SceneProfile::scan(&gaussians)?;
    let plan = match args.plan {
        PlanArg::Auto => RenderPlan::auto(&profile, settings, request)?,
        PlanArg::Full => RenderPlan::full(&profile, settings, request)?,
    };
    session.progress.say(plan.to_string());
    let name = args.preset.to_possible_value();
    let name = name.as_ref().map_or("", |v| v.get_name());
    session.receipt.setting("preset", name, "constants of the renderer");
    session.receipt.setting("plan", &plan, "what is computed, and why not the rest");
    if args.depth {
        session.receipt.setting("depth_scale", args.depth_scale, "16-bit steps per unit");
    }
    Ok(plan.prepare(gaussians)?)
}

/// Writes the pictures of a camera; gives the number of depths that do not fit.
fn write(session: &Session<'_>, args: &Args, shot: &Shot, picture: &Rendered) -> Result<usize> {
    let (width, height) = (picture.width, picture.height);
    let path = session.out(&format!("{}.png", shot.name))?;
    let rgb = rendered_picture(picture).context("a picture has three channels")?;
    session.wrote(&path, write_png(&path, &rgb)?);
    let depth = solid_depth(picture).filter(|_| args.depth);
    let Some(depth) = depth else { return Ok(0) };
    let inside = |folder: &str| session.out(&format!("{folder}/{}.png", shot.name));
    let (steps, lost) = depth_steps(&depth, args.depth_scale);
    let path = inside("depth")?;
    session.wrote(&path, write_png16(&path, &steps, [width, height])?);
    let path = inside("depth_color")?;
    session.wrote(&path, write_png(&path, &depth_picture(&depth, width, height))?);
    Ok(lost)
}
