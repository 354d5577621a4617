//! What a catalogue of furniture has, what of it cannot be used, who made it, and what rooms with it cost:
//!
//! ```sh
//! cargo run --release -p scenesplat-rooms --example furniture -- /usr/share/sweethome3d/furniture
//! cargo run --release -p scenesplat-rooms --example furniture -- FOLDER --attribution train > ATTRIBUTION.md
//! cargo run --release -p scenesplat-rooms --example furniture -- FOLDER --names > names.txt
//! cargo run --release -p scenesplat-rooms --example furniture -- FOLDER --time
//! ```

use scenesplat_rooms::catalogue::Meaning;
use scenesplat_rooms::{CLASSES, Catalogue, FurnitureSplit, SyntheticRoomSettings, generate};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Instant;

/// Rooms whose making is timed, cold and warm.
const ROOMS: u64 = 60;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let path = PathBuf::from(args.next().ok_or("which catalogue? a .sh3f file or a folder")?);
    let catalogue = Catalogue::shared(&path)?;
    let word = args.next();
    let only_time = word.as_deref() == Some("--time");
    if word.as_deref() == Some("--attribution") {
        let split: FurnitureSplit = args.next().as_deref().unwrap_or("all").parse()?;
        catalogue.check(&split)?;
        print!("{}", catalogue.attribution(&split));
        return Ok(());
    }
    if word.as_deref() == Some("--names") {
        // For a table of texts: classes, then what models are called.
        let mut names: Vec<&str> = CLASSES.iter().map(|class| class.name).collect();
        let drawn = catalogue.entries().iter().filter(|e| e.meaning != Meaning::Outdoors);
        names.extend(drawn.map(|entry| entry.name.trim()).collect::<BTreeSet<_>>());
        println!("{}", names.join("\n"));
        return Ok(());
    }

    count(&catalogue);
    if !only_time {
        examine(&catalogue);
    }
    time(path)
}

/// How many models each library and each class has.
fn count(catalogue: &Catalogue) {
    let mut libraries: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    let mut classes: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for (index, entry) in catalogue.entries().iter().enumerate() {
        let [all, held, outdoors] = libraries.entry(&entry.library).or_default();
        *all += 1;
        *held += usize::from(catalogue.is_held_out(index));
        *outdoors += usize::from(entry.meaning == Meaning::Outdoors);
        let name = entry.meaning.class().map_or("none", |class| CLASSES[class.index()].name);
        let [all, held] = classes.entry(name).or_default();
        *all += 1;
        *held += usize::from(catalogue.is_held_out(index));
    }
    for (library, [all, held, outdoors]) in libraries {
        println!("{library}: {all} models, {held} held out, {outdoors} never drawn");
    }
    let of_class =
        classes.iter().map(|(name, [all, held])| format!("{name} {all} ({held} held out)"));
    println!("classes: {}", of_class.collect::<Vec<_>>().join(", "));
}

/// What rooms cost without and with the catalogue.
fn time(path: PathBuf) -> Result<(), Box<dyn std::error::Error>> {
    let kinds = [
        ("parametric", None, 0.0),
        ("parametric, walked", None, 1.0),
        ("furnished", Some(path), 0.0),
    ];
    for (what, furniture, seen_share) in kinds {
        for pass in ["first", "again"] {
            let began = Instant::now();
            let mut gaussians = 0;
            for room in 0..ROOMS {
                let furniture = furniture.clone();
                let settings =
                    SyntheticRoomSettings { room, furniture, seen_share, ..Default::default() };
                gaussians += generate(&settings)?.scene.len();
            }
            let ms = began.elapsed().as_secs_f64() * 1e3 / ROOMS as f64;
            println!(
                "{what}, {pass}: {ms:.1} ms a room of {} Gaussians",
                gaussians / ROOMS as usize
            );
        }
    }
    Ok(())
}

/// Decodes all models, and says which cannot be used.
fn examine(catalogue: &Catalogue) {
    let began = Instant::now();
    let refused = catalogue.examine();
    println!(
        "all models decoded in {:.1} s; refused: {}",
        began.elapsed().as_secs_f64(),
        refused.len()
    );
    for bad in &refused {
        println!("  {}: {}: {}", bad.library, bad.id, bad.problem);
    }
}
