//! Scenes from anywhere: a source of one's own behind the loader of training.
//! `cargo run --release --example custom_data_source`

use scenesplat::datasets::transforms::semantic_segmentation;
use scenesplat::datasets::{
    DataError, DataSource, InputFeatures, LoaderSettings, SceneDataset, SceneLoader, SourceScene,
    build_transforms,
};
use scenesplat::prelude::*;
use scenesplat::scene::RepairReport;
use scenesplat::scene::gaussian_scene::SH_C0;
use std::sync::Arc;

/// Flat checkerboards, a class for each of the two colors.
struct Boards(Vec<String>);

impl DataSource for Boards {
    fn scene_ids(&self) -> &[String] {
        &self.0
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let known = || DataError::UnknownScene { id: id.to_owned(), known: self.0.len() };
        let number = self.0.iter().position(|known| known == id).ok_or_else(known)?;
        let side = 40 + 10 * number;
        let cells = || (0..side * side).map(|i| (i / side, i % side));
        let class = |(x, y): (usize, usize)| (x / 8 + y / 8) % 2;
        let rows = side * side;
        let scene = GaussianScene {
            coord: cells().map(|(x, y)| [0.05 * x as f32, 0.05 * y as f32, 0.0]).collect(),
            log_scale: vec![[-4.0; 3]; rows],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; rows],
            opacity_logit: vec![4.0; rows],
            sh_dc: cells().map(|cell| [(class(cell) as f32 - 0.5) / SH_C0; 3]).collect(),
            segment: Some(cells().map(|cell| class(cell) as i32).collect()),
            ..GaussianScene::default()
        };
        let report = RepairReport { source_rows: rows, ..RepairReport::default() };
        Ok(SourceScene { scene, report })
    }
}

fn main() -> anyhow::Result<()> {
    let source = Arc::new(Boards((0..6).map(|i| format!("board-{i}")).collect()));
    let steps = build_transforms(&semantic_segmentation(0.05))?;
    let scenes = Arc::new(SceneDataset::new(source, steps, 0, 1)?);
    let loader = SceneLoader::new(scenes, InputFeatures::default(), LoaderSettings::default())?;
    for batch in loader.batches(0, 0) {
        let batch = batch?;
        println!("{}: {} rows of {} channels", batch.ids.join(", "), batch.len(), batch.channels);
    }
    Ok(())
}
