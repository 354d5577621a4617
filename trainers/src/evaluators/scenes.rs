//! One scene after the other through a network, in evaluation mode.

use crate::TrainError;
use crate::tasks::point_cloud;
use candle_core::Tensor;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{Dataset, InputFeatures, TrainBatch, collate_samples};
use scenesplat_metrics::ConfusionMatrix;
use scenesplat_models::{Backbone, Forward};

/// Calls `f` with each labelled scene of `data` and the network's output for it. A scene without any
/// row is passed over.
///
/// # Errors
/// If a scene cannot be read or has no labels, or the network or `f` fails.
pub(super) fn for_each(
    data: &dyn Dataset,
    features: &InputFeatures,
    model: &dyn Backbone,
    mut f: impl FnMut(&TrainBatch, &[i32], &Tensor) -> Result<(), TrainError>,
) -> Result<(), TrainError> {
    for index in 0..data.len() {
        // Always epoch 0: an evaluation sees the same rows each time.
        let batch = collate_samples(vec![data.get(0, index)?], features)?;
        if batch.is_empty() {
            continue;
        }
        let Some(labels) = batch.segment.clone() else {
            return Err(TrainError::NoLabels { scene: batch.ids.join(", ") });
        };
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let forward = || model.forward(&point_cloud(&batch)?, &mut Forward::eval(&mut rng));
        let out = { forward }().map_err(|source| TrainError::Forward { source })?;
        f(&batch, &labels, &out)?;
    }
    Ok(())
}

/// The values of a tensor, row-major.
pub(super) fn values(out: &Tensor) -> Result<Vec<f32>, TrainError> {
    out.flatten_all().and_then(|t| t.to_vec1()).map_err(|source| TrainError::Forward { source })
}

/// Checks that an evaluation has seen a labelled row.
pub(super) fn some_label(
    name: &str,
    scenes: usize,
    confusion: &ConfusionMatrix,
) -> Result<(), TrainError> {
    if confusion.num_labelled() > 0 {
        return Ok(());
    }
    Err(TrainError::NothingMeasured { name: name.to_owned(), scenes })
}
