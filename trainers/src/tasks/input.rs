//! A batch as the networks take it.

use candle_core::{Device, Result, Tensor};
use scenesplat_datasets::TrainBatch;
use scenesplat_models::PointCloud;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_value_is_named_by_its_row_in_its_scene() {
        let mut batch = TrainBatch {
            ids: vec!["a".to_owned(), "b".to_owned()],
            feat: vec![0.0; 5 * 3],
            channels: 3,
            offsets: vec![0, 2, 5],
            ..TrainBatch::default()
        };
        assert!(bad_values(&batch).is_empty());
        // Row 3 of the batch is row 1 of the second scene.
        batch.feat[3 * 3 + 2] = f32::NAN;
        assert_eq!(bad_values(&batch), ["b: feat 2 of row 1 is NaN"]);
    }
}
