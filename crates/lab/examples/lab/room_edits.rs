//! What a network makes of rooms that were changed as scans differ from models: thinner, in another
//! unit, tilted, noisy …, with labels that agree on surfaces, as the program gives them.

use crate::Arguments;
use anyhow::Context;
use scenesplat::calibration::Calibration;
use scenesplat::evaluation::{Evaluation, EvaluationSettings, background};
use scenesplat::labels::Agreement;
use scenesplat::network::{WeightOptions, Weights, network_of};
use scenesplat::objects::surfaces::{SurfaceSettings, scene_surfaces};
use scenesplat::rooms::{CLASSES, SyntheticRoomSettings, generate};
use scenesplat::scene::edit::{EulerAngles, merge};
use scenesplat::scene::{GaussianScene, LabelSet, Similarity, Up};
use scenesplat::{Alignment, AlignmentSettings, Network, SceneEncoder, embedded};
use std::collections::{BTreeMap, BTreeSet};

type Edit = fn(&GaussianScene) -> GaussianScene;

const EDITS: [(&str, Edit); 37] = [
    ("as made", GaussianScene::clone),
    ("every 4th Gaussian", |s| every(s, 4)),
    ("every 8th Gaussian", |s| every(s, 8)),
    ("thinned to 4 cm", |s| thinned(s, 0.04)),
    ("thinned to 6 cm", |s| thinned(s, 0.06)),
    ("thinned to 8 cm", |s| thinned(s, 0.08)),
    ("size x 0.5", |s| resized(s, 0.5)),
    ("size x 0.75", |s| resized(s, 0.75)),
    ("size x 1.25", |s| resized(s, 1.25)),
    ("size x 2", |s| resized(s, 2.0)),
    ("Gaussians x 0.5", |s| swollen(s, 0.5)),
    ("Gaussians x 2", |s| swollen(s, 2.0)),
    ("Gaussians x 4", |s| swollen(s, 4.0)),
    ("opacity x 0.3", |s| faded(s, 0.3)),
    ("opacity x 0.1", |s| faded(s, 0.1)),
    ("2 % outliers 1 m below", |s| outliers(s, 1.0, 0.9)),
    ("2 % outliers 3 m below", |s| outliers(s, 3.0, 0.9)),
    ("2 % faint 10 cm below", |s| outliers(s, 0.1, 0.08)),
    ("a storey above", |s| storey(s, 2.9)),
    ("a storey below", |s| storey(s, -2.9)),
    ("upside down", |s| lying(s, Up::MINUS_Z)),
    ("y up", |s| lying(s, Up::PLUS_Y)),
    ("-y up", |s| lying(s, Up::MINUS_Y)),
    ("tilt 2", |s| turned(s, [2.0, 0.0, 0.0])),
    ("tilt 5", |s| turned(s, [5.0, 0.0, 0.0])),
    ("tilt 8", |s| turned(s, [5.0, 6.0, 0.0])),
    ("turned 37", |s| turned(s, [0.0, 0.0, 37.0])),
    ("turned 45", |s| turned(s, [0.0, 0.0, 45.0])),
    ("noise 1 cm", |s| noisy(s, 0.01)),
    ("noise 3 cm", |s| noisy(s, 0.03)),
    ("grey", |s| colored(s, |[r, g, b]| [(r + g + b) / 3.0; 3])),
    ("white", |s| colored(s, |_| [1.2; 3])),
    ("spelled at random", |s| spelled(s, None)),
    ("spelled near the identity", |s| spelled(s, Some(24))),
    ("sizes of all classes alike", alike),
    ("densities of all classes alike", |s| evened(s, true)),
    ("as many left out anywhere", |s| evened(s, false)),
];

pub fn run(mut args: Arguments) -> anyhow::Result<()> {
    let rooms: u64 = args.needed("how many rooms?")?;
    let seed: u64 = args.needed("which seed?")?;
    let weights = match args.word() {
        Some(folder) if folder != "embedded" => Weights::File(folder.into()),
        _ => Weights::Embedded,
    };
    let wanted = args.word().unwrap_or_default();
    let config = network_of(&weights, None, &WeightOptions::default())?;
    let network = Network::load(config, &weights, WeightOptions::default())?;
    let texts = embedded::vocabulary()?.class_table();
    let excluded = background(&LabelSet::new(texts.names.clone())?);
    let made: Vec<GaussianScene> = (0..rooms)
        .map(|room| {
            let settings = SyntheticRoomSettings { seed, room, ..SyntheticRoomSettings::default() };
            Ok(generate(&settings)?.scene)
        })
        .collect::<anyhow::Result<_>>()?;
    let encoder = SceneEncoder::new(&network);
    let calibration = Calibration::of(&weights)?;
    let temperature = calibration.as_ref().map(|own| own.temperature);
    let sizes = calibration.map_or_else(Calibration::embedded, Ok)?;
    let least_area = sizes.least_area(&texts.names);
    let agreement = Agreement { temperature, least_area: &least_area, ..Agreement::default() };
    println!("{:<30} {:>7} {:>7} {:>7}", "%", "present", "f-mIoU", "right");
    for (name, edit) in EDITS.iter().filter(|(name, _)| name.contains(&wanted)) {
        let settings = EvaluationSettings { excluded: excluded.clone(), ..Default::default() };
        let mut evaluation = Evaluation::new(&texts, settings)?;
        for room in &made {
            let scene = edit(room);
            let features = encoder.encode(&scene, &mut |_| Ok(()))?;
            let lies = Alignment::of(&scene, &AlignmentSettings::default());
            let settings = SurfaceSettings::default();
            let surfaces = scene_surfaces(&scene, &lies.rotation(), lies.scale, &settings)?;
            let agreement = Agreement { surfaces: Some(&surfaces), ..agreement };
            let labels = evaluation.label_agreeing(&features, false, &agreement)?;
            evaluation.add_labels(&evaluation.truth(&scene, None)?, labels)?;
        }
        let model = evaluation.report().model.context("a report")?;
        let present: Vec<f64> =
            model.classes.iter().filter(|c| c.accuracy.is_some()).filter_map(|c| c.iou).collect();
        let mean = present.iter().sum::<f64>() / present.len().max(1) as f64;
        let percent = |share: Option<f64>| 100.0 * share.unwrap_or(0.0);
        println!(
            "{name:<30} {:>7.1} {:>7.1} {:>7.1}",
            100.0 * mean,
            percent(model.foreground_mean_iou),
            percent(model.all_accuracy)
        );
    }
    Ok(())
}

/// Numbers in 0..1 that depend on nothing but their place.
fn unit(row: usize, stream: u64) -> f32 {
    let mut x = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ stream.wrapping_mul(0xD1B5_4A32_D192_ED03);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((x ^ (x >> 31)) >> 40) as f32 / 16_777_216.0
}

/// About normal, standard deviation 1.
fn noise(row: usize, stream: u64) -> f32 {
    (0..12).map(|k| unit(row, stream * 12 + k)).sum::<f32>() - 6.0
}

fn rows(scene: &GaussianScene, rows: &[usize]) -> GaussianScene {
    scene.select_rows(rows).expect("rows of the scene")
}

fn every(scene: &GaussianScene, step: usize) -> GaussianScene {
    rows(scene, &(0..scene.len()).step_by(step).collect::<Vec<_>>())
}

/// The first Gaussian of each voxel.
fn thinned(scene: &GaussianScene, size: f32) -> GaussianScene {
    let mut seen = BTreeSet::new();
    let cell = |p: [f32; 3]| p.map(|c| (c / size).floor() as i32);
    let kept: Vec<usize> =
        (0..scene.len()).filter(|&r| seen.insert(cell(scene.coord[r]))).collect();
    rows(scene, &kept)
}

fn moved(scene: &GaussianScene, by: Similarity) -> GaussianScene {
    let mut scene = scene.clone();
    scene.transform(&by);
    scene
}

fn resized(scene: &GaussianScene, scale: f64) -> GaussianScene {
    moved(scene, Similarity { scale, ..Similarity::IDENTITY })
}

fn turned(scene: &GaussianScene, degrees: [f64; 3]) -> GaussianScene {
    let rotation = EulerAngles(degrees).matrix();
    moved(scene, Similarity { rotation, ..Similarity::IDENTITY })
}

fn lying(scene: &GaussianScene, up: Up) -> GaussianScene {
    let m = up.upright();
    let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
    moved(scene, Similarity { rotation, ..Similarity::IDENTITY })
}

fn swollen(scene: &GaussianScene, by: f32) -> GaussianScene {
    let mut scene = scene.clone();
    scene.log_scale.iter_mut().flatten().for_each(|s| *s += by.ln());
    scene
}

fn faded(scene: &GaussianScene, by: f32) -> GaussianScene {
    let mut scene = scene.clone();
    for row in 0..scene.len() {
        let opacity = (scene.opacity(row) * by).clamp(1e-4, 0.9999);
        scene.opacity_logit[row] = (opacity / (1.0 - opacity)).ln();
    }
    scene
}

/// Two in a hundred once more, unlabeled, this far below the floor.
fn outliers(scene: &GaussianScene, depth: f32, opacity: f32) -> GaussianScene {
    let mut added = every(scene, 50);
    for row in 0..added.len() {
        added.coord[row][2] = -depth - 0.02 * unit(row, 1);
        added.opacity_logit[row] = (opacity / (1.0 - opacity)).ln();
    }
    joined(scene, added)
}

/// The room twice; the second one unlabeled, its floor at this height.
fn storey(scene: &GaussianScene, height: f64) -> GaussianScene {
    let translation = [0.0, 0.0, height];
    joined(scene, moved(scene, Similarity { translation, ..Similarity::IDENTITY }))
}

fn joined(scene: &GaussianScene, mut added: GaussianScene) -> GaussianScene {
    added.segment = Some(vec![-1; added.len()]);
    added.instance = None;
    let scene = GaussianScene { instance: None, ..scene.clone() };
    merge(vec![scene, added]).expect("two parts of one scene").0
}

fn noisy(scene: &GaussianScene, sigma: f32) -> GaussianScene {
    let mut scene = scene.clone();
    for (row, p) in scene.coord.iter_mut().enumerate() {
        (0..3).for_each(|a| p[a] += sigma * noise(row, 7 + a as u64));
    }
    scene
}

fn colored(scene: &GaussianScene, to: fn([f32; 3]) -> [f32; 3]) -> GaussianScene {
    let mut scene = scene.clone();
    scene.sh_dc.iter_mut().for_each(|c| *c = to(*c));
    scene
}

/// Each ellipsoid spelled by another of its 24 pairs of sizes and quaternion: any, or that of the first
/// `count` with the largest |w|.
fn spelled(scene: &GaussianScene, near: Option<usize>) -> GaussianScene {
    let mut scene = scene.clone();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    // Quarter turns about z and x make all 24.
    let turns: [([f32; 4], [usize; 3]); 2] =
        [([half, 0.0, 0.0, half], [1, 0, 2]), ([half, half, 0.0, 0.0], [0, 2, 1])];
    for row in 0..scene.len() {
        let (mut quat, mut sizes) = (scene.quat[row], scene.log_scale[row]);
        let mut best = (quat, sizes);
        for step in 0..near.map_or(8, |n| 4 * n) {
            let which = usize::from(unit(row, step as u64) < 0.5);
            let (turn, order) = turns[which];
            quat = scenesplat::scene::similarity::quat_product(quat.map(f64::from), turn);
            sizes = order.map(|a| sizes[a]);
            if near.is_none() || quat[0].abs() > best.0[0].abs() {
                best = (quat, sizes);
            }
        }
        (scene.quat[row], scene.log_scale[row]) = best;
    }
    scene
}

/// Sizes of each class brought to the same median: what is left is not told by them.
fn alike(scene: &GaussianScene) -> GaussianScene {
    let mut scene = scene.clone();
    let Some(segment) = scene.segment.clone() else { return scene };
    let largest = |s: &[f32; 3]| s.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let median = |rows: &[usize], scene: &GaussianScene| {
        let mut sizes: Vec<f32> = rows.iter().map(|&r| largest(&scene.log_scale[r])).collect();
        sizes.sort_by(f32::total_cmp);
        sizes.get(sizes.len() / 2).copied()
    };
    let all: Vec<usize> = (0..scene.len()).collect();
    let Some(due) = median(&all, &scene) else { return scene };
    for class in 0..CLASSES.len() as i32 {
        let own: Vec<usize> = all.iter().copied().filter(|&r| segment[r] == class).collect();
        let Some(has) = median(&own, &scene) else { continue };
        own.iter().for_each(|&r| scene.log_scale[r].iter_mut().for_each(|s| *s += due - has));
    }
    scene
}

/// Side of the cells that densities are counted in, meters.
const CELL: f32 = 0.05;

/// Gaussians of each class left out until a cell that the class touches holds as many as one of the class
/// that a quarter of the Gaussians are no denser than: what is left is not told by density. Or as many left out
/// of all classes alike: what there being fewer costs.
fn evened(scene: &GaussianScene, by_class: bool) -> GaussianScene {
    let Some(segment) = &scene.segment else { return scene.clone() };
    let mut cells: BTreeMap<i32, BTreeSet<[i32; 3]>> = BTreeMap::new();
    let mut counts: BTreeMap<i32, usize> = BTreeMap::new();
    for (&class, p) in segment.iter().zip(&scene.coord) {
        cells.entry(class).or_default().insert(p.map(|c| (c / CELL).floor() as i32));
        *counts.entry(class).or_default() += 1;
    }
    let density = |class: &i32| counts[class] as f32 / cells[class].len() as f32;
    let mut densities: Vec<f32> = segment.iter().map(density).collect();
    densities.sort_by(f32::total_cmp);
    let Some(&due) = densities.get(densities.len() / 4) else { return scene.clone() };
    let share = |class: &i32| (due / density(class)).min(1.0);
    let mean = segment.iter().map(share).sum::<f32>() / segment.len() as f32;
    let kept = |&row: &usize| unit(row, 61) < if by_class { share(&segment[row]) } else { mean };
    rows(scene, &(0..scene.len()).filter(kept).collect::<Vec<_>>())
}
