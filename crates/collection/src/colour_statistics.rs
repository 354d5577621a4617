//! Pictures by their colors: for tests, and for whoever has no weights.

use crate::lab::lab_of;
use crate::{CollectError, PictureEncoder};
use rayon::prelude::*;
use scenesplat_scene::picture::RgbPicture;

/// Cells along lightness, and along each of the two other axes.
const CELLS: [usize; 3] = [6, 9, 9];
/// Lowest value and width of a cell along each axis of L*a*b*.
const LOW: [f32; 3] = [8.0, -72.0, -72.0];
const STEP: [f32; 3] = [16.0, 18.0, 18.0];
/// Share of the first column, which all pictures have in common, in the squared length of a row.
const COMMON: f32 = 0.75;

/// A soft histogram over L*a*b* (6 × 9 × 9 cells, square roots, so that a cosine says how much two histograms
/// overlap), after one column that all pictures share.
///
/// Pixels that are exactly black are padding or another segment, and do not count unless there is nothing else. The
/// common column makes two pictures with nothing in common have the cosine 0.75, as networks' features have large
/// cosines, too: the dynamic weights of crops are made for such.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ColourStatistics;

impl ColourStatistics {
    /// Values of a row.
    pub const WIDTH: usize = 1 + CELLS[0] * CELLS[1] * CELLS[2];

    /// The row of a surface of one color: what a name that means a color is compared with.
    pub fn of_colour(color: [u8; 3]) -> Vec<f32> {
        row(&RgbPicture::filled(1, 1, color))
    }
}

impl PictureEncoder for ColourStatistics {
    fn name(&self) -> String {
        "colour".to_owned()
    }

    fn width(&self) -> usize {
        Self::WIDTH
    }

    fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
        if let Some(at) = pictures.iter().position(|p| p.pixels().is_empty()) {
            return Err(CollectError::argument("picture", format!("number {at} has no pixels")));
        }
        let rows: Vec<Vec<f32>> = pictures.par_iter().map(row).collect();
        Ok(rows.concat())
    }
}

/// Unit row of a picture with pixels.
fn row(picture: &RgbPicture) -> Vec<f32> {
    let keys = picture.pixels().iter().filter(|p| **p != [0; 3]).map(|p| key(*p)).collect();
    let keys = sorted(keys);
    // Where all is black, black is what there is to see.
    let keys = if keys.is_empty() { vec![0] } else { keys };
    // Equal colors are counted once: crops of renders and posters have few.
    let mut cells = vec![0.0f64; ColourStatistics::WIDTH - 1];
    for run in keys.chunk_by(|a, b| a == b) {
        let [_, r, g, b] = run[0].to_be_bytes();
        add(&mut cells, lab_of([r, g, b]), run.len() as f64);
    }
    let count = keys.len() as f64;
    let mut out = Vec::with_capacity(ColourStatistics::WIDTH);
    out.push(COMMON.sqrt());
    let scale = f64::from(1.0 - COMMON) / count;
    out.extend(cells.iter().map(|v| (v * scale).sqrt() as f32));
    out
}

fn key([r, g, b]: [u8; 3]) -> u32 {
    u32::from_be_bytes([0, r, g, b])
}

/// Colors in ascending order, by counting: two passes over the pixels, 12 bits each.
fn sorted(mut keys: Vec<u32>) -> Vec<u32> {
    const BINS: usize = 1 << 12;
    if keys.len() < BINS {
        keys.sort_unstable();
        return keys;
    }
    let mut other = vec![0; keys.len()];
    for shift in [0, 12] {
        let bin = |key: u32| (key >> shift) as usize % BINS;
        let mut next = [0usize; BINS];
        keys.iter().for_each(|&key| next[bin(key)] += 1);
        let mut before = 0;
        for place in &mut next {
            before += std::mem::replace(place, before);
        }
        for &key in &keys {
            other[next[bin(key)]] = key;
            next[bin(key)] += 1;
        }
        std::mem::swap(&mut keys, &mut other);
    }
    keys
}

/// Shares a color among the eight cells whose middles are around it.
fn add(cells: &mut [f64], color: [f32; 3], weight: f64) {
    let place = |k: usize| {
        let at = ((color[k] - LOW[k]) / STEP[k]).clamp(0.0, (CELLS[k] - 1) as f32);
        let low = (at as usize).min(CELLS[k] - 2);
        (low, f64::from(at - low as f32))
    };
    let axes = [place(0), place(1), place(2)];
    for corner in 0..8 {
        let mut share = weight;
        let mut index = 0;
        for (k, &(low, part)) in axes.iter().enumerate() {
            let up = corner >> k & 1;
            share *= if up == 1 { part } else { 1.0 - part };
            index = index * CELLS[k] + low + up;
        }
        cells[index] += share;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    fn cosine(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    }

    #[test]
    fn rows_are_unit_and_say_which_colours_there_are() {
        let halves =
            |a: [u8; 3], b: [u8; 3]| RgbPicture::from_fn(8, 4, |x, _| if x < 4 { a } else { b });
        let (red, blue, green) = ([220, 30, 30], [30, 30, 220], [30, 200, 30]);
        let pictures = [halves(red, red), halves(red, blue), halves(green, green)];
        let rows = ColourStatistics.encode(&pictures).unwrap();
        let rows: Vec<&[f32]> = rows.chunks_exact(ColourStatistics::WIDTH).collect();
        for row in &rows {
            assert!((cosine(row, row) - 1.0).abs() < 1e-6);
        }
        assert!((cosine(rows[0], rows[2]) - 0.75).abs() < 1e-6, "nothing in common");
        // Half in common: √½ of the quarter that is no constant.
        let half = 0.75 + 0.25 * 0.5f64.sqrt();
        assert!((cosine(rows[0], rows[1]) - half).abs() < 1e-6);
        assert_eq!(rows[0], ColourStatistics::of_colour(red));
    }

    #[test]
    fn black_is_padding_unless_there_is_nothing_else() {
        let padded =
            RgbPicture::from_fn(9, 9, |x, y| if x < 3 && y > 1 { [90, 120, 40] } else { [0; 3] });
        let rows = ColourStatistics.encode(&[padded]).unwrap();
        assert_eq!(rows, ColourStatistics::of_colour([90, 120, 40]));
        let black = ColourStatistics.encode(&[RgbPicture::filled(2, 2, [0; 3])]).unwrap();
        assert!((cosine(&black, &black) - 1.0).abs() < 1e-6);
        assert!(ColourStatistics.encode(&[RgbPicture::filled(0, 4, [1; 3])]).is_err());
    }

    #[test]
    fn counting_sorts_as_comparing_does() {
        let mut rng = 5u32;
        for count in [0, 1, 4095, 4096, 30_000] {
            let keys: Vec<u32> = (0..count)
                .map(|_| {
                    rng = rng.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    rng >> 8
                })
                .collect();
            let mut want = keys.clone();
            want.sort_unstable();
            assert_eq!(sorted(keys), want, "{count}");
        }
    }

    #[test]
    fn a_row_is_the_histogram_of_all_pixels() {
        // More pixels than bins, many colors twice, some black.
        let picture = RgbPicture::from_fn(120, 90, |x, y| match (x * y) % 7 {
            0 => [0; 3],
            k => [(x / 2 * 4) as u8, (y / 3 * 8) as u8, (k * 30) as u8],
        });
        let found = ColourStatistics.encode(std::slice::from_ref(&picture)).unwrap();
        // Pixel by pixel, without an order.
        let mut cells = vec![0.0f64; ColourStatistics::WIDTH - 1];
        let mut count = 0.0;
        for pixel in picture.pixels().iter().filter(|p| **p != [0; 3]) {
            add(&mut cells, crate::lab::lab(&[*pixel])[0], 1.0);
            count += 1.0;
        }
        for (got, cell) in found[1..].iter().zip(&cells) {
            let want = (0.25 * cell / count).sqrt();
            assert!((f64::from(*got) - want).abs() < 1e-6, "{got} {want}");
        }
    }

    #[test]
    fn every_colour_falls_into_the_cells() {
        let mut rng = 1u32;
        for _ in 0..2000 {
            rng = rng.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let row = ColourStatistics::of_colour([
                (rng >> 8) as u8,
                (rng >> 16) as u8,
                (rng >> 24) as u8,
            ]);
            assert!((cosine(&row, &row) - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn a_color_is_shared_among_the_cells_of_its_own_axes() {
        // Middles of cells are at 8 + 16 i of lightness, and at −72 + 18 i of both other axes: L* = 40 is cell 2,
        // a* = −18 is cell 3, b* = 54 is cell 7. L* = 48 is half way to cell 3, a* = −13.5 a quarter of the way to 4.
        let check = |color: [f32; 3], shares: &[([usize; 3], f64)]| {
            let mut want = vec![0.0f64; 6 * 9 * 9];
            for ([l, a, b], share) in shares {
                want[(l * 9 + a) * 9 + b] = *share;
            }
            let mut cells = vec![0.0f64; 6 * 9 * 9];
            add(&mut cells, color, 2.0);
            for (cell, (got, want)) in cells.iter().zip(&want).enumerate() {
                assert!((got - want).abs() < 1e-5, "{color:?}, cell {cell}: {got} {want}");
            }
        };
        check([40.0, -18.0, 54.0], &[([2, 3, 7], 2.0)]);
        // Of the weight 2: ½ · ¾, ½ · ¼, and the same again.
        let four = [([2, 3, 7], 0.75), ([2, 4, 7], 0.25), ([3, 3, 7], 0.75), ([3, 4, 7], 0.25)];
        check([48.0, -13.5, 54.0], &four);
    }

    #[test]
    fn colors_beyond_the_cells_fall_into_the_outermost() {
        let only = |color: [f32; 3], cell: [usize; 3]| {
            let mut cells = vec![0.0f64; 6 * 9 * 9];
            add(&mut cells, color, 3.0);
            let [l, a, b] = cell;
            assert!((cells[(l * 9 + a) * 9 + b] - 3.0).abs() < 1e-9, "{color:?}");
            assert!((cells.iter().sum::<f64>() - 3.0).abs() < 1e-9);
        };
        // Lightness has middles from 8 to 88, the others from −72 to 72.
        only([2.0, -90.0, 110.0], [0, 0, 8]);
        only([100.0, 90.0, -110.0], [5, 8, 0]);
        only([88.0, 72.0, -72.0], [5, 8, 0]);
        only([8.0, 0.0, 0.0], [0, 4, 4]);
        // A row is √¾, then the root of a quarter of each share. Black is lightness 0 of the middle of both others.
        let row = ColourStatistics::of_colour([0; 3]);
        assert_eq!((row.len(), ColourStatistics::WIDTH, ColourStatistics.width()), (487, 487, 487));
        assert!((row[0] - 0.75f32.sqrt()).abs() < 1e-6 && (row[1 + 4 * 9 + 4] - 0.5).abs() < 1e-4);
        assert_eq!(ColourStatistics.name(), "colour");
        let pictures = [RgbPicture::filled(1, 1, [9; 3]), RgbPicture::filled(3, 0, [1; 3])];
        let error = ColourStatistics.encode(&pictures).unwrap_err().to_string();
        assert!(error.contains("picture: number 1 has no pixels"), "{error}");
        // Rows follow each other; red, green and blue are not exchanged.
        let colors = [[200, 40, 10], [10, 200, 40], [40, 10, 200]];
        let all = ColourStatistics.encode(&colors.map(|c| RgbPicture::filled(2, 1, c))).unwrap();
        for (row, color) in all.chunks_exact(487).zip(colors) {
            assert_eq!(row, ColourStatistics::of_colour(color));
        }
    }
}
