//! Dump.
use scenesplat_datasets::effects::{Effect, EffectSet, profile::profile, simulate};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use std::time::Instant;

fn main() {
    let args: Vec<u64> = std::env::args().skip(1).map(|a| a.parse().unwrap()).collect();
    let (first, last) = (args[0], args[1]);
    for seed in first..last {
        let count = [15_000, 30_000, 60_000, 120_000][(seed % 4) as usize];
        let room = generate(&SyntheticRoomSettings::with_count(count, seed)).unwrap();
        let show = |name: &str, severity: f64, scene: &scenesplat_scene::GaussianScene| {
            let start = Instant::now();
            let seen = profile(scene, 1.0);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            print!("{seed} {count} {} {name} {severity} {ms:.1}", u8::from(room.is_points));
            for e in &seen.effects {
                for f in e.measure.iter().chain(&e.more) {
                    print!(" {}.{}={:.6}", e.effect.name(), f.name, f.value);
                }
                print!(" {}.sev={:.4} {}.on={}", e.effect.name(), e.severity, e.effect.name(), u8::from(e.present));
            }
            println!();
        };
        show("none", 0.0, &room.scene);
        for effect in Effect::ALL {
            for severity in [1.0, 2.0, 3.0, 4.0, 5.0] {
                let set = EffectSet::default().with(effect, severity).unwrap();
                show(effect.name(), severity, &simulate(&room.scene, &set, seed).unwrap().scene);
            }
        }
    }
}
