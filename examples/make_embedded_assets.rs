//! Makes the files of the network inside the program from a trained run:
//! `cargo run --release --example make_embedded_assets -- runs/embedded/model`

use anyhow::Context;
use candle_core::{DType, Device};
use scenesplat::experiment::export::write_model;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

fn main() -> anyhow::Result<()> {
    let model = PathBuf::from(std::env::args().nth(1).context("the folder of the model")?);
    let weights = candle_core::safetensors::load(model.join("model.safetensors"), &Device::Cpu)?;
    let half = |(name, tensor): (String, candle_core::Tensor)| {
        // Variances of features may lie outside the range of f16, and take no room.
        let keep = name.contains(".running_") || name.contains("num_batches");
        let tensor = if keep { tensor } else { tensor.to_dtype(DType::F16)? };
        Ok((name, tensor))
    };
    let weights: HashMap<_, _> = weights.into_iter().map(half).collect::<anyhow::Result<_>>()?;
    let config = serde_json::from_slice(&std::fs::read(model.join("config.json"))?)?;
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/embedded");
    write_model(&weights, &config, &assets)?;
    println!("wrote {}", assets.display());
    Ok(())
}
