//! Values at the edge of what is legal, through the library's own writers and readers.

use super::files::{file_name, files_of_scenes, open, refused, scene, through};
use crate::doctor::case::{Case, Finding};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::{
    GaussianScene, Policy as ReadPolicy, SceneFormat, WriteOptions, write_scene,
};

/// What is tried with each format.
const CHECKS: [(&str, fn(&Trial<'_>, SceneFormat) -> Result<Finding, Failure>); 6] = [
    ("half-turns", half_turns),
    ("alpha-0-and-1", alpha),
    ("flat", flat),
    ("far-away", far),
    ("one-gaussian", one),
    ("cut-short", cut),
];

/// Gaussians of the scenes.
const ROWS: usize = 8;

pub(super) fn cases() -> Vec<Case> {
    let of = |format: SceneFormat| {
        // `compressed`, not `compressed-ply`.
        let name = format.name().trim_end_matches("-ply");
        CHECKS.map(|(what, check)| case(format!("{name}-{what}"), move |t| check(t, format)))
    };
    files_of_scenes().chain([SceneFormat::NpyFolder]).flat_map(of).collect()
}

fn half_turns(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let mut scene = scene(ROWS, 0, 3);
    scene.quat = vec![[0.0, 0.6, 0.0, 0.8]; ROWS];
    let back = through(trial, &scene, format)?.scene;
    ensure!(back.len() == ROWS, "{} Gaussians of {ROWS}", back.len());
    let mut found = Finding::right();
    for quat in back.quat {
        let dot = 0.6 * f64::from(quat[1]) + 0.8 * f64::from(quat[3]);
        found.add(1.0 - dot.abs(), || format!("[0, 0.6, 0, 0.8] became {quat:?}"));
    }
    Ok(found)
}

fn alpha(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let mut scene = scene(ROWS, 0, 4);
    for (row, logit) in scene.opacity_logit.iter_mut().enumerate() {
        *logit = if row % 2 == 0 { f32::INFINITY } else { f32::NEG_INFINITY };
    }
    let loaded = through(trial, &scene, format)?;
    ensure!(loaded.report.is_clean(), "reported as repaired: {}", loaded.report);
    let with = |alpha: f32| {
        (0..loaded.scene.len()).filter(|&row| loaded.scene.opacity(row) == alpha).count()
    };
    let counts = (with(0.0), with(1.0));
    ensure!(counts == (ROWS / 2, ROWS / 2), "{counts:?} Gaussians of alpha 0 and 1");
    Ok(Finding::right())
}

fn flat(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let mut scene = scene(ROWS, 0, 5);
    scene.log_scale.iter_mut().for_each(|scale| scale[1] = f32::NEG_INFINITY);
    let loaded = through(trial, &scene, format)?;
    ensure!(loaded.report.is_clean(), "reported as repaired: {}", loaded.report);
    ensure!(loaded.scene.len() == ROWS, "{} Gaussians of {ROWS}", loaded.scene.len());
    let thick = (0..ROWS).map(|row| f64::from(loaded.scene.scale(row)[1])).fold(0.0, f64::max);
    Ok(Finding::of(thick, format!("thickness 0 became {thick:e} m")))
}

fn far(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let mut scene = scene(ROWS, 0, 6);
    // Steps that an f32 still holds at that distance, apart enough to know rows again.
    for (row, coord) in scene.coord.iter_mut().enumerate() {
        *coord = [1e6 + 8.0 * row as f32, -1e6, 0.5];
    }
    let loaded = through(trial, &scene, format)?;
    ensure!(loaded.scene.len() == ROWS, "{} Gaussians of {ROWS}", loaded.scene.len());
    let mut got = loaded.scene.coord;
    got.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut found = Finding::right();
    for (got, want) in got.iter().zip(&scene.coord) {
        for (g, w) in got.iter().zip(want) {
            let error = (f64::from(*g) - f64::from(*w)).abs() / 1e6;
            found.add(error, || format!("{want:?} became {got:?}"));
        }
    }
    Ok(found)
}

fn one(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let scene = GaussianScene { coord: vec![[0.25, -0.5, 0.75]], ..scene(1, 0, 7) };
    let loaded = through(trial, &scene, format)?;
    ensure!(loaded.scene.len() == 1, "{} Gaussians", loaded.scene.len());
    let apart = loaded.scene.coord[0].iter().zip(&scene.coord[0]);
    let error = apart.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    Ok(Finding::of(error, format!("{:?} became {:?}", scene.coord[0], loaded.scene.coord[0])))
}

fn cut(trial: &Trial<'_>, format: SceneFormat) -> Result<Finding, Failure> {
    let path = trial.folder().join(file_name(format));
    let scene = scene(ROWS, 0, 8);
    write_scene(&scene, &path, format, &WriteOptions::default(), &mut |_| true)?;
    let file = if path.is_dir() { path.join("coord.npy") } else { path.clone() };
    let whole = std::fs::read(&file)?;
    // Half of a `.splat` file is a whole one of half as many Gaussians: it has no header.
    let half = if format == SceneFormat::Splat { 5 } else { whole.len() / 2 };
    for rest in [half, whole.len() - 5] {
        std::fs::write(&file, &whole[..rest])?;
        refused(open(&path, ReadPolicy::Repair), &[&file_name(format)])?;
    }
    Ok(Finding::right())
}
