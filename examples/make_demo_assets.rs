//! Writes the files under `assets/demo` again: `cargo run --release --example make_demo_assets`.

use scenesplat::assets::{demo_classes, demo_room};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use std::collections::HashMap;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
    std::fs::create_dir_all(&folder)?;
    let room = demo_room()?;
    write_inria_ply(&room, &[], &folder.join("room.ply"))?;
    let text = demo_classes(&room)?;
    let bytes: Vec<u8> = text.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let shape = vec![text.names.len(), text.dim];
    let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape, &bytes)?;
    let labels = serde_json::to_string(&text.names)?;
    let metadata = HashMap::from([("labels".to_owned(), labels)]);
    let path = folder.join("classes.safetensors");
    safetensors::serialize_to_file([("text_embeddings", view)], Some(metadata), &path)?;
    Ok(())
}
