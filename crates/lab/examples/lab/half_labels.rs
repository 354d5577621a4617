//! A scene, and labels of half of its objects: what `scenesplat adapt` is measured with.

use crate::Arguments;
use anyhow::{Context, bail};
use rand_chacha::rand_core::RngCore;
use scenesplat::datasets::sample_rng;
use scenesplat::input::open_input;
use scenesplat::rooms::{Capture, SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::{GaussianScene, ReadOptions};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub fn run(mut args: Arguments) -> anyhow::Result<()> {
    let out: PathBuf = args.needed("which folder?")?;
    let scene = args.word().context("which scene?")?;
    let seed: u64 = args.or(0)?;
    std::fs::create_dir_all(&out)?;
    let room = match scene.split_once(':') {
        Some((kind, numbers)) => Some(room(kind, numbers)?),
        None => None,
    };
    if let Some(room) = &room {
        write_inria_ply(room, &[], &out.join("room.ply"))?;
    }
    let scene = match room {
        Some(room) => room,
        None => open_input(Path::new(&scene), &ReadOptions::default())?.0.loaded.scene,
    };
    let segment = scene.segment.as_ref().context("the scene has no labels")?;
    let instance = scene.instance.as_ref().context("the scene has no instances")?;
    let mut of_object: BTreeMap<i32, usize> = BTreeMap::new();
    for (object, label) in instance.iter().zip(segment).filter(|(_, label)| **label >= 0) {
        if *object >= 0 {
            *of_object.entry(*object).or_default() += usize::from(*label >= 0);
        }
    }
    // As many as not, drawn by the seed.
    let mut order: Vec<(u64, i32)> = of_object
        .keys()
        .map(|object| (sample_rng(seed, 0, *object as u64).next_u64(), *object))
        .collect();
    order.sort_unstable();
    let labeled: Vec<i32> = order.iter().take(order.len() / 2).map(|(_, object)| *object).collect();
    let label = |(object, label): (&i32, &i32)| if labeled.contains(object) { *label } else { -1 };
    let labels: Vec<i32> = instance.iter().zip(segment).map(label).collect();
    write_npy(&out.join("labels.npy"), &[labels.len()], &labels)?;
    let rows = labels.iter().filter(|label| **label >= 0).count();
    println!(
        "{} of {} objects have labels, {rows} of {} Gaussians",
        labeled.len(),
        order.len(),
        labels.len()
    );
    Ok(())
}

/// `synthetic:SEED:ROOM`, `scanned:` or, of models that training did not see, `furnished:`.
fn room(kind: &str, numbers: &str) -> anyhow::Result<GaussianScene> {
    let (seed, room) = numbers.split_once(':').context("KIND:SEED:ROOM")?;
    let mut settings = SyntheticRoomSettings {
        seed: seed.parse()?,
        room: room.parse()?,
        ..SyntheticRoomSettings::default()
    };
    match kind {
        "synthetic" => {}
        "scanned" => settings.capture = Capture::Scan,
        "furnished" => {
            let catalogue =
                std::env::var("SCENESPLAT_FURNITURE").context("SCENESPLAT_FURNITURE")?;
            settings.furniture = Some(catalogue.into());
            settings.furniture_share = 1.0;
            settings.furniture_split = "held_out".parse().map_err(anyhow::Error::msg)?;
        }
        _ => bail!("there are no {kind} rooms; write synthetic, scanned or furnished"),
    }
    Ok(generate(&settings)?.scene)
}
