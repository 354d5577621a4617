//! Pictures of the scene, as `render` draws them.

use super::tools::{Answer, Arguments, word};
use crate::called::parse;
use crate::commands::labelled::LabelArgs;
use crate::commands::render;
use crate::error::{WrongUse, refuse};
use crate::frame::Frame;
use crate::session::Session;
use anyhow::{Context, Result, ensure};
use clap::Parser;
use scenesplat::objects::{Catalogue, Object, UprightBox, is_building};
use scenesplat::preview::{LookAt, SceneRows, inside_views, rendered_picture};
use scenesplat::rasterizer::{
    Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest, SceneProfile, View,
};
use scenesplat::scene::{GaussianScene, ReadOptions};
use serde_json::json;
use std::ffi::OsString;

/// Angle of view, degrees, and size, where none is given: as `render` has them.
const FOV: f64 = 60.0;
const SIZE: [u32; 2] = [640, 480];
/// Places around an object that are tried: directions, how high above it, degrees, and distances, as parts of that from which
/// its box fills the picture.
const DIRECTIONS: u32 = 8;
const ABOVE: f64 = 25.0;
const DISTANCES: [f64; 2] = [1.5, 1.0];
/// Size of the pictures by which they are compared.
const GLANCE: [u32; 2] = [96, 72];
/// Distance from the outer walls, meters.
const CLEAR: f64 = 0.1;

/// Of `render`.
#[derive(Debug, Parser)]
struct Flags {
    #[command(flatten)]
    args: render::Args,
}

/// A labeled scene, and how it lies.
pub struct Seen<'a> {
    /// Reads the scene's colors.
    pub session: &'a Session<'a>,
    /// Flags of the command.
    pub labels: &'a LabelArgs,
    /// The scene, as labels needed it.
    pub scene: &'a GaussianScene,
    /// Its objects.
    pub found: &'a Catalogue,
    /// How it lies.
    pub frame: Frame,
}

/// What pictures need, made when the first is asked for.
#[derive(Default)]
pub struct Pictures {
    prepared: Option<Prepared>,
    free_place: Option<[f64; 3]>,
}

impl Pictures {
    /// Draws a picture, towards the object if there is one.
    ///
    /// # Errors
    /// As `render` has them.
    pub fn draw(
        &mut self,
        seen: &Seen<'_>,
        object: Option<&Object>,
        arguments: &Arguments,
    ) -> Result<Answer> {
        let args = flags(seen.labels, object, arguments)?;
        let fov = args.fov.unwrap_or(FOV);
        let prepared = match self.prepared.take() {
            Some(prepared) => prepared,
            None => prepare(seen)?,
        };
        let prepared = self.prepared.insert(prepared);
        let given = args.eye.filter(|_| arguments.contains_key("eye"));
        let (eye, target) = match (given, object, args.target) {
            (Some(eye), Some(object), _) => (eye, object.position),
            (Some(eye), None, Some(target)) => (eye, target),
            (None, Some(object), _) => {
                (stand(prepared, seen, object, fov, &mut self.free_place)?, object.position)
            }
            _ => refuse!("give eye and target, or object"),
        };
        let size = args.size.unwrap_or(SIZE);
        let view = View::look_at(&LookAt { eye, target, fov }, seen.frame.up, size)
            .map_err(|error| WrongUse(error.to_string()))?;
        let drawn = prepared.render(&view, &RenderRequest::rgb())?;
        let picture = rendered_picture(&drawn).context("a picture has three channels")?;
        let mut json = json!({ "eye": eye, "target": target, "fov": fov, "size": size });
        if let Some(object) = object {
            (json["object"], json["class"]) = (object.id.into(), object.class.as_str().into());
        }
        if drawn.transmittance.iter().all(|through| *through == 1.0) {
            json["notes"] = json!(["the picture shows no Gaussian"]);
        }
        Ok(Answer { json, png: Some(picture.encode_png()?) })
    }
}

/// Where to stand to see an object: of places around it within the scene the one from which least of it is hidden, else, and for
/// what the room is made of, the free place in which `render --inside` stands.
fn stand(
    prepared: &Prepared,
    seen: &Seen<'_>,
    object: &Object,
    fov: f64,
    free_place: &mut Option<[f64; 3]>,
) -> Result<[f64; 3]> {
    let mut best = (0.0, None);
    for (eye, distance) in around(object, seen, fov) {
        let look = LookAt { eye, target: object.position, fov };
        let Ok(view) = View::look_at(&look, seen.frame.up, GLANCE) else { continue };
        // An object twice as far covers a quarter of the pixels.
        let visible = pixels(prepared, &view, &object.rows)? * distance * distance;
        if visible > best.0 {
            best = (visible, Some(eye));
        }
    }
    if let (_, Some(eye)) = best {
        return Ok(eye);
    }
    if let Some(place) = *free_place {
        return Ok(place);
    }
    let colors = vec![[0; 3]; seen.scene.len()];
    let sizes = SceneRows::of(seen.scene);
    let cameras = inside_views(&sizes.rows(seen.scene, &colors), seen.frame.up, 1, FOV, SIZE);
    let camera = cameras.first().context("the scene has no Gaussian to stand among")?;
    Ok(*free_place.insert(camera.centre()))
}

/// Places around an object, in the frame and unit of the scene, with their distances in meters.
fn around(object: &Object, seen: &Seen<'_>, fov: f64) -> Vec<([f64; 3], f64)> {
    if is_building(&object.class) {
        return Vec::new();
    }
    let UprightBox { center, size, yaw } = object.bounds;
    let radius = size.iter().map(|v| v * v).sum::<f64>().sqrt() / 2.0;
    let fills = radius / (fov / 2.0).to_radians().sin();
    let corners = seen.found.objects.iter().flat_map(|o| o.bounds.corners());
    let (low, high) = corners.fold(([f64::MAX; 3], [f64::MIN; 3]), |(low, high), c| {
        ([0, 1, 2].map(|a| low[a].min(c[a])), [0, 1, 2].map(|a| high[a].max(c[a])))
    });
    let Frame { upright, metres_per_unit, .. } = seen.frame;
    let mut places = Vec::new();
    for distance in DISTANCES.map(|part| part * fills) {
        for k in 0..DIRECTIONS {
            // Between the sides, from where most of a thing is seen.
            let turn = yaw + std::f64::consts::TAU * (f64::from(k) + 0.5) / f64::from(DIRECTIONS);
            let (sine, cosine) = ABOVE.to_radians().sin_cos();
            let away = [cosine * turn.cos(), cosine * turn.sin(), sine];
            let place = [0, 1, 2].map(|a| center[a] + distance * away[a]);
            if (0..3).all(|a| place[a] > low[a] + CLEAR && place[a] < high[a] - CLEAR) {
                let back = |a: usize| (0..3).map(|row| upright[row][a] * place[row]).sum::<f64>();
                places.push(([0, 1, 2].map(|a| back(a) / metres_per_unit), distance));
            }
        }
    }
    places
}

/// Pixels that some Gaussians cover in a view.
fn pixels(prepared: &Prepared, view: &View, rows: &[u32]) -> Result<f64> {
    let request = RenderRequest { contributions: true, ..RenderRequest::default() };
    let drawn = prepared.render(view, &request)?.contributions.unwrap_or_default();
    let place = |row: &u32| match prepared.rows() {
        Some(kept) => kept.binary_search(row).ok(),
        None => usize::try_from(*row).ok(),
    };
    let weights = rows.iter().filter_map(place).filter_map(|place| drawn.sum.get(place));
    Ok(weights.map(|weight| f64::from(*weight)).sum())
}

/// The arguments as flags of `render`, which says what is wrong with them.
fn flags(
    labels: &LabelArgs,
    object: Option<&Object>,
    arguments: &Arguments,
) -> Result<render::Args> {
    if object.is_some() && arguments.contains_key("target") {
        refuse!("object and target: give one of them");
    }
    let mut words: Vec<OsString> = Vec::new();
    for name in ["eye", "target", "fov", "size"] {
        if let Some(value) = arguments.get(name) {
            words.push(format!("--{name}={}", word(value)).into());
        }
    }
    if let Some(object) = object {
        let [x, y, z] = object.position;
        words.push(format!("--target={x},{y},{z}").into());
        // Its flags go together; where to stand is found later.
        if !arguments.contains_key("eye") {
            words.push("--eye=0,0,0".into());
        }
    }
    words.extend(["--".into(), labels.scene.clone().into_os_string()]);
    let Flags { args } = parse(&words)?;
    Ok(args)
}

/// Reads the colors of the scene that labels need not, and plans as `render` does.
fn prepare(seen: &Seen<'_>) -> Result<Prepared> {
    let Seen { session, labels, .. } = seen;
    let options = ReadOptions { sh_rest: true, ..labels.labelling.inference.source.options() };
    let scene = session.read(&labels.scene, &options)?.loaded.scene;
    let path = labels.scene.display();
    ensure!(scene.coord == seen.scene.coord, "{path}: is another scene than when it was labeled");
    let settings =
        RasterSettings { antialiased: scene.antialiased, ..RasterSettings::gsplat_1_6() };
    let gaussians = Gaussians::from_scene(&scene)?;
    let profile = SceneProfile::scan(&gaussians)?;
    let request = RenderRequest { contributions: true, ..RenderRequest::rgb() };
    let plan = RenderPlan::auto(&profile, settings, PlanRequest::new(request))?;
    Ok(plan.prepare(gaussians)?)
}
