//! The palette of higher coefficients: rows of a scene that share an entry.

use super::cluster::{self, Rows};
use super::codebook::Codebook;
use super::ticker::Ticker;
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;

/// Entries of the smallest and factor of the largest palette: 1,024 × 64, all that 16 bits hold.
const UNIT: usize = 1024;
const MAX_UNITS: usize = 64;

/// Entries with their codes, and the entry of each row.
pub(super) struct Palette {
    /// Coefficients of a row, all channels.
    pub(super) width: usize,
    pub(super) codebook: Codebook,
    /// `[entries, width]`
    pub(super) codes: Vec<u8>,
    /// By row of the scene.
    pub(super) labels: Vec<u16>,
}

impl Palette {
    /// Number of entries.
    pub(super) fn len(&self) -> usize {
        self.codes.len() / self.width
    }

    /// The palette of the coefficients up to `degree`, 1 to 3.
    ///
    /// Rows that differ in no bit share an entry. If that makes more entries than a palette for so
    /// many rows has, near ones are joined ([`cluster::cluster`]). Entries are in ascending order
    /// of their codes and each is used, so that a scene read from a file gets the same palette.
    pub(super) fn build(
        scene: &GaussianScene,
        degree: u8,
        ticker: &mut Ticker<'_>,
    ) -> Result<Self, SceneError> {
        let width = super::reader::line_width(degree) / super::reader::CENTROIDS_PER_LINE * 3;
        let rows = Rows { values: &scene.sh_rest, stride: scene.sh_rest_len() * 3, width };
        let most = palette_size(scene.len());
        let (firsts, mut labels) = equal_rows(&rows);
        ticker.tick(0.05)?;
        let entries: Vec<f32> = if firsts.len() <= most {
            firsts.par_iter().flat_map_iter(|&row| rows.row(row).iter().copied()).collect()
        } else {
            let clusters = cluster::cluster(&rows, most, &mut ticker.part(0.05, 0.95))?;
            labels = clusters.labels;
            clusters.centroids
        };
        let codebook = Codebook::fit(entries.clone());
        let codes: Vec<u8> = entries.par_iter().map(|&v| codebook.code(v)).collect();
        ticker.tick(0.98)?;
        Ok(Self::of_distinct(width, codebook, &codes, &labels))
    }

    /// Joins entries that got the same codes, and sorts them.
    fn of_distinct(width: usize, codebook: Codebook, codes: &[u8], labels: &[u32]) -> Self {
        let code = |entry: u32| &codes[entry as usize * width..(entry as usize + 1) * width];
        let mut sorted: Vec<u32> = (0..(codes.len() / width) as u32).collect();
        sorted.par_sort_unstable_by(|&a, &b| code(a).cmp(code(b)).then(a.cmp(&b)));
        let mut place = vec![0u16; sorted.len()];
        let mut distinct: Vec<u8> = Vec::with_capacity(codes.len());
        let mut last: Option<u32> = None;
        for &entry in &sorted {
            if last.is_none_or(|last| code(last) != code(entry)) {
                distinct.extend_from_slice(code(entry));
            }
            last = Some(entry);
            // At most 65,536 entries.
            place[entry as usize] = (distinct.len() / width - 1) as u16;
        }
        let labels = labels.par_iter().map(|&entry| place[entry as usize]).collect();
        Self { width, codebook, codes: distinct, labels }
    }
}

/// As `splat-transform` chooses: the largest power of two of thousands that the rows exceed.
fn palette_size(rows: usize) -> usize {
    let units = (rows / UNIT).max(1);
    (1 << units.ilog2()).min(MAX_UNITS) * UNIT
}

/// The first of each set of equal rows, and for each row the number of its set.
fn equal_rows(rows: &Rows<'_>) -> (Vec<u32>, Vec<u32>) {
    // Numbers of rows fit: they are checked before a scene gets here.
    let mut keyed: Vec<(u64, u32)> =
        (0..rows.len() as u32).into_par_iter().map(|row| (hash(rows.row(row)), row)).collect();
    let bits = |row: u32| rows.row(row).iter().map(|v| v.to_bits());
    // Rows are compared only where hashes agree, which for different rows hardly ever happens.
    keyed.par_sort_unstable_by(|a, b| {
        a.0.cmp(&b.0).then_with(|| bits(a.1).cmp(bits(b.1))).then(a.1.cmp(&b.1))
    });
    let mut firsts = Vec::new();
    let mut labels = vec![0; rows.len()];
    let mut last: Option<(u64, u32)> = None;
    for &(key, row) in &keyed {
        if last.is_none_or(|(k, r)| k != key || !bits(r).eq(bits(row))) {
            firsts.push(row);
        }
        last = Some((key, row));
        labels[row as usize] = (firsts.len() - 1) as u32;
    }
    (firsts, labels)
}

/// Multiplies and mixes the bits of each value in turn.
fn hash(row: &[f32]) -> u64 {
    row.iter().fold(0x9e37_79b9_7f4a_7c15, |hash: u64, v| {
        let mixed = (hash ^ u64::from(v.to_bits())).wrapping_mul(0xff51_afd7_ed55_8ccd);
        mixed ^ mixed >> 32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_those_of_the_reference() {
        for (rows, size) in [
            (1, 1024),
            (1023, 1024),
            (2047, 1024),
            (2048, 2048),
            (8406, 8192),
            (31_000, 16_384),
            (65_535, 32_768),
            (500_000, 65_536),
            (12_000_000, 65_536),
        ] {
            assert_eq!(palette_size(rows), size, "{rows}");
        }
    }

    #[test]
    fn equal_rows_share_a_number() {
        let values = [1.0f32, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0, 1.0, 2.5];
        let rows = Rows { values: &values, stride: 2, width: 2 };
        let (firsts, labels) = equal_rows(&rows);
        assert_eq!(firsts.len(), 3);
        for (row, &label) in labels.iter().enumerate() {
            assert_eq!(rows.row(firsts[label as usize]), rows.row(row as u32));
        }
    }
}
