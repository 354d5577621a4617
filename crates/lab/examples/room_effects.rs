//! Which capture effects each of some synthetic rooms calls for, and what they cost.
//!
//!     cargo run --release -p scenesplat-lab --example room_effects [-- EFFECTS]      e.g. glass=3,light=2,blur=3,holes=2

use scenesplat::datasets::effects::{EffectSet, simulate_in_room};
use scenesplat::rooms::{SyntheticRoomSettings, generate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text = std::env::args().nth(1);
    let text =
        text.as_deref().unwrap_or("holes=2,floaters=2,surface=1,blur=3,glass=3,light=3,noise=1");
    let effects: EffectSet = text.parse()?;
    for number in 0..6 {
        let settings =
            SyntheticRoomSettings { room: number, ..SyntheticRoomSettings::with_count(50_000, 1) };
        let room = generate(&settings)?;
        let damaged = simulate_in_room(&room, &effects, number)?;
        let left = damaged.simulated.scene.len();
        println!("room {number}: {} Gaussians, {left} after", room.scene.len());
        for effect in &damaged.plan {
            println!("  {effect}");
        }
    }
    Ok(())
}
