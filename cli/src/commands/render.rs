//! `scenesplat render`

mod cameras;

use super::WrongUse;
use crate::flags::{Shared, SourceArgs, parse_positive, parse_up};
use crate::session::Session;
use anyhow::{Context, Result};
use cameras::{Shot, Shots};
use clap::ValueEnum;
use scenesplat::preview::{depth_picture, write_png, write_png16};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, MAX_PIXELS, MAX_SIDE, PlanRequest, Prepared, RasterSettings,
    RenderPlan, RenderRequest, Rendered, SceneProfile, View,
};
use scenesplat::scene::picture::RgbPicture;
use scenesplat::scene::{GaussianScene, ReadOptions, UpAxis, guess_up};
use std::path::PathBuf;

/// Draws a scene: one PNG for each camera of a file, or for cameras around the scene. With --depth
/// also depth/NAME.png (16 bits) and depth_color/NAME.png.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// cameras.json, transforms.json or a COLMAP folder; without it the scene is looked at from
    /// around it.
    #[arg(long, value_name = "PATH")]
    pub cameras: Option<PathBuf>,
    /// Only these cameras: names of pictures, or numbers from 0.
    #[arg(long = "camera", value_name = "NAME|INDEX", num_args = 1.., requires = "cameras")]
    pub chosen: Vec<String>,
    /// Number of cameras around the scene; 4 if no other cameras are given.
    #[arg(long, value_name = "N", conflicts_with_all = ["cameras", "eye", "inside"],
          value_parser = clap::value_parser!(u16).range(1..=3600))]
    pub orbit: Option<u16>,
    /// Number of cameras that look around from a free place inside the scene: for rooms.
    #[arg(long, value_name = "N", conflicts_with_all = ["cameras", "eye"],
          value_parser = clap::value_parser!(u16).range(1..=3600))]
    pub inside: Option<u16>,
    /// Where a single camera stands, in the coordinates of the scene.
    #[arg(long, value_name = "X,Y,Z", requires = "target", conflicts_with = "cameras",
          value_parser = parse_point, allow_hyphen_values = true)]
    pub eye: Option<[f64; 3]>,
    /// What it looks at.
    #[arg(long, value_name = "X,Y,Z", requires = "eye",
          value_parser = parse_point, allow_hyphen_values = true)]
    pub target: Option<[f64; 3]>,
    /// Angle of view across the shorter side of the picture, of --eye (60 by default) and --inside
    /// (75).
    #[arg(long, value_name = "DEGREES", conflicts_with_all = ["cameras", "orbit"],
          value_parser = parse_fov)]
    pub fov: Option<f64>,
    /// Also writes depth.
    #[arg(long)]
    pub depth: bool,
    /// What one unit of the scene is in the 16-bit pictures of depth: 1000 writes millimetres of a
    /// scene in metres.
    #[arg(long, value_name = "STEPS", default_value_t = 1000.0, requires = "depth",
          value_parser = parse_positive, allow_hyphen_values = true)]
    pub depth_scale: f64,
    /// Size of the pictures; by default the cameras' own, 640x480 for those around the scene.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Whose constants to use.
    #[arg(long, value_enum, default_value_t = PresetArg::Gsplat16)]
    pub preset: PresetArg,
    /// Makes up for the low-pass with opacity; for scenes that were trained so.
    #[arg(long)]
    pub antialiased: bool,
    /// Colour behind the scene, 0 to 1; black by default.
    #[arg(long, value_name = "R,G,B", value_parser = parse_color)]
    pub background: Option<[f32; 3]>,
    /// auto leaves out what the scene does not have; full computes everything.
    #[arg(long, value_enum, default_value_t = PlanArg::Auto)]
    pub plan: PlanArg,
    /// Which way is up for --orbit, --inside and --eye; judged by the scene if not given.
    #[arg(long, value_name = "AXIS", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<UpAxis>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Whose constants to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetArg {
    /// gsplat 1.6.
    #[value(name = "gsplat-1.6")]
    Gsplat16,
    /// gsplat 1.5.
    #[value(name = "gsplat-1.5")]
    Gsplat15,
    /// Inria's original rasterizer.
    #[value(name = "inria")]
    Inria,
}

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PlanArg {
    /// What the scene and the request call for.
    Auto,
    /// Everything.
    Full,
}

/// Depth is written where at least this much of the light is stopped.
const SOLID: f32 = 0.5;

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
    let scene = read_scene(&session, args)?;
    let shots = match read {
        Some(shots) => shots,
        None => {
            let up = args.up.unwrap_or_else(|| guess_up(&scene).axis);
            cameras::of_scene(&scene, up, args)?
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

fn read_scene(session: &Session<'_>, args: &Args) -> Result<GaussianScene> {
    let _stage = session.receipt.stage("read");
    let options = ReadOptions { sh_rest: true, ..args.source.options() };
    let opened = session.read(&args.scene, &options)?;
    if !opened.loaded.report.is_clean() {
        let text = opened.loaded.report.to_string();
        session.progress.say(&text);
        session.receipt.warning(text);
    }
    session.receipt.add_rows_in(opened.loaded.source_rows());
    session.receipt.fingerprint("input", &args.scene)?;
    Ok(opened.loaded.scene)
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
    let preset = match args.preset {
        PresetArg::Gsplat16 => RasterSettings::gsplat_1_6(),
        PresetArg::Gsplat15 => RasterSettings::gsplat_1_5(),
        PresetArg::Inria => RasterSettings::inria(),
    };
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
    let bytes = |v: &f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let rgb: Vec<u8> = picture.rgb.iter().flatten().map(bytes).collect();
    let rgb = RgbPicture::from_pixels(width, height, rgb.as_chunks::<3>().0.to_vec())
        .context("a picture has three channels")?;
    let path = session.out(&format!("{}.png", shot.name))?;
    session.wrote(&path, write_png(&path, &rgb)?);
    let Some(depth) = picture.depth_expected.as_ref().filter(|_| args.depth) else { return Ok(0) };
    let solid: Vec<f32> = depth
        .iter()
        .zip(&picture.transmittance)
        .map(|(d, t)| if 1.0 - t >= SOLID { *d } else { 0.0 })
        .collect();
    let inside = |folder: &str| session.out(&format!("{folder}/{}.png", shot.name));
    let mut lost = 0;
    let steps: Vec<u16> = solid
        .iter()
        .map(|d| {
            let steps = (f64::from(*d) * args.depth_scale).round();
            lost += usize::from(steps > 65535.0);
            if steps > 65535.0 { 0 } else { steps as u16 }
        })
        .collect();
    let path = inside("depth")?;
    session.wrote(&path, write_png16(&path, &steps, [width, height])?);
    let path = inside("depth_color")?;
    session.wrote(&path, write_png(&path, &depth_picture(&solid, width, height))?);
    Ok(lost)
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let size: Option<[u32; 2]> =
        text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    match size {
        Some([w, h]) if w > 0 && h > 0 => {
            if w.max(h) > MAX_SIDE || u64::from(w) * u64::from(h) > MAX_PIXELS {
                let most = format!("{MAX_SIDE} on a side and {MAX_PIXELS} in all");
                return Err(format!("{text:?}: pictures have at most {most}"));
            }
            Ok([w, h])
        }
        _ => Err(format!("{text:?} is no size; write 640x480")),
    }
}

fn parse_point(text: &str) -> Result<[f64; 3], String> {
    let values: Option<Vec<f64>> =
        text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let point = values.and_then(|v| <[f64; 3]>::try_from(v).ok());
    point.ok_or_else(|| format!("{text:?} is no point; write three numbers: 1.5,0,-2"))
}

fn parse_fov(text: &str) -> Result<f64, String> {
    let angle = text.parse().ok().filter(|v: &f64| *v >= 1.0 && *v <= 170.0);
    angle.ok_or_else(|| format!("{text:?}: write an angle of 1 to 170 degrees"))
}

fn parse_color(text: &str) -> Result<[f32; 3], String> {
    let values: Option<Vec<f32>> = text.split(',').map(|v| v.trim().parse().ok()).collect();
    match values.as_deref() {
        Some(&[r, g, b]) if [r, g, b].iter().all(|v| (0.0..=1.0).contains(v)) => Ok([r, g, b]),
        _ => Err(format!("{text:?} is no colour; write three numbers from 0 to 1: 1,1,1")),
    }
}
