//! Vision-language pretraining: the network's features shall be those of its targets.

use super::learner::{Learner, RowTargets};
use super::task_module::TrainingTask;
use crate::module::{StepContext, StepOutput};
use candle_core::{Device, Result, Tensor, bail};
use scenesplat_datasets::TrainBatch;
use scenesplat_metrics::TextRows;
use scenesplat_scene::TextTable;

/// Where the target of a row comes from.
#[derive(Debug, Clone)]
pub enum TargetSource {
    /// The scene's own language features (`lang_feat`), where its mask says so.
    Features,
    /// The row of a table for the row's class; unlabeled rows have none. `[C, D]`, unit rows.
    ClassText(Tensor),
}

impl TargetSource {
    /// Targets by class from a table.
    ///
    /// # Errors
    /// If a row does not have unit length, which those of [`TextTable::from_rows`] have.
    pub fn class_text(table: &TextTable) -> Result<Self> {
        let rows = TextRows::new(&table.values, table.dim).map_err(candle_core::Error::wrap)?;
        let shape = (rows.num_classes(), rows.dim());
        Tensor::from_slice(rows.rows(), shape, &Device::Cpu).map(Self::ClassText)
    }

    /// Targets of a batch, and which rows have one. `[N, D]`, `[N]`
    ///
    /// # Errors
    /// If the batch has no features or no labels, or a label is no class.
    pub fn of(&self, batch: &TrainBatch) -> Result<(Tensor, Vec<bool>)> {
        match self {
            Self::Features => {
                let Some(rows) = &batch.lang_feat else {
                    bail!(
                        "lang_feat: none of the scenes {} has language features; collect them, or \
                         take the targets from class texts",
                        batch.ids.join(", ")
                    );
                };
                let shape = (batch.len(), rows.dim);
                let values: Vec<f32> = rows.values.iter().map(|v| v.to_f32()).collect();
                let target = Tensor::from_vec(values, shape, &Device::Cpu)?;
                let valid = batch.valid_feat.clone().unwrap_or_else(|| vec![true; batch.len()]);
                Ok((target, valid))
            }
            Self::ClassText(table) => {
                let Some(labels) = &batch.segment else {
                    bail!("segment: none of the scenes {} has labels", batch.ids.join(", "));
                };
                let classes = table.dim(0)?;
                let row = |(i, &label): (usize, &i32)| match usize::try_from(label) {
                    Ok(class) if class < classes => Ok(class as u32),
                    Ok(class) => bail!("segment of row {i}: class {class} of {classes}"),
                    Err(_) => Ok(0),
                };
                let rows = labels.iter().enumerate().map(row).collect::<Result<Vec<u32>>>()?;
                let target = table.index_select(&Tensor::new(rows, &Device::Cpu)?, 0)?;
                Ok((target, labels.iter().map(|l| *l >= 0).collect()))
            }
        }
    }
}

/// Each step: features of all rows, the losses over rows that have a target. Classes (`segment`),
/// where the data have them, are handed to the losses as well, which may or may not look at them.
///
/// # Source
/// `LangPretrainer`, SceneSplat be9d5e1. Differs: the schedule of a term goes by step, not by epoch.
#[derive(Debug, Clone)]
pub struct LanguagePretraining {
    /// Where the targets come from.
    pub targets: TargetSource,
}

impl TrainingTask for LanguagePretraining {
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        let pred = learner.forward(batch, cx)?;
        let (target, valid) = self.targets.of(batch)?;
        let label = batch.segment.as_deref();
        let targets = RowTargets { target: Some(&target), valid: Some(&valid), label };
        learner.output(&pred, targets, cx)
    }
}
