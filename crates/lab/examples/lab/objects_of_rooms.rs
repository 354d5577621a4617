//! How well objects agree with the true instances of rooms that nothing was trained on: with true labels, and
//! with those of the network inside the program.

use crate::Arguments;
use anyhow::{Context, Result};
use scenesplat::embedded;
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat::metrics::ZeroShotOptions;
use scenesplat::objects::{Agreement, ObjectInput, ObjectSettings, UprightBox, find_objects};
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::Up;

#[derive(Default)]
struct Sums {
    matches: usize,
    found: usize,
    truth: usize,
    center: Vec<f64>,
    size: Vec<f64>,
}

impl Sums {
    fn show(&mut self, name: &str) {
        for errors in [&mut self.center, &mut self.size] {
            errors.sort_by(f64::total_cmp);
        }
        let at =
            |v: &[f64], q: f64| v.get((v.len().saturating_sub(1) as f64 * q) as usize).copied();
        let share = |of: usize| self.matches as f64 / of.max(1) as f64;
        println!(
            "| {name} | {} | {} | {:.3} | {:.3} | {:.3} / {:.3} | {:.3} / {:.3} |",
            self.truth,
            self.found,
            share(self.found),
            share(self.truth),
            at(&self.center, 0.5).unwrap_or(f64::NAN),
            at(&self.center, 0.9).unwrap_or(f64::NAN),
            at(&self.size, 0.5).unwrap_or(f64::NAN),
            at(&self.size, 0.9).unwrap_or(f64::NAN),
        );
    }
}

pub fn run(mut args: Arguments) -> Result<()> {
    let (rooms, seed): (u64, u64) = (args.or(20)?, args.or(2026)?);
    let network = Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
    let text = embedded::vocabulary()?.class_table();
    let settings = ObjectSettings::default();
    let mut sums = [Sums::default(), Sums::default(), Sums::default()];
    for room in 0..rooms {
        let room = generate(&SyntheticRoomSettings { seed, room, ..Default::default() })?;
        let scene = &room.scene;
        let truth = scene.segment.as_deref().context("a room has labels")?;
        let ids = scene.instance.as_deref().context("a room has instances")?;
        let features = SceneEncoder::new(&network).encode(scene, &mut |_| Ok(()))?;
        let options = ZeroShotOptions::default();
        let own = label_with_vote(&features, Classes::Texts(&text), &options, &scene.coord, 25)?;
        let add = |row: usize, sum: &mut [f32]| {
            let values = features.gaussian_rows(row..row + 1).unwrap_or_default();
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        };
        let cases: [(&[i32], bool); 3] =
            [(truth, false), (&own.labels, false), (&own.labels, true)];
        for ((labels, with_features), sums) in cases.into_iter().zip(&mut sums) {
            let input = ObjectInput {
                scene,
                labels,
                scores: None,
                instances: None,
                features: with_features.then_some((features.width(), &add as _)),
                names: &text.names,
                upright: Up::PLUS_Z.upright(),
                metres_per_unit: 1.0,
                floor: None,
            };
            let found = find_objects(&input, &settings)?;
            let agreed = Agreement::of(&found, ids, truth, settings.min_count);
            sums.matches += agreed.matches.len();
            sums.found += agreed.found;
            sums.truth += agreed.truth;
            for m in &agreed.matches {
                let rows = (0u32..).zip(ids).filter(|(_, id)| **id == m.truth);
                let rows: Vec<u32> = rows.map(|(row, _)| row).collect();
                let Some(want) = UprightBox::around(&scene.coord, &rows) else { continue };
                let got = found.objects[m.found].bounds;
                let off = (0..3).map(|a| (want.center[a] - got.center[a]).powi(2)).sum::<f64>();
                sums.center.push(off.sqrt());
                let sides = (0..3).map(|a| (want.size[a] - got.size[a]).abs());
                sums.size.push(sides.fold(0.0, f64::max));
            }
        }
    }
    println!(
        "| labels | true | found | precision | recall | center error, m (50 / 90 %) | size error, m |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (name, sums) in ["true", "network", "network, with features"].iter().zip(&mut sums) {
        sums.show(name);
    }
    Ok(())
}
