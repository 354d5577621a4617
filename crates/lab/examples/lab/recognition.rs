//! What of a scene the network inside the program knows: `lab recognition SCENES...` reports what is known of files. A name that begins
//! with `+` is a room, or part of one, with `-` is none; of these the area under the ROC curve is printed. With `@N`
//! behind it, N balls of it are read as well, in four densities.

use crate::Arguments;
use anyhow::{Context, bail};
use scenesplat::AlignmentSettings;
use scenesplat::input::open_input;
use scenesplat::kernels::random::{sample_rng, unit};
use scenesplat::recognition::{KNOWN, Recognition, SURE};
use scenesplat::scene::{GaussianScene, ReadOptions};
use scenesplat_lab::reader::{Read, Reader};
use scenesplat_lab::recognition::fitted;
use scenesplat_lab::recognition::scenes::ball;
use std::cmp::Ordering;
use std::path::Path;

/// Seeds of the scenes that rows and surfaces are fitted to.
const SEEDS: [u64; 2] = [6101, 6102];

pub fn run(args: Arguments) -> anyhow::Result<()> {
    let words: Vec<String> = args.0.collect();
    let reader = Reader::embedded()?;
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/embedded/recognition.json");
    let known: Recognition = serde_json::from_str(&std::fs::read_to_string(file)?)?;
    let (mut rooms, mut others) = (Vec::new(), Vec::new());
    println!(
        "{:<44} {:>8} {:>7} {:>7} {:>6} {:>6}",
        "scene", "rows", "score", "square", "known", "sure"
    );
    for word in &words {
        let (name, balls) = word.split_once('@').unwrap_or((word, "0"));
        let (kind, path) = name.split_at_checked(1).context("+FILE or -FILE")?;
        let balls: u64 = balls.parse().context("FILE@N")?;
        let (opened, _) = open_input(Path::new(path), &ReadOptions::default())?;
        let (scene, stated_up) = (&opened.loaded.scene, opened.loaded.stated_up);
        let mut parts = vec![(path.to_owned(), scene.clone())];
        for number in 0..balls {
            let (what, part) = part(scene, number)?;
            parts.push((format!("  {what}"), part));
        }
        // Parts lie as their scene does, which is easier to see in the whole.
        let mut settings = AlignmentSettings { stated_up, ..AlignmentSettings::default() };
        for (name, part) in parts {
            let alignment = reader.alignment(&part, &settings)?;
            settings.up = Some(alignment.turned_from);
            let Read { features, surfaces, squareness } = reader.read(&part, alignment)?;
            let found = known.of(&features, Some(surfaces.largest()), squareness)?;
            let Some(found) = found else { continue };
            let share = found.share(KNOWN);
            println!(
                "{name:<44} {:>8} {:>7.2} {:>7.2} {share:>6.2} {:>6.2}",
                part.len(),
                found.score,
                found.squareness,
                found.share(SURE)
            );
            let mean = found.probability.iter().map(|p| f64::from(*p)).sum::<f64>();
            let mean = mean / found.probability.len().max(1) as f64;
            match kind {
                "+" => rooms.push(mean),
                "-" => others.push(mean),
                _ => bail!("{word}: begin with + for a room, - for what is none"),
            }
        }
    }
    if !rooms.is_empty() && !others.is_empty() {
        println!(
            "{} rooms, {} others: AUROC {:.3}",
            rooms.len(),
            others.len(),
            roc_area(&rooms, &others)
        );
    }
    Ok(())
}

/// The probability that a room scores more than what is none; equal scores count half.
fn roc_area(rooms: &[f64], others: &[f64]) -> f64 {
    let pairs = rooms.iter().flat_map(|room| others.iter().map(move |other| (room, other)));
    let won = pairs.map(|(room, other)| match room.total_cmp(other) {
        Ordering::Greater => 1.0,
        Ordering::Equal => 0.5,
        Ordering::Less => 0.0,
    });
    won.sum::<f64>() / (rooms.len() * others.len()) as f64
}

/// Fits to made scenes. `weights`: SHA-256 of the network's.
pub fn write(reader: &Reader, weights: String, assets: &Path) -> anyhow::Result<()> {
    let known = fitted(reader, SEEDS, weights, |count| eprint!("\r{count} scenes"))?;
    let path = assets.join("recognition.json");
    std::fs::write(&path, serde_json::to_string_pretty(&known)? + "\n")?;
    println!("\nwrote {}", path.display());
    Ok(())
}

/// What of a scene lies within 1.2 to 2.5 of one of its Gaussians, and every first, second, fourth or eighth of it.
fn part(scene: &GaussianScene, number: u64) -> anyhow::Result<(String, GaussianScene)> {
    let mut rng = sample_rng(47, number, 0);
    let middle = scene.coord[((unit(&mut rng) * scene.len() as f64) as usize).min(scene.len() - 1)];
    let reach = 1.2 + 1.3 * unit(&mut rng);
    let every = 1 << (number % 4);
    Ok((format!("within {reach:.1}, 1 of {every}"), ball(scene, middle, reach, every)?))
}
