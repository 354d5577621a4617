//! The small scene and classes that come with the project, so that the first command needs no file
//! of the user's own.
//!
//! Both are generated: [`demo_room`] and [`demo_classes`] make the files under `assets/demo` (a test
//! compares them). The class rows are no embeddings of any language model: they are what the tiny
//! network with seeded weights makes of each class of this very room, and mean nothing elsewhere.

use crate::{Network, NetworkConfig, SceneEncoder, WeightOptions, Weights};
use anyhow::{Context, Result};
use scenesplat_datasets::generated_room::CLASS_NAMES;
use scenesplat_datasets::{RoomSettings, generate_room};
use scenesplat_scene::{GaussianScene, TextTable};

/// Gaussians of the demo room.
pub const DEMO_GAUSSIANS: usize = 16_000;

/// The room of `assets/demo/room.ply`.
///
/// # Errors
/// Never with these settings; the generator's type says it may.
pub fn demo_room() -> Result<GaussianScene> {
    Ok(generate_room(&RoomSettings { num_gaussians: DEMO_GAUSSIANS, seed: 7 })?.scene)
}

/// The class rows of `assets/demo/classes.safetensors`: the mean feature of each class of a room,
/// less the mean of all, under the tiny network with the weights `seeded:0`.
///
/// # Errors
/// If the room has no labels.
pub fn demo_classes(room: &GaussianScene) -> Result<TextTable> {
    let labels = room.segment.as_ref().context("the room has no labels")?;
    let config = NetworkConfig::tiny();
    let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default())?;
    let features = SceneEncoder::new(&network).encode(room, &mut |_| Ok(()))?;
    let width = features.width();
    let mut sums = vec![vec![0f64; width]; CLASS_NAMES.len()];
    let mut counts = vec![0usize; CLASS_NAMES.len()];
    let rows = features.gaussian_rows(0..features.len())?;
    for (row, &label) in rows.chunks_exact(width).zip(labels) {
        if let Ok(label) = usize::try_from(label) {
            counts[label] += 1;
            sums[label].iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(*v));
        }
    }
    let present: Vec<usize> = (0..counts.len()).filter(|&c| counts[c] > 0).collect();
    let mean = |c: usize, i: usize| sums[c][i] / counts[c] as f64;
    let mut values = Vec::with_capacity(present.len() * width);
    for &c in &present {
        for i in 0..width {
            let all: f64 = present.iter().map(|&o| mean(o, i)).sum::<f64>() / present.len() as f64;
            values.push((mean(c, i) - all) as f32);
        }
    }
    let names = present.iter().map(|&c| CLASS_NAMES[c].to_owned()).collect();
    Ok(TextTable::from_rows(names, values, width)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{ReadOptions, open_scene};
    use std::path::Path;

    #[test]
    fn shipped_files_are_what_the_generator_makes() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
        let room = demo_room().unwrap();
        let shipped = open_scene(&folder.join("room.ply"), &ReadOptions::default()).unwrap().scene;
        assert_eq!(shipped.coord, room.coord);
        assert_eq!(shipped.segment, room.segment);
        let classes = demo_classes(&room).unwrap();
        let shipped = TextTable::read(&folder.join("classes.safetensors"), None).unwrap();
        assert_eq!(shipped.names, classes.names);
        // Instruction sets may differ in the last bits.
        for (a, b) in shipped.values.iter().zip(&classes.values) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
    }
}
