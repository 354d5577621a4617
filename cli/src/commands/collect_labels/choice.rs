//! Which pictures: planned ones where there are no photos, the best where there are many.

use super::args::Args;
use super::frames::Frame;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::collection::{
    Shown, ViewPlanSettings, choose_pictures, fit_photo, plan_views, relative_sharpness, seen_in,
};
use scenesplat::rasterizer::{Gaussians, View};
use scenesplat::scene::{Camera, LoadedScene, guess_up};
use scenesplat_lab::capture::frame_figures;

/// Cameras for a scene without photos.
pub(super) fn planned(
    session: &Session<'_>,
    args: &Args,
    loaded: &LoadedScene,
    gaussians: &Gaussians,
    count: u16,
) -> Result<Vec<Frame>> {
    let _stage = session.receipt.stage("frames");
    session.progress.say("planning views");
    let scene = &loaded.scene;
    let up = args.lifting.up.unwrap_or_else(|| guess_up(scene, loaded.stated_up).direction);
    let settings =
        ViewPlanSettings { count: usize::from(count), size: args.size, fov: args.fov, up };
    let plan = plan_views(gaussians, &settings)?;
    let text = format!(
        "{} views {} the scene show {:.1} % of the Gaussians ({} of {} that were tried looked at nothing, or stood \
         in or too near to something)",
        plan.cameras.len(),
        if plan.outside { "around" } else { "inside" },
        100.0 * plan.seen,
        plan.refused,
        plan.tried
    );
    session.progress.say(&text);
    session.receipt.setting("views", plan.cameras.len(), &text);
    session.receipt.setting("up", up, "of the planned views");
    if plan.cameras.len() < usize::from(count) {
        session.warn(format!("{} of {count} views: more would show nothing", plan.cameras.len()));
    }
    let frame = |camera: Camera| Frame { name: camera.name.clone(), camera, photo: None };
    Ok(plan.cameras.into_iter().map(frame).collect())
}

/// The frames that show most, in their order; all if there are no more than `most`.
pub(super) fn chosen(
    session: &Session<'_>,
    frames: Vec<Frame>,
    gaussians: &Gaussians,
    most: u32,
) -> Result<Vec<Frame>> {
    let _stage = session.receipt.stage("frames");
    let most = most as usize;
    if frames.len() <= most {
        return Ok(frames);
    }
    let (mut sharpness, mut shown, mut things) = (Vec::new(), Vec::new(), 0);
    for (number, frame) in frames.iter().enumerate() {
        session.check_stop()?;
        session.progress.advance("choosing pictures", number as f64 / frames.len() as f64);
        let Some(path) = &frame.photo else { continue };
        let (photo, camera, _) = fit_photo(path, &frame.camera)?;
        let figures = frame_figures(&photo).with_context(|| path.display().to_string())?;
        sharpness.push(figures.sharpness);
        let seen = seen_in(gaussians, &View::from_camera(&camera)?, 0.0)?;
        things = seen.sampled;
        shown.push(Shown { things: seen.rows, quality: 1.0 });
    }
    session.progress.finish();
    for (shown, quality) in shown.iter_mut().zip(relative_sharpness(&sharpness)) {
        shown.quality = quality;
    }
    let mut picked = choose_pictures(&shown, things, most);
    picked.sort_unstable();
    let text = format!(
        "{} of {} pictures: those that show most that the others do not, sharp ones first",
        picked.len(),
        frames.len()
    );
    session.progress.say(&text);
    session.receipt.setting("max_frames", most, &text);
    anyhow::ensure!(
        !picked.is_empty(),
        "no picture shows a Gaussian; are the cameras in the frame of the scene?"
    );
    let mut all: Vec<Option<Frame>> = frames.into_iter().map(Some).collect();
    Ok(picked.into_iter().filter_map(|i| all[i].take()).collect())
}
