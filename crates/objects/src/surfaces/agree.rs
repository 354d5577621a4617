//! Labels that agree on surfaces.

use super::small::relabel_small;
use super::{NO_SURFACE, SceneSurfaces, Surfaces};
use crate::error::{Result, check_labels, check_rows, check_setting};
use rayon::prelude::*;

/// How much speaks for each class.
#[derive(Debug, Clone, Copy)]
pub struct ClassShares<'a> {
    /// Which row each Gaussian has. `[N]`
    pub row_of: &'a [u32],
    /// How probable each class is, 0 to 1 and 1 together. `[rows, classes]`
    pub rows: &'a [f32],
    /// How many classes.
    pub num_classes: usize,
}

impl ClassShares<'_> {
    pub(crate) fn of(&self, gaussian: u32) -> &[f32] {
        let row = self.row_of[gaussian as usize] as usize;
        &self.rows[row * self.num_classes..][..self.num_classes]
    }

    pub(crate) fn check(&self, labels: &[i32]) -> Result<()> {
        check_rows("row_of", labels.len(), self.row_of.len())?;
        let rows = self.rows.len().checked_div(self.num_classes).unwrap_or_default();
        if let Some(row) = self.row_of.iter().find(|row| **row as usize >= rows) {
            check_setting(false, "row_of", row, "a row of the shares")?;
        }
        check_labels(labels, self.num_classes)
    }
}

/// How labels come to agree.
#[derive(Debug, Clone, Copy)]
pub struct AgreeSettings<'a> {
    /// What a Gaussian's own shares count for, where each of its surfaces counts for 1; from 0.
    pub own: f32,
    /// Least surface that a thing of each class has, square meters: smaller pieces take the label of a neighbor.
    /// Classes beyond its end have none; empty, pieces stay.
    pub least_area: &'a [f64],
    /// Least share that the label of a neighbor must have in such a piece, as part of that of its own label.
    pub keep: f64,
}

impl Default for AgreeSettings<'_> {
    fn default() -> Self {
        Self { own: 0.3, least_area: &[], keep: 0.25 }
    }
}

/// What was changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Agreed {
    /// Gaussians with another label.
    pub changed: usize,
    /// Those whose piece was too small for what it was taken for.
    pub small: usize,
}

/// Gaussians by what they are part of.
struct Groups {
    /// Where those of each begin in `rows`; one more than there are.
    start: Vec<usize>,
    /// Gaussians, rising in each group.
    rows: Vec<u32>,
}

impl Groups {
    /// Labeled Gaussians by what they are part of.
    fn new(of: &[u32], count: usize, labels: &[i32]) -> Self {
        let is_in = |row: usize| labels[row] >= 0 && (of[row] as usize) < count;
        let mut start = vec![0; count + 1];
        (0..of.len()).filter(|&row| is_in(row)).for_each(|row| start[of[row] as usize + 1] += 1);
        for i in 0..count {
            start[i + 1] += start[i];
        }
        let mut next = start.clone();
        let mut rows = vec![0; start[count]];
        for row in (0..of.len()).filter(|&row| is_in(row)) {
            let at = &mut next[of[row] as usize];
            rows[*at] = row as u32;
            *at += 1;
        }
        Self { start, rows }
    }

    fn of(&self, group: usize) -> &[u32] {
        &self.rows[self.start[group]..self.start[group + 1]]
    }
}

/// Mean shares of the labeled Gaussians of each surface. `[surfaces, classes]`
fn means(shares: &ClassShares<'_>, surfaces: &Surfaces, labels: &[i32]) -> Vec<f32> {
    let classes = shares.num_classes;
    let groups = Groups::new(&surfaces.of, surfaces.count, labels);
    let mut out = vec![0.0; surfaces.count * classes];
    out.par_chunks_exact_mut(classes).enumerate().for_each_init(
        || vec![0.0_f64; classes],
        |sum, (surface, out)| {
            let rows = groups.of(surface);
            sum.fill(0.0);
            for &row in rows {
                sum.iter_mut().zip(shares.of(row)).for_each(|(sum, p)| *sum += f64::from(*p));
            }
            let count = rows.len().max(1) as f64;
            out.iter_mut().zip(sum.iter()).for_each(|(out, sum)| *out = (sum / count) as f32);
        },
    );
    out
}

/// What speaks for the classes in each cell.
struct OfCells {
    /// Shares of the classes. `[cells, classes]`
    shares: Vec<f32>,
    /// The class of each cell, and of each of its Gaussians.
    labels: Vec<(i32, Vec<i32>)>,
}

impl OfCells {
    /// `total` puts what speaks for the classes in a Gaussian.
    fn new(cells: &Groups, classes: usize, total: impl Fn(u32, &mut [f32]) + Sync) -> Self {
        let mut shares = vec![0.0; (cells.start.len() - 1) * classes];
        let of_cell = |sum: &mut Vec<f32>, (cell, share): (usize, &mut [f32])| {
            let mut own = Vec::with_capacity(cells.of(cell).len());
            for &row in cells.of(cell) {
                total(row, sum);
                own.push(largest(sum));
                share.iter_mut().zip(sum.iter()).for_each(|(share, p)| *share += p);
            }
            let whole: f32 = share.iter().sum();
            if whole > 0.0 {
                share.iter_mut().for_each(|share| *share /= whole);
            }
            (largest(share), own)
        };
        let cells = shares.par_chunks_exact_mut(classes).enumerate();
        let labels = cells.map_init(|| vec![0.0_f32; classes], of_cell).collect();
        Self { shares, labels }
    }
}

/// Labels as surfaces of several scales have them: each Gaussian takes the class of which the mean shares of its
/// surfaces and its own share are the most together; of equal ones the smallest. Where surfaces of one scale hold
/// parts of two things, those of another count for more. Then pieces that are too small for their class
/// ([`AgreeSettings::least_area`]) take the label of the neighbor for which most speaks.
///
/// Gaussians without a label (negative) have no say and get none; those of no surface keep theirs. The same for any
/// number of threads.
///
/// # Errors
/// If labels, shares and surfaces are of different Gaussians, or a label is no class.
pub fn agree(
    labels: &mut [i32],
    shares: &ClassShares<'_>,
    surfaces: &SceneSurfaces,
    settings: &AgreeSettings<'_>,
) -> Result<Agreed> {
    shares.check(labels)?;
    let own = settings.own;
    check_setting(own >= 0.0 && own.is_finite(), "own", own, "a finite number from 0")?;
    for len in surfaces.scales.iter().map(|scale| scale.of.len()).chain([surfaces.cell_of.len()]) {
        check_rows("surfaces", labels.len(), len)?;
    }
    if shares.num_classes == 0 {
        return Ok(Agreed::default());
    }
    let of_scale: Vec<Vec<f32>> =
        surfaces.scales.iter().map(|scale| means(shares, scale, labels)).collect();
    let cells = Groups::new(&surfaces.cell_of, surfaces.area.len(), labels);
    let classes = shares.num_classes;
    let total = |row: u32, sum: &mut [f32]| {
        sum.iter_mut().zip(shares.of(row)).for_each(|(sum, p)| *sum = settings.own * p);
        for (scale, means) in surfaces.scales.iter().zip(&of_scale) {
            let surface = scale.of[row as usize];
            if surface != NO_SURFACE {
                let mean = &means[surface as usize * classes..][..classes];
                sum.iter_mut().zip(mean).for_each(|(sum, p)| *sum += p);
            }
        }
    };
    // Cell by cell, for the shares of cells are needed as well.
    let found = OfCells::new(&cells, classes, total);
    let mut agreed = Agreed::default();
    for (cell, (_, own)) in found.labels.iter().enumerate() {
        for (&row, &label) in cells.of(cell).iter().zip(own) {
            let label = if label < 0 { labels[row as usize] } else { label };
            agreed.changed += usize::from(label != labels[row as usize]);
            labels[row as usize] = label;
        }
    }
    if settings.least_area.iter().all(|area| *area <= 0.0) {
        return Ok(agreed);
    }
    let before: Vec<i32> = found.labels.iter().map(|(label, _)| *label).collect();
    agreed.small = change_small(labels, &before, &cells, &found.shares, surfaces, settings);
    Ok(agreed)
}

/// Gives pieces too small for their class another label; how many Gaussians took it. `before`: of cells.
fn change_small(
    labels: &mut [i32],
    before: &[i32],
    cells: &Groups,
    share_of_cell: &[f32],
    surfaces: &SceneSurfaces,
    settings: &AgreeSettings<'_>,
) -> usize {
    let mut after = before.to_vec();
    relabel_small(&mut after, share_of_cell, surfaces, settings);
    let mut changed = 0;
    for (cell, (&before, &after)) in before.iter().zip(&after).enumerate() {
        if before == after {
            continue;
        }
        for &row in cells.of(cell) {
            let label = &mut labels[row as usize];
            if *label == before {
                *label = after;
                changed += 1;
            }
        }
    }
    changed
}

/// The class with the largest share, the smallest of equal ones; −1 if none has any.
pub(super) fn largest(shares: &[f32]) -> i32 {
    let best = (0..shares.len()).fold(0, |best, c| if shares[c] > shares[best] { c } else { best });
    if shares.get(best).is_some_and(|share| *share > 0.0) { best as i32 } else { -1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{below, sample_rng, unit};

    /// Gaussians in cells of their own, of 1 m² each.
    fn made_of(scales: Vec<Surfaces>, touching: Vec<[u32; 2]>) -> SceneSurfaces {
        let of = &scales[0].of;
        let is_out = |row: usize| of[row] == NO_SURFACE;
        let cell_of = (0..of.len()).map(|r| if is_out(r) { NO_SURFACE } else { r as u32 });
        SceneSurfaces { cell_of: cell_of.collect(), area: vec![1.0; of.len()], touching, scales }
    }

    fn scale(of: &[u32], count: usize) -> Surfaces {
        Surfaces { of: of.to_vec(), count }
    }

    fn one_hot(labels: &[i32], classes: usize) -> Vec<f32> {
        let of = |&label: &i32| (0..classes as i32).map(move |c| f32::from(u8::from(c == label)));
        labels.iter().flat_map(of).collect::<Vec<f32>>()
    }

    /// So many cells, each of which touches the next one.
    fn chain(cells: u32) -> SceneSurfaces {
        let of: Vec<u32> = (0..cells).collect();
        made_of(vec![scale(&of, of.len())], (1..cells).map(|i| [i - 1, i]).collect())
    }

    /// The labels after they agreed, each Gaussian with a row of shares of its own.
    fn agreed(
        labels: &[i32],
        rows: &[f32],
        found: &SceneSurfaces,
        settings: &AgreeSettings<'_>,
    ) -> (Vec<i32>, Agreed) {
        let row_of: Vec<u32> = (0..labels.len() as u32).collect();
        let shares = ClassShares { row_of: &row_of, rows, num_classes: rows.len() / labels.len() };
        let mut labels = labels.to_vec();
        let agreed = agree(&mut labels, &shares, found, settings).unwrap();
        (labels, agreed)
    }

    #[test]
    fn shares_of_all_scales_are_added() {
        let small = scale(&[0, 0, 1, 1, 1, NO_SURFACE, 2], 3);
        let large = scale(&[0, 0, 0, 0, 0, NO_SURFACE, 1], 2);
        let labels = [3, 0, 0, 0, 2, 2, -1];
        let rows = one_hot(&labels, 4);
        let agreed = |scales: &[Surfaces], own: f32| {
            let settings = AgreeSettings { own, ..AgreeSettings::default() };
            let (labels, agreed) =
                agreed(&labels, &rows, &made_of(scales.to_vec(), Vec::new()), &settings);
            (labels, agreed.changed)
        };
        // Of the first surface one half each: the smaller label.
        assert_eq!(agreed(std::slice::from_ref(&small), 0.0), (vec![0, 0, 0, 0, 0, 2, -1], 2));
        // Unless the Gaussian itself has a say: 3 has 1/2 + 0.3.
        assert_eq!(agreed(std::slice::from_ref(&small), 0.3), (vec![3, 0, 0, 0, 0, 2, -1], 1));
        // In the first 3 has 1/2 + 1/5 and 0 1/2 + 3/5.
        assert_eq!(agreed(&[small.clone(), large], 0.0), (vec![0, 0, 0, 0, 0, 2, -1], 2));
        let other = scale(&[0, 1, 2, 2, 3, 3, 3], 4);
        // 3 has 1/2 + 1, 0 has 1/2; the fifth: 2 has 1/3 + 1, 0 has 2/3.
        assert_eq!(agreed(&[small, other], 0.0), (vec![3, 0, 0, 0, 2, 2, -1], 0));
    }

    #[test]
    fn what_is_surer_counts_for_more() {
        // Two hardly for 1, one surely for 0; the fourth was withheld and has no say.
        let rows = [0.4, 0.6, 0.9, 0.1, 0.0, 1.0];
        let shares = ClassShares { row_of: &[0, 0, 1, 2], rows: &rows, num_classes: 2 };
        let found = made_of(vec![scale(&[0; 4], 1)], Vec::new());
        let mut labels = [1, 1, 0, -1];
        agree(&mut labels, &shares, &found, &AgreeSettings::default()).unwrap();
        // 0 has 1.7 / 3 + 0.3 × 0.4, 1 has 1.3 / 3 + 0.3 × 0.6.
        assert_eq!(labels, [0, 0, 0, -1]);
        let mut labels = [1, 1, 0, -1];
        agree(&mut labels, &shares, &found, &AgreeSettings { own: 2.0, ..Default::default() })
            .unwrap();
        assert_eq!(labels, [1, 1, 0, -1]);
    }

    #[test]
    fn it_is_the_definition_for_any_number_of_threads() {
        let (n, classes) = (3000, 5);
        let mut rng = sample_rng(8, 0, 0);
        let rows: Vec<f32> = (0..400)
            .flat_map(|_| {
                let row: [f32; 5] = std::array::from_fn(|_| unit(&mut rng) as f32);
                let sum: f32 = row.iter().sum();
                row.map(|p| p / sum)
            })
            .collect();
        let row_of: Vec<u32> = (0..n).map(|_| below(&mut rng, 400)).collect();
        let mut of = |count: u32| -> Surfaces {
            let of: Vec<u32> = (0..n).map(|_| below(&mut rng, count)).collect();
            scale(&of, count as usize)
        };
        let scales = vec![of(300), of(40)];
        let mut found = made_of(scales.clone(), Vec::new());
        found.cell_of = of(700).of;
        let shares = ClassShares { row_of: &row_of, rows: &rows, num_classes: classes };
        let labels: Vec<i32> = (0..n).map(|i| if i % 11 == 0 { -1 } else { 0 }).collect();
        let run = |threads: usize| {
            let mut labels = labels.clone();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let agreed = pool
                .install(|| agree(&mut labels, &shares, &found, &AgreeSettings::default()))
                .unwrap();
            (labels, agreed)
        };
        let (once, agreed) = run(1);
        assert_eq!((once.clone(), agreed), run(3));
        let p = |row: usize, c: usize| f64::from(rows[row_of[row] as usize * classes + c]);
        let mut changed = 0;
        for row in 0..n {
            if labels[row] < 0 {
                assert_eq!(once[row], -1);
                continue;
            }
            let due = (0..classes).map(|c| {
                let of_scale = scales.iter().map(|scale| {
                    let same = (0..n).filter(|&r| scale.of[r] == scale.of[row] && labels[r] >= 0);
                    let (sum, count) = same.fold((0.0, 0.0), |(s, n), r| (s + p(r, c), n + 1.0));
                    sum / count
                });
                0.3 * p(row, c) + of_scale.sum::<f64>()
            });
            let due: Vec<f64> = due.collect();
            let most = due.iter().copied().fold(0.0, f64::max);
            assert!(due[once[row] as usize] > most - 1e-5, "{row}: {} of {due:?}", once[row]);
            changed += usize::from(once[row] != labels[row]);
        }
        assert_eq!(agreed, Agreed { changed, small: 0 });
    }

    /// Cells of the floor (0), with a bed (1) that is none, of two cells, and a large one.
    const ROW: [i32; 14] = [0, 0, 0, 1, 1, 0, 0, 2, 1, 1, 1, 1, -1, 1];

    #[test]
    fn pieces_too_small_for_their_class_become_what_is_beside_them() {
        // For 3 speaks most in the second cell of the small bed, but it is beside nothing of the kind.
        let mut rows = one_hot(&ROW, 4);
        rows[3 * 4..][..4].copy_from_slice(&[0.3, 0.6, 0.1, 0.0]);
        rows[4 * 4..][..4].copy_from_slice(&[0.0, 0.6, 0.0, 0.4]);
        let agreed = |least_area: &[f64], keep: f64| {
            let settings = AgreeSettings { least_area, keep, ..AgreeSettings::default() };
            let (labels, agreed) = agreed(&ROW, &rows, &chain(14), &settings);
            (labels, agreed.small)
        };
        let as_they_are = (ROW.to_vec(), 0);
        assert_eq!(agreed(&[], 0.24), as_they_are);
        assert_eq!(agreed(&[0.0, 2.0], 0.24), as_they_are, "two cells are enough");
        let due = vec![0, 0, 0, 0, 0, 0, 0, 2, 1, 1, 1, 1, -1, 1];
        // The last has no neighbor with a label: it stays, however small.
        assert_eq!(agreed(&[0.0, 3.0], 0.24), (due, 2));
        // 0.3 of 1.2 speaks for the floor: just enough above, not here.
        assert_eq!(agreed(&[0.0, 3.0], 0.26), as_they_are);
        // The lone 2 and its neighbors: nothing speaks for them there.
        assert_eq!(agreed(&[0.0, 0.0, 1.5], 0.24), as_they_are);
        assert_eq!(agreed(&[0.0, 0.0, 1.5], 0.0).0[7], 0, "of equal ones the smallest");
        // All are too small: there is nothing that they could be.
        assert_eq!(agreed(&[99.0; 4], 0.0), as_they_are);
    }

    #[test]
    fn small_pieces_grow_with_what_they_become() {
        let least_area = &[0.0, 1.5, 1.5];
        let settings = AgreeSettings { least_area, ..AgreeSettings::default() };
        // 1 1 2 1 1: the 2 is too small, and so is each 1 beside it, until it is gone.
        let labels = [0, 0, 0, 0, 1, 1, 2, 1, 1];
        let mut rows = one_hot(&labels, 3);
        rows[6 * 3..][..3].copy_from_slice(&[0.1, 0.4, 0.5]);
        let (now, done) = agreed(&labels, &rows, &chain(9), &settings);
        assert_eq!((now, done.small), (vec![0, 0, 0, 0, 1, 1, 1, 1, 1], 1));
        // 0 0 0 1 2: beside the 2 there is only a 1 that is too small itself, until it has become 0.
        let labels = [0, 0, 0, 1, 2];
        let mut rows = one_hot(&labels, 3);
        rows[3 * 3..].copy_from_slice(&[0.4, 0.6, 0.0, 0.3, 0.1, 0.6]);
        let (now, done) = agreed(&labels, &rows, &chain(5), &settings);
        assert_eq!((now, done.small), (vec![0; 5], 2));
    }

    #[test]
    fn what_does_not_belong_together_is_refused() {
        let (found, labels) = (chain(14), ROW);
        let (row_of, rows) = (vec![0; labels.len()], vec![0.25; 4]);
        let shares = ClassShares { row_of: &row_of, rows: &rows, num_classes: 4 };
        let run = |labels: &[i32], shares: &ClassShares<'_>, own: f32| {
            let settings = AgreeSettings { own, ..AgreeSettings::default() };
            agree(&mut labels.to_vec(), shares, &found, &settings).map_err(|e| e.to_string())
        };
        assert!(run(&labels, &shares, 0.3).is_ok());
        assert!(run(&labels, &shares, f32::NAN).unwrap_err().starts_with("own: NaN"));
        assert!(run(&labels[1..], &shares, 0.3).unwrap_err().contains("row_of"));
        let far = ClassShares { row_of: &vec![1; labels.len()], ..shares };
        assert!(run(&labels, &far, 0.3).unwrap_err().starts_with("row_of: 1 is"));
        let some = ClassShares { row_of: &row_of[1..], ..shares };
        assert!(run(&labels[1..], &some, 0.3).unwrap_err().contains("surfaces"));
        let none = ClassShares { num_classes: 0, rows: &[], row_of: &[] };
        assert!(run(&[], &none, 0.3).is_err(), "surfaces of other Gaussians");
    }

    #[test]
    fn of_a_small_piece_only_gaussians_of_its_label_take_another() {
        // Three cells in a row, of 1, 3 and 1 Gaussians; one of the second has a label of its own.
        let mut labels = [0, 1, 1, 2, 0];
        let cells = Groups::new(&[0, 1, 1, 1, 2], 3, &labels);
        let share = [1.0, 0.0, 0.0, 0.3, 0.5, 0.2, 1.0, 0.0, 0.0];
        // A 1 has 2 square meters at least and the cell has 1; of 0 it has 0.3, more than 0.25 of 0.5.
        let settings = AgreeSettings { least_area: &[0.0, 2.0], ..AgreeSettings::default() };
        let changed = change_small(&mut labels, &[0, 1, 0], &cells, &share, &chain(3), &settings);
        assert_eq!((labels, changed), ([0, 0, 0, 2, 0], 2));
    }
}
