//! Features of fewer numbers: their coordinates along the directions that they have most of.

use super::slots::SlotStore;
use super::{EncodeError, SceneFeatures};
use crate::principal::sample_step;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn};
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;

/// Rows brought down at a time.
const BLOCK: usize = 4096;

/// Directions that features were brought down to: `codes` orthonormal axes of `width` numbers.
///
/// They are the leading eigenvectors of the rows' second moments, about 0 and not about their mean,
/// so that products of a code and of a text along the same axes are those of feature and text but for
/// what is left out. They come from the scene's own features and know no text, so that codes that were
/// written can be compared with any text later.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureCodes {
    /// One axis after the other, largest share first. `[codes, width]`
    pub axes: Vec<f32>,
    /// Numbers of a feature.
    pub width: usize,
    /// Part of the features' squared length that the codes keep, 0..=1.
    pub kept: f64,
}

impl FeatureCodes {
    /// Numbers of a code.
    pub fn codes(&self) -> usize {
        self.axes.len() / self.width.max(1)
    }

    /// Coordinates of rows along the axes, not brought to unit length. `[n, width] → [n, codes]`
    ///
    /// # Panics
    /// If the values are no rows of this width (a bug of the caller).
    pub fn project(&self, rows: &[f32]) -> Vec<f32> {
        let packed =
            PackedMatrix::from_strided(&self.axes, self.width, self.codes(), 1, self.width);
        self.project_with(rows, &packed)
    }

    fn project_with(&self, rows: &[f32], packed: &PackedMatrix) -> Vec<f32> {
        let mut out = vec![0.0; rows.len() / self.width * self.codes()];
        gemm(rows, packed, Epilogue::default(), &mut out);
        out
    }

    /// Finds the axes of a scene's rows.
    fn find(features: &SceneFeatures, codes: usize) -> Result<Self, EncodeError> {
        let (slots, width) = (features.num_slots(), features.width());
        let step = sample_step(slots);
        let mut sample = Vec::with_capacity(slots.div_ceil(step) * width);
        for row in (0..slots).step_by(step) {
            sample.extend(features.slot_rows(row..row + 1)?);
        }
        let mut moments = vec![0f32; width * width];
        gemm_tn(&sample, width, &sample, width, None, &mut moments);
        drop(sample);
        let moments: Vec<f64> = moments.into_iter().map(f64::from).collect();
        let eigen = symmetric_eigen(&moments, width, codes);
        let sum = |values: &[f64]| values.iter().map(|v| v.max(0.0)).sum::<f64>();
        let all = sum(&eigen.values);
        let kept = if all > 0.0 { (sum(&eigen.values[..codes]) / all).min(1.0) } else { 1.0 };
        let axes = eigen.vectors.iter().map(|v| *v as f32).collect();
        Ok(Self { axes, width, kept })
    }
}

impl SceneFeatures {
    /// These features as codes of so many numbers. A code is as long as the part of its feature that the
    /// axes hold, so that its product with a text is the feature's as far as the axes reach: brought to
    /// unit length, the rows that they hold least of would come first for every rare text.
    ///
    /// # Errors
    /// If the features have fewer numbers, or cannot be read.
    pub fn into_codes(self, codes: usize) -> Result<Self, EncodeError> {
        let found = FeatureCodes::find(&self, codes)?;
        let slots = self.num_slots();
        let packed = PackedMatrix::from_strided(&found.axes, found.width, codes, 1, found.width);
        let mut values = Vec::with_capacity(slots * codes);
        for start in (0..slots).step_by(BLOCK) {
            let rows = self.slot_rows(start..(start + BLOCK).min(slots))?;
            values.extend(found.project_with(&rows, &packed));
        }
        Ok(Self { slots: SlotStore::rows(values, codes), codes: Some(found), ..self })
    }

    /// The directions that the rows are coordinates along; `None` if they are the network's own.
    pub fn codes(&self) -> Option<&FeatureCodes> {
        self.codes.as_ref()
    }

    /// Numbers of a text that the features can be compared with.
    pub fn text_width(&self) -> usize {
        self.codes.as_ref().map_or(self.width(), |codes| codes.width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_models::ops::normalize_rows;

    /// Rows in three of eight dimensions, of unit length.
    fn rows(count: usize) -> Vec<f32> {
        let mut values = Vec::new();
        for i in 0..count {
            let t = [2.0, (i as f32 * 0.7).sin(), 0.3 * (i as f32 * 1.3).cos()];
            values.extend((0..8).map(|d| -> f32 {
                (0..3).map(|j| t[j] * ((d * (j + 1)) as f32 + 0.5).sin()).sum()
            }));
        }
        normalize_rows(&mut values, 8);
        values
    }

    #[test]
    fn enough_codes_keep_all_products() {
        let rows = rows(300);
        let features = SceneFeatures::from_rows(rows.clone(), 8).unwrap();
        assert_eq!((features.codes(), features.text_width()), (None, 8));
        let coded = features.into_codes(3).unwrap();
        let codes = coded.codes().unwrap();
        assert!((codes.kept - 1.0).abs() < 1e-6, "{}", codes.kept);
        assert_eq!((codes.codes(), coded.width(), coded.text_width()), (3, 3, 8));
        let text: Vec<f32> = (0..8).map(|d| (d as f32 * 0.4).cos()).collect();
        let short = codes.project(&text);
        for (row, code) in
            rows.chunks_exact(8).zip(coded.slot_rows(0..300).unwrap().chunks_exact(3))
        {
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
            assert!((dot(row, &text) - dot(code, &short)).abs() < 1e-5);
            assert!((dot(code, code) - 1.0).abs() < 1e-5, "all of a unit row is kept");
            // And back.
            let back: Vec<f32> =
                (0..8).map(|d| (0..3).map(|j| code[j] * codes.axes[j * 8 + d]).sum()).collect();
            assert!(row.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn fewer_codes_say_what_they_lose() {
        let rows = rows(300);
        let lost = |codes: usize| {
            let coded =
                SceneFeatures::from_rows(rows.clone(), 8).unwrap().into_codes(codes).unwrap();
            let found = coded.codes().unwrap();
            let short = found.project(&rows);
            let length = |v: &[f32]| v.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
            let kept = length(&short) / length(&rows);
            assert!((kept - found.kept).abs() < 1e-5, "{kept} {}", found.kept);
            1.0 - kept
        };
        assert!(lost(1) > lost(2) && lost(2) > 1e-4 && lost(3) < 1e-5);
    }

    #[test]
    fn a_row_that_the_axes_hardly_hold_is_not_what_a_text_finds_first() {
        // Most rows lie along the first two directions; one lies off them, with a trace of the second.
        let mut rows: Vec<f32> = (0..60)
            .flat_map(|i| if i % 3 == 0 { [0.3, 0.95, 0.0] } else { [0.95, 0.3, 0.0] })
            .collect();
        rows.extend([0.0, 0.05, 1.0]);
        normalize_rows(&mut rows, 3);
        let coded = SceneFeatures::from_rows(rows.clone(), 3).unwrap().into_codes(2).unwrap();
        let text = coded.codes().unwrap().project(&[0.0, 1.0, 0.0]);
        let codes = coded.slot_rows(0..61).unwrap();
        for (row, code) in rows.chunks_exact(3).zip(codes.chunks_exact(2)) {
            let score = code.iter().zip(&text).map(|(a, b)| a * b).sum::<f32>();
            assert!((score - row[1]).abs() < 0.01, "{score} instead of {}", row[1]);
        }
    }

    #[test]
    fn rows_without_direction_stay_so() {
        let zeros = SceneFeatures::from_rows(vec![0.0; 16], 8).unwrap().into_codes(2).unwrap();
        assert_eq!(zeros.slot_rows(0..2).unwrap(), [0.0; 4]);
        assert_eq!(zeros.codes().unwrap().kept, 1.0);
    }
}
