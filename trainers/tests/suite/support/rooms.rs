//! Synthetic rooms, and batches of voxels.

use candle_core::{Result, Tensor};
use scenesplat_datasets::transforms::{
    CenterShift, CropOrigin, GridSample, RandomRotate, ViewCrop, ViewGroup, Views,
};
use scenesplat_datasets::{
    Dataset, InputFeatures, LoaderSettings, Sample, SceneDataset, SceneLoader, SyntheticRooms,
    TrainBatch, TransformConfig, ViewKind, build_transforms, collate_samples, sample_rng,
};
use scenesplat_models::layers::Linear;
use scenesplat_models::{Backbone, Forward, Mode, ParamStore, PointCloud};
use scenesplat_rooms::{CLASSES, SyntheticRoomSettings};
use scenesplat_scene::TextTable;
use std::sync::{Arc, Mutex};

pub fn rooms(count: usize, gaussians: usize, seed: u64) -> SyntheticRooms {
    let settings = SyntheticRoomSettings { num_gaussians: Some(gaussians), ..Default::default() };
    SyntheticRooms::new(count, settings, seed).unwrap()
}

pub fn dataset(rooms: SyntheticRooms, steps: &[TransformConfig], seed: u64) -> Arc<SceneDataset> {
    let steps = build_transforms(steps).unwrap();
    Arc::new(SceneDataset::new(Arc::new(rooms), steps, seed, 1).unwrap())
}

/// Batches of so many scenes, which are not mixed.
pub fn loader(data: Arc<dyn Dataset>, batch_size: usize, workers: usize) -> SceneLoader {
    let settings =
        LoaderSettings { batch_size, workers, mix_probability: 0.0, ..Default::default() };
    SceneLoader::new(data, InputFeatures::default(), settings).unwrap()
}

/// Directions of the classes, apart from each other.
pub fn texts(width: usize) -> TextTable {
    let values = (0..CLASSES.len() * width).map(|i| ((i * i) as f32 * 0.7).sin()).collect();
    let names = CLASSES.iter().map(|c| c.name.to_owned()).collect();
    TextTable::from_rows(names, values, width).unwrap()
}

/// Two global and two local views, each turned and sampled at a quarter of a meter.
pub fn views(global_ratio: f64) -> Vec<TransformConfig> {
    let each = || -> Vec<TransformConfig> {
        let turn = RandomRotate { probability: 1.0, ..RandomRotate::default() };
        let grid = GridSample { grid_size: 0.25, ..GridSample::default() };
        vec![turn.into(), grid.into(), CenterShift { apply_z: false }.into()]
    };
    let group = |kind, ratio, center| ViewGroup {
        kind,
        shared: vec![],
        crop: Some(ViewCrop { ratio, point_max: 1500, center }),
        views: vec![each(), each()],
    };
    let groups = vec![
        group(ViewKind::Global, [global_ratio, 1.0], CropOrigin::Major),
        group(ViewKind::Local, [0.2, 0.4], CropOrigin::Uncovered),
    ];
    vec![CenterShift::default().into(), Views { groups }.into()]
}

/// A batch of scenes of Gaussians at these places.
pub fn batch_of(scenes: &[Vec<[f32; 3]>], steps: &[TransformConfig]) -> TrainBatch {
    let samples = (0_u64..).zip(scenes).map(|(i, coord)| {
        let n = coord.len();
        let mut sample = Sample {
            id: format!("scene-{i}"),
            coord: coord.clone(),
            color: vec![[10.0, 120.0, 200.0]; n],
            opacity: vec![0.5; n],
            scale: vec![[0.1, 0.2, 0.3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            ..Sample::default()
        };
        let mut rng = sample_rng(1, 0, i);
        for step in build_transforms(steps).unwrap() {
            step.apply(&mut sample, &mut rng).unwrap();
        }
        sample
    });
    collate_samples(samples.collect(), &InputFeatures::default()).unwrap()
}

/// A linear layer on each voxel, which notes the modes it was run in.
pub struct PerVoxel(Linear, usize, pub Arc<Mutex<Vec<Mode>>>);

impl PerVoxel {
    pub fn new(params: &ParamStore, width: usize) -> Self {
        Self(Linear::new(11, width, true, params.builder()).unwrap(), width, Arc::default())
    }
}

impl Backbone for PerVoxel {
    fn forward(&self, points: &PointCloud, cx: &mut Forward<'_>) -> Result<Tensor> {
        self.2.lock().unwrap().push(cx.mode);
        self.0.forward(&points.feat)
    }
    fn out_channels(&self) -> usize {
        self.1
    }
}
