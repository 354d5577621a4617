//! A batch as the networks take it.

use candle_core::{Device, Result, Tensor};
use scenesplat_datasets::TrainBatch;
use scenesplat_losses::{IGNORE, LossInput, Objective};
use scenesplat_models::PointCloud;

use crate::module::StepOutput;

/// Voxels and features of a batch.
///
/// # Errors
/// If arrays are out of step.
pub fn point_cloud(batch: &TrainBatch) -> Result<PointCloud> {
    let shape = (batch.len(), batch.channels);
    let feat = Tensor::from_slice(&batch.feat, shape, &Device::Cpu)?;
    PointCloud::new(batch.grid_coord.as_slice(), feat, batch.offsets.as_slice())
}

/// What in a batch is not finite, one entry a scene and array: `room-3: feat 2 of row 17 is NaN`.
/// Rows are those of the scene's sample.
pub fn bad_values(batch: &TrainBatch) -> Vec<String> {
    let mut found = Vec::new();
    for (id, rows) in batch.ids.iter().zip(batch.offsets.windows(2)) {
        let mut look = |name: &str, width: usize, value: &dyn Fn(usize) -> f32| {
            let bad = (rows[0] * width..rows[1] * width).find(|&i| !value(i).is_finite());
            if let Some(i) = bad {
                let (row, column) = (i / width - rows[0], i % width);
                found.push(format!("{id}: {name} {column} of row {row} is {}", value(i)));
            }
        };
        look("feat", batch.channels, &|i| batch.feat[i]);
        if let Some(target) = &batch.lang_feat {
            look("lang_feat", target.dim, &|i| target.values[i].to_f32());
        }
    }
    found
}

/// Loss and terms of predictions. Rows count if they have a target, or a label where no target is
/// asked for or none is there; none does in a step without any term.
pub(super) fn evaluate(
    objective: &Objective,
    input: &LossInput<'_>,
    features: Option<&Tensor>,
) -> Result<StepOutput> {
    let out = objective.forward(input)?;
    let terms = out
        .terms
        .iter()
        .map(|term| Ok((term.name.clone(), f64::from(term.value.to_scalar::<f32>()?))))
        .collect::<Result<_>>()?;
    let rows = input.pred.dim(0)?;
    let targets = match (input.target, input.valid) {
        (None, _) => 0,
        (Some(_), None) => rows,
        (Some(_), Some(valid)) => valid.iter().filter(|v| **v).count(),
    };
    let labels = || input.label.map_or(0, |l| l.iter().filter(|l| **l != IGNORE).count());
    let counted_rows = match (out.terms.is_empty(), targets) {
        (true, _) => 0,
        (false, 0) => labels(),
        (false, targets) => targets,
    };
    let features = features.map(Tensor::detach);
    Ok(StepOutput { loss: out.total, rows, counted_rows, terms, features })
}
