//! Distillation: the network's features shall be those of a teacher.

use super::learner::{Learner, RowTargets};
use super::task_module::TrainingTask;
use crate::module::{StepContext, StepOutput};
use candle_core::{Device, Result, Tensor, bail};
use rayon::prelude::*;
use scenesplat_datasets::TrainBatch;

/// Each step: features of all rows, the losses over the rows that the teacher has a row for.
///
/// The teacher is none of this task's: whoever makes the samples asks it
/// ([`SceneDataset::with_teacher`](scenesplat_datasets::SceneDataset::with_teacher)) and batches hold
/// its rows as `lang_feat`. So it takes part in no gradient and in no batch statistic, and may have voxels
/// and inputs of its own. Its rows are compared at unit length, whatever length they have; a row of
/// zeros says nothing and does not count.
///
/// Classes (`segment`), where the data have them, are handed to the losses as well, which may or may not
/// look at them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Distillation;

impl TrainingTask for Distillation {
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        let (target, valid) = taught_rows(batch)?;
        let width = learner.backbone().out_channels();
        if target.dim(1)? != width {
            bail!(
                "the teacher's rows are {} wide and the student's {width}: set model.projection",
                target.dim(1)?
            );
        }
        let pred = learner.forward(batch, cx)?;
        let label = batch.segment.as_deref();
        learner.output(&pred, RowTargets { target: Some(&target), valid: Some(&valid), label }, cx)
    }
}

/// The teacher's rows at unit length, `[N, D]`, and which rows have one, `[N]`.
fn taught_rows(batch: &TrainBatch) -> Result<(Tensor, Vec<bool>)> {
    let Some(rows) = &batch.lang_feat else {
        bail!("the scenes {} come without rows of a teacher", batch.ids.join(", "));
    };
    let (n, dim) = (batch.len(), rows.dim);
    let mut values = vec![0f32; n * dim];
    let mut valid = batch.valid_feat.clone().unwrap_or_else(|| vec![true; n]);
    values
        .par_chunks_exact_mut(dim.max(1))
        .zip(rows.values.par_chunks_exact(dim.max(1)))
        .zip(&mut valid)
        .with_min_len(256)
        .for_each(|((out, row), valid)| {
            let norm = row.iter().map(|v| v.to_f64().powi(2)).sum::<f64>().sqrt();
            *valid &= norm != 0.0;
            // A row that is not finite stays so, for the loss to name it.
            let scale = if norm > 0.0 { 1.0 / norm } else { 1.0 };
            for (out, v) in out.iter_mut().zip(row) {
                *out = (v.to_f64() * scale) as f32;
            }
        });
    Ok((Tensor::from_vec(values, (n, dim), &Device::Cpu)?, valid))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_without_a_feature_do_not_count_whatever_they_hold() {
        use half::f16;
        let batch = TrainBatch {
            ids: vec!["a".to_owned()],
            coord: vec![[0.0; 3]; 3],
            offsets: vec![0, 3],
            lang_feat: Some(scenesplat_scene::LanguageFeatures {
                values: [3.0, 4.0, 3.0, 4.0, 0.0, 0.0].map(f16::from_f32).to_vec(),
                dim: 2,
            }),
            valid_feat: Some(vec![true, false, true]),
            ..TrainBatch::default()
        };
        let (target, valid) = taught_rows(&batch).unwrap();
        // The second is marked as none, the third is zero.
        assert_eq!(valid, [true, false, false]);
        assert_eq!(target.to_vec2::<f32>().unwrap()[0], [0.6, 0.8]);
    }
}
