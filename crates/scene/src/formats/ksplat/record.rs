//! The records of a `.ksplat` file.

use super::header::{Buckets, KsplatFile, Section, f32_at, u16_at};
use crate::formats::packed_values::{alpha_logits, color_terms, log_of_scale};
use crate::formats::scene_blocks::SceneBlock;
use half::f16;

/// Tables that all records share.
pub(super) struct Decoder {
    level: u16,
    logits: [f32; 256],
    terms: [f32; 256],
    /// What a coefficient stored as a byte stands for.
    coefficients: [f32; 256],
}

impl Decoder {
    pub(super) fn new(file: &KsplatFile<'_>) -> Self {
        let [min, max] = file.sh_bounds.map(f64::from);
        let coefficients =
            std::array::from_fn(|byte| (min + byte as f64 / 255.0 * (max - min)) as f32);
        Self { level: file.level, logits: alpha_logits(), terms: color_terms(), coefficients }
    }

    /// Fills the rows of a block that lie in a section.
    pub(super) fn fill(&self, section: &Section<'_>, block: &mut SceneBlock<'_>) {
        let first = section.first_row.max(block.first_row);
        let end = (section.first_row + section.rows).min(block.first_row + block.coord.len());
        let width = block.sh_rest.len() / block.coord.len().max(1);
        let sources = rest_sources(section.sh_degree, width);
        let mut bucket = BucketWalk::new(section.buckets.as_ref(), first - section.first_row);
        for row in first..end {
            let (i, local) = (row - block.first_row, row - section.first_row);
            let record = &section.records[local * section.record_bytes..][..section.record_bytes];
            let float = |at: usize| f32_at(record, at);
            let half = |at: usize| f16::from_bits(u16_at(record, at)).to_f32();
            let color_at = if self.level == 0 {
                block.coord[i] = [0, 4, 8].map(float);
                block.log_scale[i] = [12, 16, 20].map(float).map(log_of_scale);
                block.quat[i] = [24, 28, 32, 36].map(float);
                40
            } else {
                let offset = [0, 2, 4].map(|at| u16_at(record, at));
                block.coord[i] = bucket.position(local, offset);
                block.log_scale[i] = [6, 8, 10].map(half).map(log_of_scale);
                block.quat[i] = [12, 14, 16, 18].map(half);
                20
            };
            let color = |channel: usize| usize::from(record[color_at + channel]);
            block.sh_dc[i] = [0, 1, 2].map(|c| self.terms[color(c)]);
            block.opacity_logit[i] = self.logits[color(3)];
            let rest_at = color_at + 4;
            let rest = &mut block.sh_rest[i * width..(i + 1) * width];
            // What the section has no coefficients for stays 0.
            for (value, &source) in rest.iter_mut().zip(&sources) {
                *value = match self.level {
                    0 => float(rest_at + 4 * source),
                    1 => half(rest_at + 2 * source),
                    _ => self.coefficients[usize::from(record[rest_at + source])],
                };
            }
        }
    }
}

/// Where in a record each coefficient of the scene is, as far as the record has it.
///
/// Records hold band after band, and within a band all of red, of green and of blue; scenes hold
/// coefficient after coefficient, with the channels inside.
fn rest_sources(sh_degree: u8, width: usize) -> Vec<usize> {
    let mut sources = Vec::with_capacity(width);
    for band in 1..=usize::from(sh_degree) {
        let (start, size) = (3 * (band * band - 1), 2 * band + 1);
        for m in 0..size {
            sources.extend([0, 1, 2].map(|channel| start + channel * size + m));
        }
    }
    sources.truncate(width);
    sources
}

/// Follows the buckets of a section as its rows are read in order.
struct BucketWalk<'a> {
    buckets: Option<&'a Buckets<'a>>,
    bucket: usize,
    end: usize,
    center: [f64; 3],
}

impl<'a> BucketWalk<'a> {
    fn new(buckets: Option<&'a Buckets<'a>>, first_row: usize) -> Self {
        let mut walk = Self { buckets, bucket: 0, end: 0, center: [0.0; 3] };
        walk.enter(first_row);
        walk
    }

    fn enter(&mut self, row: usize) {
        if let Some(buckets) = self.buckets {
            self.bucket = buckets.of_row(row);
            self.end = buckets.end_of(self.bucket);
            self.center = buckets.center(self.bucket);
        }
    }

    fn position(&mut self, row: usize, offset: [u16; 3]) -> [f32; 3] {
        if row >= self.end {
            self.enter(row);
        }
        let Some(buckets) = self.buckets else { return [0.0; 3] };
        std::array::from_fn(|i| {
            ((f64::from(offset[i]) - buckets.range) * buckets.step + self.center[i]) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_found_band_by_band() {
        assert_eq!(rest_sources(1, 9), [0, 3, 6, 1, 4, 7, 2, 5, 8]);
        let two = rest_sources(2, 24);
        assert_eq!(two[..9], rest_sources(1, 9));
        assert_eq!(two[9..15], [9, 14, 19, 10, 15, 20]);
        assert_eq!(rest_sources(2, 0), [0usize; 0]);
        let mut all = rest_sources(3, 45);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..45));
    }
}
