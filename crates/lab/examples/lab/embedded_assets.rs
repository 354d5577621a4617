//! Makes the files of the network inside the program from trained runs (of several: from the mean of their weights), and fits where the features of rooms lie, at
//! which temperature cosines are probabilities, how much surface things have, what tells rooms from other scenes, and what effects of a capture cost. The catalogue of furniture is
//! that of `SCENESPLAT_FURNITURE`.

use crate::Arguments;
use anyhow::Context;
use candle_core::{DType, Device, Tensor};
use scenesplat::calibration::Calibration;
use scenesplat::experiment::export::write_model;
use scenesplat::familiarity::Familiarity;
use scenesplat::metrics::{FeatureSlice, cosine_scores, fit_temperature, probability_error};
use scenesplat::network::config_beside;
use scenesplat::objects::surfaces::{SurfaceSettings, surfaces};
use scenesplat::rooms::{CLASSES, Capture, SyntheticRoomSettings, Vocabulary, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::scene::quantile::quantile;
use scenesplat::text::text_rows;
use scenesplat::{Network, SceneEncoder, SceneFeatures, WeightOptions, Weights};
use scenesplat_lab::reader::Reader;
use sha2::Digest;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Rooms of each kind of capture, those that are fitted to and those that the limit is from.
const ROOMS: u64 = 8;
const SEEDS: [u64; 2] = [5001, 5002];
/// Rows of each room, about, and centers.
const ROWS: usize = 4000;
const CENTRES: usize = 64;
/// Rooms of each kind whose things are measured.
const MEASURED: u64 = 16;
/// Share of the things of a class that have less surface than the table says.
const SMALLEST: f64 = 0.05;

pub fn run(args: Arguments) -> anyhow::Result<()> {
    let models: Vec<PathBuf> = args.0.map(PathBuf::from).collect();
    let first = models.first().context("the folder of a model")?;
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/embedded");
    if models.len() > 1 || first.canonicalize()? != assets.canonicalize()? {
        let half = |(name, tensor): (String, Tensor)| {
            // Variances of features may lie outside the range of f16, and take no room.
            let keep = name.contains(".running_") || name.contains("num_batches");
            let tensor = if keep { tensor } else { tensor.to_dtype(DType::F16)? };
            Ok((name, tensor))
        };
        let weights: HashMap<_, _> =
            mean_of(&models)?.into_iter().map(half).collect::<anyhow::Result<_>>()?;
        let config = serde_json::from_slice(&std::fs::read(first.join("config.json"))?)?;
        write_model(&weights, &config, &assets)?;
        println!("wrote {}", assets.display());
    }

    let path = assets.join("model.safetensors");
    let hash = sha2::Sha256::digest(std::fs::read(&path)?);
    let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    let config = config_beside(&assets)?.context("config.json is missing")?;
    let network = Network::load(config, &Weights::File(assets.clone()), WeightOptions::default())?;
    let mut rows = Vec::new();
    each_room(&network, SEEDS[0], None, |_, features| {
        let step = features.num_slots().div_ceil(ROWS).max(1);
        for slot in (0..features.num_slots()).step_by(step) {
            rows.extend(features.slot_rows(slot..slot + 1)?);
        }
        Ok(())
    })?;
    let width = network.model().out_channels();
    let familiar = Familiarity::fit(&rows, width, CENTRES, SEEDS[0]);
    let mut found = Vec::new();
    each_room(&network, SEEDS[1], None, |_, features| {
        found.extend(familiar.strangeness(features)?);
        Ok(())
    })?;
    println!("strangeness of {} rooms: {found:.2?}", found.len());
    let familiar = familiar.with_rooms(&found, hash.clone());
    println!("rooms {:.2?}, limit {:.2}", familiar.rooms(), familiar.limit());
    let path = assets.join("familiarity.safetensors");
    std::fs::write(&path, familiar.to_safetensors()?)?;
    println!("wrote {}", path.display());
    calibrate(&network, hash.clone(), &assets)?;
    let reader = Reader::of(network)?;
    crate::yardsticks::write(&reader, hash.clone(), &assets)?;
    crate::recognition::write(&reader, hash.clone(), &assets)?;
    crate::effect_costs::write(&assets, hash)
}

/// Weights of one network, or the mean of those of several with the same names and shapes; counters are the first one's.
fn mean_of(models: &[PathBuf]) -> anyhow::Result<HashMap<String, Tensor>> {
    let read = |model: &PathBuf| -> anyhow::Result<BTreeMap<String, Tensor>> {
        let path = model.join("model.safetensors");
        let read = candle_core::safetensors::load(&path, &Device::Cpu);
        Ok(read.with_context(|| path.display().to_string())?.into_iter().collect())
    };
    let mut sums = HashMap::new();
    for (nth, model) in models.iter().enumerate() {
        let own = read(model)?;
        if nth > 0 && own.len() != sums.len() {
            anyhow::bail!("{}: {} names, the first has {}", model.display(), own.len(), sums.len());
        }
        for (name, tensor) in own {
            let is_number = tensor.dtype().is_float();
            let value = if is_number { tensor.to_dtype(DType::F64)? } else { tensor };
            let sum = match (sums.remove(&name), nth) {
                (None, 0) => value,
                (Some(sum), 1..) if !is_number => sum,
                (Some(sum), 1..) => (&sum + &value)?,
                _ => anyhow::bail!("{}: {name} is not in all of them", model.display()),
            };
            sums.insert(name, sum);
        }
    }
    let count = models.len() as f64;
    let mean = |(name, sum): (String, Tensor)| {
        let mean = match sum.dtype().is_float() {
            true => (sum / count)?.to_dtype(DType::F32)?,
            false => sum,
        };
        Ok((name, mean))
    };
    sums.into_iter().map(mean).collect()
}

/// Which furniture rooms have: built from parameters, or of models that training saw, or of those that it did not.
fn furniture() -> anyhow::Result<[(&'static str, Option<Furniture>); 3]> {
    let catalogue = std::env::var("SCENESPLAT_FURNITURE").context("SCENESPLAT_FURNITURE")?;
    let part = |split: &str| -> anyhow::Result<Option<Furniture>> {
        Ok(Some((catalogue.clone().into(), split.parse().map_err(anyhow::Error::msg)?)))
    };
    let (train, held_out) = (part("train")?, part("held_out")?);
    Ok([("parametric", None), ("furnished", train), ("furniture held out", held_out)])
}

type Furniture = (PathBuf, scenesplat::rooms::FurnitureSplit);

/// At which temperature the truth is likeliest, on rooms whose furniture training knew in other rooms; how far the
/// probabilities are off on further rooms; and how much surface things have.
fn calibrate(network: &Network, weights: String, assets: &Path) -> anyhow::Result<()> {
    let texts = Vocabulary::new(network.model().out_channels())?.class_table();
    let text = text_rows(&texts)?;
    let rows_of = |seed: u64, furniture: Option<&Furniture>| -> anyhow::Result<_> {
        let (mut scores, mut truth) = (Vec::new(), Vec::new());
        each_room(network, seed, furniture, |scene, features| {
            let segment = scene.segment.as_ref().context("labels")?;
            for row in (0..scene.len()).step_by(scene.len().div_ceil(ROWS).max(1)) {
                let own = features.gaussian_rows(row..row + 1)?;
                scores.extend(cosine_scores(&FeatureSlice::new(&own, texts.dim)?, text)?);
                truth.push(segment[row]);
            }
            Ok(())
        })?;
        Ok((scores, truth))
    };
    let kinds = furniture()?;
    let together = |rooms: &[(Vec<f32>, Vec<i32>)]| {
        let (scores, truth): (Vec<_>, Vec<_>) = rooms.iter().cloned().unzip();
        (scores.concat(), truth.concat())
    };
    let fitted = [rows_of(SEEDS[0], None)?, rows_of(SEEDS[0], kinds[1].1.as_ref())?];
    let (scores, truth) = together(&fitted);
    let temperature = fit_temperature(&scores, &truth, texts.len())?.context("no labels")?;
    let others: Vec<_> = (kinds.iter())
        .map(|(_, furniture)| rows_of(SEEDS[1], furniture.as_ref()))
        .collect::<anyhow::Result<_>>()?;
    let (scores, truth) = together(&others[..2]);
    let ece = probability_error(&scores, &truth, texts.len(), temperature)?.ece;
    println!("temperature {temperature:.4}, ECE on other rooms {:.2} %", 100.0 * ece);
    for ((name, _), (scores, truth)) in kinds.iter().zip(&others) {
        let found = probability_error(scores, truth, texts.len(), temperature)?;
        println!("{name}: NLL {:.3}, ECE {:.2} %", found.nll, 100.0 * found.ece);
        for least in [0.3, 0.4, 0.5, 0.6, 0.8] {
            let (given, right) = given(scores, truth, texts.len(), temperature, least);
            println!(
                "  at {least} and above: {given:.1} % of the Gaussians, {right:.1} % of them right"
            );
        }
    }
    let surface = least_surfaces(kinds[1].1.as_ref())?;
    let own = Calibration { weights, temperature, ece, surface };
    let path = assets.join("calibration.json");
    std::fs::write(&path, serde_json::to_string_pretty(&own)? + "\n")?;
    println!("wrote {}", path.display());
    Ok(())
}

/// Percent of the rows whose best class is so probable, and of these, percent that are right.
fn given(
    scores: &[f32],
    truth: &[i32],
    classes: usize,
    temperature: f32,
    least: f32,
) -> (f64, f64) {
    let (mut all, mut given, mut right) = (0.0, 0.0, 0.0);
    for (row, truth) in scores.chunks_exact(classes).zip(truth).filter(|(_, truth)| **truth >= 0) {
        let best = (1..classes).fold(0, |best, c| if row[c] > row[best] { c } else { best });
        let sum: f32 = row.iter().map(|c| ((c - row[best]) / temperature).exp()).sum();
        all += 1.0;
        if 1.0 / sum >= least {
            given += 1.0;
            right += f64::from(u8::from(i32::try_from(best) == Ok(*truth)));
        }
    }
    (100.0 * given / f64::max(all, 1.0), 100.0 * right / f64::max(given, 1.0))
}

/// Surface that all but the smallest things of each class have, square meters.
fn least_surfaces(furniture: Option<&Furniture>) -> anyhow::Result<BTreeMap<String, f64>> {
    let mut of_class: BTreeMap<usize, Vec<f32>> = BTreeMap::new();
    for capture in [Capture::Made, Capture::Model] {
        for furniture in [None, furniture] {
            for room in 0..MEASURED {
                let room = generate(&settings_of(SEEDS[0], room, capture, furniture))?;
                let color = vec![[0.5; 3]; room.scene.len()];
                let found = surfaces(&room.scene.coord, &color, &SurfaceSettings::default())?;
                let instance = room.scene.instance.as_ref().context("instances")?;
                let areas = found.areas(instance, room.objects.len())?;
                for (object, area) in room.objects.iter().zip(areas).filter(|(_, a)| *a > 0.0) {
                    let Some(class) = object.class else { continue };
                    of_class.entry(class.index()).or_default().push(area as f32);
                }
            }
        }
    }
    let mut out = BTreeMap::new();
    for (class, mut areas) in of_class {
        let (name, count) = (CLASSES[class].name, areas.len());
        let least = quantile(&mut areas, SMALLEST).context("an area")?;
        println!("{name}: {count} things, {least:.3} m² and more");
        out.insert(name.to_owned(), (f64::from(least) * 1e4).round() / 1e4);
    }
    Ok(out)
}

/// Rooms and flats, as made, as scans and as points of models.
fn each_room(
    network: &Network,
    seed: u64,
    furniture: Option<&Furniture>,
    mut of: impl FnMut(&GaussianScene, &SceneFeatures) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    for capture in [Capture::Made, Capture::Scan, Capture::Model] {
        for room in 0..ROOMS {
            let scene = generate(&settings_of(seed, room, capture, furniture))?.scene;
            of(&scene, &SceneEncoder::new(network).encode(&scene, &mut |_| Ok(()))?)?;
        }
    }
    Ok(())
}

fn settings_of(
    seed: u64,
    room: u64,
    capture: Capture,
    furniture: Option<&Furniture>,
) -> SyntheticRoomSettings {
    let settings = SyntheticRoomSettings {
        seed,
        room,
        capture,
        seen_share: if capture == Capture::Scan { 0.5 } else { 0.0 },
        flat_share: 0.3,
        ..SyntheticRoomSettings::default()
    };
    let Some((path, split)) = furniture else { return settings };
    let (furniture, furniture_split) = (Some(path.clone()), split.clone());
    SyntheticRoomSettings { furniture, furniture_split, ..settings }
}
