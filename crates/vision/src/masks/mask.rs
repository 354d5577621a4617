//! A region of a picture.

/// Pixels of a picture, one bit each, kept for the rows and words between its bounds alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    /// Left, top, right, bottom; the last two belong to it.
    bounds: Option<[u32; 4]>,
    area: u64,
    first_word: usize,
    words_per_row: usize,
    words: Vec<u64>,
}

impl Mask {
    /// The pixels for which `inside` says so, by column and row.
    pub fn from_fn(width: u32, height: u32, inside: impl Fn(u32, u32) -> bool) -> Self {
        let rows = (0..height).map(|y| {
            let mut row = vec![0u64; (width as usize).div_ceil(64)];
            for x in (0..width).filter(|x| inside(*x, y)) {
                row[x as usize / 64] |= 1 << (x % 64);
            }
            row
        });
        Self::from_rows(width, height, 0, 0, width, rows)
    }

    /// A mask of rows of bits that begin at `left` and `top` and are `wide` pixels long; rows behind the last are empty.
    pub(super) fn from_rows(
        width: u32,
        height: u32,
        left: u32,
        top: u32,
        wide: u32,
        rows: impl Iterator<Item = Vec<u64>>,
    ) -> Self {
        debug_assert!(left + wide <= width, "a mask inside its picture");
        let (first, shift) = (left as usize / 64, left % 64);
        let per_row = (left as usize + wide as usize).div_ceil(64) - first;
        let mut words = Vec::new();
        let mut bounds: Option<[u32; 4]> = None;
        let mut area = 0;
        for (y, row) in (top..).zip(rows) {
            let mut here = vec![0u64; per_row];
            for (i, word) in row.into_iter().enumerate() {
                here[i] |= word << shift;
                if shift > 0 && i + 1 < per_row {
                    here[i + 1] |= word >> (64 - shift);
                }
            }
            let bit = |i: usize, zeros: u32| (first + i) as u32 * 64 + zeros;
            let least = here.iter().enumerate().find(|(_, w)| **w != 0);
            let most = here.iter().enumerate().rfind(|(_, w)| **w != 0);
            if let (Some((i, low)), Some((j, high))) = (least, most) {
                let (x0, x1) = (bit(i, low.trailing_zeros()), bit(j, 63 - high.leading_zeros()));
                let [a, b, c, _] = bounds.unwrap_or([x0, y, x1, y]);
                bounds = Some([a.min(x0), b, c.max(x1), y]);
                area += here.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
            }
            // Rows above the first pixel are not kept.
            if bounds.is_some() {
                words.extend(here);
            }
        }
        Self { width, height, bounds, area, first_word: first, words_per_row: per_row, words }
            .tight()
    }

    /// Only the words between the bounds.
    fn tight(self) -> Self {
        let Some([left, top, right, bottom]) = self.bounds else {
            return Self { words: Vec::new(), words_per_row: 0, first_word: 0, ..self };
        };
        let (first, last) = (left as usize / 64, right as usize / 64);
        let per_row = last + 1 - first;
        let mut words = Vec::with_capacity((bottom + 1 - top) as usize * per_row);
        let rows = self.words.chunks_exact(self.words_per_row);
        for row in rows.take((bottom + 1 - top) as usize) {
            words.extend(&row[first - self.first_word..=last - self.first_word]);
        }
        Self { first_word: first, words_per_row: per_row, words, ..self }
    }

    /// Width and height of its picture, pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Left, top, right and bottom of its pixels, the last two inclusive; `None` without any.
    pub fn bounds(&self) -> Option<[u32; 4]> {
        self.bounds
    }

    /// Number of pixels.
    pub fn area(&self) -> u64 {
        self.area
    }

    /// Whether a pixel belongs to it; none outside the picture does.
    pub fn contains(&self, x: u32, y: u32) -> bool {
        self.word(x as usize / 64, y).is_some_and(|word| word >> (x % 64) & 1 == 1)
    }

    fn word(&self, column: usize, y: u32) -> Option<u64> {
        let [_, top, _, bottom] = self.bounds?;
        let column = column.checked_sub(self.first_word).filter(|c| *c < self.words_per_row)?;
        (top..=bottom)
            .contains(&y)
            .then(|| self.words[(y - top) as usize * self.words_per_row + column])
    }

    /// Pixels of both.
    pub fn intersection(&self, other: &Self) -> u64 {
        let (Some(a), Some(b)) = (self.bounds, other.bounds) else { return 0 };
        let columns = a[0].max(b[0]) as usize / 64..a[2].min(b[2]) as usize / 64 + 1;
        let both = |y| {
            columns.clone().map(move |c| match (self.word(c, y), other.word(c, y)) {
                (Some(a), Some(b)) => u64::from((a & b).count_ones()),
                _ => 0,
            })
        };
        (a[1].max(b[1])..=a[3].min(b[3])).flat_map(both).sum()
    }

    /// Pixels of both over pixels of either; 0 for two empty masks.
    pub fn iou(&self, other: &Self) -> f64 {
        let both = self.intersection(other);
        let either = self.area + other.area - both;
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }

    /// Its pixels as column and row, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = [u32; 2]> {
        let top = self.bounds.map_or(0, |b| b[1]);
        let first = self.first_word as u32 * 64;
        let rows = self.words.chunks_exact(self.words_per_row.max(1));
        (top..).zip(rows).flat_map(move |(y, row)| {
            (first..).step_by(64).zip(row).flat_map(move |(x, word)| {
                let mut left = *word;
                std::iter::from_fn(move || {
                    let bit = (left != 0).then(|| left.trailing_zeros())?;
                    left &= left - 1;
                    Some([x + bit, y])
                })
            })
        })
    }

    /// Lengths of runs down the columns, one after the other, beginning with pixels outside: uncompressed RLE as COCO
    /// has it.
    pub fn to_rle(&self) -> Vec<u32> {
        let mut runs = vec![0];
        let mut inside = false;
        for x in 0..self.width {
            for y in 0..self.height {
                if self.contains(x, y) != inside {
                    inside = !inside;
                    runs.push(0);
                }
                if let Some(last) = runs.last_mut() {
                    *last += 1;
                }
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_bounds_and_runs_by_hand() {
        let m = Mask::from_fn(200, 4, |x, y| (x == 63 || x == 64 || x == 130) && y > 0 && y < 3);
        assert_eq!((m.area(), m.bounds()), (6, Some([63, 1, 130, 2])));
        assert!(m.contains(130, 2) && !m.contains(130, 3) && !m.contains(65, 1));
        assert!(!m.contains(1000, 1));
        let pixels: Vec<_> = m.pixels().collect();
        assert_eq!(pixels, [[63, 1], [64, 1], [130, 1], [63, 2], [64, 2], [130, 2]]);
        let small = Mask::from_fn(2, 3, |x, y| x == 1 && y == 1);
        assert_eq!(small.to_rle(), [4, 1, 1]);
        assert_eq!(Mask::from_fn(2, 1, |x, _| x == 0).to_rle(), [0, 1, 1]);
        let none = Mask::from_fn(9, 9, |_, _| false);
        assert_eq!((none.area(), none.bounds(), none.iou(&none)), (0, None, 0.0));
        assert_eq!(none.pixels().count(), 0);
    }

    #[test]
    fn intersections_are_those_of_the_pixels() {
        let disk = |cx: i64, cy: i64, r: i64| {
            Mask::from_fn(300, 150, move |x, y| {
                (i64::from(x) - cx).pow(2) + (i64::from(y) - cy).pow(2) < r * r
            })
        };
        let all = [disk(70, 60, 40), disk(100, 80, 50), disk(290, 10, 30), disk(64, 64, 1)];
        for a in &all {
            for b in &all {
                let both = a.pixels().filter(|[x, y]| b.contains(*x, *y)).count();
                assert_eq!(a.intersection(b), both as u64);
            }
            assert_eq!(a.iou(a), 1.0);
        }
    }

    #[test]
    fn rows_may_begin_anywhere() {
        for left in [0, 1, 63, 64, 70, 100] {
            let rows = (0..3).map(|y| if y == 1 { vec![0, 0] } else { vec![u64::MAX, 0b11] });
            let m = Mask::from_rows(200, 9, left, 4, 66, rows);
            assert_eq!(m.bounds(), Some([left, 4, left + 65, 6]));
            assert_eq!(m.area(), 132);
            assert!(m.contains(left, 4) && m.contains(left + 65, 6) && !m.contains(left, 5));
        }
    }

    #[test]
    fn overlaps_sizes_and_runs_of_two_bars() {
        // Columns 60 to 69 of rows 1 and 2, and columns 66 to 140 of rows 2 to 4.
        let a = Mask::from_fn(150, 6, |x, y| (60..70).contains(&x) && (1..3).contains(&y));
        let b = Mask::from_fn(150, 6, |x, y| (66..=140).contains(&x) && (2..5).contains(&y));
        assert_eq!((a.size(), a.area(), b.area()), ([150, 6], 20, 225));
        // They share columns 66 to 69 of row 2: 4 of 20 + 225 − 4.
        assert_eq!((a.intersection(&b), b.intersection(&a)), (4, 4));
        assert!((a.iou(&b) - 4.0 / 241.0).abs() < 1e-12);
        assert!(!a.contains(59, 1) && a.contains(60, 1) && a.contains(69, 2) && !a.contains(70, 2));
        assert!(
            !a.contains(60, 0) && !b.contains(65, 3) && b.contains(66, 3) && b.contains(140, 4)
        );
        // 60 columns of 6 and one pixel before the first run of two; then 4 outside between each two.
        let runs = a.to_rle();
        assert_eq!((runs[..4].to_vec(), runs.len()), (vec![361, 2, 4, 2], 21));
        assert_eq!((runs[20], runs.iter().sum::<u32>()), (3 + 80 * 6, 900));
        let far = Mask::from_fn(150, 6, |x, y| x == 149 && y == 5);
        assert_eq!((a.intersection(&far), a.iou(&far)), (0, 0.0));
        assert_eq!((far.to_rle(), far.bounds()), (vec![899, 1], Some([149, 5, 149, 5])));
    }
}
