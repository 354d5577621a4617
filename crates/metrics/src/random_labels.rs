use crate::MetricError;
use crate::error::{check_num_classes, check_num_rows};
use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// `num_rows` labels drawn evenly from all classes: the row of a results table that any model has
/// to beat.
///
/// The same seed gives the same labels on every platform.
///
/// # Errors
/// If `num_classes` is 0 or above 4096, or there are 2³² − 1 or more rows.
///
/// ```
/// let labels = scenesplat_metrics::random_labels(4, 20, 7)?;
/// assert_eq!(labels, scenesplat_metrics::random_labels(4, 20, 7)?);
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
pub fn random_labels(
    num_rows: usize,
    num_classes: usize,
    seed: u64,
) -> Result<Vec<i32>, MetricError> {
    check_num_classes(num_classes)?;
    check_num_rows("random labels", num_rows)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // At most 4096 classes, so the cast keeps the value.
    Ok((0..num_rows).map(|_| rng.random_range(0..num_classes as i32)).collect())
}
