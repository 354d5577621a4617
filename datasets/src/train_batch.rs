//! Several samples as one.

use crate::error::check_length;
use crate::views::{View, collate_views};
use crate::{DataError, InputFeatures, Sample};
use half::f16;
use scenesplat_scene::LanguageFeatures;

/// Samples joined row by row, with what the network reads and what it shall learn; host memory.
///
/// Rows of sample `b` are `offsets[b]..offsets[b + 1]`; `M` rows together.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TrainBatch {
    /// Names of the scenes; two names joined by ` + ` for a mixed one. `[B]`
    pub ids: Vec<String>,
    /// Centers, meters, each sample in its own frame. `[M, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Cells, each sample with its own origin. `[M, 3]`
    pub grid_coord: Vec<[i32; 3]>,
    /// What the network reads, row-major, see [`InputFeatures`]. `[M, channels]`
    pub feat: Vec<f32>,
    /// Width of a row of `feat`.
    pub channels: usize,
    /// Where the rows of each sample begin, and the last end. `[B + 1]`
    pub offsets: Vec<usize>,
    /// Class index, -1 = ignored. `[M]`
    pub segment: Option<Vec<i32>>,
    /// Instance id within its sample, -1 = none. `[M]`
    pub instance: Option<Vec<i32>>,
    /// Language features. `[M, D]`
    pub lang_feat: Option<LanguageFeatures>,
    /// Whether the row of `lang_feat` holds a feature. `[M]`
    pub valid_feat: Option<Vec<bool>>,
    /// Views of the scenes, if the samples have them: each a batch of its own. The batch itself has no
    /// rows then.
    pub views: Vec<View>,
}

impl TrainBatch {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.coord.len()
    }

    /// Whether there is no row: every scene of the batch was left out. There is nothing to learn
    /// from it; a trainer passes over it but counts it.
    pub fn is_empty(&self) -> bool {
        self.coord.is_empty() && self.views.iter().all(|view| view.batch.is_empty())
    }

    /// Number of samples.
    pub fn num_samples(&self) -> usize {
        self.ids.len()
    }
}

/// Joins samples in the given order. Empty samples keep their (empty) place; of samples with views, the
/// views are joined, see [`views`](crate::views).
///
/// `segment`, `instance` and `lang_feat` are there if any sample has them: what a sample lacks is
/// filled with -1, -1 and with zeros that are not valid. `valid_feat` is there with `lang_feat`, or
/// if any sample has it; where a sample has features but no mask, rows other than 0 are valid.
///
/// # Errors
/// If a sample has no cells, arrays out of step, or values that must not reach the network, or if
/// samples have language features of different widths; the scene is named.
pub fn collate_samples(
    mut samples: Vec<Sample>,
    features: &InputFeatures,
) -> Result<TrainBatch, DataError> {
    let total = samples.iter().map(Sample::len).sum();
    let mut batch = TrainBatch { channels: features.width(), offsets: vec![0], ..<_>::default() };
    batch.views = collate_views(&mut samples, features)?;
    batch.feat.reserve_exact(total * batch.channels);
    batch.coord.reserve_exact(total);
    batch.grid_coord.reserve_exact(total);
    batch.lang_feat =
        feature_width(&samples)?.map(|dim| LanguageFeatures { values: Vec::new(), dim });
    let room = |there: bool| there.then(|| Vec::with_capacity(total));
    batch.segment = room(samples.iter().any(|s| s.segment.is_some()));
    batch.instance = room(samples.iter().any(|s| s.instance.is_some()));
    let masked = samples.iter().any(|s| s.valid_feat.is_some()) || batch.lang_feat.is_some();
    batch.valid_feat = masked.then(|| Vec::with_capacity(total));
    for sample in samples {
        let id = sample.id.clone();
        append(&mut batch, sample, features, total).map_err(|error| error.in_scene(&id))?;
        batch.ids.push(id);
    }
    Ok(batch)
}

/// The width that all language features have.
pub(crate) fn feature_width(samples: &[Sample]) -> Result<Option<usize>, DataError> {
    let mut width = None;
    for sample in samples {
        let Some(dim) = sample.lang_feat.as_ref().map(|f| f.dim) else { continue };
        let expected = *width.get_or_insert(dim);
        check_length("width of lang_feat", expected, dim)
            .map_err(|error| error.in_scene(&sample.id))?;
    }
    Ok(width)
}

fn append(
    batch: &mut TrainBatch,
    mut sample: Sample,
    features: &InputFeatures,
    total: usize,
) -> Result<(), DataError> {
    let n = sample.len();
    let feat = features.sample_rows(&sample)?;
    if sample.grid_coord.len() != n {
        return Err(DataError::no_cells("batch"));
    }
    fill_optional_arrays(
        &mut sample,
        batch.segment.is_some(),
        batch.instance.is_some(),
        batch.lang_feat.as_ref().map(|f| f.dim),
        batch.valid_feat.is_some(),
    );
    batch.feat.extend(feat);
    batch.coord.append(&mut sample.coord);
    batch.grid_coord.append(&mut sample.grid_coord);
    join(&mut batch.segment, sample.segment);
    join(&mut batch.instance, sample.instance);
    join(&mut batch.valid_feat, sample.valid_feat);
    if let (Some(all), Some(mut rows)) = (&mut batch.lang_feat, sample.lang_feat) {
        if all.values.is_empty() {
            // Hundreds of megabytes need not be copied.
            let more = (total * all.dim).saturating_sub(rows.values.len());
            rows.values.reserve_exact(more);
            all.values = rows.values;
        } else {
            all.values.append(&mut rows.values);
        }
    }
    batch.offsets.push(batch.coord.len());
    Ok(())
}

/// Adds what a part has to all, if that is there.
pub(crate) fn join<T>(all: &mut Option<Vec<T>>, part: Option<Vec<T>>) {
    if let (Some(all), Some(mut part)) = (all, part) {
        all.append(&mut part);
    }
}

/// Gives a sample the arrays that the samples it is joined with have: -1 as label and instance,
/// zeros as features, and a mask that says where features are.
pub(crate) fn fill_optional_arrays(
    sample: &mut Sample,
    segment: bool,
    instance: bool,
    lang_feat: Option<usize>,
    valid_feat: bool,
) {
    let n = sample.len();
    if segment {
        sample.segment.get_or_insert_with(|| vec![-1; n]);
    }
    if instance {
        sample.instance.get_or_insert_with(|| vec![-1; n]);
    }
    let known = sample.lang_feat.is_some();
    if let Some(dim) = lang_feat {
        let none = || LanguageFeatures { values: vec![f16::ZERO; n * dim], dim };
        sample.lang_feat.get_or_insert_with(none);
        if !known {
            // Zeros are no features, whatever the mask of the scene says.
            sample.valid_feat = Some(vec![false; n]);
        }
    }
    if valid_feat && sample.valid_feat.is_none() {
        sample.valid_feat = Some(match &sample.lang_feat {
            Some(rows) => valid_rows(rows),
            None => vec![false; n],
        });
    }
}

/// Which rows hold anything but zeros.
fn valid_rows(rows: &LanguageFeatures) -> Vec<bool> {
    // Rows of no width are no features, and have no number; the caller checked the length.
    let chunks = rows.values.chunks_exact(rows.dim.max(1));
    chunks.map(|row| row.iter().any(|&v| v != f16::ZERO)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn sample(seed: u64, rows: u32) -> Sample {
        let room = generate(&SyntheticRoomSettings::with_count(300, seed)).unwrap();
        let mut sample = Sample::from_scene(format!("room-{seed}"), room.scene);
        sample.select_rows(&(0..rows).collect::<Vec<_>>());
        sample.grid_coord = (0..rows as i32).map(|i| [i, seed as i32, 0]).collect();
        sample.labelled_points = None;
        sample
    }

    fn features(rows: usize, dim: usize) -> Option<LanguageFeatures> {
        let values = (0..rows * dim).map(|i| f16::from_f32(i as f32)).collect();
        Some(LanguageFeatures { values, dim })
    }

    #[test]
    fn rows_and_offsets() {
        let samples = vec![sample(1, 5), sample(2, 0), sample(3, 7)];
        let expected: Vec<f32> =
            samples.iter().flat_map(|s| InputFeatures::default().sample_rows(s).unwrap()).collect();
        let batch = collate_samples(samples, &InputFeatures::default()).unwrap();
        assert_eq!(batch.offsets, [0, 5, 5, 12]);
        assert_eq!(batch.ids, ["room-1", "room-2", "room-3"]);
        assert_eq!((batch.len(), batch.num_samples(), batch.channels), (12, 3, 11));
        assert_eq!(batch.feat, expected);
        assert_eq!(batch.grid_coord[5], [0, 3, 0]);
        assert_eq!(batch.segment.unwrap().len(), 12);
        assert!(batch.lang_feat.is_none() && batch.valid_feat.is_none());
    }

    #[test]
    fn what_a_sample_lacks_is_filled() {
        let (mut a, mut b, mut c) = (sample(1, 2), sample(2, 3), sample(3, 2));
        a.segment = None;
        b.instance = None;
        b.lang_feat = features(3, 2);
        c.valid_feat = Some(vec![true; 2]);
        let batch = collate_samples(vec![a, b, c], &InputFeatures::default()).unwrap();
        assert_eq!(batch.segment.unwrap()[..2], [-1, -1]);
        assert_eq!(batch.instance.unwrap()[2..5], [-1; 3]);
        let feat = batch.lang_feat.unwrap();
        assert_eq!((feat.values.len(), feat.dim), (14, 2));
        assert!(feat.values[..4].iter().all(|&v| v == f16::ZERO));
        // The mask of `c` is of features that are not there.
        assert_eq!(batch.valid_feat.unwrap(), [false, false, true, true, true, false, false]);
    }

    #[test]
    fn rows_of_zeros_are_not_valid() {
        let mut a = sample(1, 3);
        a.lang_feat = features(3, 2);
        a.lang_feat.as_mut().unwrap().values[2..4].fill(f16::ZERO);
        let batch = collate_samples(vec![a], &InputFeatures::default()).unwrap();
        assert_eq!(batch.valid_feat.unwrap(), [true, false, true]);
    }

    #[test]
    fn nothing_makes_an_empty_batch() {
        let batch = collate_samples(vec![], &InputFeatures::default()).unwrap();
        assert_eq!(batch.offsets, [0]);
        assert!(batch.is_empty() && batch.segment.is_none());
    }

    #[test]
    fn errors_name_the_scene() {
        let named = |samples| {
            let error = collate_samples(samples, &InputFeatures::default()).unwrap_err();
            assert!(matches!(&error, DataError::Sample { id, .. } if id == "room-2"), "{error}");
        };
        let mut bad = sample(2, 3);
        bad.grid_coord.clear();
        named(vec![sample(1, 2), bad]);
        let mut bad = sample(2, 3);
        bad.opacity[1] = f32::NAN;
        named(vec![sample(1, 2), bad]);
        let (mut a, mut b) = (sample(1, 2), sample(2, 2));
        (a.lang_feat, b.lang_feat) = (features(2, 4), features(2, 3));
        named(vec![a, b]);
    }
}
