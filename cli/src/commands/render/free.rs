//! Cameras without a file: the one of the flags, those inside a scene, or those around it.

use super::Args;
use super::cameras::{Shot, Shots};
use crate::error::WrongUse;
use anyhow::Result;
use scenesplat::preview::{LookAt, Orbit, SceneRows, inside_views};
use scenesplat::scene::{Camera, GaussianScene, Up};

/// Size of the pictures around a scene.
const ORBIT_SIZE: [u32; 2] = [640, 480];

/// The cameras that the flags ask for.
pub(super) fn of_scene(scene: &GaussianScene, up: Up, args: &Args) -> Result<Shots> {
    let size = args.size.unwrap_or(ORBIT_SIZE);
    let plain = |cameras: Vec<Camera>| Shots {
        list: numbered(cameras),
        near: None,
        ceiling: None,
        notes: Vec::new(),
    };
    if let (Some(eye), Some(target)) = (args.eye, args.target) {
        let relative = |p: [f64; 3]| [0, 1, 2].map(|i| p[i] - scene.origin[i]);
        let fov = args.fov.unwrap_or(60.0);
        let look = LookAt { eye: relative(eye), target: relative(target), fov };
        let camera = look.camera("view", up, size).ok_or_else(|| {
            WrongUse(format!("--target {target:?}: is where --eye is; the camera looks nowhere"))
        })?;
        return Ok(plain(vec![camera]));
    }
    if let Some(count) = args.inside {
        let color = vec![[0; 3]; scene.len()];
        let sizes = SceneRows::of(scene);
        let fov = args.fov.unwrap_or(75.0);
        let cameras = inside_views(&sizes.rows(scene, &color), up, count.into(), fov, size);
        anyhow::ensure!(!cameras.is_empty(), "--inside: the scene has no Gaussian to stand among");
        return Ok(plain(cameras));
    }
    Ok(around(scene, up, args))
}

fn numbered(cameras: Vec<Camera>) -> Vec<Shot> {
    let shot = |(index, camera): (usize, Camera)| Shot { name: camera.name.clone(), camera, index };
    cameras.into_iter().enumerate().map(shot).collect()
}

/// Cameras around a scene.
fn around(scene: &GaussianScene, up: Up, args: &Args) -> Shots {
    let count = usize::from(args.orbit.unwrap_or(4));
    let color = vec![[0; 3]; scene.len()];
    let sizes = SceneRows::of(scene);
    let rows = sizes.rows(scene, &color);
    let orbit = Orbit::around(&rows, up, count, args.size.unwrap_or(ORBIT_SIZE));
    let mut notes = Vec::new();
    if orbit.near.is_some() {
        let what = if orbit.ceiling.is_some() { "ceiling and near walls" } else { "near walls" };
        notes.push(format!("a room: {what} are left out"));
    }
    Shots { list: numbered(orbit.cameras), near: orbit.near, ceiling: orbit.ceiling, notes }
}
