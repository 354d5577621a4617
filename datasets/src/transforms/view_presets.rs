//! Pipelines that end in several views of a scene.

use super::presets::{colors, moves};
use super::{
    Axis, CenterShift, ChromaticTranslation, ColorJitter, ColorSolarize, CropOrigin,
    ElasticDistortion, GridSample, RandomDropout, RandomFlip, RandomGrayscale, RandomJitter,
    RandomRotate, RandomScale, RatioCrop, RotationCenter, SphereCrop, TransformConfig, ViewCrop,
    ViewGroup, Views, VoxelBlur,
};
use crate::views::ViewKind;

type Steps = Vec<TransformConfig>;

/// Most Gaussians of a scene that views are cut out of.
const SCENE_POINTS: usize = 819_200;
/// What global and local crops are a share of, with one dataset, with several, and in the supplement's table.
const SINGLE_POINTS: [usize; 2] = [307_200; 2];
const JOINT_POINTS: [usize; 2] = [256_000; 2];
const SUPPLEMENT_POINTS: [usize; 2] = [256_000, 102_400];

fn center() -> TransformConfig {
    CenterShift { apply_z: false }.into()
}

fn grid(grid_size: f64) -> TransformConfig {
    GridSample { grid_size, ..GridSample::default() }.into()
}

fn blur(probability: f64, grid_size: f64) -> TransformConfig {
    VoxelBlur { probability, grid_size, ..VoxelBlur::default() }.into()
}

fn elastic(fields: Vec<[f64; 2]>) -> TransformConfig {
    ElasticDistortion { fields, ..ElasticDistortion::default() }.into()
}

/// What is done to a scene before its views are cut.
fn base(grid_size: f64, single: bool, chromatic: bool) -> Steps {
    let mut steps: Steps = vec![CenterShift { apply_z: true }.into()];
    if single {
        steps.push(dropout());
    }
    steps.extend(moves(0.02));
    steps.push(elastic(if single { vec![[0.2, 0.4], [0.8, 1.6]] } else { vec![[0.9, 0.1]] }));
    if chromatic {
        steps.extend(colors());
    }
    steps.push(grid(grid_size));
    steps.push(SphereCrop { point_max: SCENE_POINTS, ..SphereCrop::default() }.into());
    steps
}

/// Two global views of one region, three local ones of another, as the original cuts them.
fn original_views(
    grid_size: f64,
    point_max: [usize; 2],
    bend_local: bool,
    changes: [Steps; 3],
) -> TransformConfig {
    let region = |ratio, point_max| -> Steps {
        vec![center(), RandomFlip::default().into(), RatioCrop { ratio, point_max }.into()]
    };
    let each = |mut steps: Steps| {
        steps.extend([grid(grid_size), center()]);
        steps
    };
    let [first, second, local] = changes;
    let mut local_region = region([0.1, 0.4], point_max[1]);
    if bend_local {
        local_region.insert(0, elastic(vec![[0.2, 0.4], [0.8, 1.6]]));
    }
    let (global, local) = (vec![each(first), each(second)], vec![each(local); 3]);
    groups([(region([0.4, 1.0], point_max[0]), None, global), (local_region, None, local)])
}

/// Global views and local ones: what is shared, what is cut, what is done to each.
fn groups(of: [(Steps, Option<ViewCrop>, Vec<Steps>); 2]) -> TransformConfig {
    let kinds = [ViewKind::Global, ViewKind::Local].into_iter();
    let group = |(kind, (shared, crop, views))| ViewGroup { kind, shared, crop, views };
    Views { groups: kinds.zip(of).map(group).collect() }.into()
}

fn jitter() -> TransformConfig {
    ColorJitter::default().into()
}

fn gray() -> TransformConfig {
    RandomGrayscale::default().into()
}

fn dropout() -> TransformConfig {
    RandomDropout::default().into()
}

/// Self-supervised training on one dataset: two global and three local views, with cells of
/// `grid_size` meters (0.02 there).
///
/// # Source
/// The `train` transforms of the self-supervised configurations with one dataset, SceneSplat be9d5e1.
pub fn self_supervised(grid_size: f64) -> Vec<TransformConfig> {
    let mut steps = base(grid_size, true, true);
    let changes = [
        vec![jitter(), gray(), blur(1.0, grid_size)],
        vec![jitter(), gray(), blur(0.1, grid_size), ColorSolarize::default().into()],
        vec![jitter(), gray(), blur(0.5, grid_size)],
    ];
    steps.push(original_views(grid_size, SINGLE_POINTS, false, changes));
    steps
}

/// As [`self_supervised`], by the augmentation table of the paper's supplement: coarse bending alone, larger limits of
/// global and smaller ones of local crops, dropout in the second global view only.
///
/// # Source
/// The supplement's table of augmentations; steps that it does not name are those of the released code.
pub fn self_supervised_supplement(grid_size: f64) -> Vec<TransformConfig> {
    let mut steps = base(grid_size, false, true);
    let changes = [
        vec![jitter(), gray(), blur(1.0, grid_size)],
        vec![dropout(), jitter(), gray(), blur(0.2, grid_size), ColorSolarize::default().into()],
        vec![jitter(), gray(), blur(0.5, grid_size)],
    ];
    steps.push(original_views(grid_size, SUPPLEMENT_POINTS, false, changes));
    steps
}

/// As [`self_supervised`], of ScanNet++ beside other datasets.
///
/// # Source
/// The ScanNet++ part of the configurations with several datasets.
pub fn self_supervised_joint_scannetpp(grid_size: f64) -> Vec<TransformConfig> {
    let mut steps = base(grid_size, false, true);
    let changes = [
        vec![jitter(), gray()],
        vec![dropout(), jitter(), gray(), ColorSolarize::default().into()],
        vec![dropout(), jitter(), gray()],
    ];
    steps.push(original_views(grid_size, JOINT_POINTS, true, changes));
    steps
}

/// As [`self_supervised`], of every other dataset among several: the first global view has its own
/// colors, and local ones lose Gaussians twice.
///
/// # Source
/// The other parts of the configurations with several datasets.
pub fn self_supervised_joint(grid_size: f64) -> Vec<TransformConfig> {
    let mut steps = base(grid_size, false, false);
    let changes = [
        vec![],
        vec![dropout(), jitter(), gray(), ColorSolarize::default().into()],
        vec![dropout(), dropout(), jitter(), gray()],
    ];
    steps.push(original_views(grid_size, JOINT_POINTS, true, changes));
    steps
}

/// Self-distillation: two global views around places of the first one, four local ones around places
/// of it that no other local view covers; each turned, bent and jittered on its own.
///
/// # Source
/// The `MultiViewGenerator` of Sonata's configurations, Pointcept d74c646. Differs: each view draws its
/// colors alone (there both global ones share a draw).
pub fn self_distillation(grid_size: f64) -> Vec<TransformConfig> {
    let turn = |axis, angle: f64, center| RandomRotate {
        angle: [-angle, angle],
        axis,
        center,
        probability: 0.8,
        ..RandomRotate::default()
    };
    let each: Steps = vec![
        CenterShift { apply_z: true }.into(),
        RandomScale::default().into(),
        turn(Axis::Z, 1.0, RotationCenter::Origin).into(),
        turn(Axis::X, 1.0 / 64.0, RotationCenter::BoundingBox).into(),
        turn(Axis::Y, 1.0 / 64.0, RotationCenter::BoundingBox).into(),
        RandomFlip::default().into(),
        RandomJitter { sigma: 0.005, clip: 0.02 }.into(),
        elastic(vec![[0.2, 0.4], [0.8, 1.6]]),
        ColorJitter { hue: 0.02, ..ColorJitter::default() }.into(),
        ChromaticTranslation::default().into(),
        grid(grid_size),
        center(),
    ];
    let crop = |ratio, center| Some(ViewCrop { ratio, point_max: 65_536, center });
    let views = groups([
        (vec![], crop([0.4, 1.0], CropOrigin::Major), vec![each.clone(); 2]),
        (vec![], crop([0.1, 0.4], CropOrigin::Uncovered), vec![each; 4]),
    ]);
    vec![CenterShift { apply_z: true }.into(), grid(grid_size), views]
}
