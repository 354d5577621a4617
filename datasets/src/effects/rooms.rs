//! Effects on synthetic rooms: only those that the room itself calls for.

use super::pane::Pane;
use super::{Effect, EffectDone, EffectSet, Simulated, apply, rng};
use crate::rng::between;
use scenesplat_rooms::{ClassId, SyntheticRoom};
use scenesplat_scene::SceneError;
use std::fmt;
use std::time::Instant;

/// How fast captures of rooms are walked, meters a second.
const SPEED: [f64; 2] = [0.2, 1.4];
/// From here on pictures are blurred: 2 cm in a fortieth of a second.
const FAST: f64 = 0.8;

/// What became of an effect that was asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct RoomEffect {
    /// Which.
    pub effect: Effect,
    /// How strong, above 0 and up to 5.
    pub severity: f64,
    /// Whether the room calls for it.
    pub on: bool,
    /// What in the room says so.
    pub evidence: String,
    /// Gaussians that it removed, added or changed.
    pub changed: usize,
    /// What it cost, seconds; 0 if it is off.
    pub seconds: f64,
}

/// A room after the effects that it calls for.
#[derive(Debug, Clone, PartialEq)]
pub struct RoomDamage {
    /// The scene.
    pub simulated: Simulated,
    /// Every effect that was asked for, in the order in which they are applied.
    pub plan: Vec<RoomEffect>,
}

/// Applies to a room those of the effects that it calls for: `glass` to the panes of its windows, `light`
/// where a window lets daylight in, `blur` where the capture was walked fast (each seed walks at a speed
/// of its own); the others everywhere. A room without them is the room itself, bit for bit.
///
/// # Errors
/// If the scene's arrays do not match.
pub fn simulate_in_room(
    room: &SyntheticRoom,
    effects: &EffectSet,
    seed: u64,
) -> Result<RoomDamage, SceneError> {
    room.scene.check_rows()?;
    let windows: Vec<[[f32; 3]; 2]> = room
        .objects
        .iter()
        .filter(|object| object.class == Some(ClassId::Window))
        .map(|object| object.bounds)
        .collect();
    let speed = between(&mut rng(seed, Effect::Blur, u64::MAX), SPEED);
    let mut out = Simulated::of(&room.scene);
    let mut plan = Vec::new();
    for (effect, severity) in effects.present() {
        let of_windows = || format!("{} windows", windows.len());
        let (on, evidence) = match effect {
            Effect::Glass | Effect::Light => (!windows.is_empty(), of_windows()),
            Effect::Blur => (speed >= FAST, format!("walked at {speed:.2} m/s")),
            _ => (true, "any capture".to_owned()),
        };
        let began = Instant::now();
        let (mut changed, mut seconds) = (0, 0.0);
        if on {
            let panes: Vec<Pane> =
                windows.iter().map(|b| Pane::in_box(*b, room.size, severity)).collect();
            let text;
            (changed, text) = apply(&mut out, effect, severity, seed, None, Some(&panes))?;
            out.done.push(EffectDone { effect, severity, changed, text });
            seconds = began.elapsed().as_secs_f64();
        }
        plan.push(RoomEffect { effect, severity, on, evidence, changed, seconds });
    }
    Ok(RoomDamage { simulated: out, plan })
}

impl fmt::Display for RoomEffect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { effect, severity, on, evidence, changed, seconds } = self;
        let name = effect.name();
        match on {
            true => write!(
                f,
                "{name}={severity:.1}: on ({evidence}), {changed} Gaussians, {:.1} ms",
                1e3 * seconds
            ),
            false => write!(f, "{name}={severity:.1}: off ({evidence}), 0.0 ms"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn rooms() -> impl Iterator<Item = SyntheticRoom> {
        (0..24).map(|room| {
            let settings =
                SyntheticRoomSettings { room, ..SyntheticRoomSettings::with_count(3000, 5) };
            generate(&settings).unwrap()
        })
    }

    fn windows(room: &SyntheticRoom) -> usize {
        room.objects.iter().filter(|object| object.class == Some(ClassId::Window)).count()
    }

    fn damage(room: &SyntheticRoom, text: &str, seed: u64) -> RoomDamage {
        let out = simulate_in_room(room, &text.parse().unwrap(), seed).unwrap();
        out.simulated.scene.check_rows().unwrap();
        assert_eq!(out.simulated.source.len(), out.simulated.scene.len());
        out
    }

    #[test]
    fn glass_and_daylight_need_windows() {
        let (mut with, mut without) = (0, 0);
        // Every room of the generator has a window: half of them are bricked up.
        let bricked_up = rooms().take(12).map(|mut room| {
            room.objects.retain(|object| object.class != Some(ClassId::Window));
            room
        });
        for room in rooms().skip(12).chain(bricked_up) {
            let out = damage(&room, "glass=4,light=4", 1);
            let on: Vec<bool> = out.plan.iter().map(|effect| effect.on).collect();
            if windows(&room) == 0 {
                without += 1;
                assert_eq!(on, [false, false]);
                assert!(out.simulated.scene == room.scene && out.simulated.done.is_empty());
                assert!(out.plan.iter().all(|effect| effect.seconds == 0.0));
                assert!(out.plan[0].to_string().contains("off (0 windows)"));
            } else {
                with += 1;
                assert_eq!(on, [true, true]);
                assert!(out.plan[0].to_string().contains("on ("), "{}", out.plan[0]);
            }
        }
        assert!(with > 3 && without > 0, "{with} rooms with windows, {without} without");
    }

    #[test]
    fn panes_are_where_windows_are() {
        let room = rooms().find(|room| windows(room) > 0).unwrap();
        let out = damage(&room, "glass=5", 1);
        let boxes: Vec<_> = room
            .objects
            .iter()
            .filter(|o| o.class == Some(ClassId::Window))
            .map(|o| o.bounds)
            .collect();
        let near = |p: [f32; 3]| {
            boxes
                .iter()
                .any(|[low, high]| (0..3).all(|i| p[i] > low[i] - 0.15 && p[i] < high[i] + 0.15))
        };
        // What is gone or lost its label was in a window.
        let there: std::collections::BTreeSet<usize> =
            out.simulated.source.iter().flatten().copied().collect();
        let gone = (0..room.scene.len()).filter(|row| !there.contains(row));
        let mut count = 0;
        for row in gone {
            count += 1;
            assert!(near(room.scene.coord[row]), "row {row} is in no window");
        }
        assert!(count > 0 && out.plan[0].changed >= count, "{}", out.plan[0]);
    }

    #[test]
    fn blur_needs_a_fast_walk_and_the_rest_nothing() {
        let room = rooms().next().unwrap();
        let (mut fast, mut slow) = (0, 0);
        for seed in 0..40 {
            let out = damage(&room, "blur=3,noise=1", seed);
            let [blur, noise] = &out.plan[..] else { panic!("{:?}", out.plan) };
            assert!(noise.on);
            let alone =
                super::super::simulate(&room.scene, &"noise=1".parse().unwrap(), seed).unwrap();
            if blur.on {
                fast += 1;
                assert_ne!(out.simulated.scene, alone.scene);
            } else {
                slow += 1;
                assert_eq!(out.simulated.scene, alone.scene);
            }
        }
        assert!(fast > 8 && slow > 8, "{fast} fast, {slow} slow");
        assert_eq!(damage(&room, "none", 3).simulated.scene, room.scene);
    }
}
