//! The library in 20 lines: a scene in, labels out, with the network inside the program.

use scenesplat::embedded;
use scenesplat::metrics::{FeatureSlice, ZeroShotOptions, classify};
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::text::text_rows;

fn main() -> anyhow::Result<()> {
    // Or a file: open_scene("scene.ply".as_ref(), &ReadOptions::default())?.scene
    let scene = generate(&SyntheticRoomSettings { room: 3, ..Default::default() })?.scene;
    let network = Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
    let features = SceneEncoder::new(&network).encode(&scene, &mut |_| Ok(()))?;

    let text = embedded::vocabulary()?.class_table();
    let rows = features.gaussian_rows(0..features.len())?;
    let rows = FeatureSlice::new(&rows, features.width())?;
    let found = classify(&rows, text_rows(&text)?, &ZeroShotOptions::default())?;
    println!("Gaussian 0: {} ({:.2})", text.names[found.labels[0] as usize], found.scores[0]);
    Ok(())
}
