//! The library in 20 lines: a scene in, labels out.

use scenesplat::metrics::{FeatureSlice, ZeroShotOptions, classify};
use scenesplat::prelude::*;
use scenesplat::text::metric_table;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let scene = open_scene(Path::new("assets/demo/room.ply"), &ReadOptions::default())?.scene;
    let config = NetworkConfig::tiny();
    let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default())?;
    let features = SceneEncoder::new(&network).encode(&scene, &mut |_| Ok(()))?;

    let text = read_text_table(Path::new("assets/demo/classes.safetensors"), None)?;
    let rows = features.gaussian_rows(0..features.len())?;
    let rows = FeatureSlice::new(&rows, features.width())?;
    let found = classify(&rows, &metric_table(&text)?, &ZeroShotOptions::default())?;
    println!("Gaussian 0: {} ({:.2})", text.names[found.labels[0] as usize], found.scores[0]);
    Ok(())
}
