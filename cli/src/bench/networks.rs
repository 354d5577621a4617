//! Rows of whole networks.

use super::products::weight_size;
use super::stopwatch::time;
use super::train_step::TrainStep;
use super::{Accuracy, Measured, Request, checks, flop};
use anyhow::{Context, Result};
use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat::kernels::Precision;
use scenesplat::kernels::bench_room as room;
use scenesplat::models::weights::WeightSource;
use scenesplat::models::{
    Compute, Forward, LitePtConfig, ModelConfig, ParamStore, PointCloud, PointTransformerV3Config,
};
use std::path::Path;

/// Rows that are compared between precisions.
const COMPARED: usize = 4096;

/// A network that computes in a precision.
fn in_precision(model: ModelConfig, precision: Precision) -> ModelConfig {
    let compute = Compute { precision, ..model.backbone.get().compute() };
    model.with_compute(compute)
}

fn semseg(precision: Precision) -> ModelConfig {
    // Without normals, as the networks it is compared with.
    let shape = PointTransformerV3Config { in_channels: 11, ..PointTransformerV3Config::semseg() };
    in_precision(ModelConfig::new(shape).with_classes(20), precision)
}

fn cloud(voxels: Vec<[i32; 3]>, channels: usize) -> Result<PointCloud> {
    let n = voxels.len();
    let feat = Tensor::from_vec(room::values(n * channels, 1), (n, channels), &Device::Cpu)?;
    Ok(PointCloud::single(voxels, feat)?)
}

/// The language network.
pub(super) fn language(n: usize, request: &Request) -> Result<Measured> {
    forward(&in_precision(ModelConfig::language(), request.precision), n, request)
}

/// LitePT-S with features as wide as those of the language network.
pub(super) fn litept_language(n: usize, request: &Request) -> Result<Measured> {
    let wide = ModelConfig::language().out_channels();
    let model = ModelConfig::new(LitePtConfig::small()).with_projection(wide);
    forward(&in_precision(model, request.precision), n, request)
}

/// The segmentation network.
pub(super) fn segmentation(n: usize, request: &Request) -> Result<Measured> {
    forward(&semseg(request.precision), n, request)
}

fn forward(model: &ModelConfig, n: usize, request: &Request) -> Result<Measured> {
    let weights = ParamStore::frozen(WeightSource::hashed(0, ""));
    let network = model.build(weights.builder())?;
    let voxels = room::voxels(n);
    let points = cloud(voxels.clone(), model.in_channels())?;
    let mut out = None;
    let measured = time(request, || {
        out = None;
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        out = Some(network.forward(&points, &mut Forward::eval(&mut rng))?);
        Ok(())
    })?;
    let out = out.context("no pass")?;
    let rows: Vec<u32> = checks::some_rows(n, COMPARED).into_iter().map(|r| r as u32).collect();
    let rows = Tensor::from_vec(rows.clone(), rows.len(), &Device::Cpu)?;
    let (width, out) = (out.dim(1)?, out.index_select(&rows, 0)?.flatten_all()?.to_vec1::<f32>()?);
    let accuracy = compare(request, &out, width, "rows")?;
    let io = 4 * n * (model.in_channels() + width);
    Ok(Measured {
        size: n,
        flop: flop::count(model, &voxels, true)?.forward(),
        bytes: (io + weight_size(request.precision) * model.num_values()) as u64,
        accuracy,
        ..measured
    })
}

/// Forward, cross entropy, backward, AdamW.
pub(super) fn train_step(n: usize, recompute: bool, request: &Request) -> Result<Measured> {
    let model = semseg(request.precision);
    let voxels = room::voxels(n);
    let mut step = TrainStep::new(&model, cloud(voxels.clone(), model.in_channels())?, recompute)?;
    if !request.one_pass {
        // The first of thousands of steps allocates what all others use again.
        step.run()?;
    }
    let measured = time(request, || {
        let loss = step.run()?;
        anyhow::ensure!(loss.is_finite(), "the loss became {loss}");
        Ok(())
    })?;
    let gradient = step.first_gradient();
    let width = gradient.len() / PointTransformerV3Config::semseg().enc_channels[0];
    let accuracy = compare(request, gradient, width, "channels of the first gradient of the stem")?;
    Ok(Measured {
        size: n,
        flop: flop::count(&model, &voxels, false)?.train(),
        // Input; weights and both moments, read and written.
        bytes: (4 * n * model.in_channels() + 24 * model.num_values()) as u64,
        accuracy,
        ..measured
    })
}

/// Keeps a result in f32, or compares one in less with it.
fn compare(request: &Request, rows: &[f32], width: usize, what: &str) -> Result<Option<Accuracy>> {
    match &request.rows_file {
        Some(path) if request.precision == Precision::F32 => {
            write_rows(path, rows)?;
            Ok(None)
        }
        Some(path) => Ok(Some(checks::against_f32(rows, &read_rows(path)?, width, what))),
        None => Ok(None),
    }
}

fn write_rows(path: &Path, rows: &[f32]) -> Result<()> {
    let bytes: Vec<u8> = rows.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(path, bytes).with_context(|| path.display().to_string())
}

fn read_rows(path: &Path) -> Result<Vec<f32>> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    Ok(bytes.as_chunks().0.iter().map(|v| f32::from_le_bytes(*v)).collect())
}
