//! The small scene and class texts that come with the project, so that the first command needs no
//! file of the user's own.
//!
//! Both are generated: [`demo_room`] and [`demo_text`] make exactly the files under `assets/demo`
//! (a test compares them). The texts are hashed numbers, not embeddings of any language model.

use scenesplat_datasets::generated_room::CLASS_NAMES;
use scenesplat_datasets::{DataError, RoomSettings, generate_room};
use scenesplat_models::weights::unit;
use scenesplat_scene::{GaussianScene, SceneError, TextTable};

/// Gaussians of the demo room.
pub const DEMO_GAUSSIANS: usize = 8000;
/// Width of the demo texts: the output of the tiny network.
pub const DEMO_WIDTH: usize = 64;

/// The room of `assets/demo/room.ply`.
///
/// # Errors
/// Never with these settings; the generator's type says it may.
pub fn demo_room() -> Result<GaussianScene, DataError> {
    Ok(generate_room(&RoomSettings { num_gaussians: DEMO_GAUSSIANS, seed: 7 })?.scene)
}

/// The class texts of `assets/demo/classes.safetensors`: one hashed unit row per class of the
/// generated rooms.
///
/// # Errors
/// Never with these values; the table's type says it may.
pub fn demo_text() -> Result<TextTable, SceneError> {
    let names: Vec<String> = CLASS_NAMES.iter().map(|n| (*n).to_owned()).collect();
    let values = names.iter().flat_map(|name| unit(name, DEMO_WIDTH, 0)).collect();
    TextTable::from_rows(names, values, DEMO_WIDTH)
}
