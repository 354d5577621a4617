//! A room with its classes, for the tests of commands: made once per run, in a folder of its own.

use super::Folder;
use scenesplat::rooms::{CLASSES, RoomKind, SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::{GaussianScene, ReadOptions, TextTable, open_scene};
use scenesplat::{Network, NetworkConfig, SceneEncoder, WeightOptions, Weights};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::OnceLock;

/// Gaussians of the room.
pub const GAUSSIANS: usize = 16_000;

/// A file of the demo scene: `room.ply` has labels, `classes.safetensors` its classes under the tiny
/// network with the weights `seeded:0`.
pub fn asset(name: &str) -> PathBuf {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = Folder::lasting();
        let room = folder.path("room.ply");
        write_inria_ply(&room_scene(), &[], &room).unwrap();
        let room = open_scene(&room, &ReadOptions::default()).unwrap().scene;
        write_classes(&class_rows(&room), &folder.path("classes.safetensors"));
        folder
    });
    folder.path(name)
}

/// An [`asset`] as a word of a command line.
pub fn asset_at(name: &str) -> String {
    asset(name).display().to_string()
}

/// The names of the labels of `room.ply`, in their order.
pub fn class_names() -> Vec<String> {
    CLASSES.iter().map(|class| class.name.to_owned()).collect()
}

/// A living room, which has floor, walls, tables and chairs in it.
fn room_scene() -> GaussianScene {
    let kind = Some(RoomKind::Living);
    let settings =
        SyntheticRoomSettings { kind, ..SyntheticRoomSettings::with_count(GAUSSIANS, 7) };
    generate(&settings).unwrap().scene
}

/// The mean feature of each class of the room, less the mean of all. No embeddings of any language
/// model: they mean nothing for other rooms.
fn class_rows(room: &GaussianScene) -> TextTable {
    let config = NetworkConfig::tiny();
    let network = Network::load(config, &Weights::Seeded(0), WeightOptions::default()).unwrap();
    let features = SceneEncoder::new(&network).encode(room, &mut |_| Ok(())).unwrap();
    let width = features.width();
    let mut sums = vec![vec![0f64; width]; CLASSES.len()];
    let mut counts = vec![0usize; CLASSES.len()];
    let rows = features.gaussian_rows(0..features.len()).unwrap();
    for (row, &label) in rows.chunks_exact(width).zip(room.segment.as_ref().unwrap()) {
        if let Ok(label) = usize::try_from(label) {
            counts[label] += 1;
            sums[label].iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(*v));
        }
    }
    let present: Vec<usize> = (0..counts.len()).filter(|&c| counts[c] > 0).collect();
    let mean = |c: usize, i: usize| sums[c][i] / counts[c] as f64;
    let values = present.iter().flat_map(|&c| {
        let present = &present;
        (0..width).map(move |i| {
            let all: f64 = present.iter().map(|&o| mean(o, i)).sum::<f64>() / present.len() as f64;
            (mean(c, i) - all) as f32
        })
    });
    let names = present.iter().map(|&c| CLASSES[c].name.to_owned()).collect();
    TextTable::from_rows(names, values.collect(), width).unwrap()
}

fn write_classes(text: &TextTable, path: &std::path::Path) {
    let bytes: Vec<u8> = text.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let shape = vec![text.names.len(), text.dim];
    let view =
        safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape, &bytes).unwrap();
    let labels = serde_json::to_string(&text.names).unwrap();
    let metadata = HashMap::from([("labels".to_owned(), labels)]);
    safetensors::serialize_to_file([("text_embeddings", view)], Some(metadata), path).unwrap();
}
