//! A loss of one's own beside ours: `cargo run --release --example custom_loss`

use candle_core::{Device, Result, Tensor};
use scenesplat::losses::{CosineLoss, Loss, LossInput, Objective};
use scenesplat::models::{Forward, ParamStore, PointCloud};
use scenesplat::prelude::*;

/// Mean absolute difference of features and targets, over the rows that have a target.
struct L1;

impl Loss for L1 {
    fn name(&self) -> &str {
        "l1"
    }

    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let Some(target) = input.target else { return Ok(None) };
        let (rows, width) = input.pred.dims2()?;
        let counts = |row| input.valid.is_none_or(|valid| valid[row]);
        let mask: Vec<f32> = (0..rows).map(|row| f32::from(u8::from(counts(row)))).collect();
        let counted: f32 = mask.iter().sum();
        if counted == 0.0 {
            return Ok(None); // Off in this step: the log then says so.
        }
        let mask = Tensor::from_vec(mask, (rows, 1), input.pred.device())?;
        let difference = (input.pred - target.detach())?.abs()?.broadcast_mul(&mask)?;
        Ok(Some((difference.sum_all()? / f64::from(counted * width as f32))?))
    }
}

fn main() -> anyhow::Result<()> {
    let store = ParamStore::trainable(0);
    let network = ModelConfig::tiny().build(store.builder())?;
    let grid: Vec<[i32; 3]> = (0..200).map(|i| [i % 20, i / 20, i % 3]).collect();
    let feat: Vec<f32> = (0..200 * 11).map(|i| (i as f32 * 0.37).sin()).collect();
    let points = PointCloud::single(grid, Tensor::from_vec(feat, (200, 11), &Device::Cpu)?)?;
    let mut rng = scenesplat::datasets::sample_rng(0, 0, 0);
    let pred = network.forward(&points, &mut Forward::train(&mut rng))?;
    let target = Tensor::ones(pred.shape(), pred.dtype(), pred.device())?.affine(0.125, 0.0)?;

    let objective = Objective::new().with(1.0, CosineLoss::default()).with(0.5, L1);
    let input = LossInput {
        pred: &pred,
        target: Some(&target),
        label: None,
        valid: None,
        progress: 0.0,
        seed: 0,
    };
    let output = objective.forward(&input)?;
    for term in &output.terms {
        println!("{} · {} = {}", term.weight, term.name, term.value.to_scalar::<f32>()?);
    }
    let gradients = output.total.backward()?;
    let reached = store.parameters().values().filter(|v| gradients.get(v).is_some()).count();
    println!("total {}, gradients of {reached} parameters", output.total.to_scalar::<f32>()?);
    Ok(())
}
