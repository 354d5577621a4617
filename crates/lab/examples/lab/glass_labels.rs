//! What it is worth to lift labels in two layers where pictures look through glass: puts two rooms next to each
//! other, makes a pane of most of the wall between them, takes 60 pictures from the first one, and compares the labels that come back in one layer
//! and in two. In a part of the pictures the pane is a segment of its own, in the others what is seen through it.

use crate::Arguments;
use crate::planted::{DIM, Planted, Size, heaviest};
use anyhow::{Context, Result};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat::datasets::effects::profile::profile;
use scenesplat::datasets::effects::{Effect, simulate, simulate_in_room};
use scenesplat::rooms::{ClassId, SyntheticRoomSettings, generate};
use scenesplat::scene::edit::merge;
use scenesplat_lab::compensation::panes_of;
use scenesplat_rasterizer::View;
use scenesplat_rasterizer::lifting::{
    DepthTolerance, FinaliseSettings, LabelledPicture, LiftSettings, Lifter, Panes, Robust,
    SegmentMap,
};

/// Part of the pictures in which the pane is a segment of its own.
const NAMED: [f64; 4] = [0.0, 0.25, 0.5, 1.0];

/// Two rooms with a pane between them.
struct World {
    planted: Planted,
    /// What kind each Gaussian is: 0 other, 1 of the pane, 2 behind it, 3 mirror image.
    kind: Vec<u8>,
    /// Number of the pane among the objects.
    pane: usize,
    /// The box of the pane's Gaussians: where it begins and ends along each axis.
    at: [[f32; 2]; 3],
    /// As the profile finds it.
    panes: Panes,
    /// What the profile says.
    found: String,
}

pub fn run(mut args: Arguments) -> Result<()> {
    let (gaussians, first, count): (_, u64, u64) = (args.or(60_000)?, args.or(0)?, args.or(3)?);
    for room in first..first + count {
        for (two, severity) in [(true, 2.0), (true, 3.0), (true, 4.0), (false, 2.0), (false, 4.0)] {
            let world = World::new(gaussians, room, severity, two)?;
            let rooms = if two { "two rooms" } else { "one room" };
            let count = |rows: &[bool]| rows.iter().filter(|is| **is).count();
            println!(
                "{rooms} {room} glass={severity}: {}; {} balls, {} of {} Gaussians of the pane",
                world.found,
                world.panes.balls.iter().map(Vec::len).sum::<usize>(),
                count(&world.panes.is_sheet),
                world.kind.iter().filter(|k| **k == 1).count()
            );
            for named in NAMED {
                let maps = world.maps(named);
                let [off, on] = [None, Some(&world.panes)].map(|panes| world.lift(&maps, panes));
                let (off, on) = (off?, on?);
                let shares = |k: usize| format!("{:.1} → {:.1} %", off.right[k], on.right[k]);
                println!(
                    "{rooms} {room} glass={severity} named in {named}: own object all {}, pane {}, behind {}, \
                     other {}; confidence behind {:.2} → {:.2}, mirror images {:.2} → {:.2}; {} pictures",
                    shares(4),
                    shares(1),
                    shares(2),
                    shares(0),
                    off.confidence[2],
                    on.confidence[2],
                    off.confidence[3],
                    on.confidence[3],
                    on.pictures
                );
            }
        }
    }
    Ok(())
}

/// How far before the camera a point is.
fn depth_of(view: &View, point: &[f32; 3]) -> f32 {
    let row = view.world_to_camera[2];
    row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]
}

/// What came back.
struct Lifted {
    /// Share with their own object by kind, of those with a weight of half a pixel, %; the last: of all.
    right: [f64; 5],
    /// Mean confidence by kind.
    confidence: [f64; 4],
    /// Pictures in two layers.
    pictures: usize,
}

impl World {
    /// With another room behind the wall at the end of x and most of the wall a pane, or one room, a part of whose
    /// largest wall is a pane.
    fn new(gaussians: usize, room: u64, severity: f64, two: bool) -> Result<Self> {
        let make = |room, gaussians| {
            let settings = SyntheticRoomSettings {
                room,
                points_share: 0.0,
                num_gaussians: Some(gaussians),
                ..SyntheticRoomSettings::default()
            };
            generate(&settings)
        };
        let effect = format!("glass={severity}").parse()?;
        let (before, rows, size, glass) = if two {
            let (mut near, far) = (make(room, gaussians / 2)?, make(room + 1000, gaussians / 2)?);
            let [x, width, height] = near.size;
            // Without its own wall there.
            let inside: Vec<usize> =
                (0..far.scene.len()).filter(|&row| far.scene.coord[row][0] > 0.15).collect();
            let mut other = far.scene.select_rows(&inside)?;
            other.coord.iter_mut().for_each(|p| p[0] += x);
            let rows = near.scene.len();
            near.scene = merge(vec![near.scene, other])?.0;
            let y = [0.15, 0.85].map(|s| s * width.min(far.size[1]));
            let mut window = near.objects.first().context("an object")?.clone();
            window.class = Some(ClassId::Window);
            window.bounds = [[x - 0.06, y[0], 0.3], [x + 0.06, y[1], 0.85 * height]];
            near.objects = vec![window];
            let glass = simulate_in_room(&near, &effect, room)?.simulated;
            (near.scene, rows, near.size, glass)
        } else {
            let room_of = make(room, gaussians)?;
            let glass = simulate(&room_of.scene, &effect, room)?;
            (room_of.scene, usize::MAX, room_of.size, glass)
        };
        let before = before.instance.context("objects")?;
        let pane = before.iter().max().map_or(0, |o| *o as usize + 1);
        let after = glass.scene.instance.clone().context("objects")?;
        let (mut kind, mut object) = (Vec::new(), Vec::new());
        for (row, source) in glass.source.iter().enumerate() {
            let (k, o) = match *source {
                None => (3, -1),
                Some(from) if after[row] < 0 && before[from] >= 0 => (1, pane as i32),
                Some(from) => (if from >= rows { 2 } else { 0 }, before[from]),
            };
            kind.push(k);
            object.push(o);
        }
        let found = profile(&glass.scene, 1.0);
        let found = found.of(Effect::Glass);
        let regions = if found.present { &found.regions[..] } else { &[] };
        let size_of = Size { gaussians, views: 60, picture: [320, 240], room };
        let (panes, text) = (panes_of(&glass.scene, regions), found.text.clone());
        let of_pane = || glass.scene.coord.iter().zip(&kind).filter(|(_, k)| **k == 1);
        let end = |a: usize, sign: f32| {
            sign * of_pane().map(|(p, _)| sign * p[a]).fold(f32::NEG_INFINITY, f32::max)
        };
        let at = std::array::from_fn(|a| [end(a, -1.0), end(a, 1.0)]);
        let planted = Planted::of(glass.scene, object, size, size_of);
        Ok(Self { planted, kind, pane, at, panes, found: text })
    }

    /// The maps of the pictures: in a part of them the pane is a segment.
    fn maps(&self, named: f64) -> Vec<SegmentMap> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let planted = &self.planted;
        let views = planted.views.iter().zip(&planted.maps);
        let named = |_: &_| rng.random_bool(named);
        let with: Vec<bool> = planted.views.iter().map(named).collect();
        let map = |((view, map), with): ((&View, &SegmentMap), &bool)| {
            if !with {
                return map.clone();
            }
            let rows = heaviest(&planted.gaussians, view);
            let ids = rows.iter().enumerate().map(|(i, &row)| {
                let (x, y) = (i as u32 % view.width, i as u32 / view.width);
                let depth = match row {
                    u32::MAX => 0.0,
                    row => depth_of(view, &planted.scene.coord[row as usize]),
                };
                match self.shows_pane(view, x, y, depth) {
                    true => self.pane as u16,
                    false => map.at(x, y),
                }
            });
            SegmentMap::new(view.width, view.height, ids.collect()).expect("one id per pixel")
        };
        views.zip(&with).map(map).collect()
    }

    /// Whether the ray of a pixel goes through the pane, before what is seen at that depth.
    fn shows_pane(&self, view: &View, x: u32, y: u32, depth: f32) -> bool {
        let m = &view.world_to_camera;
        let local =
            [(x as f32 + 0.5 - view.cx) / view.fx, (y as f32 + 0.5 - view.cy) / view.fy, 1.0];
        let turned = |v: [f32; 3], a: usize| (0..3).map(|k| m[k][a] * v[k]).sum::<f32>();
        let translation = [m[0][3], m[1][3], m[2][3]];
        let (from, to) = (|a| -turned(translation, a), |a| turned(local, a));
        let extent = |a: usize| self.at[a][1] - self.at[a][0];
        let thin = if extent(0) < extent(1) { 0 } else { 1 };
        let middle = 0.5 * (self.at[thin][0] + self.at[thin][1]);
        let t = (middle - from(thin)) / to(thin);
        let within = |a: usize| (self.at[a][0]..self.at[a][1]).contains(&(from(a) + t * to(a)));
        t > 0.0 && depth > t - 0.15 && within(1 - thin) && within(2)
    }

    fn lift(&self, maps: &[SegmentMap], panes: Option<&Panes>) -> Result<Lifted> {
        let planted = &self.planted;
        let settings =
            LiftSettings { depth: Some(DepthTolerance::RENDERED), ..LiftSettings::default() };
        let mut lifter = Lifter::new(&planted.gaussians, 1, DIM, settings)?;
        if let Some(panes) = panes {
            lifter = lifter.with_panes(panes.clone())?;
        }
        let mut light = vec![0.0; planted.object.len()];
        let plain = LiftSettings::default();
        let mut all = Lifter::new(&planted.gaussians, 1, DIM, plain)?;
        for (view, map) in planted.views.iter().zip(maps) {
            let levels = std::slice::from_ref(map);
            let picture =
                LabelledPicture { view, levels, features: &planted.features, depth: None };
            lifter.add(&picture)?;
            // Everything in one segment: how much of each Gaussian is seen at all.
            let whole = [SegmentMap::new(view.width, view.height, vec![0; view.pixels()])?];
            all.add(&LabelledPicture { levels: &whole, ..picture })?;
        }
        light.copy_from_slice(&all.collect(0, &FinaliseSettings::default())?.coverage);
        // As the program does: guarded where pictures contradict each other.
        let measured = lifter.disagreement(0)?;
        let finalise = match Robust::default().decide(measured.value()) {
            true => FinaliseSettings {
                guard_above: measured.conflict().map(|limit| limit as f32),
                ..FinaliseSettings::robust()
            },
            false => FinaliseSettings::default(),
        };
        let found = planted.recover(&mut lifter, &finalise)?;
        let confidence = lifter.collect(0, &finalise)?.confidence;
        let (mut right, mut sure, mut seen) = ([0.0; 5], [0.0; 5], [0.0f64; 5]);
        for (row, &kind) in self.kind.iter().enumerate().filter(|(row, _)| light[*row] >= 0.5) {
            let kind = usize::from(kind);
            let own = planted.object[row];
            if own < 0 && kind != 3 {
                continue;
            }
            for k in if kind == 3 { vec![3] } else { vec![kind, 4] } {
                seen[k] += 1.0;
                right[k] += f64::from(u8::from(found.object[row] == own));
                sure[k] += f64::from(confidence[row]);
            }
        }
        Ok(Lifted {
            right: std::array::from_fn(|k| 100.0 * right[k] / seen[k].max(1.0)),
            confidence: std::array::from_fn(|k| sure[k] / seen[k].max(1.0)),
            pictures: lifter.num_through_panes(),
        })
    }
}
