//! Writes a generated room: `cargo run --release --example generate_room -- 100000 room.ply`.

use anyhow::Context;
use scenesplat::datasets::{RoomSettings, generate_room};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let num_gaussians = args.next().context("how many Gaussians?")?.parse()?;
    let path = args.next().context("which file?")?;
    let room = generate_room(&RoomSettings { num_gaussians, seed: 0 })?;
    write_inria_ply(&room.scene, &[], Path::new(&path))?;
    Ok(())
}
