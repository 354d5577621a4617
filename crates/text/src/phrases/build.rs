//! How a table is made of an encoder and a list.

use super::{KEPT, PhraseTable};
use crate::{PhraseError, TextEncoder};
use rayon::prelude::*;
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;

impl PhraseTable {
    /// Encodes a list of phrases and keeps the leading principal components.
    ///
    /// The phrases are sorted, and each counts once. Sums are f64 in a fixed order, so the table has the same bits for
    /// any number of threads on one instruction set. `told` gets the number of phrases encoded so far.
    ///
    /// # Errors
    /// If a phrase is not as [`normalized`](super::normalized) gives it or cannot be encoded, or the list is shorter than
    /// the vectors.
    pub fn build(
        encoder: &TextEncoder,
        mut phrases: Vec<String>,
        told: &mut dyn FnMut(usize),
    ) -> Result<Self, PhraseError> {
        let bad = |problem: String| Err(PhraseError::Table { problem });
        phrases.sort_unstable();
        phrases.dedup();
        let (count, width) = (phrases.len(), encoder.dim());
        if count <= KEPT || width < KEPT {
            return bad(format!(
                "needs more than {KEPT} phrases and an encoder of that width; there are {count} phrases \
                 of {width} numbers"
            ));
        }
        if let Some(other) = phrases.iter().find(|p| super::normalized(p) != **p) {
            let form = super::normalized(other);
            return bad(format!("cannot hold {other:?}, which would be looked for as {form:?}"));
        }
        let mut values = Vec::with_capacity(count * width);
        for part in phrases.chunks(1024) {
            values.extend(encoder.encode(part)?.values);
            told(values.len() / width);
        }
        let mean: Vec<f64> = (0..width)
            .map(|c| values.iter().skip(c).step_by(width).map(|v| f64::from(*v)).sum::<f64>())
            .map(|sum| sum / count as f64)
            .collect();
        let covariance: Vec<f64> = (0..width)
            .into_par_iter()
            .flat_map_iter(|a| {
                let mut row = vec![0.0; width];
                for phrase in values.chunks_exact(width) {
                    let own = f64::from(phrase[a]) - mean[a];
                    for b in a..width {
                        row[b] += own * (f64::from(phrase[b]) - mean[b]);
                    }
                }
                row
            })
            .collect();
        let found = symmetric_eigen(&covariance, width, KEPT);
        let single = |values: &[f64]| values.iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let (mean, basis) = (single(&mean), single(&found.vectors));
        let mut table = Self::of(phrases, Vec::new(), Vec::new(), mean, basis);
        let coordinates: Vec<Vec<f64>> =
            values.par_chunks_exact(width).map(|row| table.coordinates(row)).collect();
        for row in coordinates {
            let top = row.iter().fold(0.0, |top: f64, v| top.max(v.abs()));
            let scale = (top / 127.0) as f32;
            let step = if scale > 0.0 { f64::from(scale) } else { 1.0 };
            table.rows.extend(row.iter().map(|v| (v / step).round().clamp(-127.0, 127.0) as i8));
            table.scales.push(scale);
        }
        Ok(table)
    }
}
