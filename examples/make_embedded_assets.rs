//! Makes the files of the network inside the program from a trained run, and fits where the features of rooms lie:
//! `cargo run --release --example make_embedded_assets -- runs/embedded_flats/model`

use anyhow::Context;
use candle_core::{DType, Device};
use scenesplat::experiment::export::write_model;
use scenesplat::familiarity::Familiarity;
use scenesplat::network::config_beside;
use scenesplat::rooms::{Capture, SyntheticRoomSettings, generate};
use scenesplat::{Network, SceneEncoder, SceneFeatures, WeightOptions, Weights};
use sha2::Digest;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Rooms of each kind of capture, those that are fitted to and those that the limit is from.
const ROOMS: u64 = 8;
const SEEDS: [u64; 2] = [5001, 5002];
/// Rows of each room, about, and centres.
const ROWS: usize = 4000;
const CENTRES: usize = 64;

fn main() -> anyhow::Result<()> {
    let model = PathBuf::from(std::env::args().nth(1).context("the folder of the model")?);
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/embedded");
    if model.canonicalize()? != assets.canonicalize()? {
        let weights =
            candle_core::safetensors::load(model.join("model.safetensors"), &Device::Cpu)?;
        let half = |(name, tensor): (String, candle_core::Tensor)| {
            // Variances of features may lie outside the range of f16, and take no room.
            let keep = name.contains(".running_") || name.contains("num_batches");
            let tensor = if keep { tensor } else { tensor.to_dtype(DType::F16)? };
            Ok((name, tensor))
        };
        let weights: HashMap<_, _> =
            weights.into_iter().map(half).collect::<anyhow::Result<_>>()?;
        let config = serde_json::from_slice(&std::fs::read(model.join("config.json"))?)?;
        write_model(&weights, &config, &assets)?;
        println!("wrote {}", assets.display());
    }

    let path = assets.join("model.safetensors");
    let hash = sha2::Sha256::digest(std::fs::read(&path)?);
    let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    let config = config_beside(&assets)?.context("config.json is missing")?;
    let network = Network::load(config, &Weights::File(assets.clone()), WeightOptions::default())?;
    let mut rows = Vec::new();
    each_room(&network, SEEDS[0], |features| {
        let step = features.num_slots().div_ceil(ROWS).max(1);
        for slot in (0..features.num_slots()).step_by(step) {
            rows.extend(features.slot_rows(slot..slot + 1)?);
        }
        Ok(())
    })?;
    let width = network.model().out_channels();
    let familiar = Familiarity::fit(&rows, width, CENTRES, SEEDS[0]);
    let mut found = Vec::new();
    each_room(&network, SEEDS[1], |features| {
        found.extend(familiar.strangeness(features)?);
        Ok(())
    })?;
    println!("strangeness of {} rooms: {found:.2?}", found.len());
    let familiar = familiar.with_rooms(&found, hash);
    let limits = (familiar.limit(), familiar.clear_limit());
    println!("rooms {:.2?}, limits {limits:.2?}", familiar.rooms());
    let path = assets.join("familiarity.safetensors");
    std::fs::write(&path, familiar.to_safetensors()?)?;
    println!("wrote {}", path.display());
    Ok(())
}

/// Rooms and flats, as made, as scans and as points of models.
fn each_room(
    network: &Network,
    seed: u64,
    mut of: impl FnMut(&SceneFeatures) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    for capture in [Capture::Made, Capture::Scan, Capture::Model] {
        for room in 0..ROOMS {
            let settings = SyntheticRoomSettings {
                seed,
                room,
                capture,
                seen_share: if capture == Capture::Scan { 0.5 } else { 0.0 },
                flat_share: 0.3,
                ..SyntheticRoomSettings::default()
            };
            let scene = generate(&settings)?.scene;
            of(&SceneEncoder::new(network).encode(&scene, &mut |_| Ok(()))?)?;
        }
    }
    Ok(())
}
