//! How large objects of each class are in rooms: percentiles of the boxes' longest side on the floor and of their height.
//!
//! ```sh
//! cargo run --release -p scenesplat-rooms --example class_sizes -- [CATALOGUE]
//! ```

use scenesplat_rooms::{CLASSES, SyntheticRoomSettings, generate};
use std::path::PathBuf;

const ROOMS: u64 = 400;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let furniture = std::env::args().nth(1).map(PathBuf::from);
    let mut sizes: Vec<[Vec<f32>; 2]> = vec![[Vec::new(), Vec::new()]; CLASSES.len()];
    for room in 0..ROOMS {
        // Every second from the catalogue.
        let furniture = furniture.clone().filter(|_| room % 2 == 1);
        let settings = SyntheticRoomSettings {
            seed: 6001,
            room,
            gaussians_per_m2: 5.0,
            furniture,
            ..Default::default()
        };
        for object in generate(&settings)?.objects {
            let Some(class) = object.class else { continue };
            let [low, high] = object.bounds;
            let side = |i: usize| high[i] - low[i];
            let [wide, tall] = &mut sizes[class.index()];
            wide.push(side(0).max(side(1)));
            tall.push(side(2));
        }
    }
    println!("class, objects; longest side 2, 50, 98 %; height 2, 50, 98 %, metres");
    for (class, [wide, tall]) in CLASSES.iter().zip(&mut sizes) {
        wide.sort_by(f32::total_cmp);
        tall.sort_by(f32::total_cmp);
        let at = |v: &[f32], share: f32| {
            v.get(((v.len().max(1) - 1) as f32 * share) as usize).copied().unwrap_or(f32::NAN)
        };
        let of = |v: &[f32]| format!("{:.2} {:.2} {:.2}", at(v, 0.02), at(v, 0.5), at(v, 0.98));
        println!("{}, {}; {}; {}", class.name, wide.len(), of(wide), of(tall));
    }
    Ok(())
}
