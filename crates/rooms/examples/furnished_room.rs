//! Writes a room as PLY, and says what is in it:
//! `cargo run --release -p scenesplat-rooms --example furnished_room -- CATALOGUE 7 room.ply [held_out] [scan|model|depth] [walk] [flat] [public|KIND]`

use scenesplat_rooms::{Capture, FurnitureSplit, SyntheticRoomSettings, generate};
use scenesplat_scene::formats::inria_ply::write_inria_ply;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [catalogue, room, file, rest @ ..] = args.as_slice() else {
        return Err("which catalogue, which room, which file?".into());
    };
    let mut settings = SyntheticRoomSettings {
        room: room.parse()?,
        gaussians_per_m2: 2500.0,
        furniture: Some(catalogue.into()),
        ..SyntheticRoomSettings::default()
    };
    for word in rest {
        match word.as_str() {
            "scan" => settings.capture = Capture::Scan,
            "model" => settings.capture = Capture::Model,
            "flat" => settings.flat_share = 1.0,
            "depth" => settings.capture = Capture::Depth,
            "public" => settings.public_share = 1.0,
            "walk" => settings.seen_share = 1.0,
            word => match serde_json::from_value(word.into()) {
                Ok(kind) => settings.kind = Some(kind),
                Err(_) => settings.furniture_split = word.parse::<FurnitureSplit>()?,
            },
        }
    }
    let room = generate(&settings)?;
    write_inria_ply(&room.scene, &[], Path::new(file))?;
    println!("{:?}, {:.1?} m, {} Gaussians", room.kind, room.size, room.scene.len());
    for object in &room.objects {
        let [low, high] = object.bounds;
        let class = object.class.map_or("none", |class| class.about().name);
        println!("{}: {class}, {low:.2?} to {high:.2?}", object.name);
    }
    Ok(())
}
